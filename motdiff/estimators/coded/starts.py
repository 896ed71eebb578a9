"""Paths to begin a fit from: decoded from the photos' kernels, in other orders of a path, and
crossed from two.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from motdiff.metrics import register_shift
from motdiff.psf_frame import in_frame
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

_PASS_PX = 1.5  # strands nearer than this meet
_LOOP_PX = 4.0  # less path between two meetings is no loop
_MOST_MEETINGS = 10
_FAINT = 0.04  # share of the peak
_DOUBT = 0.08  # least share of the light at a point with the shutter open, or closed
_BLUR_PX = 1.0  # between kernels that were found apart from each other
_EMISSION = 0.3  # weight of how bright a point is
_STRAY_PX = 0.6  # stretches that differ by less are the same


def decoded_paths(
    kernels: Sequence[FloatArray],
    codes: Sequence[str],
    *,
    knots: int,
    count: int,
    length_px: float,
    rng: np.random.Generator,
    shifts: FloatArray | None = None,
) -> FloatArray:
    """Draw paths whose every moment lies where the kernels have light at the codes' bits of that
    moment.

    The share of a point's light that an exposure holds tells whether its shutter was open when the
    path passed there. A hidden Markov model over the points of the first kernel with steps of
    about the mean speed draws whole paths (forward filtering, backward sampling).

    Parameters
    ----------
    kernels : sequence of I (S, S) float
        Of the exposures; the first is that of the code with the most light.
    codes : sequence of I str
    knots, count : int
    length_px : float
        Length of the path, as far as it is known.
    rng : numpy Generator
    shifts : (I, 2) float, optional
        Where each kernel lies against the path, (x, y) px; they are laid on the first one when
        omitted.

    Returns
    -------
    (count, knots, 2) float, px
    """
    size = max(len(kernel) for kernel in kernels)
    light = [np.mean(np.array(list(code), dtype=np.float64)) for code in codes]
    soft = [
        share * ndimage.gaussian_filter(in_frame(kernel / kernel.sum(), size), _BLUR_PX)
        for kernel, share in zip(kernels, light, strict=True)
    ]
    laid = [soft[0]]
    for i, kernel in enumerate(soft[1:], 1):
        move = (
            register_shift(soft[0], kernel)[::-1]
            if shifts is None
            else (shifts[0] - shifts[i])[::-1]
        )
        laid.append(np.maximum(ndimage.shift(kernel, move, order=1), 0))
    lit = soft[0] > _FAINT * soft[0].max()
    rows, columns = np.nonzero(lit)
    steps = knots - 1
    when = (np.arange(steps) + 0.5) / steps
    score = np.tile(_EMISSION * np.log(soft[0][lit] / soft[0].max()), (steps, 1))
    for code, share, kernel in zip(codes, light, laid, strict=True):
        if share == 1:
            continue
        held = np.clip(kernel[lit] / soft[0][lit] * light[0], _DOUBT, 1 - _DOUBT)
        is_open = np.array(list(code))[(when * len(code)).astype(np.intp)] == "1"
        score += np.where(is_open[:, None], np.log(held), np.log(1 - held))
    emission = np.exp(score - score.max(axis=1, keepdims=True))
    step_px = length_px / steps
    apart = np.hypot(rows[:, None] - rows, columns[:, None] - columns)
    passing = np.exp(-0.5 * ((apart - step_px) / (0.6 * step_px + 0.5)) ** 2)
    passing /= passing.sum(axis=1, keepdims=True)
    forward = np.empty_like(emission)
    forward[0] = emission[0] / emission[0].sum()
    for k in range(1, steps):
        forward[k] = (forward[k - 1] @ passing) * emission[k]
        forward[k] /= forward[k].sum()
    points = np.stack([columns, rows], axis=1) - float(size // 2)
    state = rng.choice(len(points), size=count, p=forward[-1])
    drawn = [state]
    for k in range(steps - 2, -1, -1):
        chances = np.cumsum(forward[k] * passing[:, state].T, axis=1)
        state = (chances < rng.random((count, 1)) * chances[:, -1:]).sum(axis=1)
        drawn.append(np.minimum(state, len(points) - 1))
        state = drawn[-1]
    smooth = ndimage.gaussian_filter1d(points[np.array(drawn[::-1])], 1.5, axis=0, mode="nearest")
    at = np.linspace(0, 1, knots)
    return np.stack(
        [[np.interp(at, when, smooth[:, i, axis]) for axis in (0, 1)] for i in range(count)]
    ).swapaxes(1, 2)


def orders(path: Trajectory, *, knots: int, most: int) -> FloatArray:
    """Orders in time (N, knots, 2) that draw the same PSF: loops between two meetings reversed,
    and the whole.

    Parameters
    ----------
    path : Trajectory
    knots, most : int
    """
    fine = path.at(np.linspace(0, 1, 20 * (knots - 1) + 1))
    loops = _meetings(fine, path)
    subsets = itertools.chain.from_iterable(
        itertools.combinations(loops, n) for n in range(len(loops) + 1)
    )
    chosen = (
        subset
        for subset in subsets
        if not any(_overlap(*pair) for pair in itertools.combinations(subset, 2))
    )
    found = []
    for subset in itertools.islice(chosen, max(1, most // 2)):
        order = fine
        for start, stop in sorted(subset, key=lambda loop: loop[1] - loop[0]):  # inner loops first
            order = _reversed_loop(order, start, stop)
        found += [order[::20], order[::-20]]
    return np.stack(found)[:most]


def loop_reversals(points: FloatArray, *, most: int, rng: np.random.Generator) -> list[FloatArray]:
    """Paths (K, 2) like ``points`` but for one loop, reversed; the whole path reversed where there
    is none.
    """
    loops = _meetings(points, Trajectory.from_samples(points))
    found = [_reversed_loop(points, start, stop) for start, stop in loops] or [points[::-1]]
    return [found[i] for i in rng.permutation(len(found))[:most]]


def crossed(path: FloatArray, other: FloatArray, *, rng: np.random.Generator) -> FloatArray | None:
    """Return a path (K, 2) with a stretch of another, between two times at which both are at one
    place, or None.

    Parameters
    ----------
    path, other : (K, 2) float, px
    rng : numpy Generator
    """
    apart = np.linalg.norm(path - other, axis=1)
    inner = (apart[1:-1] < _PASS_PX) & (apart[1:-1] <= apart[:-2]) & (apart[1:-1] <= apart[2:])
    last = len(path) - 1
    together = [0, *(1 + np.flatnonzero(inner)).tolist(), last]
    stretches = [
        (start, stop)
        for start, stop in itertools.combinations(together, 2)
        if (start, stop) != (0, last) and apart[start : stop + 1].max() > _STRAY_PX
    ]
    if not stretches:
        return None
    start, stop = stretches[rng.integers(len(stretches))]
    gap_start = path[start] - other[start]
    gap_stop = path[stop] - other[stop]
    if start == 0:  # an end of the path may lie elsewhere
        gap_start = gap_stop
    elif stop == last:
        gap_stop = gap_start
    share = np.linspace(0, 1, stop - start + 1)[:, None]
    child = path.copy()
    child[start : stop + 1] = other[start : stop + 1] + (1 - share) * gap_start + share * gap_stop
    return child


def bridged(path: FloatArray, walk: FloatArray, *, rng: np.random.Generator) -> FloatArray:
    """Return a path with a stretch, 15 to 60 % of it, drawn anew: as in a walk, or run backwards,
    between its ends.

    Parameters
    ----------
    path, walk : (K, 2) float, px
    rng : numpy Generator
    """
    knots = len(path)
    length = int(knots * rng.uniform(0.15, 0.6))
    middle = int(rng.integers(knots))
    start = max(0, middle - length // 2)
    stop = min(knots - 1, middle + length - length // 2)
    new = path[start : stop + 1][::-1] if rng.random() < 0.25 else walk[start : stop + 1]
    gaps = [path[start] - new[0], path[stop] - new[-1]]
    if start == 0:  # an end of the path may lie elsewhere
        gaps[0] = gaps[1]
    elif stop == knots - 1:
        gaps[1] = gaps[0]
    share = np.linspace(0, 1, stop - start + 1)[:, None]
    child = path.copy()
    child[start : stop + 1] = new + (1 - share) * gaps[0] + share * gaps[1]
    return child


def _overlap(loop: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether one loop begins within the other and ends outside: reversed, it moves the other's
    meeting point.
    """
    (first, first_end), (second, second_end) = sorted([loop, other])
    return first < second < first_end < second_end


def _meetings(points: FloatArray, path: Trajectory) -> list[tuple[int, int]]:
    """Pairs of indices at which a path of points evenly spaced in time meets itself, nearest
    first.
    """
    stride = max(1, len(points) // 240)
    fine = points[::stride]
    apart = np.linalg.norm(fine[:, None] - fine, axis=-1)
    arc = np.interp(np.linspace(0, 1, len(points))[::stride], path.t, path.arc_px)
    apart[(np.abs(arc[:, None] - arc) < _LOOP_PX) | np.tri(len(fine), dtype=bool)] = np.inf
    found: list[tuple[int, int]] = []
    while len(found) < _MOST_MEETINGS:
        i, j = np.unravel_index(int(apart.argmin()), apart.shape)
        if apart[i, j] > _PASS_PX:
            break
        found.append((int(i) * stride, int(j) * stride))
        near = 0.75 * _LOOP_PX
        apart[np.ix_(np.abs(arc - arc[i]) < near, np.abs(arc - arc[j]) < near)] = np.inf
    return found


def _reversed_loop(points: FloatArray, start: int, stop: int) -> FloatArray:
    turned = points.copy()
    turned[start : stop + 1] = points[start : stop + 1][::-1]
    return turned
