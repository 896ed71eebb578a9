"""The AVR firmware does what docs/cxp1.md says: conformance, limits built in, frames of any
kind."""

import binascii
import random
import struct
import time
import zlib
from itertools import pairwise

import pytest
from emulators import conformance
from emulators.avr import HEX, RawPort, build
from emulators.conformance import ABORT, ARM, CODE, FAULT, LOAD, OK, READ, TRIG, Host, arm, program
from emulators.tools import require_simavr, require_tool

from hw.cxp.protocol import BINARY, Op, Stored, unpack_status
from hw.drivers.cxp import Controller
from hw.emulation.uno import CLOCK_HZ, EmulatedUno
from hw.errors import DeviceError, VerifyError
from hw.program import Program

REPLY_S = 10.0
# a reply that is not due but comes later than this would be taken for the next one's, and seen
# there
SILENCE_S = 0.008


class UnoDevice:
    """Conformance's view of an emulated Uno."""

    def __init__(self, uno, port):
        self.uno = uno
        self.port = port._port
        self.port.write(b"\0")

    def send(self, body, *, spoil=0):
        crc = binascii.crc_hqx(body, 0xFFFF) ^ spoil
        self.port.timeout = SILENCE_S if spoil or len(body) < 2 else REPLY_S
        self.port.write(BINARY.wrap(body + crc.to_bytes(2, "little")) + BINARY.end)
        wire = self.port.read_until(b"\0")
        return BINARY.decode(wire[:-1]) if wire else None

    def sleep(self, seconds):
        end = self.uno.cycle() + seconds * CLOCK_HZ
        time.sleep(seconds)
        while self.uno.cycle() < end:  # on a busy computer its time lags behind
            time.sleep(0.002)


@pytest.mark.parametrize("check", conformance.CHECKS, ids=lambda check: check.__name__)
def test_docs_cxp1(check):
    require_simavr()
    with EmulatedUno() as uno, RawPort(uno.port) as raw:
        check(UnoDevice(uno, raw))


@pytest.fixture(scope="module")
def limited(tmp_path_factory):
    require_simavr()
    require_tool("avr-gcc", "avr-objcopy", "make")
    return build(tmp_path_factory.mktemp("limited"), on_us=600, duty_permille=420)


def test_limits_built_in_are_kept(limited):
    with EmulatedUno(limited) as uno, RawPort(uno.port) as raw:
        conformance.check_announced_limits(UnoDevice(uno, raw))


@pytest.fixture(scope="module")
def quarter(tmp_path_factory):
    """Firmware for a light that may be on for a quarter of the time."""
    require_simavr()
    require_tool("avr-gcc", "avr-objcopy", "make")
    return build(tmp_path_factory.mktemp("quarter"), duty_permille=250)


def test_a_play_cut_short_owes_its_closed_time(quarter):
    with EmulatedUno(quarter) as uno, RawPort(uno.port) as raw:
        conformance.check_closed_time_is_owed(UnoDevice(uno, raw))


@pytest.mark.parametrize("way_out", ["ABORT", "ABORT and LOAD", "reset", "reset and ABORT"])
def test_the_open_fraction_stays_below_its_limit_however_plays_are_cut_short(quarter, way_out):
    payloads = [program(20_000, "1" * open_chips + "0" * 3 * open_chips) for open_chips in (8, 7)]
    with EmulatedUno(quarter) as uno, RawPort(uno.port) as raw:
        host = Host(UnoDevice(uno, raw))
        for play in range(6):
            if play == 0 or way_out != "ABORT":
                host.ok(LOAD, payloads[play % 2])
            while (error := host.ask(ARM, arm(60000))[0]) == conformance.DUTY_LIMIT:
                pass
            assert error == OK
            host.ok(TRIG)
            while len(uno.edges()) != 2 * play + 2:  # no longer than it is open
                time.sleep(0.001)
            if way_out.startswith("reset"):
                uno.hang()
                host.device.sleep(0.1)
                assert host.hello()["cause"] == 3
            if "ABORT" in way_out:
                host.ok(ABORT)
        opened, closed = (
            [cycle for cycle, level in uno.edges() if level == is_open] for is_open in (1, 0)
        )
        lasted = [end - begin for begin, end in zip(opened, closed, strict=True)]
        for play in range(1, 6):
            assert sum(lasted[:play]) <= 0.25 * (opened[play] - opened[0])


def test_limits_built_in_are_known_to_the_host_and_kept_without_it(limited):
    good = Program("1" * 3 + "0" * 5, chip_ns=200_000)
    long = Program("1" * 4 + "0" * 6, chip_ns=200_000)
    often = Program("10101", chip_ns=200_000)
    with EmulatedUno(limited) as uno, Controller.open(uno.port) as controller:
        assert (controller.announced.max_on_ticks, controller.announced.max_duty) == (1200, 0.42)
        controller.upload(good)
        for program_, refusal in ((long, "too long"), (often, "too much of the time")):
            with pytest.raises(ValueError, match=r"longest opening|duty"):
                controller.upload(program_)
            with pytest.raises(DeviceError, match=refusal):
                controller.load(program_)
        # The least stretch of the clock makes 600 us more than 600 us.
        with pytest.raises(DeviceError, match="too long"):
            controller.link.request(Op.LOAD, Stored(good.bits, 400, 1).payload)
        assert controller.read().bits == good.bits


def test_frames_longer_than_the_device_can_keep_are_answered_for_what_they_are():
    require_simavr()
    with EmulatedUno() as uno, RawPort(uno.port) as raw:
        host = Host(UnoDevice(uno, raw))
        stored = host.load()
        for chips in (1025, 1032, 2040, 4000, 65535):
            assert host.ask(LOAD, program(400, "1" * chips)) == (conformance.OUT_OF_RANGE, b"")
        assert host.ask(LOAD, program(400, "1" * 2040) + b"\0") == (conformance.BAD_LENGTH, b"")
        assert host.ask(ARM, bytes(3000)) == (conformance.BAD_LENGTH, b"")
        assert host.ask(0x7E, bytes(range(256)) * 4) == (conformance.BAD_OP, b"")
        assert host.ask(READ) == (OK, stored)


def test_any_program_is_stored_and_read_back():
    require_simavr()
    rng = random.Random(6)
    with EmulatedUno(speed=0) as uno, RawPort(uno.port) as raw:
        host = Host(UnoDevice(uno, raw))
        for chips in (*range(1, 18), 255, 256, 1023, 1024):
            for density in (0.02, 0.5, 0.98):  # bytes of 0x00 and 0xFF, and all others
                bits = (
                    "".join("1" if rng.random() < density else "0" for _ in range(chips - 1)) + "1"
                )
                payload = program(
                    rng.choice([100, 256, 0xFF00]), bits, fraction=rng.choice([0, 1, 0xFF00])
                )
                assert host.ask(LOAD, payload) == (OK, struct.pack("<I", zlib.crc32(payload)))
                assert host.ask(READ) == (OK, payload)


def test_many_requests_at_once_are_answered_one_by_one_and_no_watchdog_bites():
    require_simavr()
    with EmulatedUno() as uno, RawPort(uno.port) as raw:
        host = Host(UnoDevice(uno, raw))
        payload = program(100, "1" * 1024)
        host.ok(LOAD, payload)
        raw.send(
            b"".join(BINARY.encode(bytes([READ, seq])) for seq in range(30))
        )  # 0.4 s of answers
        for seq in range(30):
            assert raw.receive() == bytes([READ | 0x80, seq, OK]) + payload
        assert host.hello()["cause"] == 0


def test_garbage_is_counted_and_what_follows_it_is_understood():
    require_simavr()
    rng = random.Random(3)
    with EmulatedUno() as uno, RawPort(uno.port) as raw:
        host = Host(UnoDevice(uno, raw))
        stored = host.load()
        for length in (1, 2, 5, 40, 254, 255, 256, 700):
            bad = host.status()["bad"]
            raw.send(bytes(rng.randrange(1, 256) for _ in range(length)) + b"\0\0\0")
            assert host.status()["bad"] == bad + 1
        raw.send(BINARY.encode(b"\7\1")[:-2])  # half a frame, and then a whole one
        raw.send(b"\0")
        assert host.ask(READ) == (OK, stored)


def test_time_since_boot_is_the_cycles_own():
    require_simavr()
    with EmulatedUno(speed=0) as uno, Controller.open(uno.port) as controller:
        for _ in range(100):
            told = controller.status().uptime_us
        assert 0 <= uno.hang() / CLOCK_HZ * 1e6 - told < 0.2 * told


def test_a_millisecond_that_ends_while_the_time_is_read_is_counted_once(tmp_path):
    require_simavr()
    require_tool("avr-gcc", "avr-objcopy", "make")
    slow = build(
        tmp_path,
        (
            "clock.c",
            "        count = TCNT2;\n",
            "        _delay_us(50);\n        count = TCNT2;\n        _delay_us(50);\n",
        ),
        ("clock.c", '#include "board.h"', '#include "board.h"\n#include <util/delay.h>'),
    )
    burst = [BINARY.encode(bytes([Op.STATUS, seq])) for seq in range(4)]
    steps = []
    phases = set()
    with EmulatedUno(slow, speed=0) as uno, RawPort(uno.port) as raw:
        for k in range(100):
            raw.send(b"\0" * (k % 13) + b"".join(burst))
            told = [unpack_status(raw.receive()[3:]).uptime_us for _ in burst]
            steps += [later - earlier for earlier, later in pairwise(told)]
            phases |= {us % 1000 // 50 for us in told}
    assert phases == set(range(20))
    # The line's speed makes replies of one length follow each other in a steady step.
    assert max(steps) - min(steps) < 300


def test_a_missed_edge_closes_and_does_not_count(tmp_path):
    require_simavr()
    require_tool("avr-gcc", "avr-objcopy", "make")
    slow = build(
        tmp_path,
        ("uart.c", "    uint8_t at = head;\n\n", "    uint8_t at = head;\n    _delay_us(150);\n"),
        ("uart.c", '#include "board.h"', '#include "board.h"\n#include <util/delay.h>'),
    )
    code = Program("1" * 1000, chip_ns=50_000)
    with EmulatedUno(slow) as uno, Controller.open(uno.port) as controller:
        controller.upload(code, arm=True)
        controller.trigger()
        with pytest.raises(VerifyError, match="reports a fault"):
            controller.wait(timeout_s=2)
        assert (controller.status().runs, controller.status().late) == (0, 1)
        opened, closed = (cycle for cycle, _ in uno.edges())
        assert closed - opened < 1000 * 800  # it was open, and closed before its end


def test_fault_state_is_left_by_abort_only(tmp_path):
    require_simavr()
    require_tool("avr-gcc", "avr-objcopy", "make")
    slow = build(
        tmp_path,
        ("player.c", "if ((TIFR1 & _BV(OCF1A)) || TCNT1 > top) {", "if (begun == 3) {"),
    )
    with EmulatedUno(slow) as uno, RawPort(uno.port) as raw:
        host = Host(UnoDevice(uno, raw))
        stored = host.load()
        host.ok(ARM, arm(1000))
        host.ok(TRIG)
        UnoDevice(uno, raw).sleep(0.05)
        found = host.status()
        assert (found["state"], found["plays"], found["missed"]) == (FAULT, 0, 1)
        for op, payload in ((ARM, arm(1000)), (TRIG, b""), (LOAD, stored)):
            assert host.ask(op, payload) == (conformance.WRONG_STATE, b"")
        assert host.ask(READ) == (OK, stored)
        host.ok(ABORT)
        assert host.state == conformance.LOADED
        assert len(uno.edges()) % 2 == 0


def test_the_name_of_the_firmware_is_one_that_is_called_proven():
    require_simavr()
    assert HEX.is_file()
    with EmulatedUno() as uno, Controller.open(uno.port) as controller:
        assert controller.announced.firmware == "cxp-avr 1"
        assert controller.upload(Program(CODE, chip_ns=50_000)).trust == "A"
