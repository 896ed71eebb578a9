"""Trajectory of the image during one exposure, with its exact OTF, PSF and HR map (numpy only).

A :class:`Trajectory` is piecewise linear in time. So the OTF is a sum of closed-form segment
terms, and the PSF on a pixel grid is integrated exactly, so no rasterising error enters a design.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from motdiff.path_psfs import interpolated, slice_of, slice_psfs
from motdiff.psf_frame import MAP_CENTRE, MAP_PITCH, MAP_PX, PSF_PX
from motdiff.types import ComplexArray, FloatArray

Direction = Literal["known", "unknown"]

LONGEST_PX = 4096.0
"""Longest path that is handled, px: it passes every pixel of the usual PSF frame once, or crosses
a large photo."""

_CENTRE_TOLERANCE_PX = 1e-6
_OTF_CHUNK = 2**18  # complex numbers held at once: stays in cache, 3.5 x faster than 2**22


@dataclass(frozen=True)
class Segments:
    """Straight pieces of a trajectory, cut at the edges of time slices.

    Attributes
    ----------
    slice_index : (S,) int
        The time slice that each piece belongs to.
    dt : (S,) float
        Duration, as a fraction of the exposure.
    a, b : (S, 2) float
        Start and end, px.
    """

    slice_index: NDArray[np.intp]
    dt: FloatArray
    a: FloatArray
    b: FloatArray


@dataclass(frozen=True)
class Trajectory:
    """A motion trajectory: image displacement over the exposure.

    Parameters
    ----------
    t : (T,) float
        Times as a fraction of the exposure, strictly increasing from 0 to 1. Dwell is their
        spacing.
    xy : (T, 2) float, px
        Displacement, x to the right and y down, with its time-mean at (0, 0) and straight between
        samples.
    direction : {"known", "unknown"}
        Whether the order in time is known, or only up to reversal (one uncoded photo can never
        tell).

    Raises
    ------
    ValueError
        If the samples are fewer than two, not finite, not increasing, or not centred.

    See Also
    --------
    Trajectory.from_samples : centres the path and rescales the times.

    Examples
    --------
    >>> path = Trajectory.from_samples([[0, 0], [3, 4], [3, 8]])
    >>> path.length_px, path.direction
    (9.0, 'unknown')
    >>> round(float(path.psf().sum()), 6)
    1.0
    """

    t: FloatArray
    xy: FloatArray
    direction: Direction = "unknown"

    def __post_init__(self) -> None:
        t = np.array(self.t, dtype=np.float64)
        xy = np.array(self.xy, dtype=np.float64)
        if t.ndim != 1 or xy.shape != (t.size, 2):
            raise ValueError(
                f"trajectory: t must be (T,) and xy (T, 2), got {t.shape} and {xy.shape}"
            )
        if t.size < 2:
            raise ValueError(f"trajectory: needs at least 2 samples, got {t.size}")
        if not (np.isfinite(t).all() and np.isfinite(xy).all()):
            raise ValueError("trajectory: t and xy must be finite, found NaN or infinity")
        if not (np.diff(t) > 0).all():
            where = int(np.argmin(np.diff(t))) + 1
            raise ValueError(
                f"trajectory: t must be strictly increasing, but t[{where}] <= t[{where - 1}]"
            )
        if abs(t[0]) > 1e-9 or abs(t[-1] - 1) > 1e-9:
            raise ValueError(f"trajectory: t must run from 0 to 1, got {t[0]:g} to {t[-1]:g}")
        if self.direction not in ("known", "unknown"):
            raise ValueError(
                f'trajectory: direction must be "known" or "unknown", got {self.direction!r}'
            )
        mean = _time_mean(t, xy)
        if np.abs(mean).max() > _CENTRE_TOLERANCE_PX * max(1.0, float(np.abs(xy).max())):
            raise ValueError(
                f"trajectory: time-mean must be at (0, 0), got ({mean[0]:.3g}, {mean[1]:.3g}); use"
                " from_samples"
            )
        # to the last digit: slices are cut at 0 and 1
        t[0], t[-1] = 0.0, 1.0
        for name, values in (("t", t), ("xy", xy)):
            values.setflags(write=False)
            object.__setattr__(self, name, values)

    def __eq__(self, value: object) -> bool:
        """Whether a value is the same path in the same order, sample by sample."""
        return isinstance(value, Trajectory) and self._samples == value._samples

    def __hash__(self) -> int:
        """Of the same samples, so that a trajectory can be looked up."""
        return hash(self._samples)

    @property
    def _samples(self) -> tuple[bytes, bytes, Direction]:
        # 0 added: -0.0 has other bytes
        return (self.t + 0.0).tobytes(), (self.xy + 0.0).tobytes(), self.direction

    # -- making one -------------------------------------------------------------------------------

    @classmethod
    def from_samples(
        cls, xy: ArrayLike, *, t: ArrayLike | None = None, direction: Direction = "unknown"
    ) -> Trajectory:
        """Make a trajectory from raw samples: times are rescaled to 0..1 and the path is centred.

        ``xy`` (T, 2) is in px. The times ``t`` (T,) may have any unit; they are evenly spaced when
        omitted. Errors are those of the constructor.
        """
        points = np.asarray(xy, dtype=np.float64)
        times = np.linspace(0, 1, len(points)) if t is None else np.asarray(t, dtype=np.float64)
        # what is malformed goes on as it is: the constructor says what is wrong
        well_formed = times.ndim == 1 and times.size > 1 and points.shape == (times.size, 2)
        if (
            well_formed
            and np.isfinite(times).all()
            and np.isfinite(points).all()
            and times[-1] > times[0]
        ):
            times = (times - times[0]) / (times[-1] - times[0])
            points = points - _time_mean(times, points)
        return cls(times, points, direction)

    @classmethod
    def straight(
        cls, length_px: float, *, angle_rad: float = 0.0, direction: Direction = "unknown"
    ) -> Trajectory:
        """Make a uniform straight motion; the angle turns from +x (right) towards +y (down).

        Examples
        --------
        >>> Trajectory.straight(20.0).length_px
        20.0
        """
        end = 0.5 * length_px * np.array([np.cos(angle_rad), np.sin(angle_rad)])
        return cls(np.array([0.0, 1.0]), np.array([-end, end]), direction)

    # -- measuring and changing one ---------------------------------------------------------------

    @property
    def x(self) -> FloatArray:
        """(T,) displacement to the right, px."""
        return self.xy[:, 0]

    @property
    def y(self) -> FloatArray:
        """(T,) displacement down, px."""
        return self.xy[:, 1]

    @property
    def length_px(self) -> float:
        """Arc length, px."""
        return float(self.arc_px[-1])

    @property
    def arc_px(self) -> FloatArray:
        """(T,) arc length from the start up to each sample, px."""
        return arc_lengths(self.xy)

    @property
    def extent_px(self) -> float:
        """Larger side of the bounding box, px."""
        return float(np.ptp(self.xy, axis=0).max())

    def at(self, t: ArrayLike) -> FloatArray:
        """Displacement (..., 2) px at times ``t`` (...) as a fraction of the exposure."""
        return interpolated(np.asarray(t, dtype=np.float64), self.t, self.xy)

    def reversed(self) -> Trajectory:
        """Return the path backwards in time: the uncoded OTF stays, a coded one changes."""
        return replace(self, t=1.0 - self.t[::-1], xy=self.xy[::-1])

    def scaled(self, factor: float) -> Trajectory:
        """Return the path enlarged by ``factor``, as that of a photo resized by it."""
        if not (np.isfinite(factor) and factor > 0):
            raise ValueError(f"factor must be a positive number, got {factor}")
        return replace(self, xy=self.xy * factor)

    def thinned(self, tolerance_px: float = 1e-4) -> Trajectory:
        """Return the path with fewer samples, always within ``tolerance_px`` of this one.

        Its OTF differs by at most ``2 pi |f| tolerance_px``. Made for paths of a million samples,
        in about a second. ValueError if the tolerance is not a positive number.
        """
        check_positive("tolerance_px", tolerance_px)
        # centring the thinned path moves it by no more than it was moved on average
        knots = thinned_knots(self.t, self.xy, 0.5 * tolerance_px)
        return Trajectory.from_samples(self.xy[knots], t=self.t[knots], direction=self.direction)

    def arc_resampled(self, samples: int) -> FloatArray:
        """Points (samples, 2) px evenly spaced along the path, whatever the dwell."""
        arc = self.arc_px
        return interpolated(np.linspace(0, arc[-1], samples), arc, self.xy)

    def segments(self, edges: Sequence[float] | FloatArray = (0.0, 1.0)) -> Segments:
        """Cut the path into straight pieces at its samples and at slice ``edges`` within 0..1."""
        cuts = _checked_edges(edges)
        u = np.union1d(self.t[(self.t > cuts[0]) & (self.t < cuts[-1])], cuts)
        points = self.at(u)
        slice_index = slice_of(0.5 * (u[1:] + u[:-1]), cuts)
        return Segments(slice_index, np.diff(u), points[:-1], points[1:])

    # -- optics -----------------------------------------------------------------------------------

    def otf(self, fx_cy_px: ArrayLike, fy_cy_px: ArrayLike) -> ComplexArray:
        r"""Exact OTF, ``H(f) = integral_0^1 exp(-2 pi i f . p(t)) dt``, at any real frequencies.

        Frequencies in cycles/px broadcast together, and the result has their shape. No pixel grid
        is involved; multiply by :func:`bilinear_otf` or :func:`pixel_aperture_otf` for sampling.
        """
        (otf,) = self.slice_otfs((0.0, 1.0), fx_cy_px, fy_cy_px)
        return np.asarray(otf, dtype=np.complex128)

    def slice_otfs(
        self, edges: Sequence[float] | FloatArray, fx_cy_px: ArrayLike, fy_cy_px: ArrayLike
    ) -> ComplexArray:
        """Exact OTF of each time slice, (slices, ...): they sum to that of the span of the edges.

        The edges (slices + 1,) are increasing times within 0..1, frequencies as of :meth:`otf`.
        """
        fx, fy = np.broadcast_arrays(
            np.asarray(fx_cy_px, np.float64), np.asarray(fy_cy_px, np.float64)
        )
        pieces = self.segments(edges)
        out = np.zeros((len(edges) - 1, fx.size), dtype=np.complex128)
        flat_x = fx.ravel()
        flat_y = fy.ravel()
        step = max(1, _OTF_CHUNK // max(1, pieces.dt.size))
        middle = 0.5 * (pieces.a + pieces.b)
        delta = pieces.b - pieces.a
        starts = np.flatnonzero(np.diff(pieces.slice_index, prepend=-1))
        for lo in range(0, fx.size, step):
            f = np.stack([flat_x[lo : lo + step], flat_y[lo : lo + step]])
            # straight piece: integral of exp(-2 pi i f . p) = dt sinc(f . (b - a)) exp(at middle)
            terms = pieces.dt[:, None] * np.sinc(delta @ f) * np.exp(-2j * np.pi * (middle @ f))
            out[:, lo : lo + step] = np.add.reduceat(terms, starts, axis=0)
        shaped: ComplexArray = out.reshape(-1, *fx.shape)
        return shaped

    def psf(self, size: int = PSF_PX) -> FloatArray:
        """PSF (size, size), summing to 1, zero displacement at index ``size // 2``.

        The path's measure seen through the bilinear hat of each pixel, integrated exactly. The
        ValueError for a path that does not fit the frame says which size would.
        """
        (psf,) = self.slice_psfs((0.0, 1.0), size)
        return np.asarray(psf, dtype=np.float64)

    def slice_psfs(self, edges: Sequence[float] | FloatArray, size: int = PSF_PX) -> FloatArray:
        """PSF of each time slice, (slices, size, size), summing to its share of the exposure."""
        needed = self.frame_size()
        if size < needed:
            raise ValueError(
                f"size: the path needs a PSF frame of at least {needed} px, got {size}"
            )
        return slice_psfs(self.t, self.xy, _checked_edges(edges), size)

    def frame_size(self, least_px: int = 1) -> int:
        """Smallest PSF frame of at least ``least_px`` that holds the whole path, px."""
        # the bilinear hat of a point touches the pixels on both sides of it
        low = np.floor(self.xy.min())
        high = np.floor(self.xy.max()) + 1
        return int(max(least_px, -2 * low, 2 * high + 1))

    def hr_map(self) -> NDArray[np.uint8]:
        """Binary map (256, 256) of the path at a pitch of 1/4 px, one pixel wide and 8-connected.

        Displacement d px sits at index ``129.5 + 4 d``, so that 4 x 4 box means land on the 64-px
        PSF's grid. ValueError if the path leaves the 64-px field.
        """
        samples = int(np.ceil(8 * self.length_px)) + 2
        index = np.rint(MAP_CENTRE + MAP_PITCH * self.arc_resampled(samples)).astype(np.intp)
        if index.min() < 0 or index.max() >= MAP_PX:
            raise ValueError(
                "trajectory: leaves the 64-px field of the HR map (extent"
                f" {self.extent_px:.1f} px)"
            )
        hr = np.zeros((MAP_PX, MAP_PX), np.uint8)
        pixels = thin_path(index)
        hr[pixels[:, 1], pixels[:, 0]] = 1
        return hr


def check_positive(name: str, value: float) -> None:
    """Refuse a value that is no positive, finite number; the ValueError names it."""
    if not (np.isfinite(value) and value > 0):
        raise ValueError(f"{name}: must be a positive number, got {value}")


def checked_points(name: str, points: ArrayLike) -> FloatArray:
    """Return points (N, 2), at least one, as float64; ValueError, which names them, for others."""
    path = np.asarray(points, dtype=np.float64)
    if path.ndim != 2 or path.shape[1:] != (2,) or not len(path) or not np.isfinite(path).all():
        raise ValueError(
            f"{name}: must be finite (N, 2) points with N >= 1, got shape {path.shape}"
        )
    return path


def arc_lengths(points: FloatArray) -> FloatArray:
    """Length (N,), px, of a path of points (N, 2) up to each of them."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def bilinear_otf(fx_cy_px: ArrayLike, fy_cy_px: ArrayLike) -> FloatArray:
    """OTF of bilinear splatting, ``sinc(fx)^2 sinc(fy)^2``, frequencies in cycles/px."""
    return pixel_aperture_otf(fx_cy_px, fy_cy_px) ** 2


def pixel_aperture_otf(fx_cy_px: ArrayLike, fy_cy_px: ArrayLike) -> FloatArray:
    """OTF of a square pixel with full fill, ``sinc(fx) sinc(fy)`` (frequencies in cycles/px)."""
    fx = np.asarray(fx_cy_px, dtype=np.float64)
    fy = np.asarray(fy_cy_px, dtype=np.float64)
    return np.asarray(np.sinc(fx) * np.sinc(fy), dtype=np.float64)


def _time_mean(t: FloatArray, xy: FloatArray) -> FloatArray:
    return np.asarray(np.diff(t) @ (0.5 * (xy[1:] + xy[:-1])), dtype=np.float64)


def _checked_edges(edges: Sequence[float] | FloatArray) -> FloatArray:
    cuts = np.asarray(edges, dtype=np.float64)
    if (
        cuts.ndim != 1
        or cuts.size < 2
        or not (np.diff(cuts) > 0).all()
        or cuts[0] < 0
        or cuts[-1] > 1
    ):
        raise ValueError("edges: need at least two times, increasing, within 0..1")
    return cuts


def thin_path(index: NDArray[np.intp]) -> NDArray[np.intp]:
    """Thin a walk of touching pixels to an 8-connected line without corner steps.

    Consecutive pixels (N, 2) are equal or 8-neighbours; the line (M, 2) has the same ends.
    """
    is_new = np.r_[True, np.any(np.diff(index, axis=0) != 0, axis=1)]
    walk = index[is_new]
    line = [walk[0]]
    for pixel, after in itertools.pairwise(walk[1:]):
        if np.abs(after - line[-1]).max() > 1:  # otherwise its neighbours already touch: a corner
            line.append(pixel)
    line.append(walk[-1])
    return np.array(line)


def thinned_knots(t: FloatArray, xy: FloatArray, tolerance_px: float) -> NDArray[np.intp]:
    """Choose samples between which a path is straight in space and time, to within a tolerance.

    Neighbouring intervals are joined in pairs, these in pairs again, and so on, as long as every
    sample between the ends lies within the tolerance of the straight, uniform motion between them.
    That takes O(T log T), or O(T) where nothing can be joined, and gives up to a few times as many
    samples as the fewest possible.

    The path has times ``t`` (T,) and places ``xy`` (T, 2), px. ``tolerance_px`` is the largest
    distance, at equal times, between it and the one through the chosen samples, (K,) from 0 to
    T - 1.
    """
    is_knot = np.ones(t.size, dtype=bool)
    joined = np.ones(t.size - 1, dtype=bool)  # whether each block of intervals is straight
    width = 1
    while joined.size > 1:
        width *= 2
        blocks = joined.size // 2
        straight = np.asarray(joined[: 2 * blocks].reshape(blocks, 2).all(axis=1))
        candidates = np.flatnonzero(straight)
        if not candidates.size:
            break
        first = candidates * width
        last = (candidates + 1) * width
        times = t[: blocks * width].reshape(blocks, width)[candidates]
        share = (times - t[first, None]) / (t[last] - t[first])[:, None]
        distance2 = np.zeros(share.shape)
        for column in xy.T:
            start = column[first, None]
            chord = start + share * (column[last, None] - start)
            distance2 += (column[: blocks * width].reshape(blocks, width)[candidates] - chord) ** 2
        fits = distance2.max(axis=1) <= tolerance_px**2
        straight[candidates] = fits
        is_knot[first[fits] + width // 2] = False
        joined = straight
    return np.flatnonzero(is_knot)


def check_length(trajectory: Trajectory) -> None:
    """Refuse a path of more than :data:`LONGEST_PX`, before work that grows with its length."""
    if trajectory.length_px > LONGEST_PX:
        raise ValueError(
            f"trajectory: the path is {trajectory.length_px:.6g} px long, at most {LONGEST_PX:g}"
            " px can be handled"
        )
