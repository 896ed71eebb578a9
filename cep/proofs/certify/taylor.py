"""Taylor bounds: H and its gradient at many frequencies, and a lower bound of |H| around each.

With the path measured from the centroid of its open part, Taylor's theorem gives on the cell
``|d_i| <= h_i``::

    |H(f + d)|  >=  Re(conj(u) (H + g . d)) - (2 pi)^2 / 2 d' M d - slack,   |u| = 1,

``g`` the gradient and ``M = integral of p p' dt`` the open path's second moment. The bound closes
quadratically.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cep.compiled import compiled
from cep.optics.code import ShutterCode
from cep.optics.exposure import OpenPath
from motdiff.types import FloatArray

CELLS_PER_PX = 1.5  # of the first grid in the plane: cells per px of the path's spread
_LONGEST_PX = 0.25  # of a piece: the series of sinc are good to rounding up to a phase of 0.6
_EPS = 2.0**-53  # half a unit in the last place: the largest error of one rounding


@dataclass(frozen=True)
class Pieces:
    """Straight pieces of the open path, short enough for a series, measured from their centroid.

    Attributes
    ----------
    weight : (S,) float
        Shares of the exposure, or chips.
    middle, delta : (2, S) float
        Midpoints and extents, px (or chips, along the first axis).
    moment : (2, 2) float
        Second moments about the centroid: the integral of ``p p'``.
    box : (2, 2) float
        Lowest and highest frequency along each axis; by symmetry one half of the band is enough.
    slack : float
        Bound of the rounding error of H at any frequency of the box.
    extended : bool
        Sum in the machine's longest floating point: for codes whose minimum is close to rounding.
    """

    weight: FloatArray
    middle: FloatArray
    delta: FloatArray
    moment: FloatArray
    box: FloatArray
    slack: float
    extended: bool = False

    @property
    def reach(self) -> float:
        """Largest distance from the centroid along an axis, px."""
        return float((np.abs(self.middle) + 0.5 * np.abs(self.delta)).max())

    @property
    def gradient_slack(self) -> float:
        """Bound of the rounding error of each partial derivative."""
        return 2 * np.pi * (self.reach + 1) * self.slack


def pieces_of_path(path: OpenPath) -> Pieces:
    """Prepare an open path for the band [-0.5, 0.5] x [0, 0.5]."""
    return _pieces(path.dt, path.a, path.b, np.array([[-0.5, 0.5], [0.0, 0.5]]))


def pieces_along(path: OpenPath, axis: FloatArray) -> Pieces:
    """Prepare a path on a straight line for frequencies along it, the unit vector ``axis``."""
    reach = 0.5 * float(np.abs(axis).sum())
    a, b = (
        np.stack([vertices @ axis, np.zeros(len(vertices))], axis=1)
        for vertices in (path.a, path.b)
    )
    return _pieces(path.dt, a, b, np.array([[0.0, reach], [0.0, 0.0]]))


def pieces_of_code(code: ShutterCode) -> Pieces:
    """Prepare a code's 0/1 polynomial on the unit circle, frequencies in cycles per chip.

    Chips count from a whole one and frequencies are multiples of 2^-43, so that phases are exact:
    only sines and sums are rounded.
    """
    chips = np.flatnonzero(code.array > 0).astype(np.float64)
    chips -= np.rint(chips.mean())
    middle = np.stack([chips, np.zeros(chips.size)])
    moment = np.array([[float(chips @ chips), 0.0], [0.0, 0.0]])
    slack = _EPS * chips.size * (chips.size + 100)
    box = np.array([[0.0, 0.5], [0.0, 0.0]])
    return Pieces(np.ones(chips.size), middle, np.zeros_like(middle), moment, box, slack)


def snapped(points: FloatArray) -> FloatArray:
    """Round frequencies to the multiples of 2^-43 at which a code's phases are exact."""
    return np.asarray(np.rint(points * 2.0**43) / 2.0**43, dtype=np.float64)


def _pieces(weight: FloatArray, a: FloatArray, b: FloatArray, box: FloatArray) -> Pieces:
    parts = np.maximum(1, np.ceil(np.linalg.norm(b - a, axis=1) / _LONGEST_PX)).astype(np.intp)
    owner = np.repeat(np.arange(parts.size), parts)
    place = np.arange(owner.size) - np.repeat(np.cumsum(parts) - parts, parts)
    delta = (b - a)[owner] / parts[owner, None]
    middle = a[owner] + (place[:, None] + 0.5) * delta
    share = weight[owner] / parts[owner]
    total = float(share.sum())
    # any point would do; the centroid makes the moment, and with it the remainder, smallest
    middle = middle - share @ middle / total
    moment = (middle.T * share) @ middle + (delta.T * share) @ delta / 12
    # each phase is off by a few roundings of |f . p|, the cuts by a rounding of the time; a sum by
    # one per term
    span = float(np.abs(a).max() + np.abs(b).max()) + 1
    length = float(np.linalg.norm(b - a, axis=1).sum())
    slack = _EPS * (total * (200 * span + owner.size + 100) + 8 * len(weight) + 20 * length)
    middle, delta = (np.ascontiguousarray(points.T) for points in (middle, delta))
    return Pieces(share, middle, delta, moment * (1 + 1e-9), box, slack)


def jets(pieces: Pieces, points: FloatArray) -> FloatArray:
    """Real and imaginary parts of H, dH/dfx and dH/dfy, (F, 6), at (F, 2) frequencies."""
    if pieces.extended:
        return _long_jets(pieces, points)
    out = np.empty((len(points), 6))
    _jets(np.ascontiguousarray(points), pieces.weight, pieces.middle, pieces.delta, out)
    return out


def extended(pieces: Pieces) -> Pieces:
    """Use extended precision for the sums; where the machine has none, the bounds stay as wide."""
    count = pieces.weight.size
    slack = float(np.finfo(np.longdouble).eps) * count * (count + 100)
    return replace(pieces, slack=min(slack, pieces.slack), extended=True)


def _long_jets(pieces: Pieces, points: FloatArray) -> FloatArray:
    # of a code alone: points on a line, so that sinc is 1 and nothing varies along y
    places = pieces.middle[0].astype(np.longdouble)
    turns = points[:, :1].astype(np.longdouble) * places
    # np.pi is rounded to double; of whole turns the phase keeps no trace, so that it stays small
    phase = 2 * np.longdouble("3.14159265358979323846264338327950288") * (turns - np.rint(turns))
    re = np.cos(phase)
    im = -np.sin(phase)
    scale = 2 * np.pi * places
    columns = [re.sum(axis=1), im.sum(axis=1), (scale * im).sum(axis=1), -(scale * re).sum(axis=1)]
    return np.stack([*columns, 0 * columns[0], 0 * columns[0]], axis=1).astype(np.float64)


def floors(pieces: Pieces, jet: FloatArray, half: FloatArray) -> FloatArray:
    """Lower bounds (F,) of |H| on the cells of half-sides (2,) around the points of ``jet``."""
    m = pieces.moment
    corner = m[0, 0] * half[0] ** 2 + 2 * abs(m[0, 1]) * half[0] * half[1] + m[1, 1] * half[1] ** 2
    # of the formula's two last terms, at the cell's corner, and what rounding does to g
    loss = 2 * np.pi**2 * float(corner) + pieces.slack + pieces.gradient_slack * float(half.sum())
    out = np.empty(len(jet))
    _floors(jet, float(half[0]), float(half[1]), loss, out)
    return out


def first_cells(
    pieces: Pieces, *, cells_per_px: float = CELLS_PER_PX
) -> tuple[FloatArray, FloatArray]:
    """Centres (F, 2) and half-sides (2,) of a first grid, finer where the path spreads wider."""
    spread = np.sqrt(np.diag(pieces.moment) / pieces.weight.sum())
    sides = np.ptp(pieces.box, axis=1)
    # powers of two: the centres of all later cells are then short binary fractions of the sides
    counts = 2 ** np.ceil(
        np.log2(np.maximum(1.0, 4 * cells_per_px * sides * np.maximum(1.0, spread)))
    )
    half = sides / counts / 2
    axes = [
        lo + h * (2 * np.arange(n) + 1)
        for lo, h, n in zip(pieces.box[:, 0], half, counts, strict=True)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2), half


@compiled
def _jets(
    points: FloatArray, weight: FloatArray, middle: FloatArray, delta: FloatArray, out: FloatArray
) -> None:
    mx = middle[0]
    my = middle[1]
    dx = delta[0]
    dy = delta[1]
    for i in range(points.shape[0]):
        fx = points[i, 0]
        fy = points[i, 1]
        hr = hi = xr = xi = yr = yi = 0.0
        for s in range(weight.size):
            turn = fx * mx[s] + fy * my[s]
            # sine and cosine of pi v, |v| <= 1/2, by their series, then of the double angle: no
            # call, so it vectorises
            v = np.pi * (turn - np.floor(turn + 0.5))
            q = v * v
            series = 1.0 - q / 342
            series = 1.0 - q / 272 * series
            series = 1.0 - q / 210 * series
            series = 1.0 - q / 156 * series
            series = 1.0 - q / 110 * series
            series = 1.0 - q / 72 * series
            series = 1.0 - q / 42 * series
            series = 1.0 - q / 20 * series
            series = 1.0 - q / 6 * series
            sine = v * series
            series = 1.0 - q / 380
            series = 1.0 - q / 306 * series
            series = 1.0 - q / 240 * series
            series = 1.0 - q / 182 * series
            series = 1.0 - q / 132 * series
            series = 1.0 - q / 90 * series
            series = 1.0 - q / 56 * series
            series = 1.0 - q / 30 * series
            series = 1.0 - q / 12 * series
            cosine = 1.0 - q / 2 * series
            re = 1.0 - 2.0 * sine * sine
            im = -2.0 * sine * cosine
            x = np.pi * (fx * dx[s] + fy * dy[s])
            z = x * x
            gain = weight[s] * (
                1.0 - z / 6 * (1.0 - z / 20 * (1.0 - z / 42 * (1.0 - z / 72 * (1.0 - z / 110))))
            )
            series = 1.0 - z / 130
            series = 1.0 - z / 88 * series
            series = 1.0 - z / 54 * series
            series = 1.0 - z / 28 * series
            series = 1.0 - z / 10 * series
            slope = -np.pi * weight[s] * x / 3 * series
            # d/df of exp(-2 pi i f.m) sinc(f.d): -2 pi i m times the term, and d times the slope
            # of sinc
            hr += gain * re
            hi += gain * im
            turned_re = 2 * np.pi * gain * im
            turned_im = -2 * np.pi * gain * re
            xr += mx[s] * turned_re + dx[s] * slope * re
            xi += mx[s] * turned_im + dx[s] * slope * im
            yr += my[s] * turned_re + dy[s] * slope * re
            yi += my[s] * turned_im + dy[s] * slope * im
        out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4], out[i, 5] = hr, hi, xr, xi, yr, yi


@compiled
def _floors(jet: FloatArray, half_x: float, half_y: float, loss: float, out: FloatArray) -> None:
    for i in range(jet.shape[0]):
        hr = jet[i, 0]
        hi = jet[i, 1]
        xr = jet[i, 2]
        xi = jet[i, 3]
        yr = jet[i, 4]
        yi = jet[i, 5]
        best = 0.0
        x2 = xr * xr + xi * xi
        y2 = yr * yr + yi * yi
        x = y = 0.0  # the corner or point d of the cell that decides u
        # of the few operations below
        rounding = abs(hr) + abs(hi) + (abs(xr) + abs(xi)) * half_x + (abs(yr) + abs(yi)) * half_y
        rounding *= 2e-15
        for _ in range(4):
            # direction u: first of H at the centre, then of H + g.d where that is nearly smallest.
            # Any u is valid, a better one only raises the bound
            ur = hr + x * xr + y * yr
            ui = hi + x * xi + y * yi
            size = np.sqrt(ur * ur + ui * ui)
            if size > 0.0:
                ur /= size
                ui /= size
                floor = (
                    ur * hr
                    + ui * hi
                    - abs(ur * xr + ui * xi) * half_x
                    - abs(ur * yr + ui * yi) * half_y
                )
                best = max(best, floor - rounding)
            if x2 > 0.0:
                x = -((hr + y * yr) * xr + (hi + y * yi) * xi) / x2
                x = max(-half_x, min(half_x, x))
            if y2 > 0.0:
                y = -((hr + x * xr) * yr + (hi + x * xi) * yi) / y2
                y = max(-half_y, min(half_y, y))
        out[i] = max(best - loss, 0.0)
