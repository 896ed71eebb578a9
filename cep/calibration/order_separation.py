"""Separation of orders: how much another order in time changes the PSFs of coded photos."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

ComplexArray = NDArray[np.complex64]

BAND_CY_PX = 0.1
"""Highest frequency compared, cycles/px: a blind search finds kernels to about 1 px."""

BLIND_ERROR = 0.02
"""Squared error of a blind search's kernel over the kernel's, in the band:
docs/decisions/motion-estimation.md."""

# frequencies up to the band's end, 1 / 120 cycles/px apart: orders of a path may lie 120 px apart
_STEPS = 12
_SHIFTS = 32  # of one PSF against another along each axis, before the best of them is refined
_NEWTON_STEPS = 2  # the grid of shifts lies within the peak: two steps reach its top
_KNOTS = 53
_MOST_ALTERED = 6
_ALIKE_PX = 2.0  # orders nearer than this to the true one, rms, do no harm


class OrderSeparation:
    """Compare the PSFs of motions with those of the same paths in other orders.

    Parameters
    ----------
    motions : sequence of (N, K, 2) float, px
        The path of each motion, then N - 1 other orders of it, N of at least 2: positions evenly
        spaced in time.
    chips : int

    Examples
    --------
    An open shutter sees no difference between there and back, its second half does:

    >>> there = np.stack([60 * np.linspace(0, 1, 53) ** 2, np.zeros(53)], axis=1)
    >>> measure = OrderSeparation([np.stack([there, there[::-1]])], chips=2)
    >>> [round(float(measure.of(code)[0]), 2) for code in ([1, 1], [0, 1])]
    [0.0, 0.35]
    """

    def __init__(self, motions: Sequence[FloatArray], *, chips: int) -> None:
        down, right = np.mgrid[-_STEPS : _STEPS + 1, : _STEPS + 1]
        # PSFs are real: half of the frequencies hold all
        half_disc = (np.hypot(down, right) <= _STEPS) & ((right > 0) | (down >= 0))
        self._at = np.stack([down[half_disc], right[half_disc]], axis=1)
        # f and -f are one in half a disc, and f = 0 is its own mirror
        self._weights = np.where(self._at.any(axis=1), 2.0, 1.0).astype(np.float32)
        fy, fx = (self._at * (BAND_CY_PX / _STEPS)).T
        edges = np.linspace(0, 1, chips + 1)
        self._slices: ComplexArray = np.stack(
            [
                Trajectory.from_samples(order).slice_otfs(edges, fx, fy).astype(np.complex64)
                for orders in motions
                for order in orders
            ]
        )  # (paths, n, F)
        counts = np.array([len(orders) for orders in motions])
        self._true = np.cumsum(counts) - counts
        self._altered = np.setdiff1d(np.arange(counts.sum()), self._true)
        self._of_motion = np.repeat(np.arange(len(counts)), counts - 1)
        self._energy = self._power(self._slices[self._true].sum(axis=1))  # of the open shutter

    def of(self, code: ArrayLike) -> FloatArray:
        """Measure what one photo through a code adds to the separation of each altered order.

        Parameters
        ----------
        code : (n,) array_like of 0 and 1

        Returns
        -------
        (P,) float
            Energy of the difference between the two PSFs, both in the light that the code lets
            through and laid on each other as they fit best, over the energy of the open shutter's
            PSF. That of several photos adds up.
        """
        otf = np.tensordot(self._slices, np.asarray(code, dtype=np.float32), (1, 0))
        true = otf[self._true[self._of_motion]]
        altered = otf[self._altered]
        energy = self._power(true) + self._power(altered)
        # min over shifts s of |A - B exp(-i f.s)|^2 = |A|^2 + |B|^2 - 2 max Re sum A B* exp(i f.s)
        alike = self._correlation(self._weights * true * altered.conj())
        return np.asarray(
            np.maximum(energy - 2 * alike, 0) / self._energy[self._of_motion], dtype=np.float64
        )

    def of_each_motion(self, separations: FloatArray) -> FloatArray:
        """Smallest separation of each motion (M,), from those of all altered orders (P,)."""
        smallest = np.full(len(self._true), np.inf)
        # indices repeat, which smallest[...] would miss
        np.minimum.at(smallest, self._of_motion, separations)
        return smallest

    def conditioning(self, codes: ArrayLike) -> FloatArray:
        """Smallest rms MTF of codes (I, n) within the band along each motion (M,); 1 at DC."""
        chips = np.asarray(codes, dtype=np.float32)
        shares = chips / chips.mean(axis=1, keepdims=True)  # of the light let through: 1 at DC
        power = sum(
            np.abs(np.tensordot(self._slices[self._true], share, (1, 0))) ** 2 for share in shares
        )
        return np.asarray(np.sqrt(power / len(chips)).min(axis=1), dtype=np.float64)

    def _power(self, otf: ComplexArray) -> FloatArray:
        return np.asarray((np.abs(otf) ** 2 @ self._weights), dtype=np.float64)

    def _correlation(self, cross: ComplexArray) -> FloatArray:
        """Largest correlation over all shifts, (P,), from cross-spectra (P, F)."""
        grid = np.zeros((len(cross), _SHIFTS, _SHIFTS), dtype=np.complex64)
        down, right = self._at.T
        grid[:, down % _SHIFTS, right] = cross
        # "forward" leaves the inverse unscaled: the sum over frequencies itself
        correlations = fft.ifft2(grid, norm="forward").real.reshape(len(cross), -1)
        best = correlations.argmax(axis=1)
        largest = correlations.max(axis=1).astype(np.float64)
        shift = np.stack(np.divmod(best, _SHIFTS), axis=1) * (2 * np.pi / _SHIFTS)
        at = self._at.astype(np.float32)
        products = (at[:, :, None] * at[:, None]).reshape(len(at), 4)
        # Newton on c(s) = Re sum_f X(f) exp(i f.s): the slope is -sum f Im(.), the curvature
        # -sum f f^T Re(.); the 1e-6 keeps it invertible where a cross-spectrum is empty
        for _ in range(_NEWTON_STEPS):
            shifted = cross * np.exp(1j * (shift @ at.T).astype(np.float32))
            curvature = (shifted.real @ products).reshape(-1, 2, 2) + 1e-6 * np.eye(2)
            shift = shift - np.linalg.solve(curvature, (shifted.imag @ at)[..., None])[..., 0]
            reached = (cross * np.exp(1j * (shift @ at.T).astype(np.float32))).real.sum(axis=1)
            largest = np.maximum(largest, reached)  # a Newton step may go astray
        return np.asarray(largest, dtype=np.float64)


def ordered_walks(
    count: int, *, length_px: float = 60.0, rng: np.random.Generator
) -> list[FloatArray]:
    """Draw random walks with other orders that an open shutter cannot tell from them.

    Parameters
    ----------
    count : int
    length_px : float, px
    rng : numpy Generator

    Returns
    -------
    list of (N, 53, 2) float, px
        Path, the path backwards, and up to five others, those with loops reversed that differ by 2
        px rms or more.
    """
    from motdiff.estimators.coded.starts import orders
    from motdiff.motions import boracchi_foi

    walks = []
    for _ in range(count):
        walk = orders(boracchi_foi(rng, max_length_px=length_px), knots=_KNOTS, count=64)
        apart = walk[2:] - walk[0]
        apart = apart - apart.mean(axis=1, keepdims=True)  # a shift of all of it does no harm
        altered = 2 + np.flatnonzero(np.sqrt((apart**2).sum(axis=2).mean(axis=1)) >= _ALIKE_PX)
        chosen = rng.permutation(altered)[: _MOST_ALTERED - 1]
        walks.append(walk[[0, 1, *chosen]])
    return walks
