"""The many paths that explain kernels, drawn from the measure of largest entropy over them."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from motdiff.estimators.coded.codes import middles, open_at
from motdiff.estimators.coded.starts import draw_index, light_on_first
from motdiff.path_psfs import interpolated
from motdiff.types import FloatArray

_BLUR_PX = 0.7  # the path moves on whole pixels, kernels estimated apart do not match to one
_FAINT = 0.03  # of the peak: where the path may be, and a pixel around it
_LONGEST_STEP_PX = 3
_LEAST_STEPS = 52  # of a path; each chip has a whole number of them
# of a step against the one before; a few turn sharply
_TURN_PX = 0.9
_SHARP_TURN_PX = 2.0
_SHARP_SHARE = 0.02
_ITERATIONS = 150
_RATE = 0.3  # of a multiplier's ascent; a path stays on a pixel for several steps
_SHORTER = 0.9
_FLOOR = 2e-3  # of the brightest: light below it is not matched
_SPREAD_PX = 1.0  # of the light of a path that is not right to a pixel
_SMOOTHED_STEPS = 1.0  # sigma: paths on whole pixels are jagged
# steps of redrawn stretches, but one, as shares of the path's: of one alone, and of either of two
_REROUTED = (0.15, 0.5)
_EXCHANGED = (0.06, 0.2)
_SHORTEST = 3  # steps
_NEAR_PX = 2.5  # stretches of which one may take the other's light
_LEAST_LOG = -16.0  # a pixel is never quite forbidden


class PathMeasure:
    """Paths at random whose light, on average, is that of kernels seen through known codes.

    A path is a Markov chain over the pixels of the first kernel and the last step's vector; a step
    differs from the one before by about a pixel. Of all measures over paths whose mean light
    through each code equals the code's kernel, the one nearest to that chain (of largest relative
    entropy) weighs a path by ``prod_t exp(sum_m c_m(t) lambda_m(p_t))``: one multiplier
    ``lambda_m`` for each kernel's open and closed chips and pixel. They are found by ascent of the
    concave dual, whose gradient is what each kernel's light lacks.

    Parameters
    ----------
    kernels : sequence of I (S, S) float
        Of the exposures; the first is that of the code with the most light.
    codes : sequence of I str
        Bits; all but those open throughout of one length.

    References
    ----------
    Léonard, "A survey of the Schrödinger problem and some of its connections with optimal
    transport", DCDS-A 34(4), 2014 (the measure); Darroch and Ratcliff, "Generalized iterative
    scaling for log-linear models", Annals of Mathematical Statistics 43(5), 1972 (the ascent).
    """

    def __init__(self, kernels: Sequence[FloatArray], codes: Sequence[str]) -> None:
        lights = light_on_first(kernels, codes, blur_px=_BLUR_PX)
        self._support = ndimage.binary_dilation(lights[0] > _FAINT * lights[0].max())
        rows, columns = np.nonzero(self._support)
        self._points = np.stack([columns, rows], axis=1) - float(len(self._support) // 2)
        self._before, self._after = _neighbours(self._support)
        self._turns = _turns()
        chips = max((len(code) for code in codes if "0" in code), default=_LEAST_STEPS)
        bits = open_at(codes, middles(chips * ceil(_LEAST_STEPS / chips)))
        light = lights[:, self._support] / lights[0, self._support].sum()
        self._centroid = light[0] @ self._points
        self._times, self._targets = _told(bits, light)
        self._weights = self._fitted_weights()

    def draw(self, count: int, *, knots: int, rng: np.random.Generator) -> FloatArray:
        """Draw paths (count, knots, 2), px, at times spaced evenly over the exposure."""
        positions = self._drawn_back(self._forward(self._weights), count, rng)
        smooth = ndimage.gaussian_filter1d(positions, _SMOOTHED_STEPS, axis=1, mode="nearest")
        times = middles(smooth.shape[1])
        at = np.linspace(0, 1, knots)
        return np.stack([interpolated(at, times, path) for path in smooth])

    def rerouted(self, path: FloatArray, *, rng: np.random.Generator) -> FloatArray:
        """Path (K, 2), px, with a stretch, 15 to 50 % of it, led through the light that is left.

        What the rest of the path leaves of each kernel's light weighs the pixels; the stretch is
        drawn between its ends, an end of the exposure being free.
        """
        length = int(self._steps * rng.uniform(*_REROUTED))
        return self._redrawn(path, [self._drawn_stretch(length, rng)], rng)

    def exchanged(self, path: FloatArray, *, rng: np.random.Generator) -> FloatArray | None:
        """Path (K, 2), px, with two short stretches led anew; None if they would cover the path.

        The nearer they are to each other the likelier they are taken, and either may get the
        other's light: led alone, each comes back to where it was, for the other one holds that.
        """
        lengths = np.maximum(_SHORTEST, (self._steps * rng.uniform(*_EXCHANGED, 2)).astype(int))
        start, stop = self._drawn_stretch(lengths[0], rng)
        starts = np.arange(self._steps) - lengths[1] // 2
        is_apart = (starts + lengths[1] < start) | (starts >= stop)
        positions = interpolated(middles(self._steps), np.linspace(0, 1, len(path)), path)
        distance = np.linalg.norm(positions[:, None] - positions[start:stop], axis=-1).min(axis=1)
        chance = is_apart * np.exp(-0.5 * (distance / _NEAR_PX) ** 2)
        if not chance.sum() > 0:
            return None
        partner = self._stretch(int(rng.choice(starts, p=chance / chance.sum())), lengths[1])
        return self._redrawn(path, [(start, stop), partner], rng)

    @property
    def _steps(self) -> int:
        return int(self._times.shape[1])

    def _drawn_stretch(self, length: int, rng: np.random.Generator) -> tuple[int, int]:
        """Draw a stretch, as :meth:`_stretch`, of which half may lie beyond the exposure."""
        return self._stretch(int(rng.integers(-length // 2, self._steps - length // 2)), length)

    def _stretch(self, start: int, length: int) -> tuple[int, int]:
        """Return the first step and the one after the last, within the exposure."""
        return max(0, start), min(self._steps, start + length + 1)

    def _redrawn(
        self, path: FloatArray, stretches: Sequence[tuple[int, int]], rng: np.random.Generator
    ) -> FloatArray:
        """Path (K, 2) with stretches of steps drawn in turn, each from the light that is left."""
        times = middles(self._steps)
        knots = np.linspace(0, 1, len(path))
        shift = self._centroid - path.mean(axis=0)
        positions = interpolated(times, knots, path + shift)
        is_held = np.ones(self._steps)
        for start, stop in stretches:
            is_held[start:stop] = 0
        redrawn = path.copy()
        for start, stop in stretches:
            weights = self._weights_left(positions, is_held, slice(start, stop))
            for index, is_end in ((0, start == 0), (-1, stop == self._steps)):
                if not is_end:
                    at = positions[start if index == 0 else stop - 1]
                    weights[index] = np.exp(-0.5 * ((self._points - at) ** 2).sum(axis=1)) + 1e-9
            positions[start:stop] = self._drawn_back(self._forward(weights), 1, rng)[0]
            is_held[start:stop] = 1
            smooth = ndimage.gaussian_filter1d(positions, _SMOOTHED_STEPS, axis=0, mode="nearest")
            is_new = (knots >= (times[start] if start else 0)) & (
                knots <= (times[stop - 1] if stop < self._steps else 1)
            )
            redrawn[is_new] = interpolated(knots[is_new], times, smooth) - shift
        return redrawn

    def _weights_left(
        self, positions: FloatArray, is_held: FloatArray, steps: slice
    ) -> FloatArray:
        """Weights (steps, P) of pixels by the light that a path (T, 2) leaves where it is held."""
        lacking = np.maximum(self._targets - self._light_of(positions, is_held), self._floor)
        lacking /= lacking.max(axis=1, keepdims=True)
        covering = self._times[:, steps]
        return np.asarray(
            np.exp(covering.T @ np.log(lacking) / np.maximum(covering.sum(axis=0), 1)[:, None])
        )

    def _light_of(self, positions: FloatArray, share: FloatArray) -> FloatArray:
        """Light (M, P) of a path (T, 2) at the times that each target tells of, times a share."""
        half = len(self._support) // 2
        column, row = np.clip(
            np.rint(positions.T + half).astype(np.intp), 0, len(self._support) - 1
        )
        image = np.zeros((len(self._times), *self._support.shape))
        for light, times in zip(image, self._times, strict=True):
            np.add.at(light, (row, column), times * share / len(share))
        blurred = ndimage.gaussian_filter(image, (0, _SPREAD_PX, _SPREAD_PX))
        return np.asarray(blurred[:, self._support])

    def _drawn_back(self, forward: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
        """Draw positions (count, T, 2) by sampling backward."""
        final_weights = forward[-1].reshape(1, -1).repeat(count, axis=0)
        pixel, step = np.divmod(draw_index(final_weights, rng), len(self._turns))
        pixels = [pixel]
        for t in range(len(forward) - 2, -1, -1):
            pixel = self._before[pixel, step]
            step = draw_index(forward[t][pixel] * self._turns[:, step].T, rng)
            pixels.append(pixel)
        return np.asarray(self._points[np.array(pixels[::-1]).T])

    @property
    def _floor(self) -> float:
        return _FLOOR * float(self._targets.max())

    def _fitted_weights(self) -> FloatArray:
        """Weight (T, P) of a pixel at each time, by the multipliers."""
        target = self._targets
        rate = _RATE
        least_gap = np.inf
        multipliers = 0.5 * np.log(np.maximum(target / target.max(axis=1, keepdims=True), 1e-3))
        image = np.zeros((len(target), *self._support.shape))
        for _ in range(_ITERATIONS):
            occupancy = self._occupancy(_weights_of(multipliers, self._times))
            image[:, self._support] = self._times @ occupancy / self._times.shape[1]
            light = ndimage.gaussian_filter(image, (0, _BLUR_PX, _BLUR_PX))[:, self._support]
            gap = float(np.abs(light - target).sum())
            if gap > least_gap:  # a step too long
                rate *= _SHORTER
            least_gap = min(gap, least_gap)
            multipliers += rate * np.log((target + self._floor) / (light + self._floor))
            multipliers -= multipliers.max(axis=1, keepdims=True)
            np.maximum(multipliers, _LEAST_LOG, out=multipliers)
        return _weights_of(multipliers, self._times)

    def _forward(self, weights: FloatArray) -> FloatArray:
        """Probability (T, P, V) of a pixel and its last step, given the weights up to then."""
        forward = np.empty((*weights.shape, len(self._turns)))
        forward[0] = weights[0, :, None]
        forward[0] /= forward[0].sum()
        for t in range(1, len(weights)):
            predicted = _gathered(forward[t - 1] @ self._turns, self._before)
            forward[t] = predicted * weights[t, :, None]
            forward[t] /= max(float(forward[t].sum()), 1e-300)
        return forward

    def _occupancy(self, weights: FloatArray) -> FloatArray:
        """Probability (T, P) of each pixel at each time, given weights (T, P)."""
        forward = self._forward(weights)
        occupancy = np.empty_like(weights)
        backward = np.ones(forward.shape[1:])
        for t in range(len(weights) - 1, -1, -1):
            occupancy[t] = (forward[t] * backward).sum(axis=1)
            occupancy[t] /= max(float(occupancy[t].sum()), 1e-300)
            from_next = _gathered(weights[t, :, None] * backward, self._after)
            backward = from_next @ self._turns.T
            backward /= max(float(backward.max()), 1e-300)
        return occupancy


def _weights_of(multipliers: FloatArray, times: FloatArray) -> FloatArray:
    """Weights (T, P) of multipliers (M, P) that hold at times (M, T); the largest is 1."""
    exponent = times.T @ multipliers
    return np.asarray(np.exp(exponent - exponent.max(axis=1, keepdims=True)))


def _steps() -> NDArray[np.intp]:
    """Step vectors (V, 2) on the pixel grid, (x, y)."""
    reach = _LONGEST_STEP_PX
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    return np.asarray(np.stack([x, y], axis=-1)[np.hypot(x, y) <= reach])


def _turns() -> FloatArray:
    """Probability (V, V) of each step after each other."""
    steps = _steps()
    squared = ((steps[:, None] - steps) ** 2).sum(axis=-1)
    turns = np.exp(-squared / (2 * _TURN_PX**2))
    turns += _SHARP_SHARE * np.exp(-squared / (2 * _SHARP_TURN_PX**2))
    return np.asarray(turns / turns.sum(axis=1, keepdims=True))


def _neighbours(support: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Index (P, V) of the pixel a step before each, and after it; P outside the support."""
    reach = _LONGEST_STEP_PX
    rows, columns = np.nonzero(support)
    index = np.full([n + 2 * reach for n in support.shape], len(rows))
    index[rows + reach, columns + reach] = np.arange(len(rows))
    x, y = _steps().T
    rows, columns = rows[:, None] + reach, columns[:, None] + reach
    return index[rows - y, columns - x], index[rows + y, columns + x]


def _gathered(values: FloatArray, index: NDArray[np.intp]) -> FloatArray:
    """Values (P, V) of each pixel's neighbour by the same step, 0 outside the support."""
    steps = values.shape[1]
    padded = np.append(values, np.zeros((1, steps)))
    return np.asarray(padded[index * steps + np.arange(steps)])


def _told(bits: FloatArray, light: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return times (M, T), 1 or 0, and the path's light (M, P) at these times together.

    Beside an open shutter a coded photo tells of two: its open chips, and its closed ones, whose
    light is the rest of the open photo's.
    """
    times, targets = [], []
    is_open_first = bits[0].all()
    for code, target in zip(bits, light, strict=True):
        if code.all() and len(bits) > 1:
            continue  # the two parts of a coded photo say it already
        times.append(code)
        targets.append(target)
        if is_open_first and not code.all():
            times.append(1 - code)
            targets.append(np.maximum(light[0] - target, 0))
    return np.stack(times), np.stack(targets)
