"""Statistics of pairs of frames of the same light, and how a camera's codes lie in its files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from motdiff.types import FloatArray

_CODES = 2**16  # code values of the files
_DEPTHS = (8, 10, 12, 14, 16)  # bits of cameras whose codes lie at the lower end of 16-bit files
_ROUNDING = 1e-12  # of the variance over the pixels: that of frames that are the same


@dataclass(frozen=True, eq=False)
class FramePair:
    """Statistics of two frames of the same light, in code values of the file.

    Attributes
    ----------
    means : (2,) float ndarray
        Of each frame.
    covariance : (2, 2) float ndarray
        Over the pixels of the two frames.
    lines : tuple of (2, K) float ndarray
        Means of the rows of both frames, and of their columns; none of frames that are not
        two-dimensional.
    histogram : (65536,) int ndarray
        Pixels of both frames with each code value.
    pixels : int
        Of one frame.
    """

    means: FloatArray
    covariance: FloatArray
    lines: tuple[FloatArray, ...]
    histogram: NDArray[np.int64]
    pixels: int

    @property
    def mean(self) -> float:
        """Mean of both frames."""
        return float(self.means.mean())

    @property
    def difference(self) -> float:
        """Mean of the second frame less that of the first."""
        return float(self.means[1] - self.means[0])

    def variance(self, black: float | None = None) -> float:
        """Variance of one frame over time, with the quantisation's.

        With the code value without light, the frames are brought to the same light first: uneven
        light and unequal pixels would not cancel otherwise. What that does to the noise is of
        second order in the difference.
        """
        scale = self._scale(black)
        # the difference of two independent frames has twice the variance of one
        variance = float(scale @ self.covariance @ scale) / 2
        if variance <= _ROUNDING * self.covariance.trace():
            return 0.0
        return variance

    def banding(self, black: float) -> float:
        """Significant part of the variance that rows or columns of differing light make up."""
        scale = self._scale(black)
        variance = self.variance(black)
        parts = [0.0]
        for means in self.lines:
            count = means.shape[1]
            share = float((scale @ means).var(ddof=1)) / max(2 * variance, 1e-300)
            chance = count / self.pixels  # of white noise
            # sqrt(2 / K) is the relative standard error of a variance of K means: five of them
            if share > chance * (1 + 5 * math.sqrt(2 / count)):
                parts.append(share - chance)
        return max(parts)

    def _scale(self, black: float | None) -> FloatArray:
        """Factors of the first frame and, with the sign of a difference, of the second."""
        signs = np.array([-1.0, 1.0])
        if black is None or self.means.min() <= black:
            return signs
        light = self.means - black
        return np.asarray(light.mean() / light * signs)

    @classmethod
    def of(
        cls, first: ArrayLike, second: ArrayLike, *, codes: ArrayLike | None = None
    ) -> FramePair:
        """Measure two frames of uint8 or uint16 code values; ValueError if their shapes differ.

        ``codes`` (65536,) are the light that each code value stands for, where that is not the
        code value itself.
        """
        dn_a = np.asarray(first)
        dn_b = np.asarray(second)
        if dn_a.shape != dn_b.shape:
            raise ValueError(f"differ in size, {_size(dn_a)} and {_size(dn_b)} px")
        if codes is None:
            codes = np.arange(_CODES)
        light = np.asarray(codes, dtype=np.float64)
        a = light[dn_a]
        b = light[dn_b]
        means = np.array([a.mean(), b.mean()])
        da = a.ravel() - means[0]
        db = b.ravel() - means[1]
        lines: tuple[FloatArray, ...] = ()
        if a.ndim == 2:
            lines = tuple(np.stack([a.mean(axis=axis), b.mean(axis=axis)]) for axis in (1, 0))
        return cls(
            means=means,
            covariance=np.array([[da @ da, da @ db], [da @ db, db @ db]]) / max(da.size - 1, 1),
            lines=lines,
            histogram=np.bincount(np.append(dn_a, dn_b), minlength=_CODES),
            pixels=dn_a.size,
        )

    def quantile(self, share: float) -> int:
        """Smallest code value that at least this share of the pixels does not exceed."""
        return int(np.searchsorted(np.cumsum(self.histogram), share * 2 * self.pixels))


@dataclass(frozen=True)
class CodeRange:
    """How a camera's code values lie in its files.

    Attributes
    ----------
    bits : int
        Of the camera.
    spacing : float
        Step of the file's values from one code value to the next.
    top_dn : float
        Largest code value.
    assumed : str
        What was assumed, one sentence; empty where nothing was.
    """

    bits: int
    spacing: float = 1.0
    top_dn: float = 0.0
    assumed: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "top_dn", self.top_dn or float(2**self.bits - 1))


def find_code_range(
    pairs: Sequence[FramePair], *, file_bits: int, bits: int | None = None
) -> CodeRange:
    """Find how many bits a camera has from the values that its files hold.

    Cameras of 10, 12 or 14 bits write 16-bit files with their code values at the lower end,
    shifted to the upper end, or spread over the whole range.

    The file's bits are 8 or 16. ValueError if the camera cannot have as many as are stated.
    """
    if bits is not None and not 1 <= bits <= file_bits:
        raise ValueError(
            f"bits: must lie within 1..{file_bits} for files of {file_bits} bits, got {bits}"
        )
    values_dn = np.flatnonzero(np.sum([pair.histogram for pair in pairs], axis=0))
    largest = int(values_dn[-1])
    gap = 1  # codes that are shifted or spread over a wider range leave gaps
    if values_dn.size > 1:
        gap = int(np.diff(values_dn).min())
    assumed = ""
    if bits is None:
        bits = file_bits - round(math.log2(gap))  # whether shifted or spread
        if gap == 1 and file_bits == 16:
            bits = next(depth for depth in _DEPTHS if largest < 2**depth)
            if largest < 2**bits - 1:
                assumed = (
                    f"taken as a camera of {bits} bits, as no value exceeds {largest}; state them"
                    " if it has more"
                )
    if largest < 2**bits:  # at the lower end of the file's range
        return CodeRange(bits, assumed=assumed)
    shift = 2 ** (file_bits - bits)
    if not (values_dn % shift).any():
        return CodeRange(bits, float(shift))
    return CodeRange(bits, (2**file_bits - 1) / (2**bits - 1))


def _size(frame: NDArray[Any]) -> str:
    return " x ".join(str(length) for length in frame.shape[1::-1])
