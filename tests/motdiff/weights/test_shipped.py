"""The weights in the package: they load, say what they are, and draw what they drew when they were
shipped."""

import json
from pathlib import Path

import numpy as np
import torch

from motdiff.estimators.motdiff.drawing import draw_psfs
from motdiff.metrics import mnc_subpixel
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory
from motdiff.weights import DEFAULT_WEIGHTS, load_network, read_network_card

RECORDED = Path(__file__).with_name("shipped_psf.json")
BENT = Trajectory.from_samples([[0, 0], [9, 2], [14, 12]])


def gaussian(sigma_px):
    d = np.arange(64) - 32
    psf = np.exp(-(d[:, None] ** 2 + d[None, :] ** 2) / (2 * sigma_px**2))
    return psf / psf.sum()


def mean_draw():
    """Mean of four draws on a blurred scikit-image photo; told of kernels that no rounding can tip
    over."""
    from skimage import data

    photo = blur_valid(data.camera()[60:380, 100:420] / 255.0, BENT.psf(65))
    told = np.stack([BENT.psf(64), gaussian(3.0), gaussian(6.0)])
    drawn = draw_psfs(
        load_network(),
        photo[None],
        told,
        count=4,
        steps=10,
        generator=torch.Generator().manual_seed(0),
    )
    return drawn.mean(axis=0)


def test_they_are_small_and_say_what_they_are():
    assert DEFAULT_WEIGHTS.stat().st_size <= 15 * 2**20
    card = read_network_card(DEFAULT_WEIGHTS)
    assert card["run"]["steps"] > 0
    assert {"photos", "samples", "validation"} <= set(card["card"])
    readme = DEFAULT_WEIGHTS.with_name("README.md").read_text(encoding="utf-8")
    assert f"{card['run']['steps']:,}" in readme


def test_they_draw_what_they_drew_when_they_were_shipped():
    psf = mean_draw()
    recorded = np.array(json.loads(RECORDED.read_text(encoding="utf-8")))
    assert mnc_subpixel(psf, BENT.psf(64)) > mnc_subpixel(gaussian(3.0), BENT.psf(64))
    blocks = psf.reshape(16, 4, 16, 4).sum(axis=(1, 3))
    np.testing.assert_allclose(blocks, recorded, atol=0.02)


if __name__ == "__main__":  # after new weights: records what they draw
    found = mean_draw().reshape(16, 4, 16, 4).sum(axis=(1, 3))
    RECORDED.write_text(json.dumps(np.round(found, 4).tolist()) + "\n", encoding="utf-8")
