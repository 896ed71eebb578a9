import random

import pytest
from emulators.cxp_controller import CxpController, Faults
from hypothesis import example, given
from hypothesis import strategies as st

from hw.cxp.clock import fit_clock, measure_clock
from hw.drivers.cxp import Controller
from hw.errors import VerifyError


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
