"""Restoration of a photo: along a trajectory, with a PSF, or from the photo alone."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cep.optics.band import uniform_length_px
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.restoration.blind import find_psf
from cep.restoration.blur import channels_first, trimmed_psf
from cep.restoration.clipping import fill_clipped
from cep.restoration.direction import DirectionResult, detect_direction
from cep.restoration.registry import find_method, registered_method
from cep.restoration.result import Restoration, misfit
from cep.restoration.sharpen import (
    FEW_CLIPPED,
    LARGEST_PX,
    is_possible_light,
    restore_chosen,
    sharpen,
)
from motdiff.crops import clipped_mask, exposure_gain
from motdiff.psf_frame import PSF_PX
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

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
    searched in the photo, see :func:`cep.restoration.blind.find_psf`. Clipped pixels are replaced
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
        A name of :data:`cep.restoration.registry.METHODS`: "wiener", "inverse", "tv", "l0",
        "tv-ring" (TV less its ringing) or "pnp" (with a trained denoiser); or a function of your
        own, or its ``module:name``, that takes (photo, psf) and returns the restored photo, or a
        Restoration. "auto" is "pnp" for a photo through a code whose motion is given, and for
        a motion that is known in time unless the photo speaks against it. Else the photo
        shows how well the PSF fits, and decides between it and "tv", which trusts the PSF less:
        :func:`cep.restoration.sharpen.restore_chosen`. Of more than 16
        megapixels, or 4 where the PSF is estimated, it is "wiener", for the time.
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
    if method == "auto":
        if unknown := sorted(set(options) - {"camera"}):
            raise ValueError(f"{unknown[0]}: not valid without a method that takes it")
        if psf is None and trajectory is None and code is None and not options:
            return _restore_alone(photo, anyway=anyway, seed=seed, progress=progress)
    else:
        find_method(method)  # before the work
    if psf is not None and trajectory is not None:
        raise ValueError("trajectory and psf: give one of them at most")
    if psf is not None and code is not None:
        raise ValueError("code: not valid with a PSF, which holds its code already")
    started = time.perf_counter()
    channels = channels_first(photo)
    searched = 0.0
    psf_source = "given"
    direction: str | None = None
    psf_confidence: float | None = None
    test: DirectionResult | None = None
    notes: list[str] = []
    if trajectory is not None:
        _check_reach("trajectory", trajectory.frame_size(), channels)
        psf_source = "trajectory"
        direction = trajectory.direction
        if direction == "unknown" and code is not None:
            test = detect_direction(photo, trajectory, code)
            direction = test.direction
            psf = test.psf
        else:
            size = trajectory.frame_size(PSF_PX)
            psf = coded_psf(trajectory, code or ShutterCode("1"), size=size)
        if direction == "undecidable":
            notes.append("the photo does not tell the direction of the motion; forward was taken")
    elif psf is None:
        blind = find_psf(
            photo,
            code,
            progress=lambda share: progress(_SEARCH_SHARE * share, "searching the PSF"),
        )
        searched = _SEARCH_SHARE
        psf_source = "photo"
        psf = blind.psf
        psf_confidence = blind.confidence
        notes += blind.warnings
    assert psf is not None

    def restoring(share: float) -> None:
        progress(searched + (1 - searched) * share, "restoring")

    restoring(0.0)
    kernel = trimmed_psf(psf)
    by_evidence = is_known = False
    if method == "auto":
        is_coded = code is not None or kernel.sum() < _ALL_LIGHT
        is_known = trajectory is not None and (
            trajectory.direction == "known" or uniform_length_px(trajectory) is not None
        )
        # a straight motion that was estimated looks like a known one: the photo shows how it fits
        by_evidence = psf_source == "photo" or not is_coded
        # ahead in every row of our tables with a known motion: docs/decisions/restoration.md
        method = "pnp" if channels[0].size <= LARGEST_PX else "wiener"
    label, apply = find_method(method)
    if trajectory is None:
        _check_reach("psf", len(kernel), channels)
        if kernel.sum() > _FULL_LIGHT:
            notes.append(
                f"the PSF sums to {kernel.sum():.4g}, a light-true one to the open share of the"
                " exposure, at most 1; the photo comes out darker by that factor"
            )
    reach = len(kernel) // 2
    clipped = float(clipped_mask(photo).mean())
    entry = registered_method(apply)
    # a user-defined function gets the photo as it is
    fills = entry is not None and entry.fills_clipped
    meaning = "expect ringing around them"
    if fills:
        meaning = "their light was inferred from the other pixels"
    if clipped > FEW_CLIPPED:
        notes.append(f"{100 * clipped:.1f} % of the pixels are clipped: {meaning}")
    # borders that are a guess then take half of the shorter side
    if 4 * reach > min(channels.shape[1:]):
        notes.append(
            f"the PSF reaches {reach} px, far into a photo of {channels.shape[2]} x"
            f" {channels.shape[1]} px"
        )
    if by_evidence:
        gain = exposure_gain(photo)
        bright = np.asarray(photo) * gain
        # it fills the clipped pixels itself
        image, label = restore_chosen(bright, psf, trusted=is_known, progress=restoring)
        if not is_possible_light(image, bright, psf):
            notes.append(
                "the restored photo has dark and bright halos or stripes: the motion does not fit"
                " this photo well"
            )
        image = image / gain
    else:
        light = fill_clipped(photo, psf) if fills else photo
        if entry is not None and entry.reports_progress:
            options["progress"] = restoring
        image = _checked_image(apply(light, psf, **options), np.shape(photo), label)
    restoring(1.0)
    return Restoration(
        image=image,
        method=label,
        psf=np.asarray(psf, dtype=np.float64),
        psf_source=psf_source,
        psf_confidence=psf_confidence,
        direction=direction,
        direction_test=test,
        trajectory=test.trajectory if test is not None and test.trajectory else trajectory,
        residual=misfit(photo, image, psf),
        unreliable_px=reach,
        saturated_fraction=clipped,
        warnings=tuple(notes),
        seconds=time.perf_counter() - started,
    )


def _restore_alone(
    photo: ArrayLike, *, anyway: bool, seed: int, progress: Callable[[float, str], None]
) -> Restoration:
    """Restore a photo with what suits it of the motion found in it, or keep it."""
    from motdiff.estimators.registry import METHODS as ESTIMATORS  # its import loads no torch

    started = time.perf_counter()
    estimator = ESTIMATORS["motdiff"]().load(
        seed=seed, progress=lambda share, note: progress(_ESTIMATE_SHARE * share, note)
    )
    estimate = estimator.estimate(np.asarray(photo))
    progress(_ESTIMATE_SHARE, "restoring")
    restored = sharpen(photo, estimate, anyway=anyway)
    return replace(restored, seconds=time.perf_counter() - started)


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
