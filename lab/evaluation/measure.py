"""Figures of one method on one photo: kernel, path, restored photo, confidence, time."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from lab.evaluation.draws import measure_draws
from lab.evaluation.metrics import laid_on, psnr_ssim_up_to_shift
from lab.evaluation.sets import Case
from motdiff.estimators.base import Estimator, MotionEstimate
from motdiff.estimators.description import as_estimate
from motdiff.metrics import mnc, mnc_subpixel, path_distance_px
from motdiff.photo_values import luminance
from motdiff.psf_frame import PSF_PX
from motdiff.types import FloatArray

DRAW_FIGURES = ("best_draw", "draws_alike", "covered")
"""Names of the figures of :class:`Measured` that only several draws have."""

FIGURES = (
    "mnc",
    "mnc_subpixel",
    "path_mnc",
    "path_px",
    "psnr_db",
    "ssim",
    "confidence",
    "cpu_s",
    *DRAW_FIGURES,
)
"""Names of the figures of :class:`Measured`."""

_LEAST_WEIGHT = 2e-4
_MOST_WEIGHT = 2e-3
_WEIGHT_PER_VARIANCE = 2.5
_NAN = math.nan

RESTORATION = (
    f"L0 gradients, whose weight is {_WEIGHT_PER_VARIANCE:g} times the variance of the noise found"
    f" in the photo, {_LEAST_WEIGHT:g} (PMP's) at least and {_MOST_WEIGHT:g} at most"
)
"""What :func:`restored` does, in words for a report."""


@dataclass(frozen=True)
class Measured:
    """Figures of one kernel on one photo; NaN where there is nothing to measure.

    Attributes
    ----------
    psf : (S, S) float
        The kernel.
    mnc, mnc_subpixel : float
        Of the PSF with the true one, over whole pixels and over 0.05 px.
    path_mnc : float
        Sub-pixel MNC of the PSF that the trajectory draws by itself.
    path_px : float, px
        :func:`motdiff.metrics.path_distance_px` to the true trajectory.
    psnr_db, ssim : float
        Of the photo's luminance restored with the PSF, up to shift.
    confidence : float
        Of the estimate, 0..1.
    cpu_s : float, seconds
        Processor time of the estimate, all threads, including earlier runs of a resumed estimate.
    best_draw, draws_alike, covered : float
        Of an estimate with several draws, as in :class:`lab.evaluation.draws.DrawFigures`;
        ``covered`` is 0 or 1.
    """

    psf: FloatArray
    mnc: float
    mnc_subpixel: float
    path_mnc: float = _NAN
    path_px: float = _NAN
    psnr_db: float = _NAN
    ssim: float = _NAN
    confidence: float = _NAN
    cpu_s: float = _NAN
    best_draw: float = _NAN
    draws_alike: float = _NAN
    covered: float = _NAN


def measure_psf(case: Case, psf: FloatArray, *, restore: bool = True) -> Measured:
    """Measure a kernel that no estimator found: a floor or a ceiling.

    Parameters
    ----------
    case : Case
    psf : (S, S) float
    restore : bool
        Whether the photo is restored, where there is a sharp one.

    Raises
    ------
    ValueError
        If the kernel is not finite, or zero.
    """
    psnr_db, ssim = _restoration(case, psf) if restore else (_NAN, _NAN)
    return Measured(
        psf, mnc(psf, case.psf), mnc_subpixel(psf, case.psf), psnr_db=psnr_db, ssim=ssim
    )


def measure_estimator(case: Case, estimator: Estimator, *, restore: bool = True) -> Measured:
    """Run an estimator on the photo and measure its result.

    An estimate resumed from a checkpoint has its earlier processor time in its details, as
    ``earlier_cpu_s``.

    Parameters
    ----------
    case : Case
    estimator : Estimator
    restore : bool
        Whether the photo is restored, where there is a sharp one.

    Raises
    ------
    ValueError
        If the estimator finds no motion, or none that can be measured.
    """
    began_s = time.process_time()
    returned = estimator.estimate(case.photo)
    cpu_s = time.process_time() - began_s
    estimate = as_estimate(returned, type(estimator).__name__)
    cpu_s += _earlier_cpu_s(estimate)
    psf_figures = measure_psf(case, estimate.psf, restore=restore)
    path_mnc, path_px = _path_figures(case, estimate)
    figures = replace(
        psf_figures,
        path_mnc=path_mnc,
        path_px=path_px,
        confidence=estimate.confidence,
        cpu_s=cpu_s,
    )
    if len(estimate.draws) < 2:
        return figures
    draw_figures = measure_draws(estimate.draws, case.psf)
    return replace(
        figures,
        best_draw=draw_figures.best,
        draws_alike=draw_figures.alike,
        covered=float(draw_figures.covered),
    )


def restored(photo: FloatArray, psf: FloatArray) -> FloatArray:
    """Restore a photo with a known kernel: L0 gradients on a periodic extension, weighted by the
    photo's noise.

    Parameters
    ----------
    photo : (H, W) float, linear light 0..1
    psf : (S, S) float, sum 1, zero displacement at index ``S // 2``

    Returns
    -------
    (H, W) float, 0..1

    References
    ----------
    Xu, Zheng, Jia, "Unnatural L0 sparse representation for natural image deblurring", CVPR 2013.
    """
    import torch

    from motdiff.blind_search.grids import fast_size, periodic_extension
    from motdiff.blind_search.latent import Coupling, l0_pmp_latent
    from motdiff.photo_noise import noise_sigma

    height, width = photo.shape
    # 2.5 sigma^2 is near the best of 1e-4..1e-2 at sigma 0.01 and 0.03; without noise PMP's 2e-4
    # for Levin's photos
    weight = min(max(_WEIGHT_PER_VARIANCE * noise_sigma(photo) ** 2, _LEAST_WEIGHT), _MOST_WEIGHT)
    with torch.no_grad():
        blurred = torch.from_numpy(np.ascontiguousarray(photo, dtype=np.float32))[None]
        kernel = torch.from_numpy(np.ascontiguousarray(psf, dtype=np.float32))[None]
        rows, columns = (fast_size(n + s - 1) for n, s in zip(photo.shape, psf.shape, strict=True))
        wide = periodic_extension(blurred, (rows, columns))
        latent = l0_pmp_latent(
            wide,
            kernel,
            intensity_weight=0.0,
            gradient_weight=weight,
            patch_px=1,
            coarse=False,
            coupling=Coupling(),
        )
    return np.asarray(latent[0, :height, :width].double().clamp(0, 1).numpy(), dtype=np.float64)


def _earlier_cpu_s(estimate: MotionEstimate) -> float:
    earlier = estimate.details.get("earlier_cpu_s", 0.0)
    return float(earlier) if isinstance(earlier, int | float) else 0.0


def _path_figures(case: Case, estimate: MotionEstimate) -> tuple[float, float]:
    path = estimate.trajectories[0]
    path_psf = path.psf(path.frame_size(PSF_PX))
    distance_px = _NAN if case.trajectory is None else path_distance_px(path, case.trajectory)
    return mnc_subpixel(path_psf, case.psf), distance_px


def _restoration(case: Case, psf: FloatArray) -> tuple[float, float]:
    if case.sharp is None:
        return _NAN, _NAN
    sharp = luminance(case.sharp)
    image = restored(luminance(case.photo), laid_on(case.psf, psf))
    return psnr_ssim_up_to_shift(image, sharp)
