"""Smallest |H| over a continuum of frequencies: an attained value and a rigorous lower bound."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from cep.compiled import compiled
from cep.optics.band import in_band
from cep.optics.code import ShutterCode
from cep.optics.exposure import open_path
from cep.optics.response import ShutterResponse
from cep.optics.straight_motion import straight_axis, uniform_length_px
from cep.proofs.certify.taylor import (
    CELLS_PER_PX,
    Pieces,
    extended,
    first_cells,
    floors,
    jets,
    pieces_along,
    pieces_of_code,
    pieces_of_path,
    snapped,
)
from cep.proofs.certify.zeros import Zero, kantorovich, zeros_along, zeros_of_code
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

_CANDIDATES = 24  # local minima of the first grid that are refined, the lowest ones
_LATER = 4  # cells refined at a later level
_NEARLY_ZERO = 1e-8  # of DC: below it a proof of a true zero is tried
_CHIP_GAP = 1e-6  # relative widths at which subdivision stops: docs/decisions/proofs.md
_PATH_GAP = 1e-4
_PADDED = 16  # points per chip of the quick grid
_FEW = 512  # cells left before sums are made longer for a minimum near rounding
_ALONG = 14.0  # cells per px and spread on a line, where they cost little
_STEPS = 60  # of a descent at most; Newton's steps converge in a few
_SHORTENED = 12  # trials of one step, each 0.35 of the last: a step of 3e-6 of the first is none


@dataclass(frozen=True)
class Minimum:
    """Bounds of a minimum over a continuum.

    Attributes
    ----------
    lower : float
        No frequency lies below it; 0 for a true zero.
    upper : float
        Value at ``at``, reached by refinement; exactly 0 for a proven zero.
    at : tuple of float
        Frequency, cycles per chip or cycles/px.
    method : str
        How ``lower`` was proven, or the proof of the zero.
    zero : Zero, optional
        The zero's proof.
    """

    lower: float
    upper: float
    at: tuple[float, ...]
    method: str = "second-order subdivision"
    zero: Zero | None = None

    @property
    def relative_width(self) -> float:
        """``(upper - lower) / upper``, 0 for a proven zero."""
        return (self.upper - self.lower) / (self.upper or 1.0)


def min_chip(code: ShutterCode) -> float:
    """Smallest |P| over the unit circle, P the code's 0/1 polynomial, in chips.

    Examples
    --------
    >>> round(min_chip(ShutterCode("1111101110100110101101110001111")), 4)  # claimed: 1.85
    0.0
    """
    pieces = pieces_of_code(code)
    grid = np.abs(np.fft.rfft(code.array, _PADDED * code.chips))
    local = np.flatnonzero(ndimage.minimum_filter1d(grid, 3) == grid)
    starts = np.stack([local, 0 * local], axis=1) / (_PADDED * code.chips)
    # narrow minima hide between points of the grid: what counts is how low |P| could fall within a
    # step
    floor = floors(pieces, jets(pieces, starts), np.array([1 / (_PADDED * code.chips), 0.0]))
    order = np.argsort(floor + 0.1 * grid[local])
    lowest = float(polish(pieces, starts[order[:_LATER]])[1].min())
    later = order[_LATER:][floor[order[_LATER:]] < lowest]
    lowest = min(lowest, float(polish(pieces, starts[later])[1].min(initial=np.inf)))
    proven_zero = lowest < _NEARLY_ZERO * code.open_chips and zeros_of_code(code.bits).found
    return 0.0 if proven_zero else lowest


def chip_minimum(code: ShutterCode, *, budget: int = 2_000_000) -> Minimum:
    """Bounds of :func:`min_chip`, within a millionth of it; zeros are decided exactly."""

    def first_zero(_: FloatArray) -> Zero | None:
        return next(iter(zeros_of_code(code.bits).found), None)

    bounds = _bounded(pieces_of_code(code), _CHIP_GAP, budget, first_zero)
    return replace(bounds, at=bounds.at[:1])


def mtf_minimum(
    trajectory: Trajectory,
    code: ShutterCode,
    *,
    budget: int = 300_000,
    response: ShutterResponse | None = None,
) -> Minimum:
    """Bounds of the smallest |H| over the band [-0.5, 0.5]^2 along a trajectory, light-true.

    The subdivision has at most ``budget`` cells, and may then end with a wider interval; 0 gives a
    quick upper bound. ``response`` is that of :func:`cep.optics.exposure.open_path`.
    """
    axis = straight_axis(trajectory)
    path = open_path(trajectory, code, response=response)
    if axis is None:
        pieces = pieces_of_path(path)
        return _bounded(pieces, _PATH_GAP, budget, lambda at: kantorovich(pieces, at))

    def first_zero(_: FloatArray) -> Zero | None:
        # ramps have no closed form, nor has a changing speed: none are listed
        if response is not None:
            return None
        return next(iter(zeros_along(trajectory, code).found), None)

    length_px = uniform_length_px(trajectory) or 0.0
    if 0.5 * np.abs(axis).sum() * length_px >= code.chips:
        # in the band a chip so long has zeros of its own, those of a box: no grid, whose work is
        # the length squared
        zero = first_zero(axis)
        if zero is not None:  # rounding may put the first one just outside
            return Minimum(0.0, 0.0, zero.at, zero.method, zero)
    bounds = _bounded(pieces_along(path, axis), _PATH_GAP, budget, first_zero)
    if bounds.zero:
        return replace(bounds, at=bounds.zero.at)
    return replace(bounds, at=in_band(bounds.at[0], axis))


def _bounded(
    pieces: Pieces, gap: float, budget: int, prove: Callable[[FloatArray], Zero | None]
) -> Minimum:
    """Bound the minimum by a first grid, refinement, and subdivision of cells that may hold less.

    ``prove`` is given a frequency where |H| nearly vanishes, and tries to prove a zero there.
    """
    dc = float(pieces.weight.sum())
    corners = np.array([[-1, 0], [1, 0]])
    cells_per_px = _ALONG
    if pieces.box[1, 1] > pieces.box[1, 0]:  # of a curved path: the band is a plane
        corners = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
        cells_per_px = CELLS_PER_PX
    cells, half = first_cells(pieces, cells_per_px=cells_per_px)
    lower = np.inf
    upper = np.inf
    at = cells[0]
    unproven_zero = np.inf
    while True:
        jet = jets(pieces, cells)
        values = np.hypot(jet[:, 0], jet[:, 1])
        if values.min() < upper:
            starts = np.argsort(values)[:_LATER]
            if upper == np.inf:  # the first grid: its lowest cells may all lie in one valley
                starts = _local_minima(pieces, half, values)
            points = snapped(polish(pieces, cells[starts])[0])
            jet_there = jets(pieces, points)
            lowest = np.hypot(jet_there[:, 0], jet_there[:, 1]) + pieces.slack
            if lowest.min() < upper:
                upper = float(lowest.min())
                at = points[lowest.argmin()]
        # a proof that failed is tried again only much closer to the zero
        if upper < min(_NEARLY_ZERO * dc, 0.5 * unproven_zero):
            unproven_zero = upper
            zero = prove(at)
            if zero is not None:
                return Minimum(0.0, 0.0, zero.at, zero.method, zero)
        floor = floors(pieces, jet, half)
        is_settled = floor >= upper * (1 - gap)
        lower = min(lower, float(floor[is_settled].min(initial=np.inf)))
        open_cells = int((~is_settled).sum())
        rounding_matters = 0.1 * gap * upper < pieces.slack and not pieces.extended
        # points alone (a code on the circle) have exact phases, so that longer sums gain digits
        if rounding_matters and open_cells < _FEW and not pieces.delta.any():
            pieces = extended(pieces)
            jet_at = jets(pieces, at[None])[0]
            upper = min(upper, float(np.hypot(jet_at[0], jet_at[1])) + pieces.slack)
        budget -= open_cells * len(corners)
        if open_cells == 0 or budget < 0 or half.max() < 1e-15:
            lower = min(lower, float(floor[~is_settled].min(initial=np.inf)), upper)
            return Minimum(lower, upper, (float(at[0]), float(at[1])))
        half = half / 2
        cells = (cells[~is_settled][:, None] + half * corners).reshape(-1, 2)


def _local_minima(pieces: Pieces, half: FloatArray, values: FloatArray) -> NDArray[np.intp]:
    """Cells of the first grid that are lower than their neighbours: the lowest of them."""
    sides = np.ptp(pieces.box, axis=1)
    # an axis without extent has one cell of no size
    shape = np.maximum(1, np.rint(sides / np.maximum(2 * half, 1e-300))).astype(int)
    grid = values.reshape(tuple(shape))
    local = np.flatnonzero((ndimage.minimum_filter(grid, 3, mode="nearest") == grid).ravel())
    return np.asarray(local[np.argsort(values[local])][:_CANDIDATES])


def polish(pieces: Pieces, starts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Descend from (F, 2) frequencies to minima (F, 2) of |H| in the box, and |H| there (F,)."""
    points = np.array(starts, dtype=np.float64)
    lowest = np.empty(len(points))
    _descend(points, pieces.box, pieces.weight, pieces.middle, pieces.delta, lowest)
    return points, lowest


@compiled
def _expand(
    fx: float,
    fy: float,
    weight: FloatArray,
    middle: FloatArray,
    delta: FloatArray,
    out: FloatArray,
) -> None:
    """Write H, its gradient and its second derivatives xx, xy, yy: (12,), re and im in turn."""
    mx = middle[0]
    my = middle[1]
    dx = delta[0]
    dy = delta[1]
    hr = hi = xr = xi = yr = yi = ar = ai = br = bi = cr = ci = 0.0
    for s in range(weight.size):
        turn = fx * mx[s] + fy * my[s]
        turn -= np.floor(turn + 0.5)
        re = weight[s] * np.cos(2 * np.pi * turn)
        im = -weight[s] * np.sin(2 * np.pi * turn)
        # sinc and its first two derivatives by their series: pieces are so short that x < 0.6
        x = np.pi * (fx * dx[s] + fy * dy[s])
        z = x * x
        s0 = 1.0 - z / 6 * (1.0 - z / 20 * (1.0 - z / 42 * (1.0 - z / 72 * (1.0 - z / 110))))
        s1 = -x / 3 * (1.0 - z / 10 * (1.0 - z / 28 * (1.0 - z / 54 * (1.0 - z / 88))))
        s2 = -(1.0 - 3 * z / 10 * (1.0 - 5 * z / 84 * (1.0 - 7 * z / 270))) / 3
        hr += s0 * re
        hi += s0 * im
        # derivatives of sinc(f.d) exp(-2 pi i f.m) in units of (2 pi)^order; u = d / 2
        ux = 0.5 * dx[s]
        uy = 0.5 * dy[s]
        xr += mx[s] * s0 * im + ux * s1 * re
        xi += ux * s1 * im - mx[s] * s0 * re
        yr += my[s] * s0 * im + uy * s1 * re
        yi += uy * s1 * im - my[s] * s0 * re
        # (-i m + u d/dx)^2 sinc = -m m s0 - i (m u + u m) s1 + u u s2
        e = ux * ux * s2 - mx[s] * mx[s] * s0
        f = -2 * mx[s] * ux * s1
        ar += e * re - f * im
        ai += e * im + f * re
        e = ux * uy * s2 - mx[s] * my[s] * s0
        f = -(mx[s] * uy + my[s] * ux) * s1
        br += e * re - f * im
        bi += e * im + f * re
        e = uy * uy * s2 - my[s] * my[s] * s0
        f = -2 * my[s] * uy * s1
        cr += e * re - f * im
        ci += e * im + f * re
    slope_scale = 2 * np.pi
    turn2 = 4 * np.pi**2
    out[0], out[1] = hr, hi
    out[2], out[3] = slope_scale * xr, slope_scale * xi
    out[4], out[5] = slope_scale * yr, slope_scale * yi
    out[6], out[7] = turn2 * ar, turn2 * ai
    out[8], out[9] = turn2 * br, turn2 * bi
    out[10], out[11] = turn2 * cr, turn2 * ci


@compiled
def _step(jet: FloatArray, free_x: bool, free_y: bool) -> tuple[float, float]:
    """Newton's step of |H|^2 / 2, or Gauss's where it is not convex; 0 along a fixed axis."""
    gx = jet[0] * jet[2] + jet[1] * jet[3]
    gy = jet[0] * jet[4] + jet[1] * jet[5]
    a = jet[2] * jet[2] + jet[3] * jet[3]
    b = jet[2] * jet[4] + jet[3] * jet[5]
    c = jet[4] * jet[4] + jet[5] * jet[5]
    na = a + jet[0] * jet[6] + jet[1] * jet[7]
    nb = b + jet[0] * jet[8] + jet[1] * jet[9]
    nc = c + jet[0] * jet[10] + jet[1] * jet[11]
    if free_x and free_y:
        if na + nc > 0.0 and na * nc - nb * nb > 1e-6 * (na + nc) * (na + nc):
            a = na
            b = nb
            c = nc
        else:
            # Gauss's matrix is singular where both derivatives point one way
            lift = 1e-3 * (a + c)
            a = a + lift
            c = c + lift
        det = a * c - b * b
        if det <= 0.0:
            return 0.0, 0.0
        return -(c * gx - b * gy) / det, -(a * gy - b * gx) / det
    if free_x:
        return _line_step(gx, a, na), 0.0
    if free_y:
        return 0.0, _line_step(gy, c, nc)
    return 0.0, 0.0


@compiled
def _line_step(slope: float, gauss: float, newton: float) -> float:
    bend = gauss
    if newton > 1e-3 * gauss:
        bend = newton
    if bend <= 0.0:
        return 0.0
    return -slope / bend


@compiled
def _descend(
    points: FloatArray,
    box: FloatArray,
    weight: FloatArray,
    middle: FloatArray,
    delta: FloatArray,
    lowest: FloatArray,
) -> None:
    jet = np.empty(12)
    trial = np.empty(12)
    for i in range(points.shape[0]):
        fx = points[i, 0]
        fy = points[i, 1]
        _expand(fx, fy, weight, middle, delta, jet)
        value = np.sqrt(jet[0] * jet[0] + jet[1] * jet[1])
        for _ in range(_STEPS):
            gx = jet[0] * jet[2] + jet[1] * jet[3]
            gy = jet[0] * jet[4] + jet[1] * jet[5]
            # at an edge whose outside is lower, only the other axis is free
            free_x = not ((fx <= box[0, 0] and gx >= 0.0) or (fx >= box[0, 1] and gx <= 0.0))
            free_y = not ((fy <= box[1, 0] and gy >= 0.0) or (fy >= box[1, 1] and gy <= 0.0))
            step_x, step_y = _step(jet, free_x, free_y)
            better = False
            for _ in range(_SHORTENED):
                new_x = min(box[0, 1], max(box[0, 0], fx + step_x))
                new_y = min(box[1, 1], max(box[1, 0], fy + step_y))
                if new_x == fx and new_y == fy:
                    break
                _expand(new_x, new_y, weight, middle, delta, trial)
                modulus = np.sqrt(trial[0] * trial[0] + trial[1] * trial[1])
                if modulus < value:
                    better = modulus < value * (1 - 1e-15)
                    fx = new_x
                    fy = new_y
                    value = modulus
                    jet[:] = trial
                    break
                step_x *= 0.35
                step_y *= 0.35
            if not better:
                break
        points[i, 0], points[i, 1], lowest[i] = fx, fy, value
