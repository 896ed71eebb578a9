import random
import subprocess
import sys
import time
from pathlib import Path

import pytest
from emulators.cxp_controller import (
    ABORT,
    ARM,
    ARMED,
    DONE,
    FAULT,
    IDLE,
    LOAD,
    LOADED,
    PLAY,
    READ,
    STATUS,
    TRIG,
    CxpController,
    Faults,
)
from emulators.scripted_port import imported_with
from hypothesis import example, given
from hypothesis import strategies as st

from hw.cxp.protocol import Op, State, Stored
from hw.device import DeviceProfile, load_profile
from hw.drivers import Trust
from hw.drivers.cxp import Controller, fit_clock, measure_clock
from hw.errors import DeviceError, VerifyError, WrongStateError
from hw.port import LinkError
from hw.program import Program

RASKAR = "1010000111000001010000110011110111010111001001100111"
PROGRAM = Program(RASKAR, chip_ns=200_000)
SLOW = Program("1" * 1000, chip_ns=30_000_000)  # 30 s: still open whenever a test looks
FAST = {"timeout_s": 0.05, "attempts": 40}


def play(controller, program=SLOW, then=None):
    controller.upload(program, arm=True)
    controller.trigger()
    if then is not None:
        raise then


def test_upload_reads_back_and_reports():
    with CxpController() as device, Controller.open(device.port, **FAST) as controller:
        report = controller.upload(PROGRAM, profile=load_profile("cxp-avr"))
        assert controller.status().state is State.LOADED
    assert device.bits == RASKAR
    assert device.ticks == 400
    assert device.ops[1:5] == [LOAD, STATUS, READ, STATUS]
    assert (report.port, report.program) == (device.port, PROGRAM)
    assert (report.trust, report.armed, report.lease_ms) == (Trust.A, False, None)


def test_the_longest_code_that_the_device_takes():
    program = Program("01" * 512, chip_ns=50_000)
    with CxpController() as device, Controller.open(device.port, **FAST) as controller:
        assert controller.upload(program).program.chips == 1024
        assert controller.read() == Stored(program.bits, 100, 0)


def test_armed_device_stays_armed_after_a_normal_end_and_its_lease_ends_that():
    with CxpController() as device:
        with Controller.open(device.port, **FAST) as controller:
            report = controller.upload(PROGRAM, arm=True, lease_ms=400)
            assert (report.armed, report.lease_ms) == (True, 400)
        assert ABORT not in device.ops
        deadline = time.monotonic() + 20
        while device.state == ARMED and time.monotonic() < deadline:
            time.sleep(0.01)
        assert device.state == LOADED


def test_play_once():
    with CxpController() as device, Controller.open(device.port, **FAST) as controller:
        controller.upload(PROGRAM, arm=True)
        status = controller.play()
        assert (status.state, status.runs, status.late) == (State.DONE, 1, 0)
        with pytest.raises(WrongStateError, match="refuses TRIG"):
            controller.trigger()
    assert device.plays == [RASKAR]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_100_loads_at_1_percent_byte_corruption_are_all_verified(seed):
    faults = Faults(noise=0.01, seed=seed)
    codes = [Program(f"{k + 1:016b}" + RASKAR[16:], chip_ns=50_000 + 500 * k) for k in range(100)]
    with (
        CxpController(faults) as device,
        Controller.open(device.port, timeout_s=0.02, attempts=60) as controller,
    ):
        for code in codes:
            assert controller.upload(code).trust is Trust.A
            assert (device.bits, device.ticks * 500) == (code.bits, code.chip_ns)
        retries = controller.link.retries
    assert device.ops.count(LOAD) == 100
    assert device.bad_frames > 5
    assert retries > 15


def test_40_triggers_at_2_percent_corruption_are_exactly_40_plays():
    code = Program(RASKAR, chip_ns=50_000)
    faults = Faults(noise=0.02, seed=7)
    with (
        CxpController(faults) as device,
        Controller.open(device.port, timeout_s=0.02, attempts=60) as controller,
    ):
        controller.upload(code)
        for count in range(1, 41):
            controller.arm()
            controller.trigger()
            assert controller.wait(timeout_s=10).runs == count
    assert len(device.plays) == 40
    assert device.ops.count(TRIG) == 40
    assert (
        device.repeats > 0
    )  # the cached reply was needed: without it some retries would have been refused


def test_wrong_stored_bit_is_caught_by_the_read_back_and_nothing_is_armed():
    with (
        CxpController(Faults(stored_flip=7)) as device,
        Controller.open(device.port, **FAST) as controller,
    ):
        with pytest.raises(VerifyError, match="1 of 52 chips differ, the first is chip 7"):
            controller.upload(PROGRAM, arm=True)
        assert device.state == LOADED
        assert ARM not in device.ops
        assert ABORT in device.ops


def test_every_violation_is_told_and_nothing_is_sent():
    profile = DeviceProfile(name="led", max_on_ns=500_000, max_duty=0.4)
    program = Program(RASKAR * 20, chip_ns=200_100)
    with CxpController() as device, Controller.open(device.port, **FAST) as controller:
        assert len(controller.check(program, profile=profile)) == 4
        with pytest.raises(
            ValueError, match=r"500 ns ticks.*at most 1024.*led: longest.*led: duty"
        ) as caught:
            controller.upload(program, profile=profile)
    assert "\n" not in str(caught.value)
    assert LOAD not in device.ops


def test_bad_lease_is_refused_before_anything_is_sent():
    with (
        CxpController() as device,
        Controller.open(device.port, **FAST) as controller,
        pytest.raises(ValueError, match="lease_ms is 0"),
    ):
        controller.upload(PROGRAM, arm=True, lease_ms=0)
    assert LOAD not in device.ops


def test_limits_that_the_device_announces_are_told_before_anything_is_sent():
    limited = {"min_ticks": 200, "max_on_ticks": 1500, "max_duty": 500}
    program = Program("11110111", chip_ns=50_000)
    with CxpController(**limited) as device, Controller.open(device.port, **FAST) as controller:
        with pytest.raises(ValueError, match=r"at least 100 us.*duty is 0\.875; at most 0\.500"):
            controller.upload(program)
        with pytest.raises(ValueError, match=r"longest opening is 1 ms; at most 750 us"):
            controller.upload(Program("1000011000", chip_ns=500_000))
        assert LOAD not in device.ops


def test_limits_are_the_devices_own_too():
    with (
        CxpController(max_on_ticks=1500, max_duty=500) as device,
        Controller.open(device.port, **FAST) as controller,
    ):
        with pytest.raises(DeviceError, match="refuses LOAD: open for too much"):
            controller.load(Program("1110", chip_ns=50_000))
        with pytest.raises(DeviceError, match="refuses LOAD: an opening is too long"):
            controller.load(Program("1100000", chip_ns=500_000))
        assert device.state == IDLE


def test_firmware_whose_timing_nobody_proved_is_trusted_less():
    with (
        CxpController(firmware="homemade 7") as device,
        Controller.open(device.port, **FAST) as controller,
    ):
        report = controller.upload(PROGRAM)
        assert controller.trust is Trust.B
    assert (report.trust, report.read_back, report.firmware) == (Trust.B, True, "homemade 7")


def test_a_clock_that_is_off_is_corrected_by_fractions_of_a_tick():
    with CxpController() as device, Controller.open(device.port, **FAST) as controller:
        assert controller.upload(PROGRAM, clock_ppm=-2021).clock_ppm == -2021
        assert device.ticks == pytest.approx(400 * (1 - 2021e-6), abs=1 / 65536)


def test_a_shutter_that_rests_high_needs_an_inverter():
    profile = DeviceProfile(name="nc-shutter", closed_level=1)
    with (
        CxpController() as device,
        Controller.open(device.port, **FAST) as controller,
        pytest.raises(ValueError, match="nc-shutter: closed at a high level"),
    ):
        controller.upload(PROGRAM, profile=profile)


def test_a_bias_that_nobody_takes_back_is_said():
    profile = DeviceProfile(name="camera", on_bias_ns=14_000)
    with CxpController() as device, Controller.open(device.port, **FAST) as controller:
        (warning,) = controller.upload(PROGRAM, profile=profile).warnings
    assert "camera makes every opening 14000 ns longer" in warning


def test_a_wrong_confirmation_is_caught():
    with (
        CxpController(Faults(stored_crc_wrong=True)) as device,
        Controller.open(device.port, **FAST) as controller,
    ):
        with pytest.raises(VerifyError, match="confirms CRC32"):
            controller.upload(PROGRAM, arm=True)
        assert ARM not in device.ops


def test_a_missed_edge_is_a_fault_until_it_is_aborted():
    with (
        CxpController(Faults(fault=True)) as device,
        Controller.open(device.port, **FAST) as controller,
    ):
        controller.upload(PROGRAM, arm=True)
        controller.trigger()
        with pytest.raises(VerifyError, match="reports a fault; ABORT was sent"):
            controller.wait(timeout_s=5)
        status = controller.status()
    assert (status.state, status.runs, status.late) == (State.LOADED, 0, 1)


def test_nothing_loaded():
    with CxpController() as device, Controller.open(device.port, **FAST) as controller:
        for refused in (controller.read, controller.arm, controller.trigger):
            with pytest.raises(WrongStateError):
                refused()
        controller.abort()
        assert controller.status().state is State.IDLE
        assert controller.link.hello() == controller.announced


def test_upload_to_an_armed_or_playing_device_is_refused_and_does_not_disturb_it():
    with CxpController() as device, Controller.open(device.port, **FAST) as controller:
        controller.upload(SLOW, arm=True)
        with pytest.raises(WrongStateError, match=r"refuses LOAD.*abort before load"):
            controller.upload(PROGRAM)
        assert device.state == ARMED
        controller.trigger()
        with pytest.raises(WrongStateError):
            controller.upload(PROGRAM)
        assert device.state == PLAY
        controller.abort()
        assert (device.state, device.shutter_open) == (LOADED, False)
        assert controller.upload(PROGRAM).trust is Trust.A


def test_a_lease_is_renewed_unless_a_trigger_is_quicker(monkeypatch):
    with CxpController() as device, Controller.open(device.port, **FAST) as controller:
        controller.upload(SLOW, arm=True)
        assert controller.renew().state is State.ARMED
        request = controller.link.request

        def triggered_before(op, *payload):
            if op is Op.ARM:
                request(Op.TRIG)
            return request(op, *payload)

        monkeypatch.setattr(controller.link, "request", triggered_before)
        assert controller.renew().state is State.PLAY
        arms = device.ops.count(ARM)
        assert controller.renew().state is State.PLAY
        assert device.ops.count(ARM) == arms
        assert device.state == PLAY


def interrupted(controller):
    controller.status()
    raise KeyboardInterrupt


def armed_then_failed(controller):
    controller.arm()  # a new lease, hence ours from now on
    raise RuntimeError("mine")


def test_an_error_closes_only_what_this_program_began():
    with CxpController() as device:
        with Controller.open(device.port, **FAST) as other:
            other.upload(SLOW, arm=True)
        for kind, begin in [
            (WrongStateError, lambda mine: mine.upload(PROGRAM)),
            (VerifyError, lambda mine: mine.verify(PROGRAM)),
            (KeyboardInterrupt, interrupted),
        ]:
            with pytest.raises(kind), Controller.open(device.port, **FAST) as mine:
                begin(mine)
            assert device.state == ARMED
        with (
            pytest.raises(RuntimeError, match="mine"),
            Controller.open(device.port, **FAST) as mine,
        ):
            armed_then_failed(mine)
        assert device.state == LOADED


@pytest.mark.parametrize("kind", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_leaving_by_an_exception_closes_an_open_shutter(kind):
    with CxpController() as device:
        controller = Controller.open(device.port, **FAST)
        play(controller)
        assert device.shutter_open
        with pytest.raises(kind, match="mine"), controller:
            raise kind("mine")
        assert (device.state, device.shutter_open) == (LOADED, False)


def test_leaving_by_an_exception_closes_through_noise_too():
    with CxpController(Faults(noise=0.02, seed=3)) as device:
        with (
            pytest.raises(RuntimeError, match="mine"),
            Controller.open(device.port, timeout_s=0.02, attempts=60) as controller,
        ):
            play(controller, then=RuntimeError("mine"))
        assert len(device.plays) == 1
        assert device.state == LOADED


@pytest.mark.parametrize("op", [ARM, TRIG])
def test_an_unanswered_arm_or_trigger_is_aborted(op):
    # The device did it but nobody said so; ABORT comes through, hence it must end closed and
    # disarmed.
    with CxpController(Faults(lost_replies={op: 3})) as device:
        controller = Controller.open(device.port, timeout_s=0.3, attempts=3)
        with pytest.raises(LinkError, match="does not answer") as caught:
            play(controller)
        assert not hasattr(caught.value, "__notes__")
        assert device.ops[-3:] == [op, ABORT, STATUS]
        assert device.state == LOADED
        controller.close()


def test_unacknowledged_abort_is_said_on_the_exception():
    with CxpController(Faults(silent_after=TRIG)) as device:
        controller = Controller.open(device.port, timeout_s=0.05, attempts=4)
        with pytest.raises(LinkError, match="does not answer TRIG") as caught, controller:
            play(controller)
        assert len(caught.value.__notes__) == 1
        assert "the shutter may still be open" in caught.value.__notes__[0]
        assert ABORT in device.ops
        assert not device.shutter_open


@pytest.mark.parametrize("op", [LOAD, READ, ARM, TRIG])
def test_unplugged_midway_is_one_clear_line(op):
    with CxpController(Faults(unplug_on=op)) as device:
        controller = Controller.open(device.port, timeout_s=0.2, attempts=5)
        with pytest.raises(LinkError, match=r"is gone") as caught:
            play(controller, PROGRAM)
        assert "\n" not in str(caught.value)
        with pytest.raises(LinkError, match="is closed"):
            controller.status()
        assert not controller.link.abort()
    assert device.plays == []


@pytest.mark.parametrize("state", [ARMED, PLAY, DONE, FAULT])
def test_an_abort_counts_only_when_the_state_says_so(state):
    with CxpController(Faults(stuck_play=True, state_after={ABORT: state})) as device:
        with Controller.open(device.port, **FAST) as controller:
            controller.load(SLOW)
            with pytest.raises(VerifyError, match="acknowledged ABORT") as caught:
                controller.abort()
            assert caught.value.__notes__ == ["the shutter may still be open"]
            device.state = IDLE
        with (
            pytest.raises(RuntimeError, match="mine") as left,
            Controller.open(device.port, **FAST) as controller,
        ):
            play(controller, then=RuntimeError("mine"))
        assert "the shutter may still be open" in left.value.__notes__[0]


def test_a_play_that_never_ends_is_aborted():
    with (
        CxpController(Faults(stuck_play=True)) as device,
        Controller.open(device.port, **FAST) as controller,
    ):
        controller.upload(PROGRAM, arm=True)
        controller.trigger()
        with pytest.raises(VerifyError, match=r"still plays after 0\.05 s; ABORT was sent"):
            controller.wait(timeout_s=0.05)
        assert device.state == LOADED


@pytest.mark.parametrize("ending", ["pass", "raise SystemExit(3)", "raise RuntimeError('oops')"])
def test_a_script_that_ends_without_closing_leaves_the_shutter_closed(ending):
    script = f"""
import sys
from hw.drivers.cxp import Controller
from hw.program import Program
controller = Controller.open(sys.argv[1])
controller.upload(Program("1" * 1000, chip_ns=30_000_000), arm=True)
controller.trigger()
{ending}
"""
    root = Path(__file__).parents[3]
    with CxpController() as device:
        command = [sys.executable, "-c", script, device.port]
        subprocess.run(command, cwd=root, timeout=60, capture_output=True, check=False)
        assert len(device.plays) == 1
        assert (device.state, device.shutter_open) == (LOADED, False)


def test_importing_hw_does_not_import_serial_or_numpy():
    assert imported_with("hw.drivers.cxp, hw.export", {"serial", "numpy"}) == set()


def readings(ppm, *, seconds=10.0, count=800, delay=lambda rng: 0.003, boot_us=0, seed=0):
    """Honest readings: the device reads its clock somewhere between request and reply."""
    rng = random.Random(seed)
    found = []
    received = 0.0
    for k in range(count):
        before = delay(rng)
        after = delay(rng)
        sent = max(
            100 + seconds * k / (count - 1), received
        )  # the next question waits for the answer
        received = sent + before + after
        device_s = (sent + before - 100) * (1 + ppm * 1e-6)
        found.append((sent, received, int(boot_us + 1e6 * device_s) % 2**32))
    return found


@given(st.floats(-50_000, 50_000))
@example(2824.625)  # the clock's rounding keeps step with the questions
def test_an_even_delay_does_not_tilt_the_line(ppm):
    fit = fit_clock(readings(ppm))
    # An error of at most half a microsecond either way, wherever it falls, tilts 10 s by 0.15 ppm
    # at most.
    assert fit.ppm == pytest.approx(ppm, abs=0.16)
    assert fit.uncertainty_ppm < 0.2
    assert fit.samples == 200


@pytest.mark.parametrize("seed", range(5))
def test_usb_jitter_of_a_millisecond_leaves_a_hundred_ppm_and_says_so(seed):
    def delay(rng):
        return 0.0005 + rng.random() * 0.001 + (0.016 if rng.random() < 0.2 else 0)

    fit = fit_clock(readings(-2021, delay=delay, seed=seed))
    assert fit.ppm == pytest.approx(-2021, abs=100)
    assert abs(fit.ppm + 2021) < 2 * fit.uncertainty_ppm


def test_the_clock_may_wrap():
    assert fit_clock(readings(30, boot_us=2**32 - 3_000_000)).ppm == pytest.approx(30, abs=0.2)


def test_a_restart_is_noticed():
    cut = readings(0)[:400] + [(s + 5.02, r + 5.02, d) for s, r, d in readings(0)[:400]]
    with pytest.raises(ValueError, match="restarted"):
        fit_clock(cut)


def test_a_controllers_clock_over_a_noisy_line():
    faults = Faults(noise=0.002, seed=2)
    with (
        CxpController(faults, clock_ppm=-20_000) as device,
        Controller.open(device.port) as controller,
    ):
        told = []
        fit = measure_clock(controller, seconds=1.0, progress=told.append)
    assert fit.ppm == pytest.approx(-20_000, abs=2000)
    assert told[-1] == 1.0
    assert told == sorted(told)


def test_bad_durations_and_restarts_while_measuring():
    with CxpController() as device, Controller.open(device.port) as controller:
        for seconds in (0, -1, float("nan")):
            with pytest.raises(ValueError, match="seconds"):
                measure_clock(controller, seconds=seconds)

        def restart(_):
            device.boot = device.boot - 20  # the clock leaps

        with pytest.raises(VerifyError, match="restarted"):
            measure_clock(controller, seconds=0.2, progress=restart)
