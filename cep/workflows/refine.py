"""A calibration improved by coded photos that were taken with its motion."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.optics.path_limits import check_resolved
from cep.restoration.direction import compare_psfs, detect_direction
from cep.workflows.calibrate import check_photo
from motdiff.estimators.base import Estimator
from motdiff.estimators.coded.codes import check_codes
from motdiff.estimators.coded.starts import orders
from motdiff.psf_frame import PSF_PX
from motdiff.trajectory import Trajectory

if TYPE_CHECKING:
    from motdiff.estimators.coded.refine import RefinedPath

__all__ = ["USUAL_UNCERTAINTY_PX", "Refinement", "refine_motion"]

FloatArray = NDArray[np.float64]

USUAL_UNCERTAINTY_PX = 1.0
"""Error of a calibration, rms over time, where none is stated."""
_FITTED = 0.9  # of the time
_ORDER_KNOTS, _MOST_ORDERS = 201, 24
_SURE = 0.8  # of the test on the photo, which errs below it: docs/decisions/motion-estimation.md
_LEAST_GAIN = 212.0  # twice the coordinates of the fitted knots: what noise alone gains
_SAME_PX = 1.0


@dataclass(frozen=True)
class Refinement:
    """A calibration and what coded photos made of it.

    Attributes
    ----------
    trajectory : Trajectory
        The refined path, or the given one where that explains the photos as well; in the order in time that two or
        more photos of one scene show.
    kept : {"refined", "given"}
    confidence : float
        Probability that the refined path is the better one.
    uncertainty_px : float
        Expected error of ``trajectory``, rms over time.
    moved_px : float
        Rms distance of the refined path from the given one in the order found; 0 where that is kept.
    given_misfit, misfit : float or None
        Of photos of one scene along the given path and along ``trajectory``: multiples of what noise leaves; None
        where only the photos' kernels could be compared.
    warnings : tuple of str
    seconds : float
    """

    trajectory: Trajectory
    kept: Literal["refined", "given"]
    confidence: float
    uncertainty_px: float
    moved_px: float
    given_misfit: float | None
    misfit: float | None
    warnings: tuple[str, ...]
    seconds: float


def refine_motion(
    photos: Sequence[ArrayLike],
    codes: Sequence[ShutterCode],
    trajectory: Trajectory,
    *,
    uncertainty_px: float = USUAL_UNCERTAINTY_PX,
    kernels: Estimator | None = None,
    progress: Callable[[float, str], None] = lambda _share, _what: None,
) -> Refinement:
    """Improve a path by photos that were taken of its motion through known codes.

    Two or more photos of one scene tell the order in time as well. The refined path is kept only if it explains the
    photos better than the given one by more than noise does.

    Parameters
    ----------
    photos : sequence of I (H, W) or (H, W, 3) array_like, linear light 0..1
    codes : sequence of I ShutterCode
    trajectory : Trajectory
        If its direction is unknown, its orders in time are tried.
    uncertainty_px : float
        Expected error of the given path, rms over time.
    kernels : Estimator, optional
        What finds the kernel of each photo; :class:`motdiff.estimators.pmp.PmpEstimator` when omitted.
    progress : callable, optional
        Called with the finished share 0..1, and what is being done.

    Raises
    ------
    ValueError
        If codes and photos do not fit each other, a photo cannot be searched, or the uncertainty is not above 0.

    Examples
    --------
    >>> from cep.optics.capture import capture
    >>> from motdiff.estimators.reference import ReferenceEstimator
    >>> rng = np.random.default_rng(0)
    >>> scene = np.kron(rng.random((30, 30)), np.ones((6, 6)))
    >>> path = Trajectory.from_samples([[0, 0], [8, 2], [12, 9]], direction="known")
    >>> code = ShutterCode("1101000101101111")
    >>> photo = capture(scene, path, code, rng=rng)
    >>> refine_motion([photo], [code], path, kernels=ReferenceEstimator(scene)).kept
    'given'
    """
    started = time.perf_counter()
    given = list(photos)
    check_codes([code.bits for code in codes], photos=len(given))
    check_resolved(trajectory, codes[0].chips)
    for i, photo in enumerate(given, 1):
        try:
            check_photo(photo, "coded")
        except ValueError as error:
            raise ValueError(f"photo {i}: {str(error).removeprefix('photo: ')}") from None
    if not (np.isfinite(uncertainty_px) and uncertainty_px > 0):
        raise ValueError(f"uncertainty_px: must be above 0, got {uncertainty_px:g}")
    progress(0.01, "loading torch")
    import_module("torch")
    from motdiff.estimators.coded.found import UNEXPLAINED
    from motdiff.estimators.coded.refine import PathRefiner

    paths = [trajectory]
    if trajectory.direction == "unknown":
        others = orders(trajectory, knots=_ORDER_KNOTS, most=_MOST_ORDERS)[2:]
        paths += [trajectory.reversed(), *(Trajectory.from_samples(xy) for xy in others)]
    refiner = PathRefiner(
        [code.bits for code in codes], deviation_px=uncertainty_px, kernels=kernels,
        progress=lambda share: progress(0.03 + (_FITTED - 0.03) * share, "fitting the path"),
    )  # fmt: skip
    found = refiner.refine(paths, given)
    progress(_FITTED, "comparing the paths")
    if found[0].values:
        best = found[0]
        is_better = (best.given_misfit - best.misfit) * best.values > _LEAST_GAIN
        confidence = 1.0 if is_better else 0.5
    else:
        baseline = _likeliest_order(given[0], codes[0], trajectory)
        best, confidence = _best_by_test(given, codes, baseline, found)
        is_better = confidence > _SURE
    misfit = best.misfit if is_better else best.given_misfit
    kept = best.trajectory if is_better else best.given if best.values else trajectory
    warnings = []
    if misfit > UNEXPLAINED:
        warnings.append(
            f"the path leaves {misfit:.1f} times the noise unexplained: was the motion the same in each photo, and are "
            "the codes given in the order of the photos?"
        )
    elif best.values and _stands_alone(found):
        kept = Trajectory(kept.t, kept.xy, direction="known")
    progress(1.0, "comparing the paths")
    return Refinement(
        trajectory=kept,
        kept="refined" if is_better else "given",
        confidence=confidence,
        uncertainty_px=min(best.deviation_px, uncertainty_px) if is_better else uncertainty_px,
        moved_px=_apart_px(best.trajectory, best.given) if is_better else 0.0,
        given_misfit=best.given_misfit if best.values else None,
        misfit=misfit if best.values else None,
        warnings=tuple(warnings),
        seconds=time.perf_counter() - started,
    )


def _likeliest_order(photo: ArrayLike, code: ShutterCode, trajectory: Trajectory) -> Trajectory:
    if trajectory.direction == "known":
        return trajectory
    return detect_direction(photo, trajectory, code).trajectory or trajectory


def _best_by_test(
    photos: Sequence[ArrayLike], codes: Sequence[ShutterCode], baseline: Trajectory, found: Sequence[RefinedPath]
) -> tuple[RefinedPath, float]:
    """Return the refined path that the photos prefer, and the probability that it is better than the baseline."""

    def log_odds(path: Trajectory, other: Trajectory) -> float:
        total = 0.0
        for photo, code in zip(photos, codes, strict=True):
            psfs = [coded_psf(one, code, one.frame_size(PSF_PX)) for one in (path, other)]
            test = compare_psfs(photo, *psfs)
            sign = {"forward": 1.0, "reverse": -1.0}.get(test.direction, 0.0)
            total += sign * float(np.log(test.confidence / (1 - test.confidence)))
        return total

    best = found[0]
    for other in found[1:]:
        if log_odds(other.trajectory, best.trajectory) > 0:
            best = other
    return best, float(1 / (1 + np.exp(-log_odds(best.trajectory, baseline))))


def _stands_alone(found: Sequence[RefinedPath]) -> bool:
    """Whether no path of another order explains the photos nearly as well as the best one."""
    best = found[0]
    return all(
        other.cost - best.cost > _LEAST_GAIN or _apart_px(other.trajectory, best.trajectory) < _SAME_PX
        for other in found[1:]
    )


def _apart_px(path: Trajectory, other: Trajectory) -> float:
    """Rms distance at equal times, wherever the paths lie."""
    t = np.linspace(0, 1, 401)
    apart = path.at(t) - other.at(t)
    return float(np.sqrt(((apart - apart.mean(axis=0)) ** 2).sum(axis=1).mean()))
