"""Flashes that find an exposure and time its edges: a plan that looks at each frame."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cep.shutter.exposure_fit import ExposureTiming, Flashes, Window, fit_exposure
from hw.cameras.camera import CameraError
from hw.cxp.protocol import Hello
from hw.program import Program
from motdiff.types import FloatArray

MOST_FRAMES = 40
LATEST_S = 0.025
"""Latest start of an exposure that is looked for, after the trigger."""
_MOST_HALVINGS = 12
_REFERENCES = 4  # frames with whole flashes within the exposure
_VISIBLE_SIGMAS = 8.0
_ENOUGH_SIGMAS = 20.0  # of a row's brightness by one flash
_UNSEEN_SHARE = 0.985  # of the earliest flash
_STRADDLING = (0.05, 0.95)
_DITHER = (0.0, -0.3, 0.3, -0.15, 0.15, 0.22, -0.22)  # of a flash
_PLACES = (0.0, 0.5, 0.0, 1.0)  # of the readout, at which edges are timed
_JITTER_SIGMAS = 8.0  # within a flash
_JITTER_FRAMES = 6
_SCATTERED_SHARE = 0.05  # of the rows: a readout leaves no gaps
_COMMON_SHARE = 0.6  # of an exposure: a longer readout leaves no time that all rows share


@dataclass(frozen=True, slots=True)
class Flash:
    """Light to be played: on from a time after the trigger, once or again and again.

    Attributes
    ----------
    period_s, until_s : float
        It is repeated each period, until a time; once where the period is 0.
    """

    start_s: float
    length_s: float
    period_s: float = 0.0
    until_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Exposed:
    """A frame under flashes.

    Attributes
    ----------
    pulses_s : (K, 2) float ndarray
        When the light really was on, s after the trigger.
    brightness : (H,) float ndarray
        Mean of each row.
    clipped : (H,) bool ndarray
    """

    pulses_s: FloatArray
    brightness: FloatArray
    clipped: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]

    @property
    def flash_s(self) -> float:
        """Length of the first flash, s."""
        return float(np.diff(self.pulses_s[0])[0])


def flash_program(flash: Flash, limits: Hello) -> Program:
    """Return the program of a controller that comes closest to a flash.

    Chips are whole ticks: among those near the flash's length the one is taken that has the flash,
    or its period, at the right time.
    """
    tick_s = limits.tick_ns * 1e-9
    lead_in_s = max(0.0, flash.start_s - limits.lead_ns * 1e-9)
    span_s = max(flash.until_s, flash.start_s + flash.length_s)
    grid_s = flash.period_s or lead_in_s
    lower = max(limits.min_ticks, math.ceil(span_s / tick_s / (limits.max_chips - 1)))
    if grid_s < 0.5 * lower * tick_s:  # it begins at once
        count = math.ceil(flash.length_s / tick_s / limits.max_ticks)
        ticks = max(limits.min_ticks, round(flash.length_s / tick_s / count))
        return Program("1" * count, ticks * limits.tick_ns)
    flash_ticks = max(flash.length_s / tick_s, lower)
    counts = np.arange(
        max(1, math.floor(grid_s / tick_s / flash_ticks / 1.3)),
        max(1, math.ceil(grid_s / tick_s / max(0.8 * flash_ticks, lower))) + 1,
    )
    choices = np.clip(np.rint(grid_s / tick_s / counts), lower, limits.max_ticks)
    ticks = int(choices[np.argmin(np.abs(choices * counts * tick_s - grid_s))])
    lead_in = "0" * round(lead_in_s / tick_s / ticks)
    bits = lead_in + "1" * max(1, round(flash.length_s / tick_s / ticks))
    if flash.period_s:
        gap = "0" * max(round(flash.period_s / tick_s / ticks) - 1, 1)
        repeats = math.floor((flash.until_s - flash.start_s) / flash.period_s)
        bits = (lead_in + "1" + (gap + "1") * max(repeats, 0))[: limits.max_chips]
    return Program(bits, ticks * limits.tick_ns)


class ExposureSweep:
    """Flashes that find an exposure and time its edges, in at most 40 frames.

    Parameters
    ----------
    expose : callable
        Takes a frame under a flash.
    length_s : float
        Exposure that the camera states.
    flash_s, earliest_s : float
        Shortest flash of the controller, and the earliest.
    """

    def __init__(
        self,
        expose: Callable[[Flash], Exposed],
        *,
        length_s: float,
        flash_s: float,
        earliest_s: float,
    ) -> None:
        self._expose = expose
        self._length_s = length_s
        self._flash_s = flash_s
        self._earliest_s = earliest_s
        self._frames: list[Exposed] = []
        self._search: list[Exposed] = []  # while the exposure is looked for
        self._black = np.zeros(0)
        self._rate = np.zeros(0)
        self._noise_dark = 0.0
        self._noise_lit = 0.0

    @property
    def taken(self) -> int:
        """Frames so far."""
        return len(self._frames) + len(self._search)

    def run(self) -> tuple[ExposureTiming, Flashes]:
        """Take the frames, and estimate.

        CameraError says that the light is not seen, clips, or is too faint.
        """
        self._look()
        begin_s, dark_until_s = self._earliest_lit()
        window = self._read_out(begin_s, dark_until_s)
        self._calibrate(window)
        start_visible, window = self._refine_start(window, begin_s, dark_until_s)
        window = self._refine_end(window)
        self._widen(window, start_visible=start_visible)
        self._time_edges(
            window, start_visible=start_visible, count=MOST_FRAMES - self.taken - _REFERENCES
        )
        while self.taken < MOST_FRAMES:
            self._flash(self._reference(window))
        flashes = self.flashes()
        unseen_s = None if start_visible else self._earliest_s
        return fit_exposure(flashes, window, unseen_before_s=unseen_s), flashes

    def flashes(self) -> Flashes:
        """Return the frames taken."""
        brightness = np.array([frame.brightness for frame in self._frames])
        share = np.clip((brightness - self._black) / (self._rate * self._flash_s), 0, None)
        variance = self._noise_dark**2 + share * max(self._noise_lit**2 - self._noise_dark**2, 0.0)
        return Flashes(
            pulses_s=[frame.pulses_s for frame in self._frames],
            brightness=brightness,
            noise=np.sqrt(variance),
            clipped=np.array([frame.clipped for frame in self._frames]),
        )

    def _flash(self, flash: Flash) -> Exposed:
        frame = self._expose(flash)
        self._frames.append(frame)
        return frame

    def _look(self) -> None:
        """Learn how dark a row is, and its noise."""
        latest_s = LATEST_S + 2 * self._length_s
        first, second = (self._flash(Flash(latest_s, self._flash_s)) for _ in range(2))
        self._black = (first.brightness + second.brightness) / 2
        self._noise_dark = _spread(first.brightness - second.brightness) / math.sqrt(2)

    def _visible(self, frame: Exposed) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        bright = frame.brightness - self._black > _VISIBLE_SIGMAS * self._noise_dark
        return np.asarray(bright | frame.clipped)

    def _lit_until(self, until_s: float, *, within_s: float) -> Exposed:
        """Expose under light until a time: flashes again and again while the search is coarse."""
        period_s = min(4 * self._flash_s, self._length_s / 2)
        if period_s < 2 * self._flash_s or within_s < 8 * self._flash_s:
            frame = self._expose(Flash(self._earliest_s, until_s - self._earliest_s))
        else:
            count = math.floor((until_s - self._flash_s - self._earliest_s) / period_s)
            last_s = until_s - self._flash_s
            frame = self._expose(
                Flash(last_s - count * period_s, self._flash_s, period_s=period_s, until_s=until_s)
            )
        self._search.append(frame)
        return frame

    def _earliest_lit(self) -> tuple[float, float]:
        """Halve the time in which the first row begins: light up to its end shows, and the row."""
        longest = self._lit_until(LATEST_S, within_s=LATEST_S)
        if not self._visible(longest).any():
            raise CameraError(
                f"no light of the controller's output reached the camera within"
                f" {LATEST_S * 1e3:g} ms of its trigger: check the light, and the wire of the"
                " trigger"
            )
        upper_s, lower_s = LATEST_S, self._earliest_s
        for _ in range(_MOST_HALVINGS):
            if upper_s - lower_s <= self._flash_s:
                break
            middle_s = (lower_s + upper_s) / 2
            frame = self._lit_until(middle_s, within_s=upper_s - lower_s)
            middle_s = float(frame.pulses_s[-1, 1])
            if self._visible(frame).any():
                upper_s = middle_s
            else:
                lower_s = middle_s
        return upper_s, lower_s

    def _read_out(self, upper_s: float, lower_s: float) -> Window:
        """Row time from the frames in which light ended before the last row began."""
        begin_s = (upper_s + lower_s) / 2
        rows = len(self._black)
        ends_s, counts, downward = [begin_s], [0], True
        for frame in self._search[1:]:
            if (count := self._rows_begun(frame)) is not None:
                ends_s.append(float(frame.pulses_s[-1, 1]))
                counts.append(abs(count))
                downward = count > 0
        if len(counts) == 1:
            return Window(begin_s, self._length_s)
        row_s = float(np.polyfit(counts, ends_s, 1)[0])
        if downward:
            return Window(begin_s, self._length_s, row_s)
        return Window(begin_s + row_s * (rows - 1), self._length_s, -row_s)

    def _rows_begun(self, frame: Exposed) -> int | None:
        """Rows that a frame's light met, below 0 from the bottom; None if all or none did."""
        light = frame.brightness - self._black
        longest = self._search[0].brightness - self._black
        bright = self._visible(frame)
        if not bright.any():
            return None
        # of the rows alone that could be seen: dark parts of a scene are dark in any case
        share = float(np.median(light[bright] / np.maximum(longest[bright], self._noise_dark)))
        rows = np.flatnonzero(share * longest > 2 * _VISIBLE_SIGMAS * self._noise_dark)
        met = bright[rows]
        if met.all() or not met.any():
            return None
        half = len(rows) // 2
        downward = met[:half].mean() > met[half:].mean()
        count = rows[met].max() + 1 if downward else len(bright) - rows[met].min()
        expected = rows < count if downward else rows >= len(bright) - count
        if np.mean(met != expected) > _SCATTERED_SHARE:
            return None
        return int(count if downward else -count)

    def _begin_s(self, window: Window, place: float = 0.0) -> float:
        """Start of the row at a share of the readout, 0 for the row that is first."""
        last = len(self._black) - 1
        row = place * last if window.row_s >= 0 else (1 - place) * last
        return window.start_s + window.row_s * row

    def _reference(self, window: Window) -> Flash:
        """One whole flash within the exposure of each row."""
        begin_s, last_s = self._begin_s(window), self._begin_s(window, 1.0)
        if last_s - begin_s < _COMMON_SHARE * self._length_s:
            return Flash((last_s + begin_s + self._length_s) / 2, self._flash_s)
        start_s, end_s = begin_s + self._length_s / 2, last_s + self._length_s / 2
        # with as much time between the flashes as the exposure is long, each row has one
        before = math.floor((start_s - self._earliest_s) / self._length_s)
        return Flash(
            start_s - min(before, 1) * self._length_s,
            self._flash_s,
            period_s=self._length_s,
            until_s=end_s + 1.5 * self._length_s,
        )

    def _calibrate(self, window: Window) -> None:
        """Learn how bright one flash is; take longer ones where it is faint."""
        while True:
            frame = self._flash(self._reference(window))
            if frame.clipped.mean() > 0.5:
                raise CameraError(
                    f"a flash of {self._flash_s * 1e6:.0f} us clips the camera: dim the light, or"
                    " lower the gain"
                )
            light = frame.brightness - self._black
            if np.median(light) >= _ENOUGH_SIGMAS * self._noise_dark:
                break
            if 4 * self._flash_s > self._length_s or self.taken > MOST_FRAMES / 2:
                raise CameraError(
                    f"a flash of {self._flash_s * 1e6:.0f} us is too faint: a brighter light, or"
                    " more gain"
                )
            self._flash_s *= 2
        self._rate = np.maximum(light, self._noise_dark) / frame.flash_s
        repeated = self._flash(self._reference(window))
        share = float(np.median((repeated.brightness - self._black) / np.maximum(light, 1e-9)))
        self._noise_lit = _spread(repeated.brightness - self._black - share * light) / math.sqrt(2)

    def _share(self, frame: Exposed, window: Window) -> float:
        """Share of a frame's flash that the first row collected."""
        row = 0 if window.row_s >= 0 else len(self._black) - 1
        rows = slice(row, row + 1) if window.row_s else slice(None)
        light = (frame.brightness - self._black)[rows].sum()
        return float(light / (self._rate[rows].sum() * frame.flash_s))

    def _refine_start(self, window: Window, upper_s: float, lower_s: float) -> tuple[bool, Window]:
        """Place the start of the first row by a flash across it, if there can be one."""
        first = lower_s <= self._earliest_s  # no frame was dark: it may have begun before
        start_s = self._earliest_s if first else max(self._earliest_s, upper_s - self._flash_s)
        frame = self._flash(Flash(start_s, self._flash_s))
        share = self._share(frame, window)
        start_visible = not first or share < _UNSEEN_SHARE
        begin_s = float(frame.pulses_s[0, 1]) - share * frame.flash_s
        shift_s = begin_s - self._begin_s(window)
        return start_visible, Window(window.start_s + shift_s, window.length_s, window.row_s)

    def _refine_end(self, window: Window) -> Window:
        """Place the end of the first row's exposure, from the stated length on."""
        begin_s = self._begin_s(window)
        end_s = begin_s + self._length_s
        step_s, direction = 0.7 * self._flash_s, 0
        for _ in range(7):
            frame = self._flash(Flash(end_s - self._flash_s / 2, self._flash_s))
            share = self._share(frame, window)
            opened_s, closed_s = frame.pulses_s[0]
            if _STRADDLING[0] < share < _STRADDLING[1]:
                end_s = float(opened_s + share * (closed_s - opened_s))
                return Window(window.start_s, end_s - begin_s, window.row_s)
            turn = 1 if share > 0.5 else -1
            step_s *= 2 if turn == direction else (0.5 if direction else 1)
            direction = turn
            end_s += turn * step_s
        raise CameraError(
            f"the end of the exposure was not found near {1e3 * self._length_s:g} ms after its"
            " start: is it the exposure that the camera states?"
        )

    def _widen(self, window: Window, *, start_visible: bool) -> None:
        """Take flashes long enough for the jitter, as a few frames show it."""
        while self.taken < 0.7 * MOST_FRAMES:
            frames = self._time_edges(
                window, start_visible=start_visible, count=_JITTER_FRAMES, places=(0.0,)
            )
            shares = np.array([self._share(frame, window) for frame in frames])
            jitter_s = self._flash_s / 3  # at least, where a flash was missed altogether
            if ((shares > _STRADDLING[0] / 2) & (shares < 1 - _STRADDLING[0] / 2)).all():
                late_s = [
                    self._lateness_s(frame, share, window)
                    for frame, share in zip(frames, shares, strict=True)
                ]
                jitter_s = float(np.std(late_s))
            if _JITTER_SIGMAS * jitter_s < 1.5 * self._flash_s:
                return
            longest_s = min(4 * self._flash_s, window.length_s / 2)
            if longest_s < 1.2 * self._flash_s:
                return
            self._flash_s = min(longest_s, _JITTER_SIGMAS * jitter_s)
            self._calibrate(window)

    def _lateness_s(self, frame: Exposed, share: float, window: Window) -> float:
        """By how much an edge of the first row is later than in the window."""
        opened_s, closed_s = frame.pulses_s[0]
        begin_s = self._begin_s(window)
        collected_s = share * (closed_s - opened_s)
        if (opened_s + closed_s) / 2 > begin_s + window.length_s / 2:
            return float(opened_s + collected_s - begin_s - window.length_s)
        return float(closed_s - collected_s - begin_s)

    def _time_edges(
        self, window: Window, *, start_visible: bool, count: int, places: Sequence[float] = _PLACES
    ) -> list[Exposed]:
        """Flash across the start and the end of rows in turn, each time at another place."""
        frames = []
        for index in range(count):
            turn = index // 2
            edge_s = self._begin_s(window, places[turn % len(places)] if window.row_s else 0.0)
            if index % 2 or not start_visible:
                edge_s += window.length_s
            shift = _DITHER[turn % len(_DITHER)] - 0.5
            start_s = max(self._earliest_s, edge_s + shift * self._flash_s)
            frames.append(self._flash(Flash(start_s, self._flash_s)))
        return frames


def _spread(values: FloatArray) -> float:
    """Return the standard deviation of values whose mean is of no interest, without outliers."""
    deviation = np.abs(values - np.median(values))
    return max(1.4826 * float(np.median(deviation)), 1e-9)
