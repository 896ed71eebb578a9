"""The modules `machine`, `rp2` and `micropython` of an RP2040 board for CPython, acting on an
emulated chip.

The state machine calls do to the chip's registers what MicroPython's port and the Pico SDK do;
programs are assembled by adafruit_pioasm. Each register access takes `ACCESS_CYCLES`, as from an
interpreter.
"""

from __future__ import annotations

import json
import subprocess
import threading
from pathlib import Path
from types import ModuleType, SimpleNamespace

import adafruit_pioasm

HERE = Path(__file__).parent
NODE = HERE.parent / "node"
ACCESS_CYCLES = 250
CLOCK_HZ = 125_000_000

PIO0 = 0x50200000
CTRL = PIO0
FSTAT = PIO0 + 0x04
FDEBUG = PIO0 + 0x08
TXF0 = PIO0 + 0x10
INSTR_MEM0 = PIO0 + 0x48
SM0_CLKDIV, SM0_EXECCTRL, SM0_SHIFTCTRL, SM0_INSTR, SM0_PINCTRL = (
    PIO0 + k for k in (0xC8, 0xCC, 0xD0, 0xD8, 0xDC)
)
IO_BANK0 = 0x40014000
PADS_BANK0 = 0x4001C000
SIO_GPIO_OUT_SET, SIO_GPIO_OUT_CLR, SIO_GPIO_OE_SET, SIO_GPIO_OE_CLR = (
    0xD0000000 + k for k in (0x14, 0x18, 0x24, 0x28)
)
FUNCTION_SIO = 5
FUNCTION_PIO0 = 6
INPUT_ENABLE = 0x40
PULL_DOWN = 0x04


class Chip:
    """The emulated chip; a context manager. All its times are clock cycles of 8 ns."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            ["node", str(HERE / "chip.mjs"), str(NODE)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self._lock = threading.Lock()
        self.access_cycles = ACCESS_CYCLES

    def __enter__(self) -> Chip:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.stdin.close()
        self._process.wait(timeout=10)
        self._process.stdout.close()

    def _ask(self, *command: object):
        with self._lock:
            self._process.stdin.write(json.dumps(command) + "\n")
            self._process.stdin.flush()
            return json.loads(self._process.stdout.readline())

    def __getitem__(self, address: int) -> int:
        """Read a register, as `machine.mem32` does."""
        value = self._ask("read", address)
        self.run(self.access_cycles)
        return value

    def __setitem__(self, address: int, value: int) -> None:
        self._ask("write", address, value & 0xFFFFFFFF)
        self.run(self.access_cycles)

    def run(self, cycles: int) -> int:
        """Let time pass; return the cycle it is now."""
        return self._ask("run", cycles)

    def input(self, gpio: int, level: int) -> int:
        """Drive a pin from outside; return the cycle it is now."""
        return self._ask("input", gpio, level)

    def edges(self, gpio: int) -> list[tuple[int, int]]:
        """Cycle and level of every change of a pin since the last question."""
        return [tuple(edge) for edge in self._ask("edges", gpio)]


class Pin:
    """`machine.Pin`."""

    IN = 0
    OUT = 1
    PULL_DOWN = 2

    def __init__(
        self, chip: Chip, number: int, mode: int, pull: int = 0, *, value: int = 0
    ) -> None:
        self.number = number
        self._chip = chip
        self.init(mode, pull, value=value)

    def init(self, mode: int, pull: int = 0, *, value: int = 0) -> None:
        chip = self._chip
        number = self.number
        chip[PADS_BANK0 + 4 + 4 * number] = INPUT_ENABLE | (
            PULL_DOWN if pull == self.PULL_DOWN else 0
        )
        if mode == self.OUT:
            chip[SIO_GPIO_OUT_SET if value else SIO_GPIO_OUT_CLR] = 1 << number
        chip[SIO_GPIO_OE_SET if mode == self.OUT else SIO_GPIO_OE_CLR] = 1 << number
        chip[IO_BANK0 + 8 * number + 4] = FUNCTION_SIO


class StateMachine:
    """`rp2.StateMachine`, number 0 only."""

    def __init__(self, chip: Chip, number: int, *config: Assembled, **options: object) -> None:
        assert number == 0
        self._chip = chip
        self._offsets: dict[int, int] = {}
        self._top = 32
        self._begin = 0
        if config:
            self.init(*config, **options)

    def init(
        self,
        program: Assembled,
        *,
        in_base: Pin,
        out_base: Pin,
        set_base: Pin | None = None,
        freq: int = CLOCK_HZ,
    ) -> None:
        assert freq == CLOCK_HZ, "the divider is 1"
        chip = self._chip
        if id(program) not in self._offsets:
            self._top -= len(program.words)
            self._offsets[id(program)] = self._top
            for k, word in enumerate(program.words):
                absolute = self._top if word >> 13 == 0 else 0  # only jumps are relocated
                chip[INSTR_MEM0 + 4 * (self._top + k)] = word + absolute
        self._begin = offset = self._offsets[id(program)]
        self._enable(0)
        chip[SM0_CLKDIV] = 1 << 16
        shift = 0b11 << 18
        for value in (shift, shift ^ 1 << 31, shift):  # switching FJOIN empties the queues
            chip[SM0_SHIFTCTRL] = value
        chip[FDEBUG] = 0x01010101
        chip[CTRL] = 1 << 4 | 1 << 8  # restart state machine and divider
        chip[SM0_INSTR] = self._begin
        chip[SM0_EXECCTRL] = program.wrap_target + offset << 7 | program.wrap + offset << 12
        chip[SM0_SHIFTCTRL] = program.shiftctrl
        pins = in_base.number << 15 | 1 << 20 | out_base.number
        if set_base is not None:
            pins |= 1 << 26 | set_base.number << 5
        for pin, levels in ((out_base, program.out_init), (set_base, program.set_init)):
            if pin is None:
                continue
            chip[SM0_PINCTRL] = 1 << 26 | pin.number << 5
            chip[SM0_INSTR] = 0xE000 | levels & 1
            chip[SM0_INSTR] = 0xE080 | levels >> 1
            chip[SM0_PINCTRL] = pins
            chip[IO_BANK0 + 8 * pin.number + 4] = FUNCTION_PIO0

    def restart(self) -> None:
        self._chip[CTRL] = self._chip[CTRL] | 1 << 4
        self._chip[SM0_INSTR] = self._begin

    def put(self, value: int) -> None:
        assert not self._chip[FSTAT] & 1 << 16, (
            "the queue is full: on a board this would wait for ever"
        )
        self._chip[TXF0] = value

    def active(self, on: int) -> None:
        self._enable(on)

    def _enable(self, on: int) -> None:
        self._chip[CTRL] = int(on)


class Assembled(SimpleNamespace):
    """A program as `rp2.asm_pio` makes it, assembled by another assembler."""


def asm_pio(*, out_init, set_init=None, out_shiftdir, autopull, pull_thresh, fifo_join):
    """`rp2.asm_pio` for the options in use."""

    def decorate(function):
        lines: list[str] = []

        def instruction(name):
            return lambda *values: lines.append(f"{name} " + ", ".join(map(str, values)))

        names = {name: name for name in ("pin", "pins", "x", "isr")} | {"x_dec": "x--"}
        names |= {name: instruction(name) for name in ("out", "mov", "jmp")}
        names["wait"] = lambda level, source, index: lines.append(f"wait {level} {source} {index}")
        names["label"] = lambda text: lines.append(f"{text}:")
        names["wrap_target"] = lambda: lines.append(".wrap_target")
        names["wrap"] = lambda: lines.append(".wrap")
        exec(function.__code__, names)
        assembled = adafruit_pioasm.Program("\n".join(lines))
        shiftctrl = (
            fifo_join << 30 | (pull_thresh & 31) << 25 | out_shiftdir << 19 | autopull << 17
        )
        return Assembled(
            text=lines,
            words=list(assembled.assembled),
            wrap=assembled.pio_kwargs["wrap"],
            out_init=out_init,
            wrap_target=assembled.pio_kwargs["wrap_target"],
            shiftctrl=shiftctrl,
            set_init=set_init,
        )

    return decorate


def modules(chip: Chip) -> dict[str, ModuleType]:
    """`machine`, `rp2` and `micropython` acting on `chip`; `machine.log` notes what has no effect
    on the chip."""
    machine = ModuleType("machine")
    rp2 = ModuleType("rp2")
    micropython = ModuleType("micropython")
    log: list[str] = []

    class WDT:
        def __init__(self, *, timeout: int) -> None:
            log.append(f"watchdog {timeout}")

        def feed(self) -> None:
            if log[-1] != "feed":
                log.append("feed")

    def pin(*args, **kwargs):
        return Pin(chip, *args, **kwargs)

    pin.IN, pin.OUT, pin.PULL_DOWN = Pin.IN, Pin.OUT, Pin.PULL_DOWN
    machine.Pin, machine.WDT, machine.mem32, machine.log = pin, WDT, chip, log
    machine.freq = lambda hertz: log.append(f"freq {hertz}")
    rp2.PIO = SimpleNamespace(
        OUT_LOW=2, OUT_HIGH=3, SHIFT_LEFT=0, SHIFT_RIGHT=1, JOIN_NONE=0, JOIN_TX=1
    )
    rp2.asm_pio = asm_pio
    rp2.StateMachine = lambda *args, **options: StateMachine(chip, *args, **options)
    micropython.kbd_intr = lambda code: log.append(f"kbd_intr {code}")
    return {"machine": machine, "rp2": rp2, "micropython": micropython}
