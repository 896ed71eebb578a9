"""The shipped AVR firmware plays to the clock cycle on two simulators that share nothing; faulty
ones are caught."""

import hashlib
import random
import subprocess

import pytest
from emulators.avr import (
    EDGE_CYCLES,
    FOLDER,
    HEX,
    LEAD_CYCLES,
    RawPort,
    build,
    check_codes,
    check_edges,
    check_wrong_crc,
    ideal_edges,
    on_grid,
    played,
)
from emulators.avr8js import Avr8jsUno
from emulators.tools import require_node_module, require_simavr, require_tool

from hw.cxp.protocol import Op, State, Stored
from hw.drivers.cxp import Controller
from hw.emulation.uno import EmulatedUno


def random_codes(count, seed, *, fractions=False, chips=(16, 512)):
    """Codes that end open, so that their end can be seen; chips of 50 us..1 ms, short ones as
    often as long ones."""
    rng = random.Random(seed)
    codes = []
    for _ in range(count):
        bits = "".join(rng.choice("01") for _ in range(rng.randint(*chips) - 1)) + "1"
        codes.append(
            Stored(bits, round(100 * 20 ** rng.random()), rng.randrange(65536) if fractions else 0)
        )
    return codes


CODES = random_codes(60, seed=1)


@pytest.fixture(scope="module")
def simavr_plays():
    require_simavr()
    with EmulatedUno(speed=0) as uno:
        return check_codes(uno, CODES)


@pytest.mark.slow  # 60 codes on an emulator
def test_60_random_codes_on_simavr(simavr_plays):
    assert len(simavr_plays) == 60
    assert sum(len(code.bits) for code in CODES) > 10_000
    assert (
        {code.ticks < 150 for code in CODES}
        == {code.ticks > 1500 for code in CODES}
        == {True, False}
    )


@pytest.mark.slow  # 60 codes on an emulator
def test_the_same_60_codes_on_avr8js_have_the_same_edges(simavr_plays):
    require_node_module("avr8js")
    with Avr8jsUno(HEX) as uno:
        plays = check_codes(uno, CODES)
    for play, other, code in zip(plays, simavr_plays, CODES, strict=True):
        assert on_grid(play, code) == on_grid(other, code)


def test_fractions_of_ticks_are_played_to_the_nearest_tick():
    require_simavr()
    codes = [
        *random_codes(10, seed=2, fractions=True),
        Stored("01" * 512, 100, 64),
        Stored("01" * 512, 100, 32768),
        Stored("10" * 511 + "01", 131, 65535),
    ]
    with EmulatedUno(speed=0) as uno:
        plays = check_codes(uno, codes)
    for play, code in zip(plays, codes, strict=True):
        start = play.edges[0][0] - ideal_edges(code)[0][0] * 8
        exact = [float(chip * code.chip_ticks * 8) for chip in edge_chips(code.bits)]
        errors = [cycle - start - at for (cycle, _), at in zip(play.edges, exact, strict=True)]
        assert max(map(abs, errors)) <= 8 + EDGE_CYCLES  # one tick and the simulator's grain
        assert (
            play.edges[-1][0] - start > len(code.bits) * code.ticks * 8
        )  # the fraction is not just left out


def edge_chips(bits):
    return [k for k, (a, b) in enumerate(zip("0" + bits, bits + "0", strict=True)) if a != b]


def test_longest_chips_and_longest_code():
    require_simavr()
    with EmulatedUno(speed=0) as uno:
        check_codes(
            uno,
            [
                Stored("1011", 65535, 0),
                Stored("1011", 65534, 65535),
                Stored("1" + "01" * 511 + "1", 100, 0),
            ],
        )


def test_nothing_moves_the_pin_but_plays():
    require_simavr()
    code = Stored("1101", 2000, 0)
    with EmulatedUno(speed=0) as uno, Controller.open(uno.port) as controller:
        uno.trigger()
        played(uno, controller, code)
        quiet = uno.edges()
        assert len(quiet) == 4
        for act in (
            uno.trigger,
            controller.arm,
            controller.abort,
            uno.trigger,
            controller.link.hello,
            controller.read,
        ):
            act()
            controller.status()
        assert uno.edges() == quiet
        check_edges(played(uno, controller, code), code)


def trigger_latencies(uno, count):
    """Play by the trigger input; cycles from its edge to that of the shutter, sorted."""
    with Controller.open(uno.port, timeout_s=0.3) as controller:
        controller.link.request(Op.LOAD, Stored("1", 100, 0).payload)
        for runs in range(count):
            controller.arm(lease_ms=65_535)
            uno.trigger()
            # no byte of a request is on its way when the edge comes: its interrupt would delay it
            while sum(level for _, level in uno.edges("trigger")) <= runs:
                pass
            while (status := controller.status()).state is not State.DONE:
                assert status.state in (State.ARMED, State.PLAY)
            assert (status.runs, status.late) == (runs + 1, 0)
    rises = [cycle for cycle, level in uno.edges() if level]
    triggers = [cycle for cycle, level in uno.edges("trigger") if level]
    return sorted(rise - trigger for rise, trigger in zip(rises, triggers, strict=True))


def test_external_trigger_has_a_constant_latency_on_simavr():
    require_simavr()
    with EmulatedUno(speed=1, noise_seed=5) as uno:
        latencies = trigger_latencies(uno, 60)
    assert abs(latencies[30] - LEAD_CYCLES) <= 32  # 2 us
    assert latencies[56] - latencies[0] <= 4
    assert latencies[59] - latencies[0] <= 64  # another interrupt was running when it came


def test_external_trigger_has_the_same_latency_on_avr8js():
    require_node_module("avr8js")
    with Avr8jsUno(HEX) as uno:
        latencies = trigger_latencies(uno, 10)
    assert all(abs(latency - LEAD_CYCLES) <= 64 for latency in latencies)


MUTANTS = {
    "tick off by one": (
        [("player.c", "uint16_t top = stored.ticks - 1;", "uint16_t top = stored.ticks;")],
        "cycles off",
    ),
    "LSB first": (
        [
            (
                "player.c",
                "next_byte = stored.bits;\n    next_mask = 0x80;",
                "next_byte = stored.bits;\n    next_mask = 1;",
            ),
            ("player.c", "next_mask >>= 1;", "next_mask <<= 1;"),
            (
                "player.c",
                "next_mask = 0x80;\n        next_byte++;",
                "next_mask = 1;\n        next_byte++;",
            ),
        ],
        "levels differ|cycles off",
    ),
    "last chip dropped": (
        [
            (
                "player.c",
                "preset_level(begun == stored.chips)",
                "preset_level(begun + 1 >= stored.chips)",
            )
        ],
        "levels differ|cycles off",
    ),
    "wrong prescaler": (
        [("player.c", "(_BV(WGM12) | _BV(CS11))", "(_BV(WGM12) | _BV(CS11) | _BV(CS10))")],
        "cycles after busy",
    ),
    "level after the end": (
        [("player.c", "!last && (", "last || (")],
        "cycles off",
    ),
    "no CRC check": (
        [("frame.c", " && crc == last_two", "")],
        "a frame with a wrong CRC is answered",
    ),
}


def prove(firmware):
    with EmulatedUno(firmware, speed=0) as uno:
        check_codes(uno, CODES[:3])
        with RawPort(uno.port) as raw:
            check_wrong_crc(raw, CODES[3].payload)


def test_the_proof_passes_the_firmware_as_built_here(tmp_path):
    require_simavr()
    require_tool("avr-gcc", "avr-objcopy", "make")
    prove(build(tmp_path))


@pytest.mark.parametrize("name", MUTANTS)
def test_the_proof_catches_a_firmware_with(name, tmp_path):
    require_simavr()
    require_tool("avr-gcc", "avr-objcopy", "make")
    changes, complaint = MUTANTS[name]
    mutant = build(tmp_path, *changes)
    with pytest.raises(AssertionError, match=complaint):
        prove(mutant)


def test_the_shipped_hex_is_what_its_hash_says_and_what_its_sources_give(tmp_path):
    digest = hashlib.sha256(HEX.read_bytes()).hexdigest()
    assert HEX.with_name("cxp-avr.hex.sha256").read_text() == f"{digest}  cxp-avr.hex\n"
    require_tool("avr-gcc", "avr-objcopy", "make")
    version = subprocess.run(
        ["avr-gcc", "-dumpversion"], check=True, capture_output=True, text=True
    ).stdout.strip()
    if f"avr-gcc {version}" not in (FOLDER / "README.md").read_text():
        pytest.skip(f"avr-gcc {version} is not the one that the shipped firmware was built with")
    assert build(tmp_path).read_bytes() == HEX.read_bytes()
