"""Starting paths of a fit: decoded from kernels, changed, crossed, and random ones."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from motdiff.estimators.coded.codes import middles, open_at
from motdiff.metrics import register_shift
from motdiff.motions import boracchi_foi
from motdiff.path_psfs import interpolated
from motdiff.psf_frame import in_frame
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

_PASS_PX = 1.5  # strands nearer than this meet
_HUB_PX = 2.5  # loops that pass so near are at one place: the fit closes the gaps
_SWEEP_SHARES = (1.0, 0.6, 0.4)  # of Legendre polynomials of degree 1, 2 and 3
_LOOP_PX = 4.0  # less path between two meetings is no loop
_MOST_MEETINGS = 10  # the orders double with each
_FAINT = 0.04  # share of the peak
_DOUBT = 0.08  # least share of the light at a point with the shutter open, or closed
_BLUR_PX = 1.0  # kernels estimated apart from each other do not match to a pixel
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
    """Draw paths (count, knots, 2), px, that are where the kernels' light fits the codes' bits.

    The share of a point's light in an exposure shows whether its shutter was open when the path
    passed there. A hidden Markov model over the points of the first kernel, with steps of about
    the mean speed, draws paths by forward filtering and backward sampling.

    Parameters
    ----------
    kernels : sequence of I (S, S) float
        Of the exposures; the first is that of the code with the most light.
    codes : sequence of I str
    length_px : float
        Approximate length of the path.
    shifts : (I, 2) float, optional
        Shift of each kernel against the path, (x, y) px; by correlation with the first kernel when
        omitted.

    References
    ----------
    Scott, "Bayesian methods for hidden Markov models", JASA 97, 2002 (the sampling).
    """
    aligned = light_on_first(kernels, codes, blur_px=_BLUR_PX, shifts=shifts)
    brightest = aligned[0]
    support = brightest > _FAINT * brightest.max()
    rows, columns = np.nonzero(support)
    steps = knots - 1
    times = middles(steps)
    score = np.tile(_EMISSION * np.log(brightest[support] / brightest.max()), (steps, 1))
    for code, kernel, is_open in zip(codes, aligned, open_at(codes, times), strict=True):
        if "0" not in code:
            continue  # open throughout, it says nothing of time
        p_open = np.clip(
            kernel[support] / brightest[support] * _open_share(codes[0]), _DOUBT, 1 - _DOUBT
        )
        score += np.where(is_open[:, None] == 1, np.log(p_open), np.log(1 - p_open))
    emission = np.exp(score - score.max(axis=1, keepdims=True))
    step_px = length_px / steps
    distance = np.hypot(rows[:, None] - rows, columns[:, None] - columns)
    transition = np.exp(-0.5 * ((distance - step_px) / (0.6 * step_px + 0.5)) ** 2)
    transition /= transition.sum(axis=1, keepdims=True)
    forward = np.empty_like(emission)
    forward[0] = emission[0] / emission[0].sum()
    for k in range(1, steps):
        forward[k] = (forward[k - 1] @ transition) * emission[k]
        forward[k] /= forward[k].sum()
    points = np.stack([columns, rows], axis=1) - float(len(brightest) // 2)
    state = rng.choice(len(points), size=count, p=forward[-1])
    states = [state]
    for k in range(steps - 2, -1, -1):
        state = draw_index(forward[k] * transition[:, state].T, rng)  # p(state_k | state_k+1)
        states.append(state)
    smooth = ndimage.gaussian_filter1d(points[np.array(states[::-1])], 1.5, axis=0, mode="nearest")
    knot_times = np.linspace(0, 1, knots)
    paths = [interpolated(knot_times, times, smooth[:, i]).T for i in range(count)]
    return np.stack(paths).swapaxes(1, 2)  # sums over this layout keep the published digits


def light_on_first(
    kernels: Sequence[FloatArray],
    codes: Sequence[str],
    *,
    blur_px: float,
    shifts: FloatArray | None = None,
) -> FloatArray:
    """Kernels (I, S, S) with the light of their codes, blurred, and shifted onto the first one.

    Parameters
    ----------
    shifts : (I, 2) float, optional
        As of :func:`decoded_paths`.
    """
    size = max(len(kernel) for kernel in kernels)
    soft = [
        _open_share(code) * ndimage.gaussian_filter(in_frame(kernel / kernel.sum(), size), blur_px)
        for kernel, code in zip(kernels, codes, strict=True)
    ]
    aligned = [soft[0]]
    for i, kernel in enumerate(soft[1:], 1):
        shift = register_shift(soft[0], kernel) if shifts is None else shifts[0] - shifts[i]
        aligned.append(np.maximum(ndimage.shift(kernel, shift[::-1], order=1), 0))
    return np.stack(aligned)


def draw_index(weights: FloatArray, rng: np.random.Generator) -> NDArray[np.intp]:
    """Draw an index for each row of weights (N, M), by inverse transform."""
    cdf = np.cumsum(weights, axis=1)
    index = (cdf < rng.random((len(cdf), 1)) * cdf[:, -1:]).sum(axis=1)
    return np.asarray(np.minimum(index, weights.shape[1] - 1))  # rounding may pass the last one


def orders(path: Trajectory, *, knots: int, count: int) -> FloatArray:
    """Orders in time (N, knots, 2), N <= count, of one PSF: loops and the whole path reversed."""
    fine = path.at(np.linspace(0, 1, 20 * (knots - 1) + 1))
    loops = _meetings(fine, path)
    subsets = itertools.chain.from_iterable(
        itertools.combinations(loops, n) for n in range(len(loops) + 1)
    )
    nested = (
        subset
        for subset in subsets
        if not any(_overlap(*pair) for pair in itertools.combinations(subset, 2))
    )
    paths = []
    for subset in itertools.islice(nested, max(1, count // 2)):
        order = fine
        for start, stop in sorted(subset, key=lambda loop: loop[1] - loop[0]):  # inner loops first
            order = _reversed_loop(order, start, stop)
        paths += [order[::20], order[::-20]]
    return np.stack(paths)[:count]


def loop_reversals(
    points: FloatArray, *, count: int, rng: np.random.Generator
) -> list[FloatArray]:
    """Paths (K, 2) with one loop of ``points`` reversed; the path reversed if it has none."""
    loops = _meetings(points, Trajectory.from_samples(points))
    paths = [_reversed_loop(points, start, stop) for start, stop in loops] or [points[::-1]]
    return [paths[i] for i in rng.permutation(len(paths))[:count]]


def loops_reordered(points: FloatArray, *, rng: np.random.Generator) -> FloatArray | None:
    """Path (K, 2) whose loops at one of its points come in another order; None without loops.

    Two loops are exchanged, or some that follow each other reversed.
    """
    distance = np.linalg.norm(points - points[rng.integers(len(points))], axis=1)
    steps_px = np.linalg.norm(np.diff(points, axis=0), axis=1)
    arc_px = np.concatenate([[0.0], np.cumsum(steps_px)])
    around = np.pad(distance, 1, constant_values=np.inf)
    nearest = (distance < _HUB_PX) & (distance <= around[:-2]) & (distance <= around[2:])
    visits: list[int] = []
    for index in np.flatnonzero(nearest).tolist():
        if not visits or arc_px[index] - arc_px[visits[-1]] > _LOOP_PX:
            visits.append(index)
    if len(visits) < 2:
        return None
    head, *loops, tail = np.split(points, visits)
    first, last = sorted(rng.integers(len(loops), size=2))
    if first < last and rng.random() < 0.5:
        loops[first], loops[last] = loops[last], loops[first]
    else:
        loops[first : last + 1] = [loop[::-1] for loop in loops[first : last + 1][::-1]]
    return _joined([stretch for stretch in (head, *loops, tail) if len(stretch)])


def _joined(stretches: Sequence[FloatArray]) -> FloatArray:
    """Stretches (n, 2) one after the other, each bent so that its ends meet its neighbours'."""
    joined = []
    for i, stretch in enumerate(stretches):
        start = stretches[i - 1][-1] if i else stretch[0]
        stop = stretches[i + 1][0] if i + 1 < len(stretches) else stretch[-1]
        share = np.linspace(0, 1, len(stretch))[:, None]
        gaps = (start - stretch[0]) / 2, (stop - stretch[-1]) / 2
        joined.append(stretch + (1 - share) * gaps[0] + share * gaps[1])
    return np.concatenate(joined)


def crossed(
    path: FloatArray, partner: FloatArray, *, rng: np.random.Generator
) -> FloatArray | None:
    """Return a path (K, 2) with a stretch of another, between two times at which they meet.

    None where there is no such stretch.
    """
    distance = np.linalg.norm(path - partner, axis=1)
    inner = distance[1:-1]
    minimum = (inner < _PASS_PX) & (inner <= distance[:-2]) & (inner <= distance[2:])
    last = len(path) - 1
    meetings = [0, *(1 + np.flatnonzero(minimum)).tolist(), last]
    stretches = [
        (start, stop)
        for start, stop in itertools.combinations(meetings, 2)
        if (start, stop) != (0, last) and distance[start : stop + 1].max() > _STRAY_PX
    ]
    if not stretches:
        return None
    start, stop = stretches[rng.integers(len(stretches))]
    return _replaced(path, partner[start : stop + 1], start)


def bridged(path: FloatArray, walk: FloatArray, *, rng: np.random.Generator) -> FloatArray:
    """Return a path (K, 2) with a stretch, 15 to 60 % of it, as in a walk, or run backwards."""
    knots = len(path)
    length = int(knots * rng.uniform(0.15, 0.6))
    middle = int(rng.integers(knots))
    start = max(0, middle - length // 2)
    stop = min(knots - 1, middle + length - length // 2)
    stretch = path[start : stop + 1][::-1] if rng.random() < 0.25 else walk[start : stop + 1]
    return _replaced(path, stretch, start)


def random_walks(rng: np.random.Generator, knots: int, lengths_px: FloatArray) -> FloatArray:
    """Random walks (B, K, 2) of such lengths."""
    times = np.linspace(0, 1, knots)
    return np.stack([boracchi_foi(rng, max_length_px=px).at(times) for px in lengths_px])


def random_sweeps(rng: np.random.Generator, knots: int, extents_px: FloatArray) -> FloatArray:
    """Smooth motions (B, K, 2) of such extents, cubic in time, as hands and machines make them."""
    t = np.linspace(-1, 1, knots)
    shares = rng.standard_normal((len(extents_px), len(_SWEEP_SHARES), 2))
    shares *= np.array(_SWEEP_SHARES)[:, None]
    paths = np.polynomial.legendre.legvander(t, len(_SWEEP_SHARES))[:, 1:] @ shares
    factors = extents_px / np.ptp(paths, axis=1).max(axis=1)
    return np.asarray(paths * factors[:, None, None])


def _replaced(path: FloatArray, stretch: FloatArray, start: int) -> FloatArray:
    """Path with a stretch (n, 2) from index ``start``, moved so that it joins on at both ends."""
    stop = start + len(stretch) - 1
    gap_start = path[start] - stretch[0]
    gap_stop = path[stop] - stretch[-1]
    if start == 0:  # an end of the path may lie elsewhere
        gap_start = gap_stop
    elif stop == len(path) - 1:
        gap_stop = gap_start
    share = np.linspace(0, 1, stop - start + 1)[:, None]
    child = path.copy()
    child[start : stop + 1] = stretch + (1 - share) * gap_start + share * gap_stop
    return child


def _open_share(code: str) -> float:
    return code.count("1") / len(code)


def _overlap(a: tuple[int, int], b: tuple[int, int]) -> bool:
    """Whether one loop begins within the other and ends outside.

    Reversed, it would move the other's meeting point.
    """
    (a_start, a_stop), (b_start, b_stop) = sorted([a, b])
    return a_start < b_start < a_stop < b_stop


def _meetings(points: FloatArray, path: Trajectory) -> list[tuple[int, int]]:
    """Index pairs at which a path of points evenly spaced in time meets itself, nearest first."""
    stride = max(1, len(points) // 240)
    fine = points[::stride]
    distance = np.linalg.norm(fine[:, None] - fine, axis=-1)
    arc = np.interp(np.linspace(0, 1, len(points))[::stride], path.t, path.arc_px)
    distance[(np.abs(arc[:, None] - arc) < _LOOP_PX) | np.tri(len(fine), dtype=bool)] = np.inf
    meetings: list[tuple[int, int]] = []
    while len(meetings) < _MOST_MEETINGS:
        i, j = np.unravel_index(int(distance.argmin()), distance.shape)
        if distance[i, j] > _PASS_PX:
            break
        meetings.append((int(i) * stride, int(j) * stride))
        radius = 0.75 * _LOOP_PX  # one meeting for each pair of strands
        distance[np.ix_(np.abs(arc - arc[i]) < radius, np.abs(arc - arc[j]) < radius)] = np.inf
    return meetings


def _reversed_loop(points: FloatArray, start: int, stop: int) -> FloatArray:
    out = points.copy()
    out[start : stop + 1] = points[start : stop + 1][::-1]
    return out
