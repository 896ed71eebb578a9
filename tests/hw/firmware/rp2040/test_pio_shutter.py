"""The shutter `pio_shutter.py` on an emulated RP2040, its PIO stepped every clock cycle: exact
edges, closed after."""

from __future__ import annotations

import random
import sys
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest
from emulators.tools import give_up, require_node_module

from hw.device import DeviceProfile
from hw.export import EXPORTERS
from hw.program import Program

SOURCE = Path(__file__).parents[4] / "hw" / "firmware" / "rp2040" / "pio_shutter.py"
SHUTTER = 15
TRIGGER = 14
TAIL = 10_000


def random_code(rng: random.Random, chips: int) -> str:
    bits = "".join(rng.choice("01") for _ in range(chips))
    return bits if "1" in bits else bits[:-1] + "1"


def packed(bits: str) -> bytes:
    size = -(-len(bits) // 8)
    return int(bits.ljust(8 * size, "0"), 2).to_bytes(size, "big")


def ideal_edges(bits: str, ticks: int) -> list[tuple[int, int]]:
    return [
        (k * ticks, int(new))
        for k, (old, new) in enumerate(zip("0" + bits, bits + "0", strict=True))
        if old != new
    ]


class Board:
    """Chip and shutter made from (perhaps altered) source."""

    def __init__(self, chip, source: str) -> None:
        self.chip = chip
        module = ModuleType("pio_shutter")
        exec(compile(source, str(SOURCE), "exec"), module.__dict__)
        self.module = module
        self.shutter = module.PioShutter(SHUTTER, TRIGGER)
        self.edges()

    def edges(self) -> list[tuple[int, int]]:
        return self.chip.edges(SHUTTER)

    def level_is_low(self) -> bool:
        return not self.chip[0x5020003C] >> SHUTTER & 1  # what PIO 0 gives to the pins

    def check_play(
        self, bits: str, ticks: int, *, start: Callable[[], object] | None = None
    ) -> int:
        """Arm, start, and look at every edge; return the cycle of the first chip."""
        shutter = self.shutter
        chip = self.chip
        shutter.arm(ticks, len(bits), packed(bits))
        assert not shutter.begun()
        assert not shutter.ended()
        assert self.edges() == []
        earliest = chip.run(0)
        (start or shutter.start)()
        latest = chip.run(0)
        assert shutter.begun()
        # No register is touched from here to the end: the processor might as well be dead.
        chip.run(len(bits) * ticks)
        chip.run(ticks + TAIL)
        found = self.edges()
        ideal = ideal_edges(bits, ticks)
        assert found
        begin = found[0][0] - ideal[0][0]
        assert [(cycle - begin, level) for cycle, level in found] == ideal
        assert earliest <= begin <= latest
        assert shutter.ended()
        assert self.level_is_low()
        shutter.close()
        assert self.edges() == []
        return begin


@pytest.fixture(scope="module")
def chip() -> Iterator[object]:
    require_node_module("rp2040js")
    try:
        from emulators.rp2040js.board import Chip, modules
    except ImportError:
        give_up("adafruit-circuitpython-pioasm not installed")
    with Chip() as running, pytest.MonkeyPatch.context() as patch:
        for name, module in modules(running).items():
            patch.setitem(sys.modules, name, module)
        yield running


@pytest.fixture
def board(chip) -> Board:
    return Board(chip, SOURCE.read_text(encoding="utf-8"))


def test_instruction_words(board):
    """The program and what is executed from outside, as an assembler that is not MicroPython's has
    them."""
    import adafruit_pioasm

    assert board.shutter._program.words == [0x2020, 0x20A0, 0x6001, 0xA026, 0x0044]
    for name, text in (
        ("_PULL", "pull block"),
        ("_MOV_ISR_OSR", "mov isr, osr"),
        ("_OUT_NULL", "out null, 32"),
        ("_SET_PINS_0", "set pins, 0"),
    ):
        assert [getattr(board.module, name)] == list(adafruit_pioasm.assemble(text))
    assert list(adafruit_pioasm.assemble("out null, 5")) == [board.module._OUT_NULL | 5]


def test_a_limit_that_hello_cannot_tell_is_refused(board):
    with pytest.raises(ValueError, match="at most 34359738"):
        type(board.shutter)(SHUTTER, TRIGGER, max_on_us=34_359_739)


def test_closed_at_boot(board):
    assert board.level_is_low()
    board.chip.run(TAIL)
    board.chip.input(TRIGGER, 1)
    board.chip.run(TAIL)
    board.chip.input(TRIGGER, 0)
    assert board.edges() == []


@pytest.mark.slow  # 60 codes on an emulator
def test_sixty_random_codes(board):
    rng = random.Random(20)
    for _ in range(60):
        board.check_play(random_code(rng, rng.randint(16, 287)), round(125 * 1000 ** rng.random()))


def test_every_length(board):
    rng = random.Random(21)
    for chips in range(1, 288):
        board.check_play(random_code(rng, chips), 125)
    board.check_play("1" * 287, 125)


def test_a_chip_of_many_cycles(board):
    board.check_play("101", 5_000_000)


def test_trigger_input_starts_after_a_constant_time(board):
    rng = random.Random(22)
    chip = board.chip
    latencies = set()
    for _ in range(60):
        pressed = []

        def press(pressed: list[int] = pressed) -> None:
            chip.run(rng.randrange(2000))
            pressed.append(chip.input(TRIGGER, 1))
            chip.run(50)

        begin = board.check_play(
            random_code(rng, rng.randint(16, 60)), rng.randint(125, 500), start=press
        )
        chip.input(TRIGGER, 0)
        latencies.add(begin - pressed[0])
    # The emulated pins have no synchronizer of two cycles, and its `wait` takes none: three less
    # than announced.
    assert latencies == {board.shutter.lead_ns // board.shutter.tick_ns - 3}


def test_a_high_trigger_input_is_no_edge(board):
    chip = board.chip
    shutter = board.shutter
    chip.input(TRIGGER, 1)
    shutter.arm(125, 8, b"\xaa")
    chip.run(TAIL)
    assert not shutter.begun()
    chip.input(TRIGGER, 0)
    chip.run(TAIL)
    assert not shutter.begun()
    chip.input(TRIGGER, 1)
    chip.run(TAIL)
    assert shutter.ended()
    assert len(board.edges()) == 8
    for level in (0, 1, 0):  # it plays once
        chip.input(TRIGGER, level)
        chip.run(TAIL)
    assert board.edges() == []
    shutter.close()


@pytest.mark.parametrize("before", [None, 0, 5, 130, 2000])
def test_start_by_both_host_and_input(board, before):
    """The input rises while the host triggers: one play, undisturbed."""
    chip = board.chip

    def both() -> None:
        chip.input(TRIGGER, 1)
        if before is not None:
            chip.run(before)
        board.shutter.start()

    board.check_play("1100101", 1000, start=both)
    chip.input(TRIGGER, 0)


def test_trigger_input_is_deaf_after_close(board):
    board.shutter.arm(125, 8, b"\xff")
    board.shutter.close()
    board.chip.input(TRIGGER, 1)
    board.chip.run(TAIL)
    board.chip.input(TRIGGER, 0)
    assert board.edges() == []


def test_close_in_the_middle_and_play_again(board):
    rng = random.Random(23)
    chip = board.chip
    shutter = board.shutter
    for _ in range(20):
        bits = random_code(rng, 100)
        shutter.arm(200, 100, packed(bits))
        shutter.start()
        chip.run(rng.randrange(100 * 200))
        shutter.close()
        assert board.level_is_low()
        board.edges()
        chip.run(100 * 200)
        assert board.edges() == []
        board.check_play(random_code(rng, rng.randint(1, 287)), 125)


class DeadError(Exception):
    """The processor has stopped."""


class DyingChip:
    """The chip as a processor sees it that stops before some register access."""

    def __init__(self, chip, accesses: int) -> None:
        self.chip = chip
        self.left = accesses

    def _live(self) -> None:
        self.left -= 1
        if self.left < 0:
            raise DeadError

    def __getitem__(self, address: int) -> int:
        self._live()
        return self.chip[address]

    def __setitem__(self, address: int, value: int) -> None:
        self._live()
        self.chip[address] = value


def test_a_processor_that_dies_anywhere_leaves_it_closed(board):
    """Dead before any register access between arming and the end: nothing is played, or the whole
    code."""
    bits = "1011001110001111000011111"
    ticks = 130
    chip = board.chip
    shutter = board.shutter
    played = []
    finished = False
    while not finished:
        dying = DyingChip(chip, len(played))
        shutter._registers = shutter._machine._chip = dying
        try:
            shutter.arm(ticks, len(bits), packed(bits))
            shutter.start()
            finished = True
        except DeadError:
            pass
        chip.run(3 * len(bits) * ticks)
        assert board.level_is_low()
        found = board.edges()
        if found:
            assert [(cycle - found[0][0], level) for cycle, level in found] == ideal_edges(
                bits, ticks
            )
        played.append(bool(found))
        shutter._registers = shutter._machine._chip = chip
        shutter.close()
        chip[0x40014000 + 8 * TRIGGER + 4] = 5  # as a reset leaves the trigger's input override
    assert len(played) > 30
    assert played == sorted(played)  # from the access on that starts it, it plays whatever follows
    assert played[-1]


MUTANTS = {
    "tick off by one": ("put(ticks - 3)", "put(ticks - 2)"),
    "last bit first": ("rp2.PIO.SHIFT_LEFT", "rp2.PIO.SHIFT_RIGHT"),
    "last chip dropped": ("<< 1\n", ">> 1 << 2\n"),
    "no closed chip behind": (" << 1\n", "\n"),
    "padding not dropped": ("if words * 32 - chips - 1:", "if False:"),
    "words in the wrong order": ("range(words - 2, -1, -1)", "range(words - 1)"),
    "queue not joined": ("rp2.PIO.JOIN_TX", "rp2.PIO.JOIN_NONE"),
}


@pytest.mark.parametrize("mutant", MUTANTS)
def test_mutants_are_caught(chip, mutant):
    source = SOURCE.read_text(encoding="utf-8")
    old, new = MUTANTS[mutant]
    assert source.count(old) == 1
    board = Board(chip, source.replace(old, new))
    with pytest.raises(AssertionError):
        board.check_play("1101" * 56, 200)


def loaded(board: Board, ticks: int, bits: str) -> dict[str, object]:
    """What arming puts into the registers, followed by hand: queue, output and input shift
    register."""
    queue: list[int] = []
    out = 0
    shifted = 32
    chip_length = 0
    machine = board.shutter._machine
    registers = board.shutter._registers
    module = board.module

    class Executing:
        def __getitem__(self, address: int) -> int:
            return registers[address]

        def __setitem__(self, address: int, value: int) -> None:
            nonlocal out, shifted, chip_length
            if address != module._INSTR:
                return
            if value == module._PULL:
                assert shifted == 32, "a pull into a full shift register does nothing"
                out = queue.pop(0)
                shifted = 0
            elif value == module._MOV_ISR_OSR:
                chip_length = out
            else:
                assert value & ~31 == module._OUT_NULL
                count = value & 31 or 32
                out = out << count & 0xFFFFFFFF
                shifted = min(32, shifted + count)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(board.shutter, "_registers", Executing())
        patch.setattr(machine, "put", lambda value: queue.append(value & 0xFFFFFFFF))
        patch.setattr(machine, "active", lambda on: None)
        board.shutter.arm(ticks, len(bits), packed(bits))
    assert len(queue) <= 8
    return {"queue": queue, "out": out, "shifted": shifted, "chip_length": chip_length}


def rising_at(press: int) -> Callable[[int], int]:
    def levels(clock: int) -> int:
        return int(clock >= press) << TRIGGER

    levels.__annotations__["clock"] = int  # not its name: the simulator asks for the type
    return levels


def test_a_second_simulator_agrees(board):
    """The same words and queues in rp2040-pio-emulator, which shares no code with rp2040js."""
    try:
        from pioemu import ShiftRegister, State, emulate
    except ImportError:
        give_up("rp2040-pio-emulator not installed")
    rng = random.Random(24)
    for chips in (31, 52, 287):
        bits = random_code(rng, chips)
        ticks = rng.randint(125, 140)
        press = rng.randrange(5, 50)
        found = loaded(board, ticks, bits)

        words = board.shutter._program.words
        states = emulate(
            [
                word | TRIGGER if word >> 13 == 1 else word for word in words
            ],  # it knows no base of input pins
            stop_when=lambda _, state, end=(chips + 3) * ticks + press: state.clock >= end,
            initial_state=State(
                pin_directions=1 << SHUTTER,
                transmit_fifo=deque(found["queue"]),
                output_shift_register=ShiftRegister(found["out"], found["shifted"]),
                input_shift_register=ShiftRegister(found["chip_length"], 0),
            ),
            input_source=rising_at(press),
            auto_pull=True,
            shift_osr_right=False,
            out_base=SHUTTER,
            out_count=1,
            wrap_target=board.shutter._program.wrap_target,
            wrap_top=board.shutter._program.wrap,
        )
        levels = [(after.clock, after.pin_values >> SHUTTER & 1) for _, after in states]
        edges = [
            new for old, new in zip([(0, 0), *levels], levels, strict=False) if old[1] != new[1]
        ]
        begin = edges[0][0] - ideal_edges(bits, ticks)[0][0]
        assert [(cycle - begin, level) for cycle, level in edges] == ideal_edges(bits, ticks)
        # The rest of what HELLO announces is the input's synchronizer of two cycles.
        assert begin - press == board.shutter.lead_ns // board.shutter.tick_ns - 2


@pytest.mark.parametrize("closed_level", [0, 1])
def test_the_exported_script_plays_exactly_too(chip, monkeypatch, closed_level):
    """`cep export --format rp2`, the code in a script without a host: two triggers, two plays."""
    rng = random.Random(25)
    program = Program(random_code(rng, 223), 8 * 130)
    script = EXPORTERS["rp2"].export(
        program, DeviceProfile(name="mine", closed_level=closed_level)
    )
    looks = 0

    class Looked(type(chip)):
        """The chip, of which the trigger rises while the script looks whether the code has
        ended."""

        def __init__(self) -> None:
            self.__dict__ = chip.__dict__

        def __getitem__(self, address: int) -> int:
            nonlocal looks
            if address == 0x50200008:
                looks += 1
                self.input(TRIGGER, looks % 400 == 50)
                if looks > 1200:
                    raise KeyboardInterrupt
            return super().__getitem__(address)

    monkeypatch.setattr(sys.modules["machine"], "mem32", Looked())
    chip.input(TRIGGER, 0)
    chip.edges(SHUTTER)
    with pytest.raises(KeyboardInterrupt):
        exec(compile(script, "script.py", "exec"), {"print": lambda *words: None})
    played = chip.edges(SHUTTER)
    played = played[1:] if closed_level else played  # it rises to its closed level first
    ideal = [(at // 8, level ^ closed_level) for at, level in program.edges]
    plays = [played[k : k + len(ideal)] for k in range(0, len(played), len(ideal))]
    assert len(plays) >= 2
    for play in plays:
        begin = play[0][0] - ideal[0][0]
        assert [(cycle - begin, level) for cycle, level in play] == ideal


@pytest.mark.parametrize(
    ("reason", "chip_reset", "cause"),
    [
        (0, 1 << 8, 0),
        (0, 1 << 16, 1),
        (0, 1 << 20, 255),
        (1, 0, 3),
        (1, 1 << 8, 3),
        (2, 1 << 16, 255),
    ],
)
def test_reset_cause(board, reason, chip_reset, cause):
    assert board.module.reset_cause({0x40058008: reason, 0x40064008: chip_reset}) == cause
