"""The twin's light against closed forms, and its address."""

import numpy as np
import pytest

from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.photographs.scenes import NAMES, photographs
from cep.shutter.twin import MovingScene, TwinOptions, code_values, openings_s
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory

RNG = np.random.default_rng(0)
LIGHT = RNG.uniform(0, 1, (60, 50))
CODE = ShutterCode("1101001011", 1_000_000)
BENT = Trajectory.from_samples([[0, 0], [7, 3], [9, -4]], t=[0, 0.3, 1], direction="known")
DURATION_S = CODE.duration_ns * 1e-9


def openings(code, start_s):
    edges = np.flatnonzero(np.diff([0, *code.array, 0])).reshape(-1, 2)
    return start_s + edges * code.chip_ns * 1e-9


def test_a_resting_scene_is_as_bright_as_the_shutter_was_open():
    scene = MovingScene(light=LIGHT, duration_s=0.01)
    light = scene.collected(np.array([[0.001, 0.002], [0.004, 0.0065]]), start_s=0.0, end_s=0.01)
    assert light == pytest.approx(LIGHT * 0.35)


def test_an_exposure_collects_what_lies_within_it():
    scene = MovingScene(light=LIGHT, duration_s=0.01)
    light = scene.collected(np.array([[-1.0, 0.002], [0.009, 5.0]]), start_s=0.001, end_s=0.0095)
    assert light == pytest.approx(LIGHT * 0.15)


def test_rows_of_a_rolling_shutter_are_late_one_after_the_other():
    row_s = 2e-5
    scene = MovingScene(light=LIGHT, duration_s=0.01)
    light = scene.collected(np.array([[0.0, 0.001]]), start_s=0.0, end_s=0.02, row_s=row_s)
    # each row begins later, and sees less of the pulse
    seen_s = np.maximum(0.001 - row_s * np.arange(60), 0)
    assert light == pytest.approx(LIGHT * seen_s[:, None] / 0.01)


def test_a_strobe_within_all_rows_of_a_rolling_shutter_is_as_of_a_global_one():
    scene = MovingScene(light=LIGHT, motion=BENT, start_s=0.003, duration_s=DURATION_S)
    pulses = openings(CODE, 0.003)
    late = scene.collected(pulses, start_s=0.0, end_s=0.02, row_s=4e-5)
    assert (late == scene.collected(pulses, start_s=0.0, end_s=0.02)).all()


def test_motion_blurs_as_the_coded_psf_does():
    scene = MovingScene(light=LIGHT, motion=BENT, start_s=0.003, duration_s=DURATION_S)
    light = scene.collected(openings(CODE, 0.003), start_s=0.0, end_s=0.02)
    expected = blur_valid(LIGHT, coded_psf(BENT, CODE, size=BENT.frame_size() | 1))
    assert light == pytest.approx(expected, abs=1e-12)


def test_bands_of_rows_that_are_cut_differently_join():
    scene = MovingScene(light=LIGHT, motion=BENT, start_s=0.0, duration_s=DURATION_S)
    row_s = 3e-4
    light = scene.collected(openings(CODE, 0.0), start_s=0.0, end_s=0.02, row_s=row_s)
    for row in (0, 7, scene.rows - 1):
        alone = scene.collected(openings(CODE, 0.0), start_s=row * row_s, end_s=0.02 + row * row_s)
        assert light[row] == pytest.approx(alone[row], abs=1e-12)


def test_a_pulse_long_after_the_motion_falls_where_it_goes_on_to():
    scene = MovingScene(light=LIGHT, motion=BENT, start_s=0.0, duration_s=DURATION_S)
    light = scene.collected(np.array([[1.0, 1.0 + DURATION_S]]), start_s=0.0, end_s=2.0)
    assert light.shape == blur_valid(LIGHT, np.ones((BENT.frame_size() | 1,) * 2)).shape
    assert light.mean() == pytest.approx(LIGHT.mean(), rel=0.05)


def test_an_open_shutter_is_open_to_the_end():
    pulses = openings_s([(16_000, 1), (32_000, 0), (48_000, 1)], 0.001)
    assert pulses[0] == pytest.approx([0.0, 0.001])
    assert pulses[1, 0] == pytest.approx(0.002)
    assert pulses[1, 1] > 100


def test_code_values_are_whole_and_have_the_black_level():
    noise = Camera(bits=8, black_level=16 / 239, gain_e_per_dn=1.0, photons_full_scale=239.0)
    values = code_values(noise, np.array([[-1.0, 0.0, 0.5, 1.0, 9.0]]))
    assert values.dtype == np.uint8
    assert values.tolist() == [[0, 16, 136, 255, 255]]


def test_the_plain_twin_is_white_at_the_last_code():
    noise = TwinOptions().noise_model()
    assert code_values(noise, np.array([0.0, 1.0])).tolist() == [64, 4095]


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("speed=3", "no 'speed=3'; known are scene=, camera=, photons="),
        ("delay_us", "known are"),
        ("delay_us=soon", "delay_us of the twin must be a number"),
        ("row_us=-1", "row_us of the twin must be 0 or more"),
        ("jitter_us=nan", "must be 0 or more"),
    ],
)
def test_a_wrong_address_is_refused(address, words):
    with pytest.raises(ValueError, match=words):
        TwinOptions.parse(address)


def test_a_scene_that_is_not_there_is_refused():
    with pytest.raises(ValueError, match="is no file, and none of camera"):
        TwinOptions(scene="moon").light()


def test_a_scene_by_its_name_is_the_photograph_of_that_name():
    for name, photograph in zip(NAMES, photographs(), strict=True):
        assert np.array_equal(TwinOptions.parse(f"scene={name}").light(), photograph)
