"""Start, length, jitter and row time of an exposure, from the brightness of frames under flashes.

The exposure of row r lasts from ``start + r * row`` on for ``length``, all of it later by a jitter
that each frame has of its own. A frame's brightness is linear in the time for which its flashes
and the exposure overlap; a flash across the start or the end of the exposure is a stopwatch of
them. Jitter and the flashes' own differences in energy are common to the rows of a frame, and are
told from each other by their pattern over the frames (variance components, by restricted maximum
likelihood: Patterson and Thompson 1971).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtr
from scipy.stats import t as student

from motdiff.types import FloatArray

EDGE_S = 1e-7
"""Error of a controller's edges, within the intervals: a cycle or two of its clock."""
CLOCK_SHARE = 1e-4
"""Error of its clock, within the intervals: that of a crystal."""

_BANDS = 8  # of a camera whose rows are exposed alike
_BAND_SHARE = 0.05  # of a flash, by which the rows of a band may differ
_INSENSITIVE = 2e-3
_COVERED = 0.95  # by the intervals
_SMOOTHED = (0.2, 0.05, 0.01)  # of a flash: at first, edges draw from afar
_ROUNDS = 12  # at each, until a step is as small a share of a flash:
_SMALL_STEP = 1e-4
_HALVINGS = 5
_VARIANCE_ROUNDS = 4
_JITTER_GUESS = 0.03  # of a flash
_ENERGY_GUESS = 0.003
_ENERGY_ROUNDS = 4
_ENERGY_SIGMA = np.concatenate([[0.0], np.geomspace(1e-5, 0.2, 50)])


@dataclass(frozen=True, slots=True)
class Interval:
    """An estimate and its interval of 95 % confidence."""

    value: float
    lower: float
    upper: float

    def __contains__(self, truth: float) -> bool:
        return self.lower <= truth <= self.upper


@dataclass(frozen=True, kw_only=True)
class Flashes:
    """Frames, each under flashes at known times.

    Attributes
    ----------
    pulses_s : sequence of (K, 2) float ndarray
        When the light was on, s after the trigger; frames may have different numbers of flashes.
    brightness : (N, H) float ndarray
        Mean of each row of each frame, in any unit.
    noise : (N, H) float ndarray
        Its standard deviation, without jitter and without the flashes' own differences.
    clipped : (N, H) bool ndarray
        Rows that do not count.
    """

    pulses_s: Sequence[FloatArray]
    brightness: FloatArray
    noise: FloatArray
    clipped: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]


@dataclass(frozen=True, kw_only=True)
class ExposureTiming:
    """When a camera exposes after its trigger. Times in seconds.

    Attributes
    ----------
    start : Interval
        From the trigger to the start of the first row's exposure; of row 0.
    jitter : Interval
        Standard deviation of the start from frame to frame.
    row : Interval
        From the start of one row to that of the next; 0 for a global shutter.
    energy : float
        Standard deviation of the flashes' energy, relative.
    rows : int
        Of a frame.
    """

    start: Interval
    length: Interval
    jitter: Interval
    row: Interval
    energy: float
    rows: int

    @property
    def readout_s(self) -> float:
        """From the start of the first row to that of the last."""
        return abs(self.row.value) * (self.rows - 1)


@dataclass(frozen=True, slots=True)
class Window:
    """Exposure of row 0, and by how much each row is later, s."""

    start_s: float
    length_s: float
    row_s: float = 0.0


def fit_exposure(
    flashes: Flashes, guess: Window, *, unseen_before_s: float | None = None
) -> ExposureTiming:
    """Estimate when a camera exposes; ValueError if no flash was across the start or the end.

    Some of the flashes are across the start and the end of the exposure, some within it, and one
    frame is without light in it. The guess has its start and end within a flash's length, and the
    row time within some percent. Before ``unseen_before_s``, when the first flash can come, the
    exposure began at a time that is not known.
    """
    rows = flashes.brightness.shape[1]
    shortest_s = min(float(np.diff(pulses, axis=1).min()) for pulses in flashes.pulses_s)
    alike = rows // _BANDS
    if guess.row_s:
        alike = min(alike, _BAND_SHARE * shortest_s / abs(guess.row_s))
    table = _banded(flashes, int(max(1, alike)), shortest_s)
    window = guess
    start_visible = unseen_before_s is None
    jitter_s, energy = _JITTER_GUESS * shortest_s, _ENERGY_GUESS
    for smoothing_s in shortest_s * np.array(_SMOOTHED):
        window = _descended(
            table, window, float(smoothing_s), (jitter_s, energy), start_visible=start_visible
        )
    jitters_s = np.concatenate([[0.0], np.geomspace(1e-4, 2.0, 80) * shortest_s])
    for _ in range(_VARIANCE_ROUNDS):
        smoothing_s = np.clip(jitter_s, _SMOOTHED[-1] * shortest_s, _SMOOTHED[0] * shortest_s)
        model = _model(
            table, window, float(smoothing_s), start_visible=start_visible, inflate=True
        )
        likelihood = model.likelihood(jitters_s, _ENERGY_SIGMA)
        best = np.unravel_index(np.argmax(likelihood), likelihood.shape)
        jitter_s, energy = float(jitters_s[best[0]]), float(_ENERGY_SIGMA[best[1]])
        limit_s = _SMOOTHED[0] * shortest_s
        window = _moved(window, model.step(jitter_s, energy), limit_s=limit_s, rows=rows)
    if model.timed_frames == 0:
        raise ValueError("no flash was across the start or the end of the exposure")
    quantile = float(student.ppf(0.5 + _COVERED / 2, max(model.timed_frames - 3, 2)))
    start_sd, length_sd, row_sd = model.deviations(jitter_s, energy)
    start = _around(window.start_s, quantile * start_sd, EDGE_S)
    length = _around(window.length_s, quantile * length_sd, EDGE_S)
    if unseen_before_s is not None:
        end_s = window.start_s + window.length_s
        middle_s = unseen_before_s / 2
        start = Interval(middle_s, 0.0, unseen_before_s)
        length = Interval(
            end_s - middle_s,
            end_s - unseen_before_s - (length.upper - length.value),
            end_s + (length.upper - length.value),
        )
    return ExposureTiming(
        start=start,
        length=length,
        jitter=_likely(jitters_s, likelihood.max(axis=1), quantile**2 / 2),
        row=_around(window.row_s, quantile * row_sd, EDGE_S / rows),
        energy=energy,
        rows=rows,
    )


@dataclass(frozen=True)
class _Table:
    """Frames in bands of rows: (N, R) arrays, the weight 0 where a band does not count."""

    pulses_s: Sequence[FloatArray]
    flash_s: float
    brightness: FloatArray
    noise: FloatArray
    weight: FloatArray
    row: FloatArray


def _banded(flashes: Flashes, size: int, flash_s: float) -> _Table:
    bands = flashes.brightness.shape[1] // size
    blocks = (len(flashes.pulses_s), bands, size)

    def cut(rows: FloatArray) -> FloatArray:
        return rows[:, : bands * size].reshape(blocks)

    return _Table(
        pulses_s=flashes.pulses_s,
        flash_s=flash_s,
        brightness=cut(flashes.brightness).mean(axis=2),
        noise=np.sqrt((cut(flashes.noise) ** 2).mean(axis=2) / size),
        # of a frame with clipped rows the others are no fair sample: they are dimmer than the mean
        weight=np.repeat(1.0 - flashes.clipped.any(axis=1), bands).reshape(-1, bands),
        row=np.arange(bands) * size + (size - 1) / 2,
    )


@dataclass(frozen=True)
class _Model:
    """Residuals of a window, linearised; sums over the rows of each frame, weighted by noise.

    ``u`` are the two patterns that a frame has in common, of its jitter (s) and of its energy;
    ``j`` the derivatives by the window's parameters that are free, and by the brightness.
    """

    uu: FloatArray  # (N, 2, 2)
    ur: FloatArray  # (N, 2)
    uj: FloatArray  # (N, 2, P)
    jj: FloatArray  # (P, P)
    jr: FloatArray  # (P,)
    rr: float
    scale: FloatArray  # (P,) by which the derivatives were divided
    free: tuple[int, ...]
    timed_frames: int

    def _kernel(self, jitter_s: FloatArray, energy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the inverse covariance along the patterns, (..., N, 2, 2), and its log det."""
        root = np.stack(np.broadcast_arrays(jitter_s, energy), axis=-1)[..., None, :]
        inner = np.eye(2) + root[..., :, None] * self.uu * root[..., None, :]
        kernel = root[..., :, None] * np.linalg.inv(inner) * root[..., None, :]
        return kernel, np.linalg.slogdet(inner)[1].sum(axis=-1)

    def _normal(self, kernel: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        fisher = self.jj - np.einsum("nap,...nab,nbq->...pq", self.uj, kernel, self.uj)
        score = self.jr - np.einsum("nap,...nab,nb->...p", self.uj, kernel, self.ur)
        square = self.rr - np.einsum("na,...nab,nb->...", self.ur, kernel, self.ur)
        return fisher, score, square

    def likelihood(self, jitters_s: FloatArray, energies: FloatArray) -> FloatArray:
        """Return the restricted log-likelihood of each pair of standard deviations."""
        kernel, log_det = self._kernel(jitters_s[:, None], energies[None, :])
        fisher, score, square = self._normal(kernel)
        fitted = np.einsum(
            "...p,...p->...", score, np.linalg.solve(fisher, score[..., None])[..., 0]
        )
        result = -0.5 * (log_det + square - fitted + np.linalg.slogdet(fisher)[1])
        return np.asarray(result, dtype=np.float64)

    def step(self, jitter_s: float, energy: float) -> FloatArray:
        """Return the change of start, length and row time (3,) that fits best; 0 if not free."""
        fisher, score, _ = self._normal_at(jitter_s, energy)
        return self._window_values(np.asarray(np.linalg.lstsq(fisher, score, rcond=1e-10)[0]))

    def square(self, jitter_s: float, energy: float) -> float:
        """Return the sum of squares of the residuals, weighted by their covariance."""
        return float(self._normal_at(jitter_s, energy)[2])

    def deviations(self, jitter_s: float, energy: float) -> FloatArray:
        """Return the standard deviations of start, length and row time (3,); 0 if not free."""
        fisher, _, _ = self._normal_at(jitter_s, energy)
        return self._window_values(np.sqrt(np.diag(np.linalg.inv(fisher))))

    def _normal_at(
        self, jitter_s: float, energy: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        return self._normal(self._kernel(np.array(jitter_s), np.array(energy))[0])

    def _window_values(self, values: np.ndarray[Any, Any]) -> FloatArray:
        window = np.zeros(3)
        window[list(self.free)] = (values / self.scale)[:-1]
        return window


def _descended(
    table: _Table,
    window: Window,
    smoothing_s: float,
    deviations: tuple[float, float],
    *,
    start_visible: bool,
) -> Window:
    """Follow the steps as long as the residuals become smaller."""
    model = _model(table, window, smoothing_s, start_visible=start_visible)
    rows = int(table.row[-1]) + 1
    for _ in range(_ROUNDS):
        step = model.step(*deviations)
        for _ in range(_HALVINGS):
            trial = _moved(window, step, limit_s=table.flash_s, rows=rows)
            trial_model = _model(table, trial, smoothing_s, start_visible=start_visible)
            if better := trial_model.square(*deviations) < model.square(*deviations):
                window, model = trial, trial_model
                break
            step = step / 2
        if not better or np.abs(step * (1, 1, rows)).max() < _SMALL_STEP * table.flash_s:
            break
    return window


def _model(
    table: _Table,
    window: Window,
    smoothing_s: float,
    *,
    start_visible: bool,
    inflate: bool = False,
) -> _Model:
    begin_s = window.start_s + window.row_s * table.row
    overlap = np.empty_like(table.brightness)
    lit_start = np.empty_like(overlap)
    lit_end = np.empty_like(overlap)
    for index, pulses in enumerate(table.pulses_s):
        light_start, lit_start[index] = _light(pulses, begin_s, smoothing_s)
        light_end, lit_end[index] = _light(pulses, begin_s + window.length_s, smoothing_s)
        overlap[index] = light_end - light_start
    by_start = lit_end - lit_start
    rate, black, weight = _levels(table, overlap, np.abs(by_start))
    # where a flash begins or ends with the exposure, the model is smoother than the frame
    corner = np.maximum(lit_start * (1 - lit_start), lit_end * (1 - lit_end))
    noise = np.hypot(table.noise, 2 * smoothing_s * rate * np.maximum(corner, 0))
    by_start, by_end = rate * by_start, rate * lit_end
    light = rate * overlap
    residual = table.brightness - black - light
    if inflate:
        noise = _inflated(noise, residual, light, by_start, weight)
    precision = weight / noise**2
    patterns = np.stack([by_start, light], axis=1)  # (N, 2, R)
    columns = [by_start, by_end, by_start * table.row]
    timed = (np.abs(by_start) > 0.3 * np.abs(rate)) & (weight > 0)
    free = tuple(index for index in range(3) if start_visible or index != 0)
    slopes = np.stack([*(columns[index] for index in free), light], axis=1)  # (N, P, R)
    scale = np.sqrt((slopes**2 * precision[:, None]).sum(axis=(0, 2)))
    slopes /= scale[:, None]
    weighted = patterns * precision[:, None]
    return _Model(
        uu=np.einsum("nar,nbr->nab", weighted, patterns),
        ur=np.einsum("nar,nr->na", weighted, residual),
        uj=np.einsum("nar,npr->nap", weighted, slopes),
        jj=np.einsum("npr,nr,nqr->pq", slopes, precision, slopes),
        jr=np.einsum("npr,nr->p", slopes, precision * residual),
        rr=float((precision * residual**2).sum()),
        scale=scale,
        free=free,
        timed_frames=int(timed.any(axis=1).sum()),
    )


def _light(
    pulses: FloatArray, until_s: FloatArray, smoothing_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return the light up to a time, s, and whether it is on; the mean over a Gaussian jitter."""
    x = (until_s[:, None] - pulses.reshape(1, -1)) / smoothing_s
    above = ndtr(x)
    ramp = smoothing_s * (x * above + np.exp(-0.5 * x**2) / np.sqrt(2 * np.pi))
    sign = np.tile([1.0, -1.0], len(pulses))
    return ramp @ sign, above @ sign


def _levels(
    table: _Table, overlap: FloatArray, sensitivity: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Brightness of each row per second of light, without any, and the weights of what counts.

    Of the frames alone whose overlap with the flashes does not depend on the window.
    """
    steady = table.weight * (sensitivity < _INSENSITIVE)
    dark = steady * (overlap < _INSENSITIVE * table.flash_s) / table.noise**2
    black = _ratio(table.brightness, np.ones_like(dark), dark, axis=0)
    light = table.brightness - black
    flash = steady * (overlap > 0.3 * table.flash_s) / table.noise**2
    # rows share the energy of a frame: neighbours that other frames lit must not differ by it
    energy = np.ones((len(light), 1))
    for _ in range(_ENERGY_ROUNDS):
        rate = _ratio(light, energy * overlap, flash, axis=0)
        energy = _ratio(light, rate * overlap, flash, axis=1)
        lit_frames = energy > 0
        energy = np.where(lit_frames, energy / energy[lit_frames].mean(), 1.0)
    usable = (dark.sum(axis=0) > 0) & (flash.sum(axis=0) > 0) & (rate[0] > 0)
    rate = rate[0]
    return np.where(usable, rate, 0.0), black, table.weight * usable


def _ratio(values: FloatArray, model: FloatArray, weight: FloatArray, *, axis: int) -> FloatArray:
    """Return the factor of a model that fits values best, along an axis, which is kept."""
    square = (weight * model**2).sum(axis=axis, keepdims=True)
    product = (weight * model * values).sum(axis=axis, keepdims=True)
    return np.asarray(product / np.maximum(square, 1e-300))


def _inflated(
    noise: FloatArray,
    residual: FloatArray,
    light: FloatArray,
    by_start: FloatArray,
    weight: FloatArray,
) -> FloatArray:
    """Raise the noise to what the steady rows show, each frame's common energy taken out."""
    floor = np.maximum(noise, 1e-6 * np.abs(light).max())
    steady = weight * (np.abs(by_start) < _INSENSITIVE * np.abs(by_start).max()) / floor**2
    share = _ratio(residual, light, steady, axis=1)
    deviations = ((residual - share * light) / floor)[steady > 0]
    spread = 1.4826 * float(np.median(np.abs(deviations))) if deviations.size else 1.0
    return np.asarray(floor * max(1.0, spread))


def _moved(window: Window, step: FloatArray, *, limit_s: float, rows: int) -> Window:
    limits_s = np.array([limit_s, limit_s, limit_s / rows])
    start_s, length_s, row_s = np.clip(step, -limits_s, limits_s)
    return Window(
        window.start_s + float(start_s),
        max(window.length_s + float(length_s), 1e-7),
        window.row_s + float(row_s),
    )


def _around(value: float, half: float, edge_s: float) -> Interval:
    half = math.sqrt(half**2 + edge_s**2 + (CLOCK_SHARE * value) ** 2)
    return Interval(value, value - half, value + half)


def _likely(values: FloatArray, likelihood: FloatArray, drop: float) -> Interval:
    """Return the values whose log-likelihood is less below the best than ``drop``."""
    inside = np.flatnonzero(likelihood > likelihood.max() - drop)
    lower, upper = max(inside[0] - 1, 0), min(inside[-1] + 1, len(values) - 1)
    best = np.argmax(likelihood)
    return Interval(float(values[best]), float(values[lower]), float(values[upper]))
