"""Restoration of a photo by one of the methods: along a trajectory, with a PSF or blindly; checks
of the result.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import signal

from cep.files.images import encode_image, write_image
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.restoration.blind import find_psf
from cep.restoration.blur import channels_first, trimmed_psf
from cep.restoration.clipping import fill_clipped
from cep.restoration.direction import DirectionResult, detect_direction
from cep.restoration.registry import find_method, is_registered
from motdiff.crops import CLIPPED_LEVEL, clipped_mask
from motdiff.psf_frame import PSF_PX
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

_FULL_LIGHT = 1.001  # 1, but for rounding
_WORTH_TELLING = 1e-3
_SEARCH_SHARE = 0.9  # of the time of a blind restoration


@dataclass(frozen=True)
class Restoration:
    """A restored photo.

    Attributes
    ----------
    image : float ndarray like the photo
        At the scale of the full open exposure, not clipped.
    method : str
    psf : (S, S) float ndarray
        Light-true PSF that it was restored with.
    psf_confidence : float or None
        Probability that a PSF found in the photo alone is a good one; None where PSF or trajectory
        were given.
    direction : {"known", "unknown", "forward", "reverse", "reordered", "undecidable"} or None
        Direction of the motion: the trajectory's, or the result of the test; None without a
        trajectory.
    direction_test : DirectionResult or None
        The test, where there was one.
    residual : float
        RMS of the reblurred result against the photo, away from borders and clipped pixels;
        full-scale units.
    unreliable_px : int
        Width of the border strip that leans on a guess of the scene outside the frame.
    saturated_fraction : float
        Share of the photo's pixels that are clipped.
    warnings : tuple of str
    seconds : float
    """

    image: FloatArray
    method: str
    psf: FloatArray
    psf_confidence: float | None
    direction: str | None
    direction_test: DirectionResult | None
    residual: float
    unreliable_px: int
    saturated_fraction: float
    warnings: tuple[str, ...]
    seconds: float

    def save(self, path: Path | str, *, bits: int = 8, gamma: str | float = "srgb") -> None:
        """Write the restored photo; parameters and errors are those of
        :func:`cep.files.images.write_image`.
        """
        write_image(path, self.image, bits=bits, gamma=gamma)

    def _repr_png_(self) -> bytes:
        return encode_image(self.image, ".png")

    def __repr__(self) -> str:
        size = f"{self.image.shape[1]} x {self.image.shape[0]} px"
        way = "" if self.direction is None else f", direction {self.direction}"
        return f"<Restoration {size} by {self.method}{way}, residual {self.residual:.3g}>"


def restore(
    photo: ArrayLike,
    psf: ArrayLike | None = None,
    *,
    trajectory: Trajectory | None = None,
    code: ShutterCode | None = None,
    method: str | Callable[..., ArrayLike] = "wiener",
    progress: Callable[[float, str], None] = lambda _share, _what: None,
    **options: Any,
) -> Restoration:
    """Restore a photo with a PSF, along the trajectory that it was exposed on, or with neither:
    from the photo alone.

    Along a trajectory of unknown direction a coded photo is tested for its orders in time, see
    :func:`cep.restoration.direction.detect_direction`. Without trajectory and PSF the PSF is
    searched in the photo, see :func:`cep.restoration.blind.find_psf`. Clipped pixels are replaced
    before a method of ours, see :func:`cep.restoration.clipping.fill_clipped`.

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
        "wiener", "inverse", "tv", "l0", "tv-ring" (TV less its ringing) or "pnp" (with a trained
        denoiser); or a function of your own, or its ``module:name``, that takes (photo, psf) and
        returns the restored photo, or a Restoration.
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
    >>> sharp.image.shape, sharp.residual < 0.001
    ((70, 70), True)
    """
    named, apply = find_method(method)
    if psf is not None and trajectory is not None:
        raise ValueError("trajectory and psf: give one of them at most")
    if psf is not None and code is not None:
        raise ValueError("code: not valid with a PSF, which holds its code already")
    started = time.perf_counter()
    channels = channels_first(photo)
    direction: str | None = None
    psf_confidence: float | None = None
    test: DirectionResult | None = None
    notes: list[str] = []
    if trajectory is not None:
        _check_reach("trajectory", trajectory.frame_size(), channels)
        direction = trajectory.direction
        if direction == "unknown" and code is not None:
            test = detect_direction(photo, trajectory, code)
            direction = test.direction
            psf = test.psf
        else:
            psf = coded_psf(
                trajectory, code or ShutterCode("1"), size=trajectory.frame_size(PSF_PX)
            )
        if direction == "undecidable":
            notes.append("the photo does not tell the direction of the motion; forward was taken")
    elif psf is None:
        found = find_psf(
            photo,
            code,
            progress=lambda share: progress(_SEARCH_SHARE * share, "searching the PSF"),
        )
        psf = found.psf
        psf_confidence = found.confidence
        notes += found.warnings
    assert psf is not None
    progress(0.0 if psf_confidence is None else _SEARCH_SHARE, "restoring")
    kernel = trimmed_psf(psf)
    if trajectory is None:
        _check_reach("psf", len(kernel), channels)
        if kernel.sum() > _FULL_LIGHT:
            notes.append(
                f"the PSF sums to {kernel.sum():.4g}, a light-true one to the open share of the"
                " exposure, at most 1; the photo comes out darker by that factor"
            )
    reach = kernel.shape[0] // 2
    clipped = float(clipped_mask(photo).mean())
    fills = is_registered(apply)  # a function of the user's own gets the photo as it is
    if clipped > _WORTH_TELLING:
        meaning = (
            "their light was inferred from the other pixels"
            if fills
            else "expect ringing around them"
        )
        notes.append(f"{100 * clipped:.1f} % of the pixels are clipped: {meaning}")
    if 4 * reach > min(channels.shape[1:]):
        notes.append(
            f"the PSF reaches {reach} px, far into a photo of {channels.shape[2]} x"
            f" {channels.shape[1]} px"
        )
    restored = apply(fill_clipped(photo, psf) if fills else photo, psf, **options)
    if isinstance(restored, Restoration):  # of a function that calls this one
        restored = restored.image
    try:
        image = np.asarray(restored, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(
            f"method: {named} returned a {type(restored).__name__}, wanted the restored photo"
        ) from None
    if image.shape != np.shape(photo):
        raise ValueError(
            f"method: {named} returned an image of shape {image.shape}, wanted {np.shape(photo)}"
        )
    progress(1.0, "restoring")
    return Restoration(
        image,
        named,
        np.asarray(psf, dtype=np.float64),
        psf_confidence,
        direction,
        test,
        misfit(photo, image, psf),
        reach,
        clipped,
        tuple(notes),
        time.perf_counter() - started,
    )


def _check_reach(name: str, reach_px: int, channels: FloatArray) -> None:
    side = min(channels.shape[1:])
    if reach_px > side:
        raise ValueError(
            f"{name}: the motion spans {reach_px} px around its zero, the photo is only {side} px"
            " on its shorter side"
        )


def misfit(
    photo: ArrayLike, restored: ArrayLike, psf: ArrayLike, *, clipped: ArrayLike | None = None
) -> float:
    """RMS of ``restored`` reblurred minus ``photo``, over the pixels that the PSF reaches from
    inside; NaN if none.

    Clipped pixels are left out: the (H, W) bool ``clipped``, or those of each channel at the
    clipped level.
    """
    channels = channels_first(photo)
    latent = channels_first(restored)
    kernel = trimmed_psf(psf)
    reach = kernel.shape[0] // 2
    if min(channels.shape[1:]) <= 2 * reach:
        return float("nan")
    window = (
        ...,
        slice(reach, channels.shape[1] - reach),
        slice(reach, channels.shape[2] - reach),
    )
    seen = (
        channels < CLIPPED_LEVEL
        if clipped is None
        else np.broadcast_to(~np.asarray(clipped), channels.shape)
    )
    again = np.stack([signal.fftconvolve(channel, kernel, mode="valid") for channel in latent])
    squares = (again - channels[window]) ** 2
    if not seen[window].all():
        squares = squares[seen[window]]
    return float(np.sqrt(np.mean(squares))) if squares.size else float("nan")
