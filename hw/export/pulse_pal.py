"""Pulse Pal v2: the code as a custom pulse train in whole 50 us cycles."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass

from hw.device import DeviceProfile
from hw.export.base import GENERIC, Exporter, item_rows
from hw.program import Program

CYCLE_NS = 50_000
"""Period of the Pulse Pal's timer in ns: every time is a whole number of these."""
MAX_PULSES = 5000
"""Pulses a custom train holds; the firmware itself does not check."""

_FORMAT = "hw.pulsepal/1"
_LEAST_CYCLES = 2  # documented: no phase below 100 us
_MOST_CYCLES = 72_000_000  # documented: no time above 3600 s
_HIGH_VOLTS = 5.0  # TTL


@dataclass(frozen=True, slots=True)
class PulseTrain:
    """A custom train as the Pulse Pal stores it; all times are in cycles of `CYCLE_NS`.

    One pulse per open chip: the device knows one pulse width per train, and joins a pulse to its
    predecessor when it starts no later than that one ends.

    Parameters
    ----------
    phase_cycles : int
        Width of every pulse (phase 1): the chip.
    onsets_cycles : tuple of int
        Start of each pulse after the first one's, hence from 0; at most `MAX_PULSES`.
    delay_cycles : int
        Train delay: the closed chips before the first open one.
    train_cycles : int
        Train duration, past the end of the last pulse. The firmware compares the last onset with
        the entry behind it, which it never clears: a time left there by an earlier, longer train
        can cut the last pulse short or keep it open for ever. Therefore send
        ``(*onsets_cycles, train_cycles)`` first and ``onsets_cycles`` alone afterwards.
    """

    phase_cycles: int
    onsets_cycles: tuple[int, ...]
    delay_cycles: int
    train_cycles: int


def pulse_train(program: Program, /) -> PulseTrain:
    """Turn a program into a custom train.

    ValueError if the chip is no whole number of cycles or below two, or if there are too many open
    chips or cycles.
    """
    phase, remainder = divmod(program.chip_ns, CYCLE_NS)
    if remainder or phase < _LEAST_CYCLES:
        least_cycles = max(_LEAST_CYCLES, phase)
        raise ValueError(
            f"chip of {program.chip_ns} ns cannot be played by a Pulse Pal: it must be a multiple"
            f" of {CYCLE_NS} ns, at least {_LEAST_CYCLES * CYCLE_NS} ns; {least_cycles * CYCLE_NS} ns"
            " would do"
        )
    onsets = [index * phase for index, bit in enumerate(program.bits) if bit == "1"]
    if len(onsets) > MAX_PULSES:
        raise ValueError(
            f"code has {len(onsets)} open chips: a Pulse Pal train holds at most {MAX_PULSES}"
        )
    end = (program.chips + 1) * phase  # a chip more: a train must not end within its last pulse
    if end > _MOST_CYCLES:
        raise ValueError(
            f"code lasts {program.duration_ns / 1e9:.6g} s: with one chip more a Pulse Pal plays"
            " at most 3600 s"
        )
    # The train begins with the first pulse; the closed chips before it are its delay.
    first = onsets[0]
    return PulseTrain(phase, tuple(onset - first for onset in onsets), first, end)


class PulsePalTrain(Exporter):
    """Custom pulse train, and the settings of its output channel."""

    name = "pulsepal"
    suffix = ".pulsepal.toml"
    summary = "custom train of a Pulse Pal v2, in its 50 us cycles"
    needs = "a Pulse Pal v2"
    manual = "Sanworks, Pulse Pal v2 documentation: serial interface"
    tick_ns = CYCLE_NS

    def export(self, program: Program, device: DeviceProfile = GENERIC, /) -> str:
        """Write train and settings as TOML, with the device's parameter numbers."""
        train = pulse_train(program)
        rest_volts = _HIGH_VOLTS * device.closed_level
        open_volts = _HIGH_VOLTS - rest_volts
        onsets = item_rows(train.onsets_cycles, per_line=12)
        return f"""\
# Pulse Pal v2 custom train written by coded-exposure: {program.chips} chips of {program.chip_ns} ns.
# All times are cycles of 50 us: send them as they are, since times in seconds get truncated on the way.
# The firmware looks one entry past the train: first send the onsets with guard_cycles as one more, then without it.
format = "{_FORMAT}"
code_crc32 = "0x{program.code_crc32:08x}"
chip_ns = {program.chip_ns}
chips = {program.chips}

[channel]
is_biphasic = 0  # parameter 1
phase1_volts = {open_volts}  # parameter 2, open
phase1_cycles = {train.phase_cycles}  # parameter 4, one chip
burst_cycles = 0  # parameter 8, no bursts
train_cycles = {train.train_cycles}  # parameter 10
delay_cycles = {train.delay_cycles}  # parameter 11, the closed chips at the start
custom_train = 1  # parameter 14
custom_target = 0  # parameter 15, onsets of pulses
custom_loop = 0  # parameter 16, play once
rest_volts = {rest_volts}  # parameter 17, closed

[train]
pulses = {len(train.onsets_cycles)}
pulse_volts = {open_volts}  # of every pulse
guard_cycles = {train.train_cycles}
onsets_cycles = [
{onsets},
]
"""

    def parse_back(self, text: str, /) -> Program:
        """Read the program back from the onsets and the width of the pulses."""
        table = tomllib.loads(text)
        phase = table["channel"]["phase1_cycles"]
        bits = ["0"] * table["chips"]
        for onset in table["train"]["onsets_cycles"]:
            chip, remainder = divmod(table["channel"]["delay_cycles"] + onset, phase)
            if remainder:
                raise ValueError(f"the pulse at {onset} cycles begins within a chip")
            bits[chip] = "1"
        return Program("".join(bits), phase * CYCLE_NS)
