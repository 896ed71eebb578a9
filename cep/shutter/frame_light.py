"""Light of a frame: histogram, clipped share, and how the light should be changed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hw.cameras.camera import Frame
from motdiff.photo_values import CLIPPED_LEVEL, to_display, to_linear

CLIPPED_SHARE = 0.01
"""Of the pixels, from which on there is too much light."""

_BINS = 64
_FAR_SHARE = 0.5  # clipped, from which on half the light is still too much
_BRIGHT = 0.999  # quantile of the brightest parts: single hot pixels are no light
_FULL = 0.9  # of white, to which the brightest parts may rise
_LEAST_FACTOR = 2  # by which more light is worth a change


def clipped_share(frame: Frame) -> float:
    """Share of a frame's pixels that the restoration takes for clipped."""
    white = 2**frame.bits - 1
    black = frame.black_level or 0.0
    level = float(to_display(CLIPPED_LEVEL)) if frame.gamma == "srgb" else CLIPPED_LEVEL
    # by whole code values: light of 12 Mpx would take longer than the frame
    high = frame.values >= math.ceil(black + level * (white - black))
    return float(np.mean(high if high.ndim == 2 else high.any(axis=2)))


@dataclass(frozen=True)
class FrameLight:
    """How the code values of a frame are spread.

    Attributes
    ----------
    counts : tuple of int
        Pixels in 64 bins from code value 0 to white, which is in the last.
    clipped : float
        Share of the pixels that the restoration takes for clipped.
    brightest : float
        Light of the brightest parts, 1 at white.
    """

    counts: tuple[int, ...]
    clipped: float
    brightest: float

    @classmethod
    def of(cls, frame: Frame) -> FrameLight:
        """Measure a frame."""
        white = 2**frame.bits - 1
        black = frame.black_level or 0.0
        counts, _ = np.histogram(frame.values, bins=_BINS, range=(0, white))
        share = max(0.0, (float(np.quantile(frame.values, _BRIGHT)) - black) / (white - black))
        return cls(
            counts=tuple(int(count) for count in counts),
            clipped=clipped_share(frame),
            brightest=float(to_linear(share)) if frame.gamma == "srgb" else share,
        )

    @property
    def is_clipped(self) -> bool:
        """Whether more than a hundredth of the pixels are clipped."""
        return self.clipped > CLIPPED_SHARE

    @property
    def advice(self) -> str:
        """What to do about the light, in a sentence."""
        if self.is_clipped:
            change = "quarter" if self.clipped > _FAR_SHARE else "halve"
            return f"{_percent(self.clipped)} of the photo is clipped: {change} the light"
        factor = math.floor(_FULL / max(self.brightest, 1e-3))
        if factor >= _LEAST_FACTOR:
            return (
                f"the brightest parts reach {_percent(self.brightest)} of white:"
                f" {factor} times the light fits, and leaves less noise"
            )
        clipped = f"{_percent(self.clipped)} is" if self.clipped else "nothing is"
        return (
            f"the light is right: the brightest parts reach {_percent(self.brightest)} of white,"
            f" {clipped} clipped"
        )


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 0.1 else f"{100 * share:.0f} %"
