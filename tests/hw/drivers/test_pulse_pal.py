import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest
from emulators.pulse_pal import (
    ABORT,
    OPEN_5V,
    PARAM,
    REST,
    SOFT_TRIGGER,
    TRAIN_1,
    Faults,
    levels,
)
from emulators.pulse_pal import (
    PulsePal as Device,
)
from emulators.scripted_port import ScriptedPort
from hypothesis import given, settings
from hypothesis import strategies as st

from hw.device import DeviceProfile
from hw.drivers.driver import Trust
from hw.drivers.pulse_pal import PulsePal, PulsePalLink, dac_code
from hw.errors import DeviceError, WrongStateError
from hw.port import LinkError, PortError, open_port
from hw.program import Program

RASKAR = "1010000111000001010000110011110111010111001001100111"
PROGRAM = Program(RASKAR, chip_ns=200_000)
SLOW = Program("1" * 100, chip_ns=300_000_000)  # 30 s: still open whenever a test looks
CYCLE_NS = 50_000
HELLO = ("d5 48", "4b 15 00 00 00")
UNLINK = [("d5 4a 0c 01 00", "01"), ("d5 4a 0d 01 00", "01")]
STOP = [("d5 50", ""), HELLO]
ABORTED = [*STOP, *UNLINK, *STOP]


def scripted(exchanges):
    port = ScriptedPort(HELLO, *exchanges)
    link = PulsePalLink(port, name="script", timeout_s=0.05)
    link.hello(hello_s=0.05)
    return port, PulsePal(link)


def expected(program, *, opened=OPEN_5V, closed=REST):
    return [(time_ns // CYCLE_NS, opened if level else closed) for time_ns, level in program.edges]


def output(device, channel=1):
    values = device.channels[channel].values
    edges, end = device.output(values)
    assert end is not None, "the channel never ends"
    return levels(edges, rest=values[17])


def until(condition):
    deadline = time.monotonic() + 20
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.005)
    return condition()


def test_transcript_byte_for_byte():
    program = Program(
        "0110100", chip_ns=200_000
    )  # pulses at 0, 4 and 12 cycles, 4 after the trigger
    times = "00 00 00 00 04 00 00 00 0c 00 00 00"
    guard = "20 00 00 00"
    port, device = scripted(
        [
            *ABORTED,
            ("d5 4a 11 01 00 80", "01"),
            ("d5 4a 0f 01 00", "01"),
            ("d5 4a 0e 01 01", "01"),
            ("d5 4a 10 01 00", "01"),
            ("d5 4a 01 01 00", "01"),
            ("d5 4a 02 01 00 c0", "01"),
            ("d5 4a 04 01 04 00 00 00", "01"),
            ("d5 4a 08 01 00 00 00 00", "01"),
            ("d5 4a 0a 01 20 00 00 00", "01"),
            ("d5 4a 0b 01 04 00 00 00", "01"),
            (f"d5 4b 04 00 00 00 {times} {guard}" + " 00 c0" * 4, "01"),
            (f"d5 4b 03 00 00 00 {times}" + " 00 c0" * 3, "01"),
            HELLO,
            ("d5 4a 80 01 00", "01"),
            ("d5 4a 0c 01 01", "01"),
            ("d5 4d 01", ""),
            *ABORTED,
        ]
    )
    with device:
        report = device.upload(program, arm=True)
        device.trigger()
        device.abort()
    assert port.all_consumed()
    assert (report.port, report.program) == ("script", program)
    assert (report.trust, report.read_back, report.firmware) == (Trust.B, False, "pulse-pal 21")
    assert (report.armed, report.lease_ms, report.retries, report.warnings) == (True, None, 0, ())


def test_transcript_of_an_inverted_shutter():
    program = Program("1", chip_ns=100_000)
    port, device = scripted(
        [
            *ABORTED,
            ("d5 4a 11 01 00 c0", "01"),
            ("d5 4a 0f 01 00", "01"),
            ("d5 4a 0e 01 01", "01"),
            ("d5 4a 10 01 00", "01"),
            ("d5 4a 01 01 00", "01"),
            ("d5 4a 02 01 00 80", "01"),
            ("d5 4a 04 01 02 00 00 00", "01"),
            ("d5 4a 08 01 00 00 00 00", "01"),
            ("d5 4a 0a 01 04 00 00 00", "01"),
            ("d5 4a 0b 01 00 00 00 00", "01"),
            ("d5 4b 02 00 00 00 00 00 00 00 04 00 00 00 00 80 00 80", "01"),
            ("d5 4b 01 00 00 00 00 00 00 00 00 80", "01"),
            HELLO,
            ("d5 4a 80 01 00", "01"),
            ("d5 4a 0c 01 01", "01"),
            ("d5 4d 01", ""),
        ]
    )
    with device:
        device.upload(program, profile=DeviceProfile(name="inverted", closed_level=1), arm=True)
        device.trigger()
    assert port.all_consumed()


codes = st.text("01", min_size=1, max_size=300).filter(lambda bits: "1" in bits)
programs = st.builds(
    lambda bits, cycles: Program(bits, chip_ns=cycles * CYCLE_NS),
    codes,
    st.sampled_from([2, 3, 4, 7, 400]),
)


def test_every_program_is_played_edge_for_edge_whatever_was_stored_before():
    # One device for all examples: what earlier, longer trains left in its memory must never show.
    with Device() as device, PulsePal.open(device.port) as driver:

        @settings(max_examples=60, deadline=None)
        @given(program=programs)
        def played(program):
            dirty = {
                1: 1,
                4: 3,
                8: 9,
                9: 9,
                10: 1,
                11: 77,
                12: 1,
                13: 1,
                14: 2,
                15: 1,
                16: 1,
                17: OPEN_5V,
            }
            device.channels[1].values.update(dirty)
            driver.upload(program)
            assert output(device) == expected(program)
            assert (device.channels[1].values[12], device.channels[1].values[13]) == (0, 0)

        played()


def test_a_shorter_train_without_the_guard_entry_would_go_wrong():
    # Why the train is sent twice: the device looks behind the last pulse, where here it finds an
    # onset of before.
    with Device() as device:
        device.channels[1].values.update({14: 1, 4: 4, 11: 0})
        longer = [0, 8, 12, 14]
        shorter = [0, 4, 12]
        for onsets in (longer, shorter):
            device._serve(
                TRAIN_1,
                struct.pack(f"<I{len(onsets)}I", len(onsets), *onsets) + b"\0\xc0" * len(onsets),
            )
        assert output(device)[-1] == (14, REST)  # the last pulse is cut from 4 cycles to 2
        device.times[TRAIN_1][3] = 12
        assert device.output(device.channels[1].values)[1] is None  # or stays open for ever


def test_raskar_is_played_in_real_time():
    with Device() as device, PulsePal.open(device.port) as driver:
        driver.upload(PROGRAM)
        driver.trigger()
        driver.wait()
        driver.trigger()
        driver.wait()
        assert len(expected(PROGRAM)) == 26
        assert [levels(play.edges, rest=REST) for play in device.plays()] == [
            expected(PROGRAM)
        ] * 2
        assert device.plays()[1].start - device.plays()[0].start >= PROGRAM.duration_ns // CYCLE_NS
        assert device.volts_now(1) == REST


def test_the_longest_train():
    program = Program("10" * 5000, chip_ns=100_000)
    with Device() as device, PulsePal.open(device.port) as driver:
        driver.upload(program)
        assert output(device) == expected(program)
        assert (device.counts[TRAIN_1], device.overrun) == (5000, False)
        assert (
            device.ops.count(TRAIN_1) == 1
        )  # no room for the guard, and nothing was ever stored behind
        with pytest.raises(ValueError, match="at most 5000"):
            driver.upload(Program("1" * 5001, chip_ns=100_000))
        assert device.ops.count(TRAIN_1) == 1


@pytest.mark.parametrize("chip_ns", [50_000, 75_000, 199_999, 200_001, 225_000])
def test_chips_off_the_grid_are_refused_before_anything_is_sent(chip_ns):
    port, device = scripted([])
    with device, pytest.raises(ValueError, match=r"cannot be played.*multiple of 50000 ns"):
        device.upload(Program("101", chip_ns=chip_ns))
    # leaving the block was no exception: the transcript has no ABORT
    assert port.all_consumed()


def test_every_violation_is_told_and_nothing_is_sent():
    profile = DeviceProfile(name="led", max_on_ns=500_000, max_duty=0.4)
    program = Program(RASKAR, chip_ns=200_100)
    port, device = scripted([])
    with device:
        assert len(device.check(program, profile=profile)) == 3
        with pytest.raises(ValueError, match=r"50000 ns.*led: longest.*led: duty") as caught:
            device.upload(program, profile=profile)
    assert "\n" not in str(caught.value)
    assert port.all_consumed()


def test_armed_by_the_trigger_input_until_abort():
    with Device() as device, PulsePal.open(device.port) as driver:
        driver.upload(PROGRAM)
        device.trigger_input(1)
        device.trigger_input(2)
        assert device.plays() == []
        driver.arm()
        device.trigger_input(2)
        assert device.plays() == []
        device.trigger_input(1)
        assert levels(device.plays()[0].edges, rest=REST) == expected(PROGRAM)
        driver.abort()
        device.trigger_input(1)
        assert len(device.plays()) == 1


def test_upload_stops_what_is_playing_and_disarms():
    with Device() as device, PulsePal.open(device.port) as driver:
        driver.upload(SLOW, arm=True)
        device.trigger_input(1)
        assert device.volts_now(1) == OPEN_5V
        driver.upload(PROGRAM)
        assert device.volts_now(1) == REST
        device.trigger_input(1)
        assert len(device.plays()) == 1


def test_a_second_trigger_is_refused_while_the_first_one_plays():
    with Device() as device, PulsePal.open(device.port) as driver:
        driver.upload(SLOW)
        driver.trigger()
        with pytest.raises(WrongStateError, match="still plays for"):
            driver.trigger()
        driver.abort()
        driver.trigger()
        assert until(lambda: device.ops.count(SOFT_TRIGGER) == 2)


def test_abort_wins_over_the_trigger_right_before_it():
    # The device takes a soft trigger one cycle late: an ABORT in between finds nothing to stop.
    with Device() as device:
        device._begin = time.monotonic() + 1e6  # only commands let cycles go by
        with PulsePal.open(device.port) as driver:
            driver.upload(SLOW)
            driver.trigger()
            driver.abort()
            assert len(device.plays()) == 1
            assert device.plays()[0].killed is not None
            assert (device.channels[1].play, device.volts_now(1)) == (None, REST)


@pytest.mark.parametrize("kind", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_leaving_by_an_exception_closes_and_disarms(kind):
    with Device() as device:
        driver = PulsePal.open(device.port)
        driver.upload(SLOW, arm=True)
        driver.trigger()
        assert until(lambda: device.volts_now(1) == OPEN_5V)
        with pytest.raises(kind, match="mine") as caught, driver:
            raise kind("mine")
        assert not hasattr(caught.value, "__notes__")
        assert device.volts_now(1) == REST
        device.trigger_input(1)
        assert len(device.plays()) == 1


def test_leaving_normally_keeps_an_armed_device_armed():
    with Device() as device:
        with PulsePal.open(device.port) as driver:
            driver.upload(PROGRAM, arm=True)
        device.trigger_input(1)
        assert len(device.plays()) == 1


@pytest.mark.parametrize("ending", ["pass", "raise SystemExit(3)", "raise RuntimeError('oops')"])
def test_a_script_that_ends_without_closing_leaves_the_shutter_closed(ending):
    script = f"""
import sys
from hw.drivers.pulse_pal import PulsePal
from hw.program import Program
driver = PulsePal.open(sys.argv[1])
driver.upload(Program("1" * 100, chip_ns=300_000_000), arm=True)
driver.trigger()
{ending}
"""
    with Device() as device:
        command = [sys.executable, "-c", script, device.port]
        subprocess.run(
            command, cwd=Path(__file__).parents[3], timeout=60, capture_output=True, check=False
        )
        assert len(device.plays()) == 1
        assert device.volts_now(1) == REST
        assert device.channels[1].values[12] == 0


def test_nothing_is_triggered_that_was_not_uploaded_here():
    port, device = scripted([])
    with device:
        for request in (device.trigger, device.arm):
            with pytest.raises(WrongStateError, match="upload before"):
                request()
    assert port.all_consumed()


@pytest.mark.parametrize(
    ("device", "words"),
    [
        (Device(Faults(silent=True)), "silent for 0.6 s"),
        (Device(Faults(babble=b"ERROR\r\n")), "no handshake: not a Pulse Pal"),
        (Device(Faults(babble=b"OK\r\n>>> ")), "no handshake: not a Pulse Pal"),
        (Device(Faults(babble=b"K" * 999)), "no handshake: not a Pulse Pal"),
        (Device(firmware=7), r"model 1 \(firmware 7\): model 2 is needed"),
        (Device(firmware=22, timer_us=100), "cycles of 100 us"),
    ],
)
def test_a_port_that_is_not_ours(device, words):
    with device:
        with pytest.raises(PortError, match=words) as caught:
            PulsePal.open(device.port, timeout_s=0.3, hello_s=0.6)
        assert str(caught.value).startswith(device.port)
        assert "\n" not in str(caught.value)
        open_port(device.port).close()  # it was let go


def test_missing_and_busy_ports(tmp_path):
    with pytest.raises(PortError, match="there is no such port"):
        PulsePal.open(str(tmp_path / "ttyNONE"))
    with (
        Device() as device,
        PulsePal.open(device.port),
        pytest.raises(PortError, match="another program has it open"),
    ):
        PulsePal.open(device.port)


@pytest.mark.parametrize("firmware", [20, 21, 22])
def test_firmware_that_works(firmware):
    with Device(firmware=firmware) as device, PulsePal.open(device.port) as driver:
        report = driver.upload(PROGRAM)
        assert report.firmware == f"pulse-pal {firmware}"
        assert [warning[:11] for warning in report.warnings] == ["firmware 20"] * (firmware == 20)
        assert output(device) == expected(PROGRAM)


def test_a_handshake_that_only_noise_answers_is_repeated():
    port = ScriptedPort(("d5 48", "00 ff 67"), HELLO)
    link = PulsePalLink(port, name="script", timeout_s=0.05)
    link.hello(hello_s=0.5)
    assert (link.firmware, link.retries) == (21, 1)


def test_lost_and_late_handshakes_are_sorted_out():
    # An ABORT and its handshake together take longer than the timeout: the second answer comes
    # among other replies.
    faults = Faults(deaf_s=0.3, boot_noise=b"\x00garbage\xffK\r\n", late_s={ABORT: 0.3, 72: 0.3})
    with Device(faults) as device, PulsePal.open(device.port) as driver:
        assert driver.link.retries >= 1
        assert driver.upload(PROGRAM).retries >= 2
        assert output(device) == expected(PROGRAM)


@pytest.mark.parametrize("op", [PARAM, TRAIN_1])
def test_silence_midway_is_said_and_the_missing_abort_too(op):
    with (
        Device(Faults(silent_after=op)) as device,
        PulsePal.open(device.port, timeout_s=0.1) as driver,
    ):
        with pytest.raises(LinkError, match="does not answer") as caught:
            driver.upload(PROGRAM, arm=True)
        assert "\n" not in str(caught.value)
        assert caught.value.__notes__ == [
            f"{device.port} did not confirm ABORT: the shutter may still be open"
        ]
        assert until(lambda: ABORT in device.ops)
        with pytest.raises(WrongStateError):
            driver.trigger()


def test_a_device_whose_answers_are_lost_is_disarmed_all_the_same():
    with Device() as device:
        driver = PulsePal.open(device.port, timeout_s=0.1)
        driver.upload(SLOW, arm=True)
        device.mute = True
        with pytest.raises(LinkError, match="does not answer"):
            driver.abort()
        assert until(lambda: device.ops[-1] == PARAM)
        device.trigger_input(1)
        assert device.plays() == []
        driver.close()


class CutPort:
    """A port that is dead from one of its writes on; the bytes of that write may still arrive."""

    def __init__(self, port, *, after, arrives):
        self.port = port
        self.left = after
        self.arrives = arrives

    @property
    def in_waiting(self):
        return self.port.in_waiting

    def read(self, size):
        if self.left < 0:
            raise OSError("cut")
        return self.port.read(size)

    def write(self, data):
        self.left -= 1
        if self.left >= 0 or (self.left == -1 and self.arrives):
            self.port.write(data)
        if self.left < 0:
            raise OSError("cut")

    def close(self):
        self.port.close()


def arm_again_and_again(driver):
    """Every way to arm and to disarm, one after another."""
    driver.upload(SLOW, arm=True)
    driver.arm()
    driver.trigger()
    driver.upload(SHORT, arm=True)
    driver.play()
    driver.abort()
    driver.upload(SHORT)
    driver.play()


SHORT = Program("0101", chip_ns=100_000)


def cut_after(device, writes, *, arrives):
    """How many writes were left when the connection was cut; a device as before, whose input
    triggers nothing."""
    device.channels[1].values.update({12: 0, 13: 0})
    port = CutPort(open_port(device.port), after=writes, arrives=arrives)
    link = PulsePalLink(port, name="cut")
    link.hello(hello_s=1.0)
    with PulsePal(link) as driver:
        arm_again_and_again(driver)
    return port.left


@pytest.mark.slow  # every place of a cut
@pytest.mark.parametrize("arrives", [False, True])
def test_a_link_cut_between_any_two_commands_leaves_a_code_that_ends(arrives):
    with Device() as device:
        writes = 1000 - cut_after(device, 1000, arrives=arrives)
    assert writes > 70
    for count in range(1, writes):
        with Device() as device:
            with pytest.raises(LinkError, match="cut"):
                cut_after(device, count, arrives=arrives)
            device.trigger_input(1)
            codes = [
                levels(play.edges, rest=REST) for play in device.plays() if play.killed is None
            ]
            assert all(code in (expected(SLOW), expected(SHORT)) for code in codes)
            assert all(play.end is not None for play in device.plays())


@pytest.mark.parametrize("op", [ABORT, PARAM, TRAIN_1])
def test_unplugged_midway_is_one_clear_line(op):
    with (
        Device(Faults(unplug_on=op)) as device,
        PulsePal.open(device.port, timeout_s=1.0) as driver,
    ):
        with pytest.raises(LinkError, match="is gone") as caught:
            driver.upload(PROGRAM)
        assert "\n" not in str(caught.value)
        with pytest.raises(LinkError, match="is closed"):
            driver.abort()


@pytest.mark.parametrize("parameter", [17, 4, 14])
def test_a_refused_parameter_is_named_and_nothing_is_armed(parameter):
    with Device(Faults(refuse=parameter)) as device, PulsePal.open(device.port) as driver:
        with pytest.raises(DeviceError, match=r"refuses \w+ = \d+: out of range"):
            driver.upload(PROGRAM, arm=True)
        assert TRAIN_1 not in device.ops
        assert device.channels[1].values[12] == 0


def test_replies_out_of_step_are_noticed():
    # Every parameter is acknowledged twice: each acknowledgement read belongs to a command before.
    with (
        Device(Faults(twice=PARAM)) as device,
        PulsePal.open(device.port, timeout_s=1.0) as driver,
    ):
        with pytest.raises(LinkError, match="out of step"):
            driver.upload(PROGRAM)
        with pytest.raises(WrongStateError):
            driver.trigger()


def test_a_train_cut_short_is_filled_up_so_that_the_abort_is_understood():
    class Interrupted:
        """Sends half of the train, as when Ctrl-C comes in the middle."""

        def __init__(self, port):
            self.port = port

        def __getattr__(self, name):
            return getattr(self.port, name)

        def write(self, data):
            if data[1:2] == bytes([TRAIN_1]):
                self.port.write(data[: len(data) // 2])
                raise KeyboardInterrupt
            self.port.write(data)

    with Device() as device:
        link = PulsePalLink(Interrupted(open_port(device.port)), name=device.port)
        link.hello(hello_s=1.0)
        with PulsePal(link) as driver:
            with pytest.raises(KeyboardInterrupt) as caught:
                driver.upload(PROGRAM, arm=True)
            assert not hasattr(caught.value, "__notes__")  # ABORT was acknowledged
            assert device.ops[-1] == 72
            assert device.pending == b""
            assert device.channels[1].values[12] == 0


def test_the_fake_itself_plays_its_power_on_train_and_notices_an_overrun():
    with Device() as device:
        assert output(device)[:3] == [(0, OPEN_5V), (20, REST), (220, OPEN_5V)]
        assert device._serve(TRAIN_1, struct.pack("<I", 5001)) == b""
        assert device.overrun


@pytest.mark.parametrize(
    ("volts", "code"), [(-10, 0), (0, 32768), (2.5, 40960), (5, 49152), (10, 65535)]
)
def test_dac_codes(volts, code):
    assert dac_code(volts) == code
