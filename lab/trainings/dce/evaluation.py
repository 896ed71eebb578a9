"""PSNR of a learned code and its network on photos outside the training set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.restoration.wiener import wiener
from lab.trainings.dce.weights import WEIGHTS, read_card, restore
from motdiff.metrics import psnr
from motdiff.photo_values import to_linear
from motdiff.psf_frame import PSF_PX
from motdiff.simulate import photograph, visible
from motdiff.training.motion_bank import MotionMix, drawn_motions
from motdiff.training.photos import load_photos
from motdiff.types import FloatArray

_BORDER_PX = PSF_PX // 2  # left out of the PSNR: a deconvolution guesses there
_LEAST_PX = 3 * PSF_PX - 1  # at least a PSF is left inside the borders
_MOST_PX = 5 * PSF_PX - 1


@dataclass(frozen=True)
class EvaluationRow:
    """Mean PSNR, dB, over all photos taken with one code; linear light, full scale 1, borders left
    out.

    Attributes
    ----------
    name : str
    code : ShutterCode
    as_taken_db : float
        Of the photo over the code's duty: nothing is restored.
    network_db : float
        Of the network; the motion is no input.
    wiener_db : float
        Of the Wiener filter with the true motion and noise.
    gain_error_db : float
        Standard error of the network's mean gain over nothing.
    """

    name: str
    code: ShutterCode
    as_taken_db: float
    network_db: float
    wiener_db: float
    gain_error_db: float


def scenes_of(photos: Path) -> list[FloatArray]:
    """Green channel, linear light, of the middle (at most 319 x 319 px) of every photo of a
    folder, large enough.
    """
    scenes = []
    for photo in load_photos(photos, least_px=_LEAST_PX):
        green = photo[1].numpy() / 255
        rows, columns = (
            slice(max(0, (n - _MOST_PX) // 2), (n + _MOST_PX) // 2) for n in green.shape
        )
        scenes.append(to_linear(green[rows, columns]))
    return scenes


def evaluate(
    scenes: Sequence[FloatArray],
    mix: MotionMix,
    *,
    count: int,
    seed: int,
    sigma: float = 0.01,
    weights: Path = WEIGHTS,
) -> tuple[EvaluationRow, ...]:
    """Take and restore ``count`` photos with each of: the learned code, the one it began with, the
    open shutter.

    Parameters
    ----------
    scenes : sequence of (H, W) float, linear light
        Sharp, taken in turn.
    mix : MotionMix
        Motions to draw; every code meets the same ones, and the same noise.
    count, seed : int
    sigma : float
        Standard deviation of the noise, full scale 1.
    weights : path
        Weights file.

    Raises
    ------
    ValueError
        If there is no scene, one is smaller than 191 x 191 px, ``count`` is below 1, or the file
        is not one of ours.
    """
    if count < 1:
        raise ValueError(f"count: must be at least 1, got {count}")
    smallest = min((min(scene.shape) for scene in scenes), default=0)
    if smallest < _LEAST_PX:
        raise ValueError(
            f"scenes: must be at least {_LEAST_PX} x {_LEAST_PX} px, got a side of {smallest} px"
        )
    card = read_card(weights)
    codes = {
        "learned": card.code,
        "start": card.start,
        "open shutter": ShutterCode("1" * card.code.chips),
    }
    scores: dict[str, list[tuple[float, float, float]]] = {name: [] for name in codes}
    for number, motion in enumerate(drawn_motions(mix, seed=seed, indices=range(count))):
        scene = scenes[number % len(scenes)]
        sharp = visible(scene, PSF_PX)
        for name, code in codes.items():
            psf = coded_psf(motion, code, PSF_PX)
            rng = np.random.default_rng([seed, number, 1])  # the same draw for every code
            # not clipped, as in training
            photo = photograph(scene, psf, rng=rng, read_sigma=sigma, record=np.asarray)
            by_wiener = wiener(photo, psf, noise_variance=sigma**2)
            by_network = restore(photo, code=code, path=weights)
            scores[name].append(
                (
                    _psnr(photo / code.duty, sharp),
                    _psnr(by_network, sharp),
                    _psnr(by_wiener, sharp),
                )
            )
    return tuple(_row(name, codes[name], np.array(figures)) for name, figures in scores.items())


def _row(name: str, code: ShutterCode, figures: FloatArray) -> EvaluationRow:
    photo, network, by_wiener = figures.mean(axis=0).tolist()
    gains = figures[:, 1] - figures[:, 0]
    error = float(gains.std(ddof=1) / np.sqrt(gains.size)) if gains.size > 1 else float("nan")
    return EvaluationRow(name, code, photo, network, by_wiener, error)


def _psnr(image: FloatArray, sharp: FloatArray) -> float:
    inside = (slice(_BORDER_PX, -_BORDER_PX), slice(_BORDER_PX, -_BORDER_PX))
    return psnr(np.clip(image[inside], 0, 1), sharp[inside])
