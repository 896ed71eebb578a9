"""A calibration improved by coded photos that were taken with its motion."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from cep.calibration.photo_checks import check_photos, check_times
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.optics.path_limits import check_resolved
from cep.restoration.direction import compare_psfs, detect_direction, orders_in_time
from motdiff.estimators.base import Estimator
from motdiff.estimators.coded.codes import check_codes
from motdiff.metrics import timed_distance_px
from motdiff.psf_frame import PSF_PX
from motdiff.trajectory import Trajectory

if TYPE_CHECKING:
    from motdiff.estimators.coded.refine import RefinedPath

USUAL_UNCERTAINTY_PX = 1.0
"""Error of a calibration, rms over time, where none is stated."""
_FITTED = 0.9  # share of the time
_SURE = 0.8  # of the test on the photo, which errs below it: docs/decisions/motion-estimation.md
_SAME_PX = 1.0  # paths that are nearer, rms over time, are one


@dataclass(frozen=True)
class Refinement:
    """A calibration and what coded photos made of it.

    Attributes
    ----------
    trajectory : Trajectory
        The refined path, or the given one where that explains the photos as well; in the order in
        time that two or more photos of one scene show. Where no path near the given one explains
        them, that one as it is.
    kept : {"refined", "given"}
    confidence : float or None
        Probability that the refined path is the better one, where only the photos' kernels could
        be compared; None for photos of one scene, whose misfit decides.
    uncertainty_px : float
        Expected error of ``trajectory``, rms over time.
    moved_px : float
        Rms distance of the refined path from the given one in the order found; 0 where that is
        kept.
    given_misfit, misfit : float or None
        Of photos of one scene along the given path, in the order in time that fits best, and along
        the path kept: multiples of what noise leaves; None where only the photos' kernels could be
        compared.
    warnings : tuple of str
    seconds : float
    """

    trajectory: Trajectory
    kept: Literal["refined", "given"]
    confidence: float | None
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

    Two or more photos of one scene tell the order in time as well. The refined path is kept only
    if it explains the photos better than the given one by more than noise does, and leaves little
    of them unexplained.

    Parameters
    ----------
    photos : sequence of I (H, W) or (H, W, 3) array_like, linear light 0..1
    codes : sequence of I ShutterCode
    trajectory : Trajectory
        If its direction is unknown, its orders in time are tried.
    uncertainty_px : float
        Expected error of the given path, rms over time.
    kernels : Estimator, optional
        What finds the kernel of each photo; PMP when omitted.
    progress : callable, optional
        Called with the finished share 0..1, and what is being done.

    Raises
    ------
    ValueError
        If codes and photos do not fit each other, the codes' chips last differently, a photo
        cannot be searched or is given twice, or the uncertainty is not above 0.

    Examples
    --------
    >>> from cep.optics.capture import capture
    >>> from motdiff.estimators.reference.estimator import ReferenceEstimator
    >>> rng = np.random.default_rng(0)
    >>> scene = np.kron(rng.random((30, 30)), np.ones((6, 6)))
    >>> path = Trajectory.from_samples([[0, 0], [8, 2], [12, 9]], direction="known")
    >>> code = ShutterCode("1101000101101111")
    >>> photo = capture(scene, path, code, rng=rng)
    >>> refine_motion([photo], [code], path, kernels=ReferenceEstimator(scene)).kept
    'given'
    """
    started = time.perf_counter()
    if not (np.isfinite(uncertainty_px) and uncertainty_px > 0):
        raise ValueError(f"uncertainty_px: must be above 0, got {uncertainty_px:g}")
    check_codes([code.bits for code in codes], photos=len(photos))
    check_times(codes)
    check_resolved(trajectory, codes[0].chips)
    check_photos(photos, "coded")
    progress(0.01, "loading torch")
    # explicitly, so that its seconds are under that note
    import_module("torch")
    from motdiff.estimators.coded.candidates import UNEXPLAINED
    from motdiff.estimators.coded.refine import NOISE_GAIN, refined_paths

    paths = [trajectory]
    if trajectory.direction == "unknown":
        paths = orders_in_time(trajectory)
    refined = refined_paths(
        paths,
        photos,
        [code.bits for code in codes],
        deviation_px=uncertainty_px,
        kernels=kernels,
        progress=lambda share: progress(0.03 + (_FITTED - 0.03) * share, "fitting the path"),
    )
    progress(_FITTED, "comparing the paths")
    best = refined[0]
    chosen = trajectory
    confidence = given_misfit = misfit = None
    is_unexplained = bool(best.misfit > UNEXPLAINED)  # NaN where only kernels are compared
    if best.values:
        chosen = best.given
        given_misfit = misfit = best.given_misfit
        # times its unit: a fall of the sum of squares, as NOISE_GAIN is
        gain = (best.given_misfit - best.misfit) * best.values
        is_better = not is_unexplained and gain > NOISE_GAIN
    else:
        likeliest = _likeliest_order(photos, codes, trajectory)
        best, confidence = _best_by_test(photos, codes, likeliest, refined)
        is_better = confidence > _SURE
    outcome: Literal["refined", "given"] = "given"
    moved_px = 0.0
    if is_better:
        outcome = "refined"
        chosen = best.trajectory
        moved_px = timed_distance_px(best.trajectory, best.given)
        uncertainty_px = min(best.deviation_px, uncertainty_px)  # photos add knowledge
        if best.values:
            misfit = best.misfit
    warnings = []
    if is_unexplained:
        chosen = trajectory
        warnings.append(
            "the given path is kept as it is, as none near it explains the photos: the best"
            f" leaves {best.misfit:.1f} times the noise; was the motion the same in each photo,"
            " and are the codes given in the photos' order?"
        )
    elif best.values and _stands_alone(refined, least_gain=NOISE_GAIN):
        chosen = Trajectory(chosen.t, chosen.xy, direction="known")
    progress(1.0, "comparing the paths")
    return Refinement(
        trajectory=chosen,
        kept=outcome,
        confidence=confidence,
        uncertainty_px=uncertainty_px,
        moved_px=moved_px,
        given_misfit=given_misfit,
        misfit=misfit,
        warnings=tuple(warnings),
        seconds=time.perf_counter() - started,
    )


def _likeliest_order(
    photos: Sequence[ArrayLike], codes: Sequence[ShutterCode], trajectory: Trajectory
) -> Trajectory:
    """Return the order in time in the first photo whose code tells both directions apart."""
    if trajectory.direction == "known":
        return trajectory
    # a code that is its own mirror image gives both directions one PSF
    i = next(i for i, code in enumerate(codes) if code.bits != code.bits[::-1])
    likeliest = detect_direction(photos[i], trajectory, codes[i]).trajectory
    assert likeliest is not None
    return likeliest


def _best_by_test(
    photos: Sequence[ArrayLike],
    codes: Sequence[ShutterCode],
    baseline: Trajectory,
    refined: Sequence[RefinedPath],
) -> tuple[RefinedPath, float]:
    """Return the refined path that the photos prefer, and the probability that it is better."""

    def log_odds(path: Trajectory, baseline: Trajectory) -> float:
        total = 0.0
        for photo, code in zip(photos, codes, strict=True):
            psfs = [
                coded_psf(motion, code, motion.frame_size(PSF_PX)) for motion in (path, baseline)
            ]
            test = compare_psfs(photo, *psfs)
            # the test names the likelier PSF; undecidable, it says nothing either way
            sign = {"forward": 1.0, "reverse": -1.0}.get(test.direction, 0.0)
            # the photos' noise is independent, so that their odds multiply
            total += sign * float(np.log(test.confidence / (1 - test.confidence)))
        return total

    best = refined[0]
    for candidate in refined[1:]:
        if log_odds(candidate.trajectory, best.trajectory) > 0:
            best = candidate
    return best, float(1 / (1 + np.exp(-log_odds(best.trajectory, baseline))))


def _stands_alone(refined: Sequence[RefinedPath], *, least_gain: float) -> bool:
    """Whether no path of another order explains the photos nearly as well as the best one."""
    best = refined[0]
    return all(
        candidate.cost - best.cost > least_gain
        or timed_distance_px(candidate.given, best.given) < _SAME_PX
        or timed_distance_px(candidate.trajectory, best.trajectory) < _SAME_PX
        for candidate in refined[1:]
    )
