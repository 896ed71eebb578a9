"""A restored photo, and how well it explains the blurred one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy import signal

from cep.files.images import encode_image, write_image
from cep.restoration.blur import channels_first, trimmed_psf
from cep.restoration.direction import DirectionResult
from motdiff.photo_values import CLIPPED_LEVEL
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

_BRIGHT = 0.999  # quantile of the restored light that has to fit below white
_CLOSE = 1.05  # times white: so little beyond it is not seen


@dataclass(frozen=True, kw_only=True)
class Restoration:
    """A restored photo.

    Attributes
    ----------
    image : float ndarray like the photo
        At the scale of the full open exposure, not clipped.
    method : str or None
        None where the photo was kept as it was.
    method_reason : str
        Why "auto" chose it, in a few words; empty where it was named.
    psf : (S, S) float ndarray
        Light-true PSF that it was restored with; a point where the photo was kept.
    psf_source : {"given", "trajectory", "photo", "path in the photo"} or None
        Of a photo alone: whether the PSF found in it was used, or that of the path drawn for
        it. None where the photo was kept.
    psf_confidence : float or None
        Probability that a PSF found in the photo alone is a good one; None where PSF or trajectory
        were given.
    direction : {"known", "unknown", "forward", "reverse", "reordered", "undecidable"} or None
        Direction of the motion: the trajectory's, or the result of the test; None without a
        trajectory.
    direction_test : DirectionResult or None
        The test, where there was one.
    trajectory : Trajectory or None
        Path along which it was restored, in the order in time that was found; None with a PSF.
    residual : float
        RMS of the reblurred result against the photo, away from borders and clipped pixels;
        full-scale units.
    unreliable_px : int
        Width of the border strip that leans on a guess of the scene outside the frame.
    saturated_fraction : float
        Share of the photo's pixels that are clipped.
    warnings : tuple of str
    seconds : float
    summary : str
        What was done, in one sentence, where what suits the photo was chosen.
    """

    image: FloatArray
    method: str | None = None
    method_reason: str = ""
    psf: FloatArray
    psf_source: str | None = None
    psf_confidence: float | None = None
    direction: str | None = None
    direction_test: DirectionResult | None = None
    trajectory: Trajectory | None = None
    residual: float = 0.0
    unreliable_px: int = 0
    saturated_fraction: float
    warnings: tuple[str, ...]
    seconds: float = 0.0
    summary: str = ""

    def save(self, path: Path | str, *, bits: int = 8, gamma: str | float = "srgb") -> None:
        """Write the restored photo, as :func:`cep.files.images.write_image` does."""
        write_image(path, self.image, bits=bits, gamma=gamma)

    def below_white(self) -> Restoration:
        """Darken the photo where its light would not fit below white, with a warning.

        Restored light is that of the open shutter: what a code left just below white is above it.
        """
        factor = float(np.quantile(self.image, _BRIGHT))
        if factor <= _CLOSE:
            return self
        note = f"the restored photo is {factor:.2g} times darker than the light, so that it fits"
        return replace(self, image=self.image / factor, warnings=(*self.warnings, note))

    @property
    def kept(self) -> bool:
        """Whether ``image`` is the photo as it was, since no restoration is better."""
        return self.method is None

    def to_dict(self) -> dict[str, object]:
        """Describe the restoration as the JSON of ``cep deblur`` has it."""
        test = self.direction_test
        psf_source = self.psf_source
        direction = self.direction or "unknown"
        if psf_source == "given":
            psf_source = "file"
            direction = self.direction or "given by the PSF"
        head: dict[str, object] = {}
        if self.summary:
            head = {"summary": self.summary, "kept": self.kept}
        return {
            **head,
            "method": self.method,
            "psf_source": psf_source,
            "psf_confidence": self.psf_confidence,
            "direction": direction,
            "direction_confidence": test and test.confidence,
            "direction_likelihoods": test and test.likelihoods,
            "residual": self.residual,
            "unreliable_px": self.unreliable_px,
            "seconds": self.seconds,
        }

    def _repr_png_(self) -> bytes:
        return encode_image(self.image, ".png")

    def __repr__(self) -> str:
        size = f"{self.image.shape[1]} x {self.image.shape[0]} px"
        direction = f", direction {self.direction}" if self.direction else ""
        return f"<Restoration {size} by {self.method}{direction}, residual {self.residual:.3g}>"


def misfit(
    photo: ArrayLike, restored: ArrayLike, psf: ArrayLike, *, clipped: ArrayLike | None = None
) -> float:
    """RMS of ``restored``, blurred again, minus ``photo``: away from borders; NaN if none is.

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
    usable = channels < CLIPPED_LEVEL
    if clipped is not None:
        usable = np.broadcast_to(~np.asarray(clipped, dtype=bool), channels.shape)
    reblurred = np.stack([signal.fftconvolve(channel, kernel, mode="valid") for channel in latent])
    squares = ((reblurred - channels[window]) ** 2)[usable[window]]
    if not squares.size:
        return float("nan")
    return float(np.sqrt(np.mean(squares)))
