"""Exported files in the hands of those they are for: compilers, an emulated Uno, a PIO, and
logic-analyser software."""

import io
import itertools
import random
import re
import subprocess
import time
import types

import pytest
import serial
from emulators.avr8js import Avr8jsUno
from emulators.tools import require_node_module, require_simavr, require_tool
from hypothesis import given, settings
from hypothesis import strategies as st

from hw.device import DeviceProfile
from hw.emulation.uno import EmulatedUno
from hw.export import EXPORTERS
from hw.program import Program

RASKAR = "1010000111000001010000110011110111010111001001100111"
CYCLE_NS = 62.5
AVR = ["-mmcu=atmega328p", "-Os", "-DF_CPU=16000000L", "-Wall", "-Wextra", "-Werror"]
HIGH = DeviceProfile(name="closed when high", closed_level=1)


def _run(*command, cwd):
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return done.stdout


def _random_program(chips, chip_ns, seed):
    bits = random.Random(seed).choices("01", k=chips)
    return Program("".join(bits), chip_ns)


def _built(program, folder, device):
    """Compile as the Arduino IDE does: its core calls setup once and loop for ever."""
    (folder / "code.ino").write_text(EXPORTERS["arduino"].export(program, device))
    (folder / "main.cpp").write_text(
        "void setup(); void loop();\nint main() { setup(); for (;;) loop(); }\n"
    )
    _run("avr-g++", *AVR, "-x", "c++", "-c", "code.ino", "-o", "code.o", cwd=folder)
    _run("avr-g++", *AVR, "main.cpp", "code.o", "-o", "code.elf", cwd=folder)
    _run("avr-objcopy", "-O", "ihex", "-R", ".eeprom", "code.elf", "code.hex", cwd=folder)
    return folder / "code.hex"


def _simavr(hexfile):
    require_simavr()
    return EmulatedUno(hexfile, speed=0)


def _avr8js(hexfile):
    require_node_module("avr8js")
    return Avr8jsUno(hexfile)


def _wait(ready):
    limit = time.monotonic() + 20
    while not ready():
        assert time.monotonic() < limit, "nothing was played"
        time.sleep(0.02)


def _triggered(uno):
    before = len(uno.edges("trigger"))
    uno.trigger()
    _wait(lambda: len(uno.edges("trigger")) == before + 2)
    time.sleep(0.5)


def _check_on_grid(play, program, closed=0):
    wanted = [(time_ns / CYCLE_NS, level ^ closed) for time_ns, level in program.edges]
    assert [level for _, level in play] == [level for _, level in wanted]
    late = [cycle - at for (cycle, _), (at, _) in zip(play, wanted, strict=True)]
    assert max(late) - min(late) < 8  # simulated pins change late, but none in another tick


@pytest.mark.parametrize(
    ("program", "device"),
    [
        (Program(RASKAR, 200_000), DeviceProfile(name="low")),
        (_random_program(1000, 50_000, 1), DeviceProfile(name="low")),
        (_random_program(333, 127_500, 2), HIGH),
        (Program("0001", 32_767_500), DeviceProfile(name="low")),
        (Program("1", 1_000_000), HIGH),
    ],
    ids=["raskar", "fastest", "closed high", "slowest", "one chip"],
)
@pytest.mark.parametrize("simulator", [_simavr, _avr8js])
def test_arduino_sketch_plays_every_edge_on_the_grid(tmp_path, simulator, program, device):
    require_tool("avr-g++", "avr-objcopy")
    closed = device.closed_level
    count = len(program.edges)
    with simulator(_built(program, tmp_path, device)) as uno:
        # Not heard before setup, nor, on simavr, as long as the pull-up alone holds the input: it
        # must be low once.
        _wait(lambda: len(uno.edges()) > closed or _triggered(uno))
        _wait(lambda: len(uno.edges()) >= closed + count)
        with serial.Serial(uno.port, 115200) as port:
            port.write(b"xtt")  # other letters, and a second t during the play, do nothing
            _wait(lambda: len(uno.edges()) >= closed + 2 * count)
            time.sleep(0.1)
        shutter = uno.edges()
        triggers = uno.edges("trigger")
    edges = shutter[closed:]
    assert len(edges) == 2 * count
    for play in (edges[:count], edges[count:]):
        _check_on_grid(play, program, closed)
    # One chip and a few microseconds after a trigger; those that came during the play did nothing.
    start = edges[0][0] - (program.edges[0][0] + program.chip_ns) / CYCLE_NS
    assert any(0 < start - rise < 12_000 / CYCLE_NS for rise, level in triggers if level)


@pytest.mark.parametrize(
    ("simulator", "hertz"),
    [
        (_simavr, 100e3),
        (_simavr, 200e3),
        (_simavr, 300e3),
        (_simavr, 500e3),
        (_simavr, 1e6),
        (_avr8js, 250e3),
    ],
)
def test_arduino_sketch_plays_right_through_a_storm_of_triggers(tmp_path, simulator, hertz):
    require_tool("avr-g++", "avr-objcopy")
    program = Program(RASKAR, 50_000)
    count = len(program.edges)
    play_cycles = (program.duration_ns + 2 * program.chip_ns) / CYCLE_NS
    with simulator(_built(program, tmp_path, DeviceProfile(name="low"))) as uno:
        _wait(lambda: uno.edges() or _triggered(uno))  # until setup is over
        _wait(lambda: len(uno.edges()) % count == 0)
        before = len(uno.edges("trigger"))
        storm = round(hertz * 0.01)
        uno.trigger(pulses=storm, hertz=hertz)
        _wait(lambda: len(uno.edges("trigger")) == before + 2 * storm)
        quiet = uno.edges("trigger")[-1][0] + play_cycles
        _wait(lambda: uno.edges()[-1][0] > quiet or _triggered(uno))
        _wait(lambda: len(uno.edges()) % count == 0)
        edges = uno.edges()
    closings = (
        cycle - opened for (opened, level), (cycle, _) in itertools.pairwise(edges) if level
    )
    assert max(closings) < 200_000 / CYCLE_NS + 8  # the code's longest opening: four chips
    plays = [edges[k : k + count] for k in range(0, len(edges), count)]
    assert (
        len(plays) >= 4
    )  # one before the storm, one after it, and one after the other while it lasts
    for play in plays:
        _check_on_grid(play, program)


@pytest.mark.parametrize(
    "options",
    [["-mmcu=atmega328p", "-DF_CPU=8000000L"], ["-mmcu=atmega2560", "-DF_CPU=16000000L"]],
)
def test_arduino_sketch_refuses_other_boards(tmp_path, options):
    require_tool("avr-g++")
    (tmp_path / "code.ino").write_text(EXPORTERS["arduino"].export(Program(RASKAR, 200_000)))
    command = ["avr-g++", *options, "-x", "c++", "-fsyntax-only", "code.ino"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode
    assert "choose Arduino Uno or Nano" in done.stderr


def test_c_header_compiles_for_an_avr(tmp_path):
    require_tool("avr-gcc", "avr-size")
    (tmp_path / "code.h").write_text(EXPORTERS["c"].export(Program(RASKAR, 2**63 - 1)))
    (tmp_path / "main.c").write_text(
        '#include "code.h"\n'
        "volatile uint64_t total;\n"
        "int main(void) {\n"
        "  for (uint16_t k = 0; k < SHUTTER_CODE_CHIPS; k++)\n"
        "    if (shutter_code[k / 8] >> (7 - k % 8) & 1) total += SHUTTER_CODE_CHIP_NS;\n"
        "  return 0;\n}\n"
    )
    _run("avr-gcc", *AVR, "-std=c99", "-pedantic", "main.c", "-o", "main.elf", cwd=tmp_path)
    assert "main.elf" in _run("avr-size", "main.elf", cwd=tmp_path)


class _Pio:
    """The six instructions of the script as words, and what a state machine does with them, cycle
    by cycle."""

    def __init__(self):
        self.words = []
        self.labels = {}
        self.target = 0
        self.wrap = None

    def names(self):
        return {
            "pin": 1,
            "pins": 0,
            "isr": 6,
            "x": 1,
            "x_dec": 2,
            "wait": lambda level, source, index: self.words.append(
                0x2000 | level << 7 | source << 5 | index
            ),
            "out": lambda place, count: self.words.append(0x6000 | place << 5 | count % 32),
            "mov": lambda place, source: self.words.append(0xA000 | place << 5 | source),
            "jmp": lambda condition, label: self.words.append(
                0x0000 | condition << 5 | self.labels[label]
            ),
            "label": lambda name: self.labels.update({name: len(self.words)}),
            "wrap_target": lambda: setattr(self, "target", len(self.words)),
            "wrap": lambda: setattr(self, "wrap", len(self.words)),
        }

    def play(self, fifo, level, trigger):
        """Run until the queue is empty and an `out` stalls; return the changes of the pin as
        (cycle, level)."""
        fifo = list(fifo)
        edges = []
        bits = []
        pc = x = isr = cycle = 0
        while True:
            word = self.words[pc]
            kind = word >> 13
            place = word >> 5 & 7
            following = self.target if pc == len(self.words) - 1 else pc + 1
            if kind == 1:
                if trigger(cycle) != word >> 7 & 1:
                    following = pc
            elif kind == 3:
                if not bits:
                    if not fifo:
                        return edges, cycle
                    bits = [int(bit) for bit in f"{fifo.pop(0):032b}"]
                count = word % 32 or 32
                value = int("".join(map(str, bits[:count])), 2)
                bits = bits[count:]
                if place == 6:
                    isr = value
                elif value != level:
                    edges.append((cycle, level := value))
            elif kind == 5:
                x = isr
            else:
                # All the cycles of `jmp x-- here` at once.
                assert word & 31 == pc
                cycle = cycle + x
                x = 2**32 - 1
            pc = following
            cycle = cycle + 1


class _Board:
    """MicroPython's modules `machine` and `rp2`, as far as the script knows them."""

    def __init__(self, plays, trigger=lambda cycle: cycle < 90 or cycle >= 100):
        # high at first: the script must wait for an edge and not for a level
        self.pio = _Pio()
        self.plays = plays
        self.played = []
        self.trigger = trigger
        self.fifo = []
        self.debug = 1 << 24
        self.pins = {}
        self.is_active = False
        self.frequency = None

    def modules(self):
        board = self

        class Pin:
            OUT = "out"
            IN = "in"
            PULL_DOWN = "down"

            def __init__(self, number, *options, **more):
                self.number = number
                self.init(*options, **more)

            def init(self, *options, value=None):
                board.pins[self.number] = (*options, value)

        class Memory:
            def __getitem__(self, address):
                assert address == 0x50200008
                return board.debug

            def __setitem__(self, address, value):
                assert address == 0x50200008
                board.debug &= ~value

        class StateMachine:
            def __init__(self, number, program, *, freq, in_base, out_base):
                assert (number, freq, in_base.number, out_base.number) == (
                    0,
                    board.frequency,
                    14,
                    15,
                )
                assert board.pins[15] == ("out", board.options["out_init"])
                board.pins[15] = ("driven by the state machine",)

            def restart(self):
                assert not board.is_active
                assert not board.fifo
                if board.plays == len(board.played):
                    raise KeyboardInterrupt

            def put(self, word):
                assert 0 <= word < 2**32
                board.fifo.append(word)
                assert len(board.fifo) <= 8, "the queue is full: put would wait for ever"

            def active(self, on):
                board.is_active = bool(on)
                if on:
                    assert not board.debug, "a stale flag would end the play at once"
                    closed = board.options["out_init"]
                    board.played.append(board.pio.play(board.fifo, closed, board.trigger))
                    board.fifo.clear()
                    board.debug = 1 << 24

        def asm_pio(**options):
            board.options = options
            return lambda program: program() or program

        machine = types.ModuleType("machine")
        machine.Pin, machine.mem32 = Pin, Memory()
        machine.freq = lambda hertz: setattr(board, "frequency", hertz)
        rp2 = types.ModuleType("rp2")
        rp2.asm_pio, rp2.StateMachine = asm_pio, StateMachine
        rp2.PIO = types.SimpleNamespace(OUT_LOW=0, OUT_HIGH=1, SHIFT_LEFT=0, JOIN_TX=1)
        return {"machine": machine, "rp2": rp2}

    def run(self, script):
        names = self.pio.names()
        modules = self.modules()
        names["print"] = lambda *words: None
        names["__builtins__"] = {
            "__import__": lambda name, *rest: modules[name],
            "print": names["print"],
        }
        with pytest.raises(KeyboardInterrupt):
            exec(compile(script, "script.py", "exec"), names)


@settings(deadline=None, max_examples=60)
@given(
    st.text("01", min_size=1, max_size=223).filter(lambda bits: "1" in bits),
    st.one_of(st.integers(125, 300), st.just(25_000), st.integers(125, 2**32 + 2)),
    st.integers(0, 1),
)
def test_rp2_script_plays_to_the_cycle(bits, cycles, closed_level):
    program = Program(bits, 8 * cycles)
    board = _Board(plays=2)
    board.run(
        EXPORTERS["rp2"].export(program, DeviceProfile(name="mine", closed_level=closed_level))
    )
    assert board.frequency == 125_000_000
    assert board.options == {
        "out_init": closed_level,
        "out_shiftdir": 0,
        "autopull": True,
        "pull_thresh": 32,
        "fifo_join": 1,
    }
    assert board.pio.wrap == len(board.pio.words)
    assert board.pins[14] == ("in", "down", None)
    assert board.pins[15] == ("out", closed_level)  # also after the script was interrupted
    for edges, stalled in board.played:
        # After the rising edge at cycle 100: one cycle to see it, one for the chip time, one to
        # put the first chip out.
        assert edges == [(102 + at // 8, level ^ closed_level) for at, level in program.edges]
        assert stalled >= 102 + program.duration_ns // 8
        assert edges[-1][1] == closed_level


@pytest.mark.parametrize("half_period", [1, 62, 125, 625])
def test_rp2_script_plays_right_through_a_storm_of_triggers(half_period):
    program = Program(RASKAR, 1000)
    board = _Board(plays=2, trigger=lambda cycle: cycle // half_period % 2 == 0)
    board.run(EXPORTERS["rp2"].export(program))
    begin = 2 * half_period + 2  # cycles after the first edge, as above
    for edges, _ in board.played:
        assert edges == [(begin + at // 8, level) for at, level in program.edges]


def test_rp2_instructions_are_what_an_assembler_makes_of_them():
    adafruit_pioasm = pytest.importorskip(
        "adafruit_pioasm", reason="adafruit-circuitpython-pioasm is not installed"
    )
    script = EXPORTERS["rp2"].export(Program(RASKAR, 200_000))
    board = _Board(plays=1)
    board.run(script)
    body = re.search(r"def play\(\):\n((?: {4}.*\n)+)", script)[1]
    for pattern, text in [
        (r"label\(\"(\w+)\"\)", r"\1:"),
        (r"wrap_target\(\)", ".wrap_target"),
        (r"wrap\(\)", ".wrap"),
        (r"x_dec, \"(\w+)\"", r"x--, \1"),
        (r"(\w+)\((.*)\)", r"\1 \2"),
        (r"wait (\d), pin, 0", r"wait \1 pin 0"),
    ]:
        body = re.sub(pattern, text, body)
    assembled = adafruit_pioasm.Program(".program play\n" + body)
    assert list(assembled.assembled) == board.pio.words
    assert board.pio.words == [0x2020, 0x20A0, 0x60C0, 0x6001, 0xA026, 0x0045]
    assert assembled.pio_kwargs["wrap_target"] == board.pio.target == 3


@settings(deadline=None, max_examples=50)
@given(
    st.text("01", min_size=1, max_size=80).filter(lambda bits: "1" in bits),
    st.integers(1, 2**63 - 1),
)
def test_vcd_is_read_by_another_library(bits, chip_ns):
    reader = pytest.importorskip("vcd.reader", reason="pyvcd is not installed")
    program = Program(bits, chip_ns)
    now = 0
    codes = {}
    unit = None
    changes = {"shutter": [], "gate": []}
    for token in reader.tokenize(io.BytesIO(EXPORTERS["vcd"].export(program).encode())):
        if token.kind is reader.TokenKind.TIMESCALE:
            unit = str(token.timescale)
        elif token.kind is reader.TokenKind.VAR:
            codes[token.var.id_code] = token.var.reference
        elif token.kind is reader.TokenKind.CHANGE_TIME:
            now = token.time_change
        elif token.kind is reader.TokenKind.CHANGE_SCALAR:
            changes[codes[token.scalar_change.id_code]].append(
                (now, int(token.scalar_change.value))
            )
    assert unit == "1 ns"
    assert changes["shutter"] == [(0, 0), *((chip_ns + at, level) for at, level in program.edges)]
    assert changes["gate"] == [(0, 0), (chip_ns, 1), (chip_ns + program.duration_ns, 0)]
    assert now == program.duration_ns + 2 * chip_ns


def test_vcd_is_measured_by_sigrok(tmp_path):
    require_tool("sigrok-cli")
    program = Program(RASKAR, 200_000)
    (tmp_path / "code.vcd").write_text(EXPORTERS["vcd"].export(program))
    command = ["sigrok-cli", "-I", "vcd:downsample=1000", "-i", "code.vcd"]
    units = {"μs": 1000, "ms": 1_000_000}
    for signal, wanted in [
        ("shutter", [length for _, length in program.runs]),
        ("gate", [program.duration_ns]),
    ]:
        said = _run(*command, "-P", f"timing:data={signal}", "-A", "timing=time", cwd=tmp_path)
        measured = [
            float(value) * units[unit] for value, unit in re.findall(r": ([0-9.]+) (\S+) \(", said)
        ]
        assert measured == pytest.approx(wanted, rel=1e-4)
