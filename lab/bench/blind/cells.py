"""Cells of the blind table: one method measured on one photo."""

from __future__ import annotations

import ctypes
import gc
import math
import time
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lab.bench.blind.cases import RealPhoto, Shot, make_case, real_pair
from lab.bench.psf_text import psf_from_text, psf_to_text
from lab.evaluation.floors import floors, path_kernel, quadratic_kernel
from lab.evaluation.measure import (
    DRAW_FIGURES,
    FIGURES,
    Measured,
    measure_estimator,
    measure_psf,
    restored,
)
from lab.evaluation.methods import named_estimators
from lab.evaluation.metrics import psnr_ssim_up_to_shift
from lab.evaluation.sets import Case, levin_photo
from lab.jobs.cells import Figure
from motdiff.estimators.base import Estimator, MotionEstimate
from motdiff.photo_values import luminance
from motdiff.threads import one_thread
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

FLOORS = ("delta", "gaussian", "mean-kernel")
"""Kernels that know nothing of the photo; the last is the mean of other motions of the kind."""
CEILINGS = ("best-quadratic", "true-path", "true-kernel")
"""Kernels that know all: what a quadratic path, a path without dwell, and the restoration can
reach."""

# a blind kernel may be shifted, and in real photos the position of the true one is unknown
_FARTHEST_PX = 10.0


def measure_simulated(
    *, method: str, photo: Path, motion: Trajectory, shot: Shot, mean: FloatArray | None = None
) -> dict[str, Figure]:
    """Simulate a photo of a sharp scene, estimate its motion and restore it.

    Parameters
    ----------
    method : str
        Name of an estimator of :mod:`lab.evaluation.methods`, of a floor or of a ceiling.
    photo : Path
        Of the sharp scene.
    motion : Trajectory
    shot : Shot
    mean : (S, S) float, optional
        For "mean-kernel".

    Returns
    -------
    dict of :data:`lab.evaluation.measure.FIGURES`, ``wall_s``, ``memory_mib`` and ``psf`` as a
    text

    Raises
    ------
    ValueError
        If the estimator finds no motion, or the file is no photo.
    """
    return _measured(method, make_case(photo, motion, shot), mean)


def measure_levin(*, method: str, photo: Path) -> dict[str, Figure]:
    """Estimate the motion in one of Levin's photos and restore it; otherwise as
    :func:`measure_simulated`.
    """
    return _measured(method, levin_photo(photo), None)


def measure_real(
    *,
    method: str,
    blurred: Path,
    sharp: Path | None,
    crop_px: int,
    gamma: str,
    crop_seed: tuple[int, ...],
) -> dict[str, Figure]:
    """Estimate the motion in a real photo of unknown kernel, and restore it.

    Parameters
    ----------
    method : str
        Of an estimator or a floor other than "mean-kernel".
    blurred : Path
    sharp : Path or None
        Without it there are only times and a confidence.
    crop_px, gamma, crop_seed
        As of :class:`lab.bench.blind.cases.Shot`.

    Returns
    -------
    dict as of :func:`measure_simulated`
    """
    photo, target = real_pair(
        RealPhoto("", "", blurred, sharp), crop_px=crop_px, gamma=gamma, crop_seed=tuple(crop_seed)
    )
    floor = floors().get(method)
    case = Case(photo, floors()["delta"])
    with one_thread():
        figures = (
            _of_estimator(method, case, restore=False)
            if floor is None
            else {"psf": psf_to_text(floor)}
        )
        # figures that need a true kernel
        figures |= dict.fromkeys(
            ("mnc", "mnc_subpixel", "path_mnc", "path_px", "psnr_db", "ssim", *DRAW_FIGURES)
        )
        if target is not None:
            image = restored(luminance(photo), psf_from_text(str(figures["psf"])))
            grey = luminance(target)
            psnr_db, ssim = psnr_ssim_up_to_shift(image, grey, max_shift_px=_FARTHEST_PX)
            figures |= {"psnr_db": psnr_db, "ssim": ssim}
    return figures


@cache
def _estimator(method: str) -> Estimator:
    """Load an estimator once per process: its weights are no part of an estimate's time."""
    (estimator,) = named_estimators([method]).values()
    return estimator


def _measured(method: str, case: Case, mean: FloatArray | None) -> dict[str, Figure]:
    with one_thread():
        psf = _known(method, case, mean)
        if psf is None:
            return _of_estimator(method, case, restore=True)
        return _figures(measure_psf(case, psf))


def _known(method: str, case: Case, mean: FloatArray | None) -> FloatArray | None:
    if method == "true-kernel":
        return case.psf
    if method == "true-path" and case.trajectory is not None:
        return path_kernel(case.trajectory)
    if method == "best-quadratic" and case.trajectory is not None:
        return _best_quadratic(case.trajectory.t.tobytes(), case.trajectory.xy.tobytes())
    return floors(mean).get(method)


@lru_cache(maxsize=8)
def _best_quadratic(t: bytes, xy: bytes) -> FloatArray:
    """Best quadratic path of a motion, searched once for its consecutive photos."""
    return quadratic_kernel(Trajectory(np.frombuffer(t), np.frombuffer(xy).reshape(-1, 2)))


def _of_estimator(method: str, case: Case, *, restore: bool) -> dict[str, Figure]:
    watched = TimedEstimator(_estimator(method))
    measured = measure_estimator(case, watched, restore=restore)
    return {**_figures(measured), "wall_s": watched.wall_s, "memory_mib": watched.memory_mib}


def _figures(measured: Measured) -> dict[str, Figure]:
    values = {name: getattr(measured, name) for name in FIGURES}
    figures = {name: None if math.isnan(value) else value for name, value in values.items()}
    return {**figures, "psf": psf_to_text(measured.psf)}


_CLEAR = Path("/proc/self/clear_refs")
_STATUS = Path("/proc/self/status")


@dataclass
class TimedEstimator:
    """An estimator that records the time and memory of its last estimate.

    Attributes
    ----------
    estimator : Estimator
    wall_s : float or None, seconds
    memory_mib : float or None, MiB
        Peak memory of the process during the estimate, above its memory before; Linux only.
    """

    estimator: Estimator
    wall_s: float | None = None
    memory_mib: float | None = None

    def estimate(self, photo: NDArray[np.float64]) -> MotionEstimate:
        """Estimate as the estimator does."""
        _give_back()
        before = _status_mib("VmRSS") if _forget_peak() else None
        began_s = time.perf_counter()
        motion = self.estimator.estimate(photo)
        self.wall_s = time.perf_counter() - began_s
        peak = _status_mib("VmHWM")
        self.memory_mib = None if before is None or peak is None else max(peak - before, 0.0)
        return motion


def _give_back() -> None:
    """Return freed memory to the system (glibc only): kept, it would hide the need of the next
    estimate.
    """
    gc.collect()
    try:
        ctypes.CDLL(None).malloc_trim(0)
    except (AttributeError, OSError, TypeError):
        return  # another C library


def _forget_peak() -> bool:
    try:
        _CLEAR.write_text("5", encoding="ascii")
    except OSError:
        return False
    return True


def _status_mib(name: str) -> float | None:
    try:
        lines = _STATUS.read_text(encoding="utf-8").splitlines()
    except OSError:
        return None
    sizes = (line.split()[1] for line in lines if line.startswith(f"{name}:"))
    return next((int(size) / 1024 for size in sizes), None)
