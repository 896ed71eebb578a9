"""MicroPython script for an RP2040: the code played by a PIO state machine, without a host."""

from __future__ import annotations

import re
from string import Template

from hw.device import DeviceProfile
from hw.export._text import GENERIC, integer, only, unaltered, verified
from hw.program import Program

suffix = ".py"
summary = "MicroPython script for an RP2040 that plays the code on GP15 at a trigger on GP14"
tick_ns = 8

_LEAST_CYCLES = 125
_MOST_CYCLES = 2**32 + 2  # the state machine counts cycles - 3 in 32 bits
_MOST_CHIPS = 223
_WORDS_PER_LINE = 4
_CHIPS = re.compile(r"^CHIPS = (\S+)$", re.MULTILINE)
_CYCLES = re.compile(r"^CYCLES = (\S+)  #", re.MULTILINE)
_CLOSED = re.compile(r"^CLOSED_LEVEL = ([01])  #", re.MULTILINE)
_CRC = re.compile(r"^# CRC32 (\S+) ", re.MULTILINE)
_WORDS = re.compile(r"^WORDS = \(([0-9a-fx,\s]*)\)$", re.MULTILINE)
_WORD = re.compile(r"0x[0-9a-f]{8}")

_SCRIPT = Template("""\
# Shutter program written by coded-exposure: $chips chips of $chip_ns ns.
# For an RP2040 (Raspberry Pi Pico) with MicroPython.
# CRC32 $crc (zlib) over chip_ns as u64, chips as u32, both little endian, and the packed bits.
#
# GP15 is the shutter. It needs a resistor of 10 kOhm to its closed level: while the board starts, pins float.
# Each rising edge on GP14 plays the code once. The state machine handles trigger and edges, to the cycle of 8 ns.
# It stops by itself behind the last chip, closed, whatever becomes of this script: no more bits come in.

import machine
import rp2

CLOCK_HZ = 125_000_000
CHIPS = $chips
CYCLES = $cycles  # of 8 ns per chip
CLOSED_LEVEL = $closed  # of GP15
# 32 levels a word, the first in the highest bit; what follows the last chip is closed.
WORDS = (
$words,
)
FDEBUG = 0x50200008  # of PIO 0
STALLED = 1 << 24  # state machine 0 has run out of bits


@rp2.asm_pio(
    out_init=rp2.PIO.$init,
    out_shiftdir=rp2.PIO.SHIFT_LEFT,
    autopull=True,
    pull_thresh=32,
    fifo_join=rp2.PIO.JOIN_TX,
)
def play():
    wait(0, pin, 0)
    wait(1, pin, 0)
    out(isr, 32)
    wrap_target()
    out(pins, 1)
    mov(x, isr)
    label("hold")
    jmp(x_dec, "hold")
    wrap()


machine.freq(CLOCK_HZ)
trigger = machine.Pin(14, machine.Pin.IN, machine.Pin.PULL_DOWN)
shutter = machine.Pin(15, machine.Pin.OUT, value=CLOSED_LEVEL)
player = rp2.StateMachine(0, play, freq=CLOCK_HZ, in_base=trigger, out_base=shutter)
try:
    while True:
        player.restart()
        player.put(CYCLES - 3)
        for word in WORDS:
            player.put(word)
        machine.mem32[FDEBUG] = STALLED
        player.active(1)
        while not machine.mem32[FDEBUG] & STALLED:
            pass
        player.active(0)
        print("played", CHIPS, "chips")
finally:
    player.active(0)
    shutter.init(machine.Pin.OUT, value=CLOSED_LEVEL)
""")


def export(program: Program, device: DeviceProfile = GENERIC, /) -> str:
    """Write the script; saved on the board as ``main.py`` it runs at power-on.

    Raises
    ------
    ValueError
        If the chip is no whole number of 8 ns or below 1 us, or if the code does not fit the state
        machine's queue.
    """
    cycles, rest = divmod(program.chip_ns, tick_ns)
    if rest or not _LEAST_CYCLES <= cycles <= _MOST_CYCLES:
        near = min(max(cycles, _LEAST_CYCLES), _MOST_CYCLES) * tick_ns
        raise ValueError(
            f"chip of {program.chip_ns} ns cannot be played by the rp2 script: it must be a"
            f" multiple of {tick_ns} ns in {_LEAST_CYCLES * tick_ns}..{_MOST_CYCLES * tick_ns} ns;"
            f" {near} ns would do"
        )
    if program.chips > _MOST_CHIPS:
        raise ValueError(
            f"code of {program.chips} chips is too long for the rp2 script: its queue holds"
            f" {_MOST_CHIPS}, and a queue refilled by software could run dry"
        )
    opened = 1 - device.closed_level
    # At least one closed level behind the code: the state machine stalls on it when the queue is
    # empty.
    padded = program.bits.ljust(32 * (program.chips // 32 + 1), "0")
    levels = "".join(str(opened if bit == "1" else 1 - opened) for bit in padded)
    words = [f"0x{int(levels[k : k + 32], 2):08x}" for k in range(0, len(levels), 32)]
    rows = [
        ", ".join(words[k : k + _WORDS_PER_LINE]) for k in range(0, len(words), _WORDS_PER_LINE)
    ]
    return _SCRIPT.substitute(
        chips=program.chips,
        chip_ns=program.chip_ns,
        cycles=cycles,
        closed=device.closed_level,
        crc=f"0x{program.code_crc32:08x}",
        words=",\n".join(f"    {row}" for row in rows),
        init="OUT_HIGH" if device.closed_level else "OUT_LOW",
    )


def parse_back(text: str, /) -> Program:
    """Read the program back from the words and the cycles.

    Raises
    ------
    ValueError
        If the text is no file of `export`.
    """
    source = "rp2 script"
    chips = integer(only(_CHIPS, text, "CHIPS", source=source), f"{source} CHIPS")
    cycles = integer(only(_CYCLES, text, "CYCLES", source=source), f"{source} CYCLES")
    closed = only(_CLOSED, text, "CLOSED_LEVEL", source=source)
    crc = only(_CRC, text, "CRC32 comment", source=source)
    words = [
        word.strip()
        for word in only(_WORDS, text, "WORDS", source=source).strip().rstrip(",").split(",")
    ]
    for word in words:
        if not _WORD.fullmatch(word):
            raise ValueError(f"{source} WORDS has {word[:20]!r}: words like 0x0123abcd are needed")
    levels = "".join(f"{int(word, 16):032b}" for word in words)
    if len(levels) <= chips:
        raise ValueError(
            f"{source} WORDS hold {len(levels)} levels: more than the {chips} chips are needed"
        )
    bits = "".join("0" if level == closed else "1" for level in levels[:chips])
    program = verified(Program(bits, cycles * tick_ns), crc, source=source)
    device = DeviceProfile(name="generic", closed_level=int(closed))
    return unaltered(program, text, export(program, device), source=source)
