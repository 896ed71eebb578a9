"""SCPI script for arbitrary-waveform generators of the 33500 class: the code as a burst of one
cycle.
"""

from __future__ import annotations

import re

from hw.device import DeviceProfile
from hw.export._text import GENERIC, integer, only, unaltered, verified
from hw.program import Program

suffix = ".scpi"
summary = "SCPI commands for a 33500-class waveform generator: triggered burst of one cycle"
tick_ns = 1

WAVEFORM = "SHUTTER"
"""Name of the waveform in the instrument's memory."""

_LEAST_SAMPLES = 8
_MOST_SAMPLES = 1_000_000
_LEAST_CHIP_NS = 16  # 62.5 MSa/s, the most with the filter off
_HIGH_V = 5
_CHIPS = re.compile(r"^# chips: (\S+)$", re.MULTILINE)
_CHIP_NS = re.compile(r"^# chip_ns: (\S+)$", re.MULTILINE)
_CRC = re.compile(r"^# code_crc32: (\S+)$", re.MULTILINE)
_DATA = re.compile(rf"^DATA:ARB {WAVEFORM},([-1,]+)$", re.MULTILINE)


def samples(program: Program, device: DeviceProfile = GENERIC, /) -> tuple[int, ...]:
    """Make the waveform's samples, one per chip and each -1 (0 V) or 1 (5 V), a closed one before
    and after.

    Between bursts the instrument holds the voltage of the first sample, hence the closed one
    before: the code begins one chip after the trigger. More closed ones follow up to the least
    length the instrument takes.

    Raises
    ------
    ValueError
        If the code is too long for the instrument's memory.
    """
    if program.chips + 2 > _MOST_SAMPLES:
        raise ValueError(
            f"code of {program.chips} chips is too long for SCPI: at most {_MOST_SAMPLES - 2}"
            " chips"
        )
    padded = f"0{program.bits}0".ljust(_LEAST_SAMPLES, "0")
    opened = 1 if device.closed_level == 0 else -1
    return tuple(opened if bit == "1" else -opened for bit in padded)


def sample_rate(program: Program, /) -> str:
    """Sample rate in Sa/s for one chip per sample, as decimal text to the instrument's 1 uSa/s.

    Raises
    ------
    ValueError
        If the chip is too short, or if it is so long that the rounding would change it by more
        than 1 ppm.
    """
    if program.chip_ns < _LEAST_CHIP_NS:
        raise ValueError(
            f"chip of {program.chip_ns} ns is too short for SCPI: at least {_LEAST_CHIP_NS} ns"
            " (62.5 MSa/s)"
        )
    micro = (2 * 10**15 + program.chip_ns) // (2 * program.chip_ns)
    if abs(micro * program.chip_ns - 10**15) > 10**9:
        raise ValueError(
            f"chip of {program.chip_ns} ns has no sample rate on the 1 uSa/s grid within 1 ppm: at"
            " most 2 s always have"
        )
    return f"{micro // 10**6}.{micro % 10**6:06d}"


def commands(program: Program, device: DeviceProfile = GENERIC, /) -> tuple[str, ...]:
    """Commands in sending order; those that end with ``?`` are answered.

    Raises
    ------
    ValueError
        As `samples` and `sample_rate`.
    """
    return (
        "OUTP OFF",
        "*CLS",
        "OUTP:LOAD INF",
        "DATA:VOL:CLE",
        f"DATA:ARB {WAVEFORM},{','.join(str(value) for value in samples(program, device))}",
        f"FUNC:ARB {WAVEFORM}",
        "FUNC ARB",
        "FUNC:ARB:FILT OFF",
        f"FUNC:ARB:SRAT {sample_rate(program)}",
        f"VOLT:HIGH {_HIGH_V}",
        "VOLT:LOW 0",
        "BURS:MODE TRIG",
        "BURS:NCYC 1",
        "BURS:PHAS 0",
        "TRIG:SOUR EXT",
        "TRIG:SLOP POS",
        "TRIG:DEL 0",
        "BURS:STAT ON",
        "OUTP ON",
        "*OPC?",
        "SYST:ERR?",
    )


def export(program: Program, device: DeviceProfile = GENERIC, /) -> str:
    """Write the commands one per line; lines that begin with ``#`` are for people and are not
    sent.

    Raises
    ------
    ValueError
        As `commands`.
    """
    closed = _HIGH_V if device.closed_level else 0
    head = [
        (
            "# SCPI script written by coded-exposure for arbitrary-waveform generators of the"
            " 33500 class."
        ),
        (
            "# Send it line by line without the lines that begin with '#'; a line that ends with"
            " '?' is answered."
        ),
        (
            f"# The output rests closed at {closed} V; the code begins one chip after the"
            " trigger's rising edge."
        ),
        "# format: hw.scpi/1",
        f"# chip_ns: {program.chip_ns}",
        f"# chips: {program.chips}",
        f"# code_crc32: 0x{program.code_crc32:08x}",
    ]
    return "\n".join([*head, *commands(program, device)]) + "\n"


def parse_back(text: str, /) -> Program:
    """Read the program back from the waveform data.

    Raises
    ------
    ValueError
        If the text is no file of `export`.
    """
    source = "SCPI text"
    chips = integer(only(_CHIPS, text, "'# chips:'", source=source), f"{source} chips")
    chip_ns = integer(only(_CHIP_NS, text, "'# chip_ns:'", source=source), f"{source} chip_ns")
    crc = only(_CRC, text, "'# code_crc32:'", source=source)
    levels = only(_DATA, text, f"DATA:ARB {WAVEFORM}", source=source).split(",")
    if not set(levels) <= {"1", "-1"} or len(levels) < max(_LEAST_SAMPLES, chips + 2):
        raise ValueError(
            f"{source} DATA:ARB has not {chips + 2} samples of 1 or -1: it was altered, export"
            " again"
        )
    closed = levels[0]
    bits = "".join("0" if level == closed else "1" for level in levels[1 : chips + 1])
    program = verified(Program(bits, chip_ns), crc, source=source)
    device = DeviceProfile(name="generic", closed_level=int(closed == "1"))
    return unaltered(program, text, export(program, device), source=source)
