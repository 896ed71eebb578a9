"""Quadrature of |H| over the frequency band [-0.5, 0.5]^2, along one axis for straight motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cep.optics.straight_motion import straight_axis
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

_NARROWEST = 1 / 256  # cycles/px: finest feature of a scene spectrum
_MOST_INTERVALS = 2**18  # beyond 8000 px memory counts: so many, while they still resolve H
_LEAST_OVERSAMPLING = 8
ACROSS = 12
"""Gauss-Legendre nodes along the lines on which a straight motion's OTF is constant."""


@dataclass(frozen=True)
class BandSamples:
    """Quadrature over the band for |H|, which is even in frequency.

    Attributes
    ----------
    fx, fy : (F,) float, cycles/px
    weight : (F,) float
        Shares of the band; they sum to 1, so ``weight @ g`` is the mean of g over the band.
    radius2 : (F, Q) float, (cycles/px)^2
        Squared radii within a sample's share: a straight motion has the same H along a whole line,
        a scene's spectrum has not.
    radius2_weight : (F, Q) float
        Their parts of the sample's share, each row summing to 1.
    """

    fx: FloatArray
    fy: FloatArray
    weight: FloatArray
    radius2: FloatArray
    radius2_weight: FloatArray


def band(size: int = 64) -> tuple[FloatArray, FloatArray]:
    """FFT frequencies (fx, fy), each (size, size) cycles/px, zero at index ``size // 2``."""
    axis = np.fft.fftshift(np.fft.fftfreq(size))
    fx, fy = np.meshgrid(axis, axis)
    return fx, fy


def band_samples(
    trajectory: Trajectory, *, oversampling: int = 64, across: int = ACROSS
) -> BandSamples:
    """Make a quadrature that resolves |H| along ``trajectory`` for any code.

    H is the Fourier transform of something no wider than the path, so 1 / extent is its natural
    step. A straight motion takes ``oversampling`` samples per such step along its one axis, or at
    least 8 where that makes more than 2^18, for thousands of px. A curved one takes the trapezoid
    rule on 64 intervals a side, or on as many as its extent in px. The lines on which a straight
    motion's H is constant are crossed by ``across`` nodes.
    """
    axis = straight_axis(trajectory)
    if axis is not None:
        return _along(axis, max(1.0, float(np.ptp(trajectory.xy @ axis))), oversampling, across)
    return grid_samples(max(64, 2 * int(np.ceil(trajectory.extent_px / 2))))


def grid_samples(side: int) -> BandSamples:
    """Make the trapezoid rule on so many intervals a side, an even number, for any |H|."""
    fx, fy = np.meshgrid(np.linspace(-0.5, 0.5, side + 1), np.linspace(0, 0.5, side // 2 + 1))
    wx = np.ones(side + 1)
    wy = np.ones(side // 2 + 1)
    wx[[0, -1]] = wy[[0, -1]] = 0.5
    weight = np.outer(wy, wx).ravel()
    return BandSamples(
        fx.ravel(),
        fy.ravel(),
        weight / weight.sum(),
        (fx**2 + fy**2).ravel()[:, None],
        np.ones((fx.size, 1)),
    )


def circle_samples(chips: int, *, oversampling: int = 64) -> BandSamples:
    """Make a quadrature over the unit circle of a code's polynomial: ``fx`` in cycles/chip."""
    return _along(np.array([1.0, 0.0]), float(chips), oversampling, ACROSS)


def in_band(along: float, axis: FloatArray) -> tuple[float, float]:
    """Find a frequency of the band whose component along a straight motion is ``along``."""
    x, y = along * axis
    if max(abs(x), abs(y)) > 0.5:
        x, y = np.sign(axis) * along / np.abs(axis).sum()
    return float(x), float(y)


def _along(axis: FloatArray, extent_px: float, oversampling: int, across: int) -> BandSamples:
    reach = 0.5 * float(np.abs(axis).sum())
    steps = max(4.0, extent_px * reach)
    intervals = int(
        np.ceil(min(oversampling * steps, max(_MOST_INTERVALS, _LEAST_OVERSAMPLING * steps)))
    )
    s = np.linspace(0, reach, intervals + 1)
    # the line f.axis = s leaves the square at low and high, measured across
    low = np.full(s.size, -np.inf)
    high = np.full(s.size, np.inf)
    for along, sideways in zip(axis, (-axis[1], axis[0]), strict=True):
        if abs(sideways) > 1e-12:
            crossings = np.stack([(-0.5 - s * along) / sideways, (0.5 - s * along) / sideways])
            low = np.maximum(low, crossings.min(axis=0))
            high = np.minimum(high, crossings.max(axis=0))
    weight = np.maximum(high - low, 0.0)
    weight[[0, -1]] *= 0.5
    # across the line a scene's 1 / (s^2 + q^2) peaks at q = 0: evenly spaced in asinh(q / width)
    # resolves any width
    width = np.hypot(s, _NARROWEST)
    u_low = np.arcsinh(low / width)
    u_high = np.arcsinh(high / width)
    nodes, shares = np.polynomial.legendre.leggauss(across)
    u = 0.5 * (u_low + u_high)[:, None] + 0.5 * (u_high - u_low)[:, None] * nodes
    across_f = width[:, None] * np.sinh(u)
    share = shares * np.cosh(u)
    return BandSamples(
        s * axis[0],
        s * axis[1],
        weight / weight.sum(),
        s[:, None] ** 2 + across_f**2,
        share / share.sum(axis=1, keepdims=True),
    )
