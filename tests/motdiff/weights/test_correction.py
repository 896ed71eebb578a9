"""Weights of the correction: only files of ours are taken, and the shipped ones mend a kernel."""

import numpy as np
import pytest
import torch

from motdiff.metrics import mnc_subpixel
from motdiff.network.correction import CorrectionNetwork, corrected_kernel
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory
from motdiff.weights import (
    CORRECTION_SCHEMA,
    CORRECTION_WEIGHTS,
    DEFAULT_WEIGHTS,
    load_correction,
)
from motdiff.weights_io import packed, read_card, write_with_card


def write(state, target, **card):
    tensors = packed(state, source=target)
    return write_with_card(tensors, target, schema=CORRECTION_SCHEMA, card=card)


WHOLE = [[0, 0], [9, 2], [14, 12]]


def test_weights_are_read_as_they_were_written(tmp_path):
    torch.manual_seed(0)
    network = CorrectionNetwork()
    torch.nn.init.normal_(network.out.weight)
    size = write(network.state_dict(), tmp_path / "c.safetensors", steps=3)
    assert (tmp_path / "c.safetensors").stat().st_size == size
    assert read_card(tmp_path / "c.safetensors", CORRECTION_SCHEMA) == {"steps": 3}
    found = load_correction(tmp_path / "c.safetensors")
    assert not found.training
    for name, value in network.state_dict().items():
        # 8 bits: half of a 127th of the filter's largest weight
        largest = value.abs().flatten(1).amax(dim=1) if value.ndim > 1 else value.abs()
        bound = largest.view(-1, *(1,) * (value.ndim - 1)) / 254 + 1e-3 * value.abs() + 1e-6
        assert ((found.state_dict()[name] - value).abs() <= bound).all()


def test_other_files_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"is no motdiff\.correction/1 file"):
        load_correction(DEFAULT_WEIGHTS)
    write({"unet.stem.weight": torch.ones(2)}, tmp_path / "c.safetensors")
    with pytest.raises(ValueError, match="its tensors do not fit the network"):
        load_correction(tmp_path / "c.safetensors")
    with pytest.raises(ValueError, match="holds values that float16 cannot"):
        write({"out.bias": torch.tensor([1e6])}, tmp_path / "d.safetensors")
    assert not (tmp_path / "d.safetensors").exists()


def test_the_shipped_ones_are_small_and_in_their_card():
    assert CORRECTION_WEIGHTS.stat().st_size <= 3 * 2**20
    card = read_card(CORRECTION_WEIGHTS, CORRECTION_SCHEMA)
    readme = CORRECTION_WEIGHTS.with_name("README.md").read_text(encoding="utf-8")
    assert f"{card['photos']:,}" in readme
    assert f"{card['kernels']:,}" in readme
    assert card["steps"] == 991 + 1500
    assert "1,500" in readme


def test_the_shipped_ones_find_the_end_that_a_kernel_lacks():
    from skimage import data

    truth = Trajectory.from_samples(WHOLE).psf(63)
    without_end = Trajectory.from_samples(WHOLE[:2]).psf(63)
    photo = blur_valid(data.camera()[60:380, 100:420] / 255.0, truth)
    photo = photo + np.random.default_rng(0).normal(0, 0.005, photo.shape)
    found = corrected_kernel(
        load_correction(), photo[None], without_end, [without_end], sigma=0.005
    )
    assert mnc_subpixel(found, truth) > mnc_subpixel(without_end, truth) + 0.05
