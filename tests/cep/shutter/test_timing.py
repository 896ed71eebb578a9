"""Timing of exposures: estimates against simulated cameras whose times are known, and a twin."""

from dataclasses import replace

import numpy as np
import pytest
from emulators.tools import require_simavr

from cep.optics.camera import Camera
from cep.shutter.exposure_fit import Flashes, Window, fit_exposure
from cep.shutter.exposure_sweep import ExposureSweep, Flash, flash_program
from cep.shutter.shoot import open_rig
from cep.shutter.timing import BUSY_LATE_NS, time_camera
from cep.shutter.twin import TwinCamera
from hw.cameras.camera import CameraError
from hw.drivers.cxp import Controller
from hw.emulation.uno import EmulatedUno
from hw.program import Program
from lab.studies.camera_timing import UNO, SimulatedCamera, random_camera

TOLERANCE_S = 2e-6 + 0.01 * 50e-6


def timed(camera, stated_s):
    return ExposureSweep(camera, length_s=stated_s, flash_s=50e-6, earliest_s=17.25e-6).run()[0]


def camera_with(**changes):
    values = {"start_s": 300e-6, "length_s": 2e-3, "jitter_s": 0.2e-6, "row_s": 0.0}
    return SimulatedCamera(**(values | changes), rng=np.random.default_rng(0))


@pytest.mark.parametrize("seed", [0, 1, 4, 12])  # rolling, global, rolling and slow, rolling
def test_times_of_a_camera_are_within_tolerance_and_40_frames(seed):
    camera, stated_s = random_camera(seed)
    timing = timed(camera, stated_s)
    assert camera.frames == 40
    assert timing.start.value == pytest.approx(camera.start_s, abs=TOLERANCE_S)
    assert timing.length.value == pytest.approx(camera.length_s, abs=TOLERANCE_S)
    assert timing.row.value == pytest.approx(camera.row_s, rel=0.01, abs=5e-9)


@pytest.mark.slow(reason="twenty cameras of 40 frames")
def test_intervals_cover_in_18_of_20():
    covered = np.zeros(4, dtype=int)
    for seed in range(20):
        camera, stated_s = random_camera(seed)
        timing = timed(camera, stated_s)
        pairs = (
            (camera.start_s, timing.start),
            (camera.length_s, timing.length),
            (camera.jitter_s, timing.jitter),
            (camera.row_s, timing.row),
        )
        covered += [truth in interval for truth, interval in pairs]
        assert timing.start.value == pytest.approx(camera.start_s, abs=TOLERANCE_S)
        assert timing.length.value == pytest.approx(camera.length_s, abs=TOLERANCE_S)
    assert covered.min() >= 18


def test_rows_that_are_read_upwards_have_a_negative_row_time():
    camera = camera_with(start_s=9e-3, row_s=-12e-6)
    timing = timed(camera, 2e-3)
    assert timing.row.value == pytest.approx(-12e-6, rel=0.01)
    assert timing.start.value == pytest.approx(9e-3, abs=TOLERANCE_S)
    assert timing.readout_s == pytest.approx(12e-6 * 479, rel=0.01)


def test_a_large_jitter_is_timed_by_longer_flashes():
    timing = timed(camera_with(start_s=2e-3, length_s=5e-3, jitter_s=20e-6, electrons=400), 5e-3)
    assert 20e-6 in timing.jitter
    assert 2e-3 in timing.start
    assert 5e-3 in timing.length


def test_a_start_before_the_first_possible_flash_is_an_interval():
    timing = timed(camera_with(start_s=5e-6), 2e-3)
    assert (timing.start.lower, timing.start.upper) == (0.0, pytest.approx(17.25e-6))
    assert 2e-3 in timing.length
    assert timing.length.upper - timing.length.lower < 25e-6


def flashes_without_noise(spans, *, start_s, length_s, row_s):
    """Four rows of a rolling camera under a flash a frame."""
    rows = start_s + row_s * np.arange(4)
    overlap = np.array(
        [np.clip(np.minimum(v, rows + length_s) - np.maximum(u, rows), 0, None) for u, v in spans]
    )
    return Flashes(
        pulses_s=[np.array([span]) for span in spans],
        brightness=64 + 1e7 * overlap * [1.0, 0.9, 1.1, 0.8],
        noise=np.full(overlap.shape, 0.01),
        clipped=np.zeros(overlap.shape, dtype=bool),
    )


@pytest.mark.parametrize("error_s", [-60e-6, 60e-6])
def test_a_guess_may_be_wrong_by_more_than_half_a_flash(error_s):
    """A step of the fit that overshoots is halved."""
    start_s, length_s, row_s = 1e-3, 2e-3, 5e-6
    shifts = (-5e-5, -4e-5, -6e-5)
    spans = [(4e-2, 4.01e-2), (1.9e-3, 2e-3), (2.0e-3, 2.1e-3)]
    spans += [(start_s + shift, start_s + shift + 1e-4) for shift in shifts]
    spans += [(start_s + length_s + shift, 3.06e-3) for shift in shifts]
    timing = fit_exposure(
        flashes_without_noise(spans, start_s=start_s, length_s=length_s, row_s=row_s),
        Window(start_s + error_s, length_s, row_s * 1.05),
    )
    assert timing.start.value == pytest.approx(start_s, abs=1e-8)
    assert timing.length.value == pytest.approx(length_s, abs=1e-8)


@pytest.mark.parametrize("start_visible", [True, False])
def test_without_noise_the_fit_is_exact(start_visible):
    # light at whole and half overlaps: linear, so no error is left
    start_s, length_s, row_s = 1e-3, 2e-3, 5e-6
    shifts = (-5e-5, -4e-5, -6e-5)
    spans = [(4e-2, 4.01e-2), (1.9e-3, 2e-3), (2.0e-3, 2.1e-3)]
    spans += [(start_s + length_s + shift, 3.06e-3) for shift in shifts]
    unseen_before_s = 1.2e-3
    if start_visible:
        spans += [(start_s + shift, start_s + shift + 1e-4) for shift in shifts]
        unseen_before_s = None
    timing = fit_exposure(
        flashes_without_noise(spans, start_s=start_s, length_s=length_s, row_s=row_s),
        Window(start_s + 8e-6, length_s - 9e-6, row_s * 1.05),
        unseen_before_s=unseen_before_s,
    )
    end_s = timing.start.value + timing.length.value
    assert end_s == pytest.approx(start_s + length_s, abs=1e-8)
    assert timing.row.value == pytest.approx(row_s, abs=1e-8)
    assert timing.jitter.value < 1e-7
    if start_visible:
        assert timing.start.value == pytest.approx(start_s, abs=1e-8)
    else:
        assert (timing.start.lower, timing.start.upper) == (0.0, unseen_before_s)
        # from the whole time to the end, to the part of it behind the first possible flash
        assert timing.length.lower == pytest.approx(end_s - unseen_before_s, abs=2e-6)
        assert timing.length.upper == pytest.approx(end_s, abs=2e-6)


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        (
            {"electrons": 0.0},
            "no light of the controller's output reached the camera within 25 ms",
        ),
        ({"electrons": 1e6}, "a flash of 50 us clips the camera"),
        ({"electrons": 0.3}, "too faint"),
        ({"length_s": 9e-3}, "the end of the exposure was not found near 2 ms"),
    ],
)
def test_light_that_cannot_time_is_one_line(changes, line):
    with pytest.raises(CameraError, match=line) as error:
        timed(camera_with(**changes), 2e-3)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("start_us", [17.25, 30, 70, 299, 12_345, 24_000])
def test_a_flash_is_played_when_it_should_be(start_us):
    program = flash_program(Flash(start_us * 1e-6, 50e-6), UNO)
    opened_us, closed_us = (1e-3 * (edge_ns + UNO.lead_ns) for edge_ns, _ in program.edges)
    # a start within half a shortest chip of the first possible one is that
    assert abs(opened_us - start_us) <= (27 if start_us < 50 else 5)
    assert 50 <= closed_us - opened_us <= 110
    assert program.chips <= UNO.max_chips


def test_flashes_again_and_again_keep_their_period():
    program = flash_program(Flash(1e-3, 50e-6, period_s=3.4567e-3, until_s=14e-3), UNO)
    starts_us = [1e-3 * edge_ns for edge_ns, level in program.edges if level]
    assert len(starts_us) == 4
    np.testing.assert_allclose(np.diff(starts_us), 3456.7, atol=10)


def test_the_busy_output_of_the_emulated_board_rises_as_late_as_stated():
    require_simavr()
    with EmulatedUno() as uno, Controller.open(uno.port) as controller:
        controller.upload(Program("0101", 60_000), arm=True)
        controller.play()
        busy = next(cycle for cycle, level in uno.edges("busy") if level)
        opening = next(cycle for cycle, level in uno.edges() if level)
    lead_ns = controller.announced.lead_ns - BUSY_LATE_NS
    assert (opening - busy) * 62.5 - 60_000 == pytest.approx(lead_ns, abs=130)


@pytest.mark.parametrize("row_us", [0, 12])
def test_the_command_times_a_twin(cep, tmp_path, row_us):
    require_simavr()
    file = tmp_path / "camera.toml"
    result = cep.succeeds(
        "hw", "timing", "--camera", f"twin:delay_us=420,jitter_us=0.5,row_us={row_us}", "-o", file,
        "--exposure", "3ms", "--profile", "sony-imx174",
    )  # fmt: skip
    assert result["delay_ns"] == pytest.approx(420e3, abs=2500)
    assert result["length_ns"] == pytest.approx(3e6, abs=2500)
    assert result["row_ns"] == pytest.approx(row_us * 1e3, rel=0.01, abs=5)
    assert result["frames"] <= 40
    camera = Camera.load(file)
    assert camera.trigger_delay_s == pytest.approx(420e-6, abs=2.5e-6)
    assert camera.lead_in_s > camera.trigger_delay_s + camera.readout_s
    known = Camera.load("sony-imx174")
    times = {
        name: 0.0 for name in vars(camera) if name.startswith(("trigger", "readout", "expos"))
    }
    assert replace(camera, **times) == known
    assert (tmp_path / "camera.png").stat().st_size > 5000
    assert cep.succeeds("camera", "list", file)["camera"]["readout_s"] == camera.readout_s


def test_dark_parts_of_a_scene_are_no_readout():
    require_simavr()
    timed_twin = time_camera("twin:delay_us=145.04,jitter_us=1.51,seed=9", exposure_s=6.8035e-3)
    assert timed_twin.timing.start.value == pytest.approx(145.04e-6, abs=TOLERANCE_S)
    assert timed_twin.timing.row.value == pytest.approx(0, abs=5e-9)
    assert timed_twin.dead_s > 0
    assert not timed_twin.warnings
    # 64 code values of pedestal are less than the read noise in so little light
    assert "black level" in time_camera("twin:photons=300").warnings[0]


def test_an_exposure_holds_its_code_after_the_lead_in():
    camera = Camera(
        trigger_delay_s=1e-3, trigger_jitter_s=1e-5, readout_s=5e-3, exposure_offset_s=2e-5
    )
    duration_s = 7e-3
    length_s = camera.least_stated_s(duration_s) + camera.exposure_offset_s
    for jitter_s in (-4e-5, 4e-5):
        first_s = camera.trigger_delay_s + jitter_s
        assert first_s + camera.readout_s <= camera.lead_in_s + 1e-12
        assert first_s + length_s >= camera.lead_in_s + duration_s - 1e-12


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (["--camera", "leica:"], "kind 'leica' is not known"),
        (["--camera", "twin:", "--trigger", "host"], "--trigger: must be shutter or camera"),
        (["--camera", "twin:", "-o", "camera.txt"], "must end in .json or .toml"),
        (["--camera", "twin:", "--exposure", "20s"], "exposes for 1 us to 10 s"),
        (["--camera", "twin:", "--profile", "nikon"], "is not known"),
    ],
)
def test_bad_input_is_one_line(cep, tmp_path, monkeypatch, options, line):
    require_simavr()
    monkeypatch.chdir(tmp_path)
    assert line in cep.refuses("hw", "timing", *options)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("error", [CameraError("lost"), KeyboardInterrupt()])
def test_the_shutter_is_closed_whatever_ends_a_frame(monkeypatch, error):
    require_simavr()
    boards = []
    edges = []

    def read(camera, timeout_s):
        boards.append(camera.uno)
        if len(boards) < 4:
            return whole(camera, timeout_s)
        raise error

    def close(camera):
        edges.extend(camera.uno.edges())
        stop(camera)

    whole, stop = TwinCamera.read, TwinCamera.close
    monkeypatch.setattr(TwinCamera, "read", read)
    monkeypatch.setattr(TwinCamera, "close", close)
    with pytest.raises(type(error)):
        time_camera("twin:")
    assert len(boards) == 4
    assert edges
    assert edges[-1][1] == 0
    with open_rig("twin:") as rig:  # and what was open is free again
        assert rig.controller is not None
