"""Response of a shutter to its commands: delay, linear ramps and bias."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike

from motdiff.types import FloatArray

RAMP_STEPS = 16
"""Steps that stand for a ramp. Each has the ramp's light; a ramp over d px at f cycles/px is off
by at most ``pi f d / (6 RAMP_STEPS^2)`` of its duration: 2e-3 at f d = 1."""


@dataclass(frozen=True, kw_only=True)
class ShutterResponse:
    """Transmission of a shutter around its commanded edges.

    After an opening edge the shutter stays closed for ``on_delay_ns``, then opens linearly within
    ``rise_ns``; after a closing edge it stays open for ``on_bias_ns``, then closes linearly within
    ``fall_ns``. Both are over within one chip, so a transition depends on two neighbouring chips
    alone.

    Parameters
    ----------
    chip_ns : float
        Chip time that the code is played with; it replaces the code's own.
    rise_ns, fall_ns : float
        Full ramps, from 0 to 1 and from 1 to 0.
    on_delay_ns, on_bias_ns : float
        Time that every open run loses at its start, and gains at its end.

    Raises
    ------
    ValueError
        If a time is negative or not finite, or opening or closing takes longer than a chip.
    """

    chip_ns: float
    rise_ns: float = 0.0
    fall_ns: float = 0.0
    on_delay_ns: float = 0.0
    on_bias_ns: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (np.isfinite(value) and value >= 0):
                raise ValueError(f"{field.name}: must be a time of at least 0 ns, got {value}")
        if self.chip_ns == 0:
            raise ValueError("chip_ns: must be above 0 ns, got 0")
        # one transition must be over before the next can begin
        for names, transition_ns in (
            ("on_delay_ns + rise_ns", self.opening_ns),
            ("on_bias_ns + fall_ns", self.closing_ns),
        ):
            if transition_ns > self.chip_ns:
                raise ValueError(
                    f"{names}: {transition_ns:g} ns is longer than a chip of {self.chip_ns:g} ns; "
                    f"chips of at least {transition_ns:g} ns would do"
                )
        # an instant rise at the chip's very end lets no light in
        if self.on_delay_ns == self.chip_ns:
            raise ValueError(
                f"on_delay_ns: {self.on_delay_ns:g} ns leaves nothing of a chip of"
                f" {self.chip_ns:g} ns"
            )

    @property
    def opening_ns(self) -> float:
        """Time from an opening edge to fully open, ns."""
        return self.on_delay_ns + self.rise_ns

    @property
    def closing_ns(self) -> float:
        """Time from a closing edge to fully closed, ns."""
        return self.on_bias_ns + self.fall_ns

    @property
    def instant(self) -> bool:
        """Whether the shutter follows its command at once."""
        return self.opening_ns == 0 and self.closing_ns == 0

    def at(self, chip_ns: float) -> ShutterResponse:
        """Return the same shutter for another chip time."""
        return replace(self, chip_ns=chip_ns)

    def opening(self, after_chips: ArrayLike) -> FloatArray:
        """Transmission (...) at times after an opening edge, in chips; ramps are stairs."""
        return self._ramp(after_chips, self.opening_cuts)

    def closing(self, after_chips: ArrayLike) -> FloatArray:
        """Transmission (...) at times after a closing edge, in chips."""
        return 1 - self._ramp(after_chips, self.closing_cuts)

    @property
    def opening_cuts(self) -> FloatArray:
        """Times after an opening edge, chips, at which the transmission steps."""
        return self._cuts(self.on_delay_ns, self.rise_ns)

    @property
    def closing_cuts(self) -> FloatArray:
        """Times after a closing edge, chips, at which the transmission steps."""
        return self._cuts(self.on_bias_ns, self.fall_ns)

    def open_time(self, codes: ArrayLike) -> FloatArray:
        """Light of (R, n) codes played on time, (R,): a fraction of the exposure.

        Examples
        --------
        >>> slow = ShutterResponse(chip_ns=100, rise_ns=80, fall_ns=40)
        >>> slow.open_time([[0, 1, 1, 0], [0, 1, 0, 1]])  # each pulse loses 40 ns and gains 20
        array([0.45, 0.4 ])
        """
        is_open = np.asarray(codes) != 0
        pulses = is_open[:, 0] + (is_open[:, 1:] & ~is_open[:, :-1]).sum(axis=1)
        # a straight ramp passes half of its light: each pulse loses delay and half a rise
        gain_ns = self.on_bias_ns + 0.5 * self.fall_ns - self.on_delay_ns - 0.5 * self.rise_ns
        open_chips = is_open.sum(axis=1) + pulses * gain_ns / self.chip_ns
        return np.asarray(open_chips / is_open.shape[1])

    @staticmethod
    def _ramp(after_chips: ArrayLike, cuts: FloatArray) -> FloatArray:
        step = np.searchsorted(cuts, after_chips, side="right")
        # halfway up each step: the stair keeps the ramp's light
        stair = (step - 0.5) / max(cuts.size - 1, 1)
        return np.where(step == 0, 0.0, np.where(step == cuts.size, 1.0, stair))

    def _cuts(self, start_ns: float, length_ns: float) -> FloatArray:
        steps = RAMP_STEPS * bool(length_ns)  # no ramp is a single step
        return (start_ns + length_ns * np.linspace(0, 1, steps + 1)) / self.chip_ns


def open_time(codes: ArrayLike, response: ShutterResponse | None) -> FloatArray:
    """Light of (R, n) codes, (R,): as of a response, or the duty of an instant shutter."""
    if response is not None:
        return response.open_time(codes)
    return np.asarray(np.asarray(codes).mean(axis=1), dtype=np.float64)
