"""Stages of the coded-exposure table as pure functions: estimate a motion, choose a code, take and
restore a photo.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from functools import lru_cache
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from cep.optics.camera import Camera
from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.proofs.measure import CodeMetrics, measure
from cep.restoration.direction import detect_direction
from cep.restoration.registry import find_method
from cep.restoration.restore import find_psf, restore
from lab.bench.coded.designs import MotionPrior, design_code
from lab.bench.coded.protocol import paths_from, paths_to
from lab.bench.datasets import Cut, sharp_scene
from lab.bench.psf_text import psf_from_text, psf_to_text
from lab.evaluation.metrics import laid_on, psnr_ssim_up_to_shift
from motdiff.metrics import mnc_subpixel
from motdiff.psf_frame import PSF_PX, moved
from motdiff.simulate import visible
from motdiff.threads import one_thread
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

_ZERO = 1e-9
_CROP_PX = 32  # left out of every comparison: restored borders lean on a guess


@dataclass(frozen=True)
class Exposure:
    """How a scene is photographed: the true motion, the code, the light and the sensor.

    Attributes
    ----------
    motion : Trajectory
    bits : str
    light_true : bool
        Whether the photo has the code's light, or as much as with an open shutter.
    camera : Camera
    borders : {"real", "symmetric"}
    seed : int
    """

    motion: Trajectory
    bits: str
    light_true: bool
    camera: Camera
    borders: str
    seed: int

    @property
    def code(self) -> ShutterCode:
        """The code that the shutter plays."""
        return ShutterCode(self.bits)

    @property
    def gain(self) -> float:
        """Light of the photo, relative to what comes through the code."""
        return 1.0 if self.light_true else 1 / self.code.duty

    def psf(self) -> FloatArray:
        """PSF of the motion through the code, (64, 64); its sum is the share of open chips."""
        return coded_psf(self.motion, self.code, PSF_PX)

    def photo(self, scene: ArrayLike) -> FloatArray:
        """Take the photo of a scene (H, W), linear light 0..1."""
        return capture(
            np.asarray(scene, dtype=np.float64),
            self.gain * self.psf(),
            camera=self.camera,
            rng=np.random.default_rng([self.seed, 3]),
            borders=self.borders,
        )


def take_photo(scene: ArrayLike, exposure: Exposure, **restored_by: Any) -> dict[str, float]:
    """Compare the restored photo of :func:`photographed`, whose parameters these are.

    Returns
    -------
    dict with ``psnr_db`` and ``ssim`` (linear light, up to shift), ``noise_gain_db`` and
    ``reversed_noise_gain_db`` (along the true motion and against it, at the light that the photo
    has; infinite on a straight, even motion whose MTF has a zero), and ``min_mtf`` (light-true)
    """
    photo = photographed(scene, exposure, **restored_by)
    along, against = _both_ways(paths_to([exposure.motion], [1.0]), exposure.bits)
    lent_db = 0.0 if exposure.light_true else 20 * math.log10(exposure.code.duty)
    psnr_db, ssim = psnr_ssim_up_to_shift(photo.restored, photo.target, crop_px=_CROP_PX)
    return {
        "psnr_db": psnr_db,
        "ssim": ssim,
        "noise_gain_db": _gain_db(along) + lent_db,
        "reversed_noise_gain_db": _gain_db(against) + lent_db,
        "min_mtf": along.min_mtf,
    }


@lru_cache(
    maxsize=4096
)  # every photo is taken with the same motions, and most codes do not depend on the photo
def _both_ways(motion: str, bits: str) -> tuple[CodeMetrics, CodeMetrics]:
    """Measure a code along a motion and against it."""
    path = paths_from(motion)[0][0]
    code = ShutterCode(bits)
    return measure(path, code, budget=0), measure(path.reversed(), code, budget=0)


def _gain_db(metrics: CodeMetrics) -> float:
    # on a line of zeros, as an open shutter has on straight motion, samples near it would give any
    # figure
    if metrics.min_chip is not None and metrics.min_mtf < _ZERO:
        return math.inf
    return metrics.noise_gain_db


@dataclass(frozen=True)
class Taken:
    """Images behind one row of figures: linear light, (H, W), and the true coded PSF, (64, 64)."""

    photo: FloatArray
    psf: FloatArray
    restored: FloatArray
    target: FloatArray


def photographed(
    scene: ArrayLike,
    exposure: Exposure,
    *,
    assumed: Trajectory | None = None,
    kernel: str | None = None,
    restoration: str,
    border_rounds: int,
) -> Taken:
    """Take a coded photo along the true motion, and restore it.

    Parameters
    ----------
    scene : (H, W) array_like, linear light 0..1
    exposure : Exposure
    assumed : Trajectory, optional
        Path given to the restoration, of unknown direction unless stated otherwise.
    kernel : str, optional
        Kernel given instead, as of :func:`find_kernel`. Without either, the true PSF is given.
    restoration : str
        The Wiener filter has the camera's noise.
    border_rounds : int
        Rounds of reblurring outside the photo's borders, for a restoration that takes them.
    """
    code = exposure.code
    psf = exposure.psf()
    scale = exposure.gain
    light = np.asarray(scene, dtype=np.float64)
    photo = exposure.photo(light)
    rest_px = np.zeros(2)
    if kernel is not None:
        restoration_psf = scale * code.duty * laid_on(psf, psf_from_text(kernel))
    else:
        estimate = psf
        if assumed is not None:
            estimate = _assumed_psf(photo / scale, assumed, code)
        # A photo does not determine the position of its scene: on a straight path a short exposure
        # at the end has the PSF of one at the start, displaced. Restored with either, the scene
        # has the same quality at another position.
        away_px = _displacement_px(estimate, psf)
        whole_px = np.round(away_px).astype(int)
        restoration_psf = scale * moved(estimate, down_px=whole_px[0], right_px=whole_px[1])
        rest_px = whole_px - away_px
    options: dict[str, Any] = {}
    if "border_rounds" in signature(find_method(restoration)[1]).parameters:
        options["border_rounds"] = border_rounds
    if restoration == "wiener":
        options["camera"] = exposure.camera
    restored = restore(photo, restoration_psf, method=restoration, **options).image
    if rest_px.any():
        restored = ndimage.shift(restored, rest_px, order=5, mode="nearest")
    restored = np.clip(restored, 0, 1)
    return Taken(photo, psf, restored, visible(light, PSF_PX, borders=exposure.borders))


def find_kernel(scene: ArrayLike, exposure: Exposure) -> dict[str, float | str]:
    """Find the kernel in the photo of :func:`photographed` as ``cep deblur`` does.

    Returns
    -------
    dict with ``psf`` of sum 1 (:func:`lab.bench.psf_text.psf_to_text`), ``mnc`` (sub-pixel),
    ``confidence``, ``cpu_s``
    """
    photo = exposure.photo(scene)
    started = time.process_time()
    with one_thread():
        # a photo of as much light as through an open shutter has its kernel's sum
        blind = find_psf(photo, exposure.code if exposure.light_true else ShutterCode("1"))
    return {
        "psf": psf_to_text(blind.psf),
        "mnc": mnc_subpixel(blind.psf, exposure.psf()),
        "confidence": blind.confidence,
        "cpu_s": time.process_time() - started,
    }


def _displacement_px(psf: FloatArray, moved_psf: FloatArray) -> FloatArray:
    """Displacement of the centroid of ``moved_psf`` from that of ``psf``, (2,): down and right."""
    start, end = (
        np.array(ndimage.center_of_mass(kernel)) - np.array(kernel.shape) // 2
        for kernel in (psf, moved_psf)
    )
    return np.asarray(end - start, dtype=np.float64)


def _assumed_psf(photo: FloatArray, path: Trajectory, code: ShutterCode) -> FloatArray:
    if path.direction == "known" or code.bits == code.bits[::-1]:
        return coded_psf(path, code, path.frame_size(PSF_PX))
    return detect_direction(photo, path, code).psf


def choose_code(
    prior: MotionPrior,
    *,
    design: str,
    chips: int,
    open_range: tuple[int, int],
    objective: str,
    camera: Camera,
    steps: int,
    seed: int,
) -> dict[str, float | str]:
    """Choose the code of a design of :mod:`lab.bench.coded.designs`: ``bits`` and ``cpu_s``."""
    started = time.process_time()
    code = design_code(
        design,
        prior,
        chips=chips,
        open_range=open_range,
        objective=objective,
        camera=camera,
        steps=steps,
        rng=np.random.default_rng([seed, 2]),
    )
    return {"bits": code.bits, "duty": code.duty, "cpu_s": time.process_time() - started}


def estimate_motion(
    scene: ArrayLike,
    motion: Trajectory,
    *,
    method: str,
    borders: str,
    camera: Camera,
    seed: int,
) -> dict[str, float | str]:
    """Take the calibration photo, shutter open, and estimate the motion from it.

    Parameters
    ----------
    scene : (H, W) array_like, linear light 0..1
    motion : Trajectory
    method : str
        Name of an estimator of :mod:`lab.evaluation.methods`.
    borders : {"real", "symmetric"}
    camera : Camera
    seed : int

    Returns
    -------
    dict with ``paths``, ``mnc`` (sub-pixel, of the path's own PSF), ``cpu_s``
    """
    from lab.evaluation.methods import named_estimators
    from motdiff.estimators.description import as_estimate

    rng = np.random.default_rng([seed, 1])
    photo = capture(scene, motion.psf(PSF_PX), camera=camera, rng=rng, borders=borders)
    estimator = named_estimators([method])[method]
    started = time.process_time()
    result = estimator.estimate(np.clip(photo, 0, 1))
    seconds = time.process_time() - started
    estimate = as_estimate(result, method)
    path = estimate.trajectories[0]
    return {
        "paths": paths_to(estimate.trajectories, estimate.weights),
        "mnc": mnc_subpixel(path.psf(path.frame_size(PSF_PX)), motion.psf(PSF_PX)),
        "cpu_s": seconds,
    }


def motion_of(photo: Path, cut: Cut, **arguments: Any) -> dict[str, float | str]:
    """Estimate a motion, as :func:`lab.bench.coded.stages.estimate_motion` does."""
    return estimate_motion(sharp_scene(photo, cut), **arguments)


def kernel_of(photo: Path, cut: Cut, **arguments: Any) -> dict[str, float | str]:
    """Find the kernel of a photo, as :func:`lab.bench.coded.stages.find_kernel` does."""
    return find_kernel(sharp_scene(photo, cut), **arguments)


def photo_of(photo: Path, cut: Cut, **arguments: Any) -> dict[str, float]:
    """Take and compare a photo, as :func:`lab.bench.coded.stages.take_photo` does."""
    return take_photo(sharp_scene(photo, cut), **arguments)


def pictures_of(photo: Path, cut: Cut, **arguments: Any) -> Taken:
    """Images of the photo of :func:`photo_of`."""
    return photographed(sharp_scene(photo, cut), **arguments)
