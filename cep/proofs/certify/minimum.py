"""Smallest |H| over a continuum of frequencies: an attained value and a rigorous lower bound."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from cep.optics.band import in_band, straight_axis, uniform_length_px
from cep.optics.code import ShutterCode
from cep.optics.exposure import open_path
from cep.optics.response import ShutterResponse
from cep.proofs.certify.descent import polish
from cep.proofs.certify.taylor import (
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

SUBDIVISION = "second-order subdivision"
_CANDIDATES = 24  # cells refined: local minima of the first grid, lowest of a later level
_LATER = 4
_NEARLY_ZERO = 1e-8  # of DC: below it a proof of a true zero is tried
_CHIP_GAP = 1e-6  # relative widths at which subdivision stops
_PATH_GAP = 1e-4
_PADDED = 16  # points per chip of the quick grid
_FEW = 512  # cells left before sums are made longer for a minimum near rounding
_ALONG = 14.0  # cells per px and spread on a line, where they cost little


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
        How ``lower`` was found, or the proof of the zero.
    zero : Zero, optional
        The zero's proof.
    """

    lower: float
    upper: float
    at: tuple[float, ...]
    method: str = SUBDIVISION
    zero: Zero | None = None

    @property
    def relative_width(self) -> float:
        """``(upper - lower) / upper``, 0 for a proven zero."""
        return (self.upper - self.lower) / self.upper if self.upper > 0 else 0.0


def min_chip(code: ShutterCode) -> float:
    """Smallest |P| over the whole unit circle, P the code's 0/1 polynomial, in chips (its DC is
    ``open_chips``).

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
    """Bounds of :func:`min_chip`, within a millionth of it; zeros are decided in exact
    arithmetic.
    """
    bounds = _bounded(
        pieces_of_code(code), _CHIP_GAP, budget, lambda _: _first(zeros_of_code(code.bits).found)
    )
    return Minimum(bounds.lower, bounds.upper, bounds.at[:1], bounds.method, bounds.zero)


def mtf_minimum(
    trajectory: Trajectory,
    code: ShutterCode,
    *,
    budget: int = 300_000,
    response: ShutterResponse | None = None,
    edges: ArrayLike | None = None,
) -> Minimum:
    """Bounds of the smallest |H| over the band [-0.5, 0.5]^2 along a trajectory, light-true (DC is
    the duty).

    Parameters
    ----------
    trajectory : Trajectory
    code : ShutterCode
    budget : int
        Largest number of cells of the subdivision, which may then end with a wider interval than a
        thousandth; 0 for a quick upper bound.
    response, edges
        How and when the shutter plays the chips, as in :func:`cep.optics.exposure.open_path`.
    """
    axis = straight_axis(trajectory)
    path = open_path(trajectory, code, response=response, edges=edges)
    if axis is None:
        pieces = pieces_of_path(path)
        return _bounded(pieces, _PATH_GAP, budget, lambda at: kantorovich(pieces, at))
    uniform_px = uniform_length_px(trajectory) if response is None and edges is None else None
    if uniform_px is not None and 0.5 * np.abs(axis).sum() * uniform_px >= code.chips:
        # in the band a chip so long has zeros of its own, those of a box: no grid, whose work is
        # the length squared
        zero = _first(zeros_along(trajectory, code).found)
        if zero is not None:  # rounding may put the first one just outside
            return Minimum(0.0, 0.0, zero.at, zero.method, zero)
    bounds = _bounded(
        pieces_along(path, axis),
        _PATH_GAP,
        budget,
        lambda _: _first(zeros_along(trajectory, code).found) if uniform_px is not None else None,
    )
    at = bounds.zero.at if bounds.zero else in_band(bounds.at[0], axis)
    return Minimum(bounds.lower, bounds.upper, at, bounds.method, bounds.zero)


def _bounded(
    pieces: Pieces, gap: float, budget: int, prove: Callable[[FloatArray], Zero | None]
) -> Minimum:
    """Bound the minimum by a first grid, refinement, and subdivision of the cells that could hold
    less.
    """
    dc = float(pieces.weight.sum())
    plane = pieces.box[1, 1] > pieces.box[1, 0]
    corners = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]] if plane else [[-1, 0], [1, 0]])
    points_only = not pieces.delta.any()
    cells, half = first_cells(pieces) if plane else first_cells(pieces, cells_per_px=_ALONG)
    lower = np.inf
    upper = np.inf
    at = cells[0]
    unproven_zero = np.inf
    while True:
        jet = jets(pieces, cells)
        values = np.hypot(jet[:, 0], jet[:, 1])
        if values.min() < upper:
            starts = np.argsort(values)[:_LATER]
            if upper == np.inf:
                starts = _local_minima(pieces, half, values)
            points = snapped(polish(pieces, cells[starts])[0])
            jet_there = jets(pieces, points)
            lowest = np.hypot(jet_there[:, 0], jet_there[:, 1]) + pieces.slack
            if lowest.min() < upper:
                upper = float(lowest.min())
                at = points[lowest.argmin()]
        if upper < min(_NEARLY_ZERO * dc, 0.5 * unproven_zero):
            unproven_zero = upper
            zero = prove(at)
            if zero is not None:
                return Minimum(0.0, 0.0, zero.at, zero.method, zero)
        floor = floors(pieces, jet, half)
        is_settled = floor >= upper * (1 - gap)
        lower = min(lower, float(floor[is_settled].min(initial=np.inf)))
        children = 2 ** (1 + plane)
        open_cells = int((~is_settled).sum())
        if (
            points_only
            and open_cells < _FEW
            and 0.1 * gap * upper < pieces.slack
            and not pieces.extended
        ):
            pieces = extended(pieces)
            jet_at = jets(pieces, at[None])[0]
            upper = min(upper, float(np.hypot(jet_at[0], jet_at[1])) + pieces.slack)
        budget -= open_cells * children
        if open_cells == 0 or budget < 0 or half.max() < 1e-15:
            lower = min(lower, float(floor[~is_settled].min(initial=np.inf)), upper)
            return Minimum(lower, upper, (float(at[0]), float(at[1])))
        half = half / 2
        cells = (cells[~is_settled][:, None] + half * corners).reshape(-1, 2)


def _local_minima(pieces: Pieces, half: FloatArray, values: FloatArray) -> NDArray[np.intp]:
    """Cells of the first grid that are lower than their neighbours: the lowest of them."""
    shape = np.maximum(
        1, np.rint(np.ptp(pieces.box, axis=1) / np.maximum(2 * half, 1e-300))
    ).astype(int)
    grid = values.reshape(tuple(shape))
    local = np.flatnonzero((ndimage.minimum_filter(grid, 3, mode="nearest") == grid).ravel())
    return np.asarray(local[np.argsort(values[local])][:_CANDIDATES])


def _first(zeros: tuple[Zero, ...]) -> Zero | None:
    return zeros[0] if zeros else None
