"""The shipped AVR firmware when things go wrong: noise, hangs, dead hosts, pulled cables. Closed,
and usable again."""

import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from emulators.avr import check_edges, one_play, played
from emulators.tools import require_simavr

from hw.cxp.link import Link
from hw.cxp.protocol import ResetCause, State, Stored
from hw.drivers.cxp import Controller
from hw.emulation.uno import CLOCK_HZ, EmulatedUno
from hw.errors import WrongStateError
from hw.port import LinkError, PortError, open_port
from hw.program import Program

RASKAR = "1010000111000001010000110011110111010111001001100111"
PROGRAM = Program(RASKAR, chip_ns=200_000)
OPEN_10_S = Program("1" * 400, chip_ns=25_000_000)
WATCHDOG_S = 0.064  # 8192 periods of the watchdog's own 128 kHz


@pytest.fixture(autouse=True)
def _simavr():
    require_simavr()


def wait_for(condition, limit_s=20.0):
    end = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.01)


def is_open(uno):
    edges = uno.edges()
    return bool(edges) and edges[-1][1] == 1


def hold_open(uno, controller):
    """Play a code that is open for 10 s."""
    controller.upload(OPEN_10_S, arm=True)
    controller.trigger()
    wait_for(lambda: is_open(uno))


def check_usable(uno):
    with Controller.open(uno.port) as controller:
        code = Stored(RASKAR, 400, 0)
        check_edges(played(uno, controller, code), code)


@pytest.mark.slow  # 300 loads over an emulated line
def test_300_loads_are_all_verified_at_1_percent_of_bytes_spoilt_each_way():
    rng = random.Random(4)
    with (
        EmulatedUno(speed=0, noise=0.01, noise_seed=1) as uno,
        Controller.open(uno.port, timeout_s=0.02, attempts=60) as controller,
    ):
        for _ in range(300):
            bits = "1" + "".join(rng.choice("01") for _ in range(51))
            assert controller.upload(
                Program(bits, chip_ns=500 * rng.randrange(100, 60_000))
            ).read_back
        assert controller.link.retries > 50
        assert controller.status().bad_frames > 20
        assert uno.edges() == ()


def test_40_triggers_are_40_plays_at_2_percent_of_bytes_spoilt_each_way():
    code = Program(RASKAR[:20], chip_ns=50_000)
    with (
        EmulatedUno(speed=0, noise=0.02, noise_seed=2) as uno,
        Controller.open(uno.port, timeout_s=0.02, attempts=60) as controller,
    ):
        controller.upload(code)
        for count in range(1, 41):
            controller.arm(lease_ms=65_535)
            controller.trigger()
            assert controller.wait(timeout_s=10).runs == count
        assert controller.link.retries > 10
        assert len(uno.edges()) == 40 * len(code.edges)
        assert len(uno.edges("busy")) == 80


def test_a_program_that_hangs_while_open_is_closed_by_the_watchdog():
    with EmulatedUno() as uno:
        with Controller.open(uno.port) as controller:
            hold_open(uno, controller)
            hung = uno.hang()
            wait_for(lambda: not is_open(uno))
            closed = uno.edges()[-1][0]
            # The last feeding may have been a moment before the hang.
            assert 0.95 * WATCHDOG_S <= (closed - hung) / CLOCK_HZ <= WATCHDOG_S + 0.001
            again = controller.link.hello()
            assert again.reset_cause is ResetCause.WATCHDOG
            assert controller.status().state is State.IDLE
        check_usable(uno)


def test_a_program_that_hangs_while_armed_forgets_it_and_obeys_no_trigger():
    with EmulatedUno() as uno:
        with Controller.open(uno.port) as controller:
            assert controller.announced.reset_cause is ResetCause.POWER
            controller.upload(PROGRAM, arm=True)
            uno.hang()
            wait_for(lambda: controller.link.hello().reset_cause is ResetCause.WATCHDOG)
            uno.trigger()
            with pytest.raises(WrongStateError):
                controller.trigger()
            assert controller.status().state is State.IDLE
            assert uno.edges() == ()
        check_usable(uno)


@pytest.mark.parametrize("hertz", [100e3, 300e3, 1e6])
def test_a_storm_of_triggers_plays_the_code_once_and_exactly(hertz):
    code = Stored(RASKAR, 100, 0)
    with EmulatedUno(speed=0) as uno, Controller.open(uno.port, timeout_s=0.3) as controller:
        controller.load(Program(RASKAR, chip_ns=50_000))
        with one_play(uno) as plays:
            controller.arm(lease_ms=0xFFFF)
            uno.trigger(pulses=round(0.01 * hertz), hertz=hertz)
            wait_for(lambda: len(uno.edges("trigger")) == 2 * round(0.01 * hertz))
            status = controller.wait(timeout_s=30)
        assert (status.state, status.runs, status.late) == (State.DONE, 1, 0)
        check_edges(plays[0], code)
        check_edges(played(uno, controller, code), code)


def test_the_lease_ends_and_no_trigger_is_obeyed_after_it():
    with EmulatedUno() as uno, Controller.open(uno.port) as controller:
        controller.upload(PROGRAM)
        controller.arm(lease_ms=1000)
        before = controller.status()
        assert before.state is State.ARMED
        while (after := controller.status()).state is State.ARMED:
            assert after.uptime_us - before.uptime_us <= 1_000_000
        assert after.state is State.LOADED
        assert after.uptime_us - before.uptime_us > 500_000
        uno.trigger()
        wait_for(lambda: uno.edges("trigger"))
        with pytest.raises(WrongStateError):
            controller.trigger()
        assert uno.edges() == ()


HOST = """
import sys, time
from hw.drivers.cxp import Controller
from hw.program import Program
with Controller.open(sys.argv[1]) as controller:
    controller.upload(Program("1" * 400, chip_ns=int(sys.argv[2])), arm=True, lease_ms=2000)
    if sys.argv[3] == "play":
        controller.trigger()
    print("armed", flush=True)
    time.sleep(60)
"""


@contextlib.contextmanager
def killed_host(uno, *, chip_ns, then):
    root = str(Path(__file__).parents[4])
    command = [sys.executable, "-c", HOST, uno.port, str(chip_ns), then]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": root}
    ) as host:
        assert host.stdout.readline() == b"armed\n"
        host.send_signal(signal.SIGKILL)
    yield


def test_a_host_killed_while_armed_leaves_a_lease_that_ends():
    with EmulatedUno() as uno:
        with (
            killed_host(uno, chip_ns=200_000, then="wait"),
            Controller.open(uno.port) as controller,
        ):
            assert controller.status().state is State.ARMED
            wait_for(lambda: controller.status().state is State.LOADED)
            uno.trigger()
            wait_for(lambda: uno.edges("trigger"))
            assert uno.edges() == ()
        check_usable(uno)


def test_a_host_killed_while_playing_leaves_a_play_that_ends():
    with EmulatedUno() as uno:
        with killed_host(uno, chip_ns=1_000_000, then="play"):
            wait_for(lambda: len(uno.edges()) == 2)
        opened, closed = (cycle for cycle, _ in uno.edges())
        assert abs(closed - opened - 400 * CLOCK_HZ // 1000) <= 4
        check_usable(uno)


class Cable:
    """A port whose cable is pulled in the middle of a LOAD."""

    def __init__(self, uno):
        self.uno = uno
        self.port = open_port(uno.port)

    @property
    def in_waiting(self):
        return self.port.in_waiting

    def read(self, size):
        return self.port.read(size)

    def close(self):
        self.port.close()

    def write(self, data):
        if len(data) < 20:
            return self.port.write(data)
        self.port.write(data[:12])
        self.uno.unplug()
        return self.port.write(data[12:])


def test_a_cable_pulled_during_load_is_told_in_one_line_and_plugged_in_all_is_well():
    with EmulatedUno() as uno:
        name = uno.port
        link = Link(Cable(uno), name=name)
        with Controller(link, link.hello()) as controller:
            with pytest.raises(LinkError, match=f"{name} is gone .*plug the device in") as caught:
                controller.upload(PROGRAM, arm=True)
            assert "\n" not in str(caught.value)
            with pytest.raises(LinkError, match="is closed"):
                controller.status()
        uno.plug()
        with Controller.open(uno.port) as controller:
            assert controller.status().state is State.IDLE
        assert uno.edges() == ()
        check_usable(uno)


def test_a_cable_pulled_while_open_ends_with_the_program():
    with EmulatedUno() as uno:
        with Controller.open(uno.port) as controller:
            controller.upload(Program("1" * 20, chip_ns=20_000_000), arm=True)
            controller.trigger()
            uno.unplug()
            with pytest.raises(LinkError, match="is gone"):
                controller.wait(timeout_s=5)
        wait_for(lambda: len(uno.edges()) == 2)
        uno.plug()
        check_usable(uno)


def test_a_second_host_is_told_that_the_port_is_busy_and_the_first_does_not_notice():
    with EmulatedUno() as uno, Controller.open(uno.port) as controller:
        hold_open(uno, controller)
        with pytest.raises(PortError, match="another program has it open"):
            Controller.open(uno.port)
        assert controller.status().state is State.PLAY
        assert is_open(uno)


def test_abort_closes_at_once_and_the_next_play_is_whole():
    with EmulatedUno() as uno:
        with Controller.open(uno.port) as controller:
            hold_open(uno, controller)
            before = controller.status().uptime_us
            controller.abort()
            after = controller.status().uptime_us
            assert not is_open(uno)
            closed = uno.edges()[-1][0]
            assert before <= closed / 16 <= after
            assert after - before < 1_000_000
            assert controller.status().state is State.LOADED
            assert controller.status().runs == 0
            controller.arm()
            controller.abort()
            assert len(uno.edges()) == 2
        check_usable(uno)


def fail_while_open(uno, controller):
    hold_open(uno, controller)
    controller.arm(lease_ms=0)


def test_an_exception_in_the_host_closes():
    with EmulatedUno() as uno:
        with pytest.raises(ValueError, match="lease_ms"), Controller.open(uno.port) as controller:
            fail_while_open(uno, controller)
        assert not is_open(uno)
        check_usable(uno)
