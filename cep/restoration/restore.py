"""Restoration of a photo: along a trajectory, with a PSF, or from the photo alone."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.optics.straight_motion import uniform_length_px
from cep.restoration.blur import channels_first, trimmed_psf
from cep.restoration.choice import (
    MethodChoice,
    choose_method,
    is_possible_light,
    restore_with_estimate,
)
from cep.restoration.clipping import clipped_warnings, fill_clipped
from cep.restoration.direction import detect_direction
from cep.restoration.registry import find_method, registered_method
from cep.restoration.result import Restoration, misfit
from cep.restoration.sharpen import LEAST_CONFIDENCE, sharpen
from motdiff.estimators.registry import METHODS as ESTIMATORS
from motdiff.photo_values import clipped_mask, exposure_gain
from motdiff.psf_frame import PSF_PX
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

if TYPE_CHECKING:
    from motdiff.estimators.base import MotionEstimate

_ALL_LIGHT = 0.999  # below it a light-true PSF was closed for a part of the exposure
_FULL_LIGHT = 1.001  # 1, but for rounding
_SEARCH_SHARE = 0.9  # of the time of a blind restoration
_ESTIMATE_SHARE = 0.75  # of the time where the motion is estimated by the network


def restore(
    photo: ArrayLike,
    psf: ArrayLike | None = None,
    *,
    trajectory: Trajectory | None = None,
    code: ShutterCode | None = None,
    method: str | Callable[..., ArrayLike] = "auto",
    anyway: bool = False,
    seed: int = 0,
    progress: Callable[[float, str], None] = lambda _share, _note: None,
    **options: Any,
) -> Restoration:
    """Restore a photo with a PSF, along its trajectory, or with neither: from the photo alone.

    Along a trajectory of unknown direction a coded photo is tested for its orders in time, see
    :func:`cep.restoration.direction.detect_direction`. Without trajectory and PSF the PSF is
    searched in the photo, see :func:`find_psf`. Clipped pixels are replaced
    before a registered method that declares ``fills_clipped``, as all of ours do, see
    :func:`cep.restoration.clipping.fill_clipped`; a function of your own gets them as they are.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light 0..1
    psf : (S, S) array_like, optional
        Light-true PSF, zero displacement at index ``size // 2``.
    trajectory : Trajectory, optional
        Instead of a PSF.
    code : ShutterCode, optional
        Of the exposure, without a PSF; the open shutter when omitted.
    method : str or callable
        A name of :data:`cep.restoration.registry.METHODS`: "wiener", "tv" or "pnp" (with a
        trained denoiser); or a function of your own, or its ``module:name``, that takes (photo,
        psf) and returns the restored photo, or a Restoration. "auto" is "pnp" for a photo through
        a code whose motion is given, and where the photo shows that the motion fits, else "tv",
        which trusts the PSF less; a motion that is known in time has some credit. Of more than 16
        megapixels, or 4 where the PSF is estimated, it is "wiener", for the time:
        :func:`cep.restoration.choice.choose_method`.
        Where nothing but the photo is given see :func:`cep.restoration.sharpen.sharpen`.
    anyway : bool
        Of a photo alone: whether one that would be kept is restored all the same.
    seed : int
        Of what is drawn at random, with "auto".
    progress : callable, optional
        Called with the finished share 0..1 and what is being done.
    **options
        Passed on to the method, as ``camera`` to "wiener" and "pnp".

    Raises
    ------
    ValueError
        If the method is not known or refuses its arguments, both PSF and trajectory are given, a
        code is given with a PSF, the motion does not fit into the photo, or a PSF cannot be
        searched in it.

    Examples
    --------
    >>> from motdiff.simulate import blur_valid
    >>> scene = np.kron(np.random.default_rng(0).random((8, 8)), np.ones((10, 10)))
    >>> path = Trajectory.straight(9.0)
    >>> photo = np.clip(blur_valid(scene, path.psf(11)), 0, 1)
    >>> sharp = restore(photo, trajectory=path)
    >>> sharp.image.shape, sharp.method
    ((70, 70), 'pnp')
    """
    if method != "auto":
        find_method(method)  # before the work
    elif unknown := sorted(set(options) - {"camera"}):
        raise ValueError(f"{unknown[0]}: not valid without a method that takes it")
    if psf is not None and trajectory is not None:
        raise ValueError("trajectory and psf: give one of them at most")
    if psf is not None and code is not None:
        raise ValueError("code: not valid with a PSF, which holds its code already")
    started = time.perf_counter()
    if method == "auto" and psf is None and trajectory is None and code is None and not options:
        estimator: Any = ESTIMATORS["motdiff"]().load(
            seed=seed, progress=lambda share, note: progress(_ESTIMATE_SHARE * share, note)
        )
        estimate = estimator.estimate_from([np.asarray(photo)])
        progress(_ESTIMATE_SHARE, "restoring")
        restored = sharpen(photo, estimate, anyway=anyway)
        return replace(restored, seconds=time.perf_counter() - started)
    channels = channels_first(photo)
    # along a trajectory a PSF costs no time, and where one is given none
    begin = _SEARCH_SHARE if psf is None and trajectory is None else 0.0

    def restoring(share: float) -> None:
        progress(begin + (1 - begin) * share, "restoring")

    draft = _with_psf(
        photo,
        psf,
        trajectory=trajectory,
        code=code,
        progress=lambda share: progress(begin * share, "searching the PSF"),
    )
    psf = draft.psf
    kernel = trimmed_psf(psf)
    restoring(0.0)
    if trajectory is None:
        _check_reach("psf", len(kernel), channels)
    is_coded = code is not None or kernel.sum() < _ALL_LIGHT
    notes: list[str] = []
    fills = True
    if method == "auto" and (draft.psf_source == "photo" or not is_coded):
        # a straight motion that was estimated looks like a known one: the photo shows how it fits
        is_trusted = trajectory is not None and (
            trajectory.direction == "known" or uniform_length_px(trajectory) is not None
        )
        image, (label, reason), notes = _by_evidence(
            photo, psf, trusted=is_trusted, progress=restoring
        )
    else:
        reason = ""
        if method == "auto":
            method, reason = choose_method(photo, psf, coded_motion=True)
        label, apply = find_method(method)
        entry = registered_method(apply)
        # a user-defined function gets the photo as it is
        fills = entry is not None and entry.fills_clipped
        light = fill_clipped(photo, psf) if fills else photo
        if entry is not None and entry.reports_progress:
            options["progress"] = restoring
        image = _checked_image(apply(light, psf, **options), np.shape(photo), label)
    restoring(1.0)
    return replace(
        draft,
        image=image,
        method=label,
        method_reason=reason,
        residual=misfit(photo, image, psf),
        unreliable_px=len(kernel) // 2,
        warnings=(
            *draft.warnings,
            *_doubts(channels, kernel, draft.saturated_fraction, fills=fills),
            *notes,
        ),
        seconds=time.perf_counter() - started,
    )


def find_psf(
    photo: ArrayLike,
    code: ShutterCode | None = None,
    *,
    progress: Callable[[float], None] | None = None,
) -> MotionEstimate:
    """Find the PSF of a photo blindly; of the code it needs the open share of the time.

    A coded photo's own kernel restores better than the PSF of a path that is fitted to it along
    the code: one photo seldom tells the order in time, and a wrong order has a wrong PSF
    (docs/decisions/restoration.md). Where the blur outgrows the search, though, the photo is made
    smaller, and the PSF is that of a path drawn through the small kernel; a warning says so.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light 0..1
    code : ShutterCode, optional
        Of the exposure; the open shutter when omitted.
    progress : callable, optional
        Called with the finished share 0..1.

    Returns
    -------
    MotionEstimate
        Its ``psf`` is light-true.

    Raises
    ------
    ValueError
        If the photo is malformed, too small or without texture.
    """
    from motdiff.estimators.pmp.estimator import PmpEstimator

    estimate = PmpEstimator(progress=progress).estimate_from([photo])
    warnings = estimate.psf_warnings
    if estimate.confidence < LEAST_CONFIDENCE:
        lost = (
            f"the PSF is probably lost (confidence {estimate.confidence:.2f}), and the restored"
            " photo may be worse than the one given: calibrate the motion, and give its"
            " trajectory"
        )
        warnings = (lost, *warnings)
    duty = (code or ShutterCode("1")).duty
    return replace(estimate, psf=duty * estimate.psf, psf_warnings=warnings)


def _with_psf(
    photo: ArrayLike,
    psf: ArrayLike | None,
    *,
    trajectory: Trajectory | None,
    code: ShutterCode | None,
    progress: Callable[[float], None],
) -> Restoration:
    """Return the photo, not restored yet, with the PSF that it will be, and how that was found."""
    draft = Restoration(
        image=np.asarray(photo, dtype=np.float64),
        psf=np.zeros((1, 1)),
        psf_source="given",
        trajectory=trajectory,
        saturated_fraction=float(clipped_mask(photo).mean()),
        warnings=(),
    )
    if psf is not None:
        return replace(draft, psf=np.asarray(psf, dtype=np.float64))
    if trajectory is None:
        estimate = find_psf(photo, code, progress=progress)
        return replace(
            draft,
            psf=estimate.psf,
            psf_source="photo",
            psf_confidence=estimate.confidence,
            warnings=estimate.psf_warnings,
        )
    _check_reach("trajectory", trajectory.frame_size(), channels_first(photo))
    draft = replace(draft, psf_source="trajectory", direction=trajectory.direction)
    if trajectory.direction == "known" or code is None:
        size = trajectory.frame_size(PSF_PX)
        return replace(draft, psf=coded_psf(trajectory, code or ShutterCode("1"), size=size))
    test = detect_direction(photo, trajectory, code)
    undecided = "the photo does not tell the direction of the motion; forward was taken"
    return replace(
        draft,
        psf=test.psf,
        direction=test.direction,
        direction_test=test,
        trajectory=test.trajectory,
        warnings=(undecided,) if test.direction == "undecidable" else (),
    )


def _doubts(channels: FloatArray, kernel: FloatArray, clipped: float, *, fills: bool) -> list[str]:
    """Warn of a PSF that is too bright or too far-reaching for a photo, and of clipped pixels."""
    doubts = []
    if kernel.sum() > _FULL_LIGHT:
        doubts.append(
            f"the PSF sums to {kernel.sum():.4g}, a light-true one to the open share of the"
            " exposure, at most 1; the photo comes out darker by that factor"
        )
    doubts += clipped_warnings(clipped, is_filled=fills)
    reach = len(kernel) // 2
    # borders that are a guess then take half of the shorter side
    if 4 * reach > min(channels.shape[1:]):
        doubts.append(
            f"the PSF reaches {reach} px, far into a photo of {channels.shape[2]} x"
            f" {channels.shape[1]} px"
        )
    return doubts


def _by_evidence(
    photo: ArrayLike, psf: FloatArray, *, trusted: bool, progress: Callable[[float], None]
) -> tuple[FloatArray, MethodChoice, list[str]]:
    """Restore a photo by the method that it shows to suit its PSF, and warn of halos."""
    gain = exposure_gain(photo)
    bright = np.asarray(photo) * gain
    choice = choose_method(bright, psf, trusted=trusted)
    image = restore_with_estimate(bright, psf, choice.method, progress=progress)
    notes = []
    if not is_possible_light(image, bright, psf):
        notes.append(
            "the restored photo has dark and bright halos or stripes: the motion does not fit"
            " this photo well"
        )
    return image / gain, choice, notes


def _checked_image(restored: object, shape: tuple[int, ...], label: str) -> FloatArray:
    if isinstance(restored, Restoration):  # of a function that calls :func:`restore`
        restored = restored.image
    try:
        image = np.asarray(restored, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(
            f"method: {label} returned a {type(restored).__name__}, wanted the restored photo"
        ) from None
    if image.shape != shape:
        raise ValueError(
            f"method: {label} returned an image of shape {image.shape}, wanted {shape}"
        )
    return image


def _check_reach(name: str, reach_px: int, channels: FloatArray) -> None:
    side = min(channels.shape[1:])
    if reach_px > side:
        raise ValueError(
            f"{name}: the motion spans {reach_px} px around its zero, the photo is only {side} px"
            " on its shorter side"
        )
