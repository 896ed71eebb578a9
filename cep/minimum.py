"""Smallest |H| over a continuum of frequencies: the value reached, and a lower bound that no grid can fake."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from cep.band import straight_axis
from cep.code import ShutterCode
from cep.exposure import open_path
from motdiff.trajectory import Trajectory

__all__ = ["Minimum", "chip_minimum", "min_chip", "minimum_over_box", "mtf_minimum"]

FloatArray = NDArray[np.float64]
_CANDIDATES = 24  # local minima of the grid that are refined
_RELATIVE_GAP = 1e-3  # subdivision stops here
_SLACK = 1e-12  # rounding of |H| at a point, relative to its maximum


@dataclass(frozen=True)
class Minimum:
    """Bounds of a minimum over a continuum.

    Attributes
    ----------
    lower : float
        No frequency lies below it: grid values less what the Lipschitz constant allows in between.
    upper : float
        Value at ``at``: reached by refinement.
    at : tuple of float
        Frequency, cycles per chip or cycles/px.
    method : str
        How ``lower`` was found, for the certificate in a code file.
    """

    lower: float
    upper: float
    at: tuple[float, ...]
    method: str = "lipschitz-grid"


def min_chip(code: ShutterCode) -> float:
    """Smallest |P| over the whole unit circle, P the code's 0/1 polynomial, in chips (its DC is ``open_chips``).

    Examples
    --------
    >>> round(min_chip(ShutterCode("1111101110100110101101110001111")), 4)  # claimed: 1.85
    0.0
    """
    power = np.abs(np.fft.rfft(code.array, 64 * code.chips))
    start = np.arange(power.size)[ndimage.minimum_filter1d(power, 3) == power] / (64 * code.chips)
    start = start[np.argsort(power[np.rint(start * 64 * code.chips).astype(int)])][:_CANDIDATES]
    modulus, lipschitz = _polynomial(code)
    best, _ = _refine(modulus, lipschitz, start[:, None], np.array([1 / (64 * code.chips)]), _chip_box())
    return best


def chip_minimum(code: ShutterCode) -> Minimum:
    """Bounds of :func:`min_chip`."""
    modulus, lipschitz = _polynomial(code)
    return minimum_over_box(modulus, lipschitz, _chip_box(), step=1 / (16 * code.chips), budget=200_000)


def mtf_minimum(trajectory: Trajectory, code: ShutterCode, *, budget: int = 20_000) -> Minimum:
    """Bounds of the smallest |H| over the band [-0.5, 0.5]^2 along a trajectory, light-true (DC is the duty).

    Parameters
    ----------
    trajectory : Trajectory
    code : ShutterCode
    budget : int
        Frequencies that the lower bound may look at. A straight motion needs few; a curved path may leave it at 0.
    """
    path = open_path(trajectory, code)
    # |H| does not change when the path is shifted, so distances count from the middle of what was seen
    centre = path.dt @ (path.a + path.b) / (2 * path.dt.sum())
    # |p - centre| is convex along a piece: the trapezoid rule bounds its integral from above
    reach = path.dt @ (np.linalg.norm(path.a - centre, axis=1) + np.linalg.norm(path.b - centre, axis=1)) / 2
    lipschitz = 2 * np.pi * float(reach)
    extent = max(trajectory.extent_px, 1.0)
    axis = straight_axis(trajectory)
    if axis is not None:
        box = np.array([[0.0, 0.5 * np.abs(axis).sum()]])
        found = minimum_over_box(
            lambda f: np.abs(path.otf(f[:, 0] * axis[0], f[:, 0] * axis[1])), lipschitz, box, 1 / (16 * extent), budget
        )
        return Minimum(found.lower, found.upper, (float(found.at[0] * axis[0]), float(found.at[0] * axis[1])))
    box = np.array([[-0.5, 0.5], [0.0, 0.5]])
    return minimum_over_box(lambda f: np.abs(path.otf(f[:, 0], f[:, 1])), lipschitz, box, 1 / (3 * extent), budget)


def minimum_over_box(
    modulus: Callable[[FloatArray], FloatArray], lipschitz: float, box: FloatArray, step: float, budget: int
) -> Minimum:
    """Bound the minimum of ``modulus`` over a box by a grid, refinement and subdivision.

    Parameters
    ----------
    modulus : callable
        (P, d) points to (P,) values, with Lipschitz constant ``lipschitz``.
    lipschitz : float
    box : (d, 2) float
    step : float
        Largest cell of the first grid.
    budget : int
        Points that subdivision may add to the first grid.
    """
    cells = np.maximum(1, np.ceil(np.ptp(box, axis=1) / step)).astype(int)
    half = np.ptp(box, axis=1) / cells / 2
    axes = [lo + h * (2 * np.arange(n) + 1) for lo, h, n in zip(box[:, 0], half, cells, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(box))
    values = modulus(points)
    grid = values.reshape(tuple(cells))
    local = np.flatnonzero((ndimage.minimum_filter(grid, 3, mode="nearest") == grid).ravel())
    local = local[np.argsort(values[local])][:_CANDIDATES]
    upper, at = _refine(modulus, lipschitz, points[local], 2 * half, box)
    slack = _SLACK * max(float(values.max()), upper)
    corners = np.stack(np.meshgrid(*[(-1.0, 1.0)] * len(box), indexing="ij"), axis=-1).reshape(-1, len(box))
    lower = upper
    if upper <= 1e3 * slack:  # a zero: subdividing around it would never end
        return Minimum(0.0, upper, tuple(float(v) for v in at))
    while True:
        floor = values - lipschitz * float(np.linalg.norm(half)) - slack
        open_cells = floor < upper * (1 - _RELATIVE_GAP)
        if not open_cells.all():
            lower = min(lower, float(floor[~open_cells].min()))
        count = int(open_cells.sum()) * len(corners)
        if count == 0 or count > budget:
            break
        budget -= count
        half = half / 2
        points = (points[open_cells][:, None] + half * corners).reshape(-1, len(box))
        values = modulus(points)
        if values.min() < upper:
            upper, at = float(values.min()), points[int(values.argmin())]
    if count:
        lower = min(lower, float(floor[open_cells].min()))
    return Minimum(max(lower, 0.0), upper, tuple(float(v) for v in at))


def _refine(
    modulus: Callable[[FloatArray], FloatArray], lipschitz: float, start: FloatArray, step: FloatArray, box: FloatArray
) -> tuple[float, FloatArray]:
    """Walk from every start to its local minimum by a shrinking stencil, dropping those that cannot win."""
    dimensions = len(box)
    stencil = np.stack(np.meshgrid(*[(-1.0, 0.0, 1.0)] * dimensions, indexing="ij"), axis=-1).reshape(-1, dimensions)
    points, values = start, modulus(start)
    for _ in range(48):
        trial = np.clip(points[:, None] + step * stencil, box[:, 0], box[:, 1])
        found = modulus(trial.reshape(-1, dimensions)).reshape(trial.shape[:2])
        pick = found.argmin(axis=1)
        points, values = trial[np.arange(len(trial)), pick], found[np.arange(len(trial)), pick]
        step = step * 0.55
        # all later steps together move a point by less than step * 0.55 / 0.45 along each axis
        can_win = values - 1.3 * lipschitz * float(np.linalg.norm(step)) <= values.min()
        points, values = points[can_win], values[can_win]
        if 1.3 * lipschitz * float(np.linalg.norm(step)) < 1e-9 * values.min():
            break
    best = int(values.argmin())
    return float(values[best]), points[best]


def _chip_box() -> FloatArray:
    return np.array([[0.0, 0.5]])


def _polynomial(code: ShutterCode) -> tuple[Callable[[FloatArray], FloatArray], float]:
    """|P| as a function of cycles per chip, and its Lipschitz constant."""
    chips = np.flatnonzero(code.array > 0)
    # the median makes the constant smallest; a shift in time does not change |P|
    offsets = chips - np.median(chips)

    def modulus(f: FloatArray) -> FloatArray:
        return np.asarray(np.abs(np.exp(-2j * np.pi * f * offsets).sum(axis=1)), dtype=np.float64)

    return modulus, 2 * np.pi * float(np.abs(offsets).sum())
