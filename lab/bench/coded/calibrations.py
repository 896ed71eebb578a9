"""Calibrations of the table by photos that tell more than one open photo: through known codes, or
of a point light.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from cep.calibration.order_codes import gray_planes
from cep.codes.sources import load_codes
from cep.files.images import read_image
from cep.optics.camera import Camera
from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from cep.optics.exposure import shifted_psf
from lab.bench.coded.protocol import paths_to
from motdiff.crops import pick_crops
from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.coded.codes import check_codes
from motdiff.metrics import mnc_subpixel, timed_distance_px
from motdiff.photo_values import luminance
from motdiff.psf_frame import in_frame
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

CALIBRATIONS: Mapping[str, str] = {
    "open + one": "designed2",
    "open + three": "open+gray3",
}
"""Set of codes behind each kind of path that is found from coded photos; see
:func:`codes_of_set`."""
POINT = "point"
"""Kind of path that is found from a point light."""

_SHIFT_PX = 2.0  # of a photo, at most, on each axis
_LIT = 0.8  # of full scale: the brightest point of a light's streak, and what is around it
_DARK = 0.01
_AROUND_PX = 160
_LIGHT_CODE = "raskar-52"  # its gaps are short: where a code is closed a trail shows nothing


def codes_of_set(name: str, chips: int) -> tuple[str, ...]:
    """Bits of a set of calibration codes, one per photo.

    Parameters
    ----------
    name : str
        Parts joined by ``+``: ``open``; ``grayN``, the N bit planes of a Gray code; ``designedN``,
        the set that ``cep calibration-set`` designs for N photos; ``half``, the first half open;
        bits, a published code's name or a file.
    chips : int
        Of the codes that have no length of their own.

    Raises
    ------
    ValueError
        If a part is no code, or no order can be told through the codes.

    Examples
    --------
    >>> codes_of_set("open+gray2", 8)
    ('11111111', '00001111', '00111100')
    """
    sources: list[str] = []
    for name_part in name.split("+"):
        kind = name_part.rstrip("0123456789")
        count = name_part.removeprefix(kind)
        if kind == "gray" and count:
            sources += [ShutterCode(plane).bits for plane in gray_planes(int(count), chips)]
        elif kind == "designed" and count:
            from cep.calibration.calibration_set import calibration_set

            sources += [
                code.bits
                for code in calibration_set(int(count), chips=chips, rng=_design_rng()).codes
            ]
        elif name_part == "half":
            sources.append("1" * (chips // 2) + "0" * (chips - chips // 2))
        else:
            sources.append(name_part)
    codes = tuple(code.bits for code in load_codes(sources))
    check_codes(codes)
    return codes


def _design_rng() -> np.random.Generator:
    return np.random.default_rng(0)  # the default seed of cep calibration-set


def set_of_codes(*, name: str, chips: int) -> dict[str, str]:
    """Return ``codes``, those of :func:`codes_of_set` with spaces between them: the figures of a
    cell.
    """
    return {"codes": " ".join(codes_of_set(name, chips))}


def moved_psfs(
    paths: Sequence[Trajectory], codes: Sequence[str], shifts_px: ArrayLike
) -> FloatArray:
    """Light-true PSFs of photos of one motion, each through its own code and moved by its own
    shift.

    Parameters
    ----------
    paths : sequence of I Trajectory
        Of each photo.
    codes : sequence of I str
        Bits.
    shifts_px : (I, 2) array_like, px
        Of the middle of each path's bounding box, (x, y).

    Returns
    -------
    (I, S, S) float, the smallest odd frame that holds them all, zero displacement at index ``S //
    2``
    """
    psfs = [
        shifted_psf(path, ShutterCode(bits), shift_px - _middle_px(path))
        for path, bits, shift_px in zip(
            paths, codes, np.asarray(shifts_px, dtype=np.float64), strict=True
        )
    ]
    frame = max(map(len, psfs))
    return np.stack([in_frame(psf, frame) for psf in psfs])


def _middle_px(path: Trajectory) -> FloatArray:
    """Middle of the path's bounding box."""
    return np.asarray(0.5 * (path.xy.min(axis=0) + path.xy.max(axis=0)), dtype=np.float64)


def calibration_photos(
    scene: ArrayLike,
    path: Trajectory,
    codes: Sequence[str],
    *,
    camera: Camera,
    rng: np.random.Generator,
    borders: str,
    light_true: bool,
) -> list[FloatArray]:
    """Take photos of a motion through codes, each moved by up to 2 px of its own.

    Parameters
    ----------
    scene : (H, W) array_like, linear light 0..1
    path : Trajectory
    codes : sequence of str
        Bits.
    camera : Camera
    rng : numpy Generator
    borders : {"real", "symmetric"}
    light_true : bool
        Whether each photo has its code's light, or as much as with an open shutter.

    Returns
    -------
    list of (h, w) float, linear light 0..1, all of one size
    """
    shifts_px = rng.uniform(-_SHIFT_PX, _SHIFT_PX, (len(codes), 2))
    psfs = moved_psfs([path] * len(codes), codes, shifts_px)
    exposures = (
        capture(
            scene, psf if light_true else psf / psf.sum(), camera=camera, rng=rng, borders=borders
        )
        for psf in psfs
    )
    return [np.clip(photo, 0, 1) for photo in exposures]


def motion_from_codes(
    photo: Path,
    *,
    side_px: int,
    gamma: Literal["linear", "srgb"],
    motion: Trajectory,
    codes: str,
    borders: str,
    light_true: bool,
    camera: Camera,
    seed: int,
) -> dict[str, float | str]:
    """Calibrate by coded photos of the most textured part of a photo.

    Parameters
    ----------
    photo : Path
    side_px : int
        Of the scene.
    gamma : {"linear", "srgb"}
        As of :class:`lab.bench.datasets.Cut`.
    motion : Trajectory
    codes : str
        Of :func:`set_of_codes`.
    borders, light_true
        As of :func:`calibration_photos`.
    camera : Camera
    seed : int

    Returns
    -------
    dict with ``paths``, ``mnc`` (sub-pixel, of the best path's own PSF), ``error_px`` (rms
    distance at equal times, after the best shift), ``confidence``, ``cpu_s``
    """
    from motdiff.estimators.coded.estimator import CodedEstimator

    bits = codes.split()
    photos = calibration_photos(
        _textured(photo, side_px, gamma),
        motion,
        bits,
        camera=camera,
        rng=np.random.default_rng([seed, 7]),
        borders=borders,
        light_true=light_true,
    )
    started = time.process_time()
    estimate = CodedEstimator(bits, seed=seed).estimate_from(photos)
    return _figures(estimate, motion, time.process_time() - started)


def motion_from_light(*, motion: Trajectory, camera: Camera, seed: int) -> dict[str, float | str]:
    """Calibrate by a point light's trail through Raskar's code; as :func:`motion_from_codes`
    otherwise.

    The light is as bright as it may be without saturating.
    """
    from motdiff.estimators.coded.trail_estimator import TrailEstimator

    rng = np.random.default_rng([seed, 8])
    codes = codes_of_set(_LIGHT_CODE, 0)
    (psf,) = moved_psfs([motion], codes, rng.uniform(-_SHIFT_PX, _SHIFT_PX, (1, 2)))
    side_px = len(psf) + _AROUND_PX
    night = np.full((side_px, side_px), _DARK)
    night[side_px // 2, side_px // 2] += _LIT / psf.max()
    photo = capture(night, psf, camera=camera, rng=rng)
    started = time.process_time()
    estimate = TrailEstimator(codes, seed=seed).estimate(np.clip(photo, 0, 1))
    return _figures(estimate, motion, time.process_time() - started)


def _textured(photo: Path, side_px: int, gamma: Literal["linear", "srgb"]) -> FloatArray:
    """Most textured square of a photo's light: what a photographer would calibrate on."""
    light = luminance(read_image(photo, gamma=gamma))
    row, column = pick_crops(light, size=side_px, count=1)[0]
    return light[row : row + side_px, column : column + side_px]


def _figures(estimate: MotionEstimate, truth: Trajectory, cpu_s: float) -> dict[str, float | str]:
    path = estimate.best
    size = max(path.frame_size(), truth.frame_size())
    directions = (path,) if path.direction == "known" else (path, path.reversed())
    return {
        "paths": paths_to(estimate.trajectories, estimate.weights),
        "mnc": mnc_subpixel(path.psf(size), truth.psf(size)),
        "error_px": min(timed_distance_px(directed, truth) for directed in directions),
        "confidence": estimate.confidence,
        "cpu_s": cpu_s,
    }
