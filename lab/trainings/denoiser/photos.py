"""Photos and motions of the denoiser's training."""

from __future__ import annotations

import zipfile
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor

from motdiff.photo_values import to_display, to_linear
from motdiff.training.motion_bank import MotionMix, drawn_motions
from motdiff.training.photos import load_photos

_LARGE_PX = 500
_SHRINK_LARGE, _SHRINK_SMALL = 0.5, 0.625
_QUALITY = 91
_MOTIONS = 2500
_TIMES = 256  # of each: straight between


def pack_shrunk(source: Path | str, target: Path | str) -> int:
    """Pack a folder's photos, shrunk in linear light; returns the bytes written.

    JPEG halves the resolution of colour: a network that sees it at full size learns that colour
    has no detail.

    Raises
    ------
    ValueError
        If there is no photo.
    """
    with zipfile.ZipFile(target, "w", zipfile.ZIP_STORED) as pack:
        for number, photo in enumerate(load_photos(source, least_px=1, most_px=1_000_000)):
            light = to_linear(photo.numpy().transpose(1, 2, 0) / 255)
            factor = _SHRINK_LARGE if min(light.shape[:2]) >= _LARGE_PX else _SHRINK_SMALL
            smaller = cv2.resize(light, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
            values = np.rint(255 * to_display(smaller.clip(0, 1))).astype(np.uint8)
            whole_colours = [
                cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
                cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
            ]
            _, encoded = cv2.imencode(
                ".jpg", values[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY, *whole_colours]
            )
            pack.writestr(f"{number:05d}.jpg", encoded.tobytes())
    return Path(target).stat().st_size


def random_paths(gyro: Path | str | None, *, seed: int, count: int = _MOTIONS) -> Tensor:
    """Draw motions (count, 256, 2), px: walks, straight, curved and accelerated ones, and of a
    hand where there is a gyroscope's recording.
    """
    mix = MotionMix(
        boracchi_foi=0.3,
        boracchi_foi_short=0.1,
        gyro=0.25 if gyro else 0.0,
        straight=0.2,
        quadratic=0.15,
        gyro_trace=str(gyro or ""),
    )
    times = np.linspace(0, 1, _TIMES)
    motions = drawn_motions(mix, seed=seed, indices=range(count))
    paths = [motion.at(times) for motion in motions]
    return torch.from_numpy(np.array(paths, np.float32))
