"""MicroPython script for an RP2040: the code played by a PIO state machine, without a host."""

from __future__ import annotations

from string import Template

from hw.device import DeviceProfile
from hw.export.base import GENERIC, Exporter, item_rows, value_in
from hw.program import Program

_LEAST_CYCLES = 125  # 1 us
_MOST_CYCLES = 2**32 + 2  # the state machine counts cycles - 3 in 32 bits
_MOST_CHIPS = 223  # seven words of 32 in the joined queue, less one closed chip

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


class Rp2Script(Exporter):
    """MicroPython script whose edges a PIO state machine makes."""

    name = "rp2"
    suffix = ".py"
    # a code.py would hide Python's own module from whatever runs beside it
    stem_suffix = "_rp2"
    summary = "MicroPython script for an RP2040 that plays the code on GP15 at a trigger on GP14"
    needs = "a Raspberry Pi Pico with MicroPython"
    manual = "Raspberry Pi RP2040 datasheet, chapter 3: PIO"
    tick_ns = 8

    def export(self, program: Program, device: DeviceProfile = GENERIC, /) -> str:
        """Write the script; saved on the board as ``main.py`` it runs at power-on."""
        cycles = self.ticks(
            program, "the rp2 script", min_ticks=_LEAST_CYCLES, max_ticks=_MOST_CYCLES
        )
        if program.chips > _MOST_CHIPS:
            raise ValueError(
                f"code of {program.chips} chips is too long for the rp2 script: its queue holds"
                f" {_MOST_CHIPS}, and a queue refilled by software could run dry"
            )
        open_level = str(1 - device.closed_level)
        # At least one closed level behind the code: the state machine stalls on it when the queue
        # is empty.
        padded = program.bits.ljust(32 * (program.chips // 32 + 1), "0")
        levels = "".join(open_level if bit == "1" else str(device.closed_level) for bit in padded)
        words = [f"0x{int(levels[k : k + 32], 2):08x}" for k in range(0, len(levels), 32)]
        return _SCRIPT.substitute(
            chips=program.chips,
            chip_ns=program.chip_ns,
            cycles=cycles,
            closed=device.closed_level,
            crc=f"0x{program.code_crc32:08x}",
            words=item_rows(words, per_line=4),
            init="OUT_HIGH" if device.closed_level else "OUT_LOW",
        )

    def parse_back(self, text: str, /) -> Program:
        """Read the program back from the words and the cycles."""
        chips = int(value_in(text, r"^CHIPS = (\d+)$"))
        cycles = int(value_in(text, r"^CYCLES = (\d+)  #"))
        closed_level = value_in(text, r"^CLOSED_LEVEL = ([01])  #")
        words = value_in(text, r"^WORDS = \(([^()]*),\n\)$").split(",")
        levels = "".join(f"{int(word, 16):032b}" for word in words)
        bits = "".join("0" if level == closed_level else "1" for level in levels[:chips])
        return Program(bits, cycles * self.tick_ns)
