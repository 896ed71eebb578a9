"""SCPI script for waveform generators of the 33500 class: the code as a burst of one cycle."""

from __future__ import annotations

from hw.device import DeviceProfile
from hw.export.base import GENERIC, Exporter, value_in
from hw.program import Program

WAVEFORM = "SHUTTER"
"""Name of the waveform in the instrument's memory."""

_LEAST_SAMPLES = 8  # the instrument refuses shorter waveforms
_MOST_SAMPLES = 1_000_000  # its memory without an option
_LEAST_CHIP_NS = 16  # 62.5 MSa/s, the most with the filter off
_HIGH_V = 5  # TTL


def samples(program: Program, device: DeviceProfile = GENERIC, /) -> tuple[int, ...]:
    """Make the waveform's samples, one per chip: 1 is 5 V, -1 is 0 V.

    Between bursts the instrument holds the voltage of the first sample, hence the closed one
    before: the code begins one chip after the trigger. More closed ones follow up to the least
    length the instrument takes.

    ValueError if the code is too long for the instrument's memory.
    """
    if program.chips + 2 > _MOST_SAMPLES:
        raise ValueError(
            f"code of {program.chips} chips is too long for SCPI: at most {_MOST_SAMPLES - 2}"
            " chips"
        )
    padded = f"0{program.bits}0".ljust(_LEAST_SAMPLES, "0")
    open_sample = 1 - 2 * device.closed_level
    return tuple(open_sample if bit == "1" else -open_sample for bit in padded)


def sample_rate(program: Program, /) -> str:
    """Sample rate in Sa/s for one chip per sample, as decimal text to the instrument's 1 uSa/s.

    ValueError if the chip is too short, or if it is so long that the rounding would change it by
    more than 1 ppm.
    """
    if program.chip_ns < _LEAST_CHIP_NS:
        raise ValueError(
            f"chip of {program.chip_ns} ns is too short for SCPI: at least {_LEAST_CHIP_NS} ns"
            " (62.5 MSa/s)"
        )
    # In integers: a float has too few digits for 1 uSa/s at 62.5 MSa/s. Rounded to nearest.
    micro = (2 * 10**15 + program.chip_ns) // (2 * program.chip_ns)
    if abs(micro * program.chip_ns - 10**15) > 10**9:
        raise ValueError(
            f"chip of {program.chip_ns} ns has no sample rate on the 1 uSa/s grid within 1 ppm: at"
            " most 2 s always have"
        )
    return f"{micro // 10**6}.{micro % 10**6:06d}"


def commands(program: Program, device: DeviceProfile = GENERIC, /) -> tuple[str, ...]:
    """Commands in sending order; those that end with ``?`` are answered."""
    return (
        "OUTP OFF",  # nothing of the set-up may reach the shutter
        "*CLS",  # errors of earlier commands
        "OUTP:LOAD INF",  # set to 50 ohm, an open input gets twice the volts
        "DATA:VOL:CLE",  # a waveform of the same name cannot be replaced
        f"DATA:ARB {WAVEFORM},{','.join(str(value) for value in samples(program, device))}",
        f"FUNC:ARB {WAVEFORM}",
        "FUNC ARB",
        "FUNC:ARB:FILT OFF",  # filters round the edges
        f"FUNC:ARB:SRAT {sample_rate(program)}",
        f"VOLT:HIGH {_HIGH_V}",
        "VOLT:LOW 0",
        "BURS:MODE TRIG",  # not gated: the trigger's length is without effect
        "BURS:NCYC 1",  # the code once a trigger
        "BURS:PHAS 0",
        "TRIG:SOUR EXT",
        "TRIG:SLOP POS",
        "TRIG:DEL 0",
        "BURS:STAT ON",
        "OUTP ON",
        "*OPC?",  # answered when all of it is done
        "SYST:ERR?",
    )


class ScpiScript(Exporter):
    """Commands for a burst of one cycle at each trigger."""

    name = "scpi"
    suffix = ".scpi"
    summary = "SCPI commands for a 33500-class waveform generator: triggered burst of one cycle"
    needs = "a waveform generator of the 33500 class"
    manual = "Keysight 33500 Series Operating and Service Guide"

    def export(self, program: Program, device: DeviceProfile = GENERIC, /) -> str:
        """Write the commands one per line, and remarks that begin with ``#``."""
        return f"""\
# SCPI script written by coded-exposure for arbitrary-waveform generators of the 33500 class.
# Send it line by line without the lines that begin with '#'; a line that ends with '?' is answered.
# The output rests closed at {_HIGH_V * device.closed_level} V; the code begins one chip after the trigger's rising edge.
# format: hw.scpi/1
# chip_ns: {program.chip_ns}
# chips: {program.chips}
# code_crc32: 0x{program.code_crc32:08x}
""" + "".join(f"{command}\n" for command in commands(program, device))

    def parse_back(self, text: str, /) -> Program:
        """Read the program back from the waveform data."""
        chips = int(value_in(text, r"^# chips: (\d+)$"))
        chip_ns = int(value_in(text, r"^# chip_ns: (\d+)$"))
        closed_level, *levels = value_in(text, rf"^DATA:ARB {WAVEFORM},(\S+)$").split(",")
        bits = "".join("0" if level == closed_level else "1" for level in levels[:chips])
        return Program(bits, chip_ns)
