"""The photon-transfer curve: figures of simulated sensors come back; frames that show none are
refused."""

import math

import numpy as np
import pytest

from cep.optics.camera import Camera
from cep.optics.frame_pairs import CodeRange, FramePair, find_code_range
from cep.optics.photon_transfer import photon_transfer
from motdiff.photo_values import to_display, to_linear

LEVELS_E = (300, 1000, 3000, 6000, 9000)


class Sensor:
    """Frames of a sensor with uneven light, pixels of unequal response, and a dark pattern, all of
    which are fixed."""

    def __init__(self, gain, read, black, bits, *, well=math.inf, side=256, seed=0):
        self.gain = gain
        self.read = read
        self.black = black
        self.bits = bits
        self.well = well
        self.rng = np.random.default_rng(seed)
        rows, columns = np.mgrid[:side, :side] / side
        self.light = (0.9 + 0.1 * rows + 0.1 * columns) * (
            1 + 0.01 * self.rng.standard_normal((side, side))
        )
        self.pattern = black + 0.5 * self.rng.standard_normal((side, side))

    def frame(self, electrons):
        collected = np.minimum(self.rng.poisson(electrons * self.light), self.well)
        values = (
            collected + self.rng.normal(0, self.read, self.light.shape)
        ) / self.gain + self.pattern
        return np.clip(np.rint(values), 0, 2**self.bits - 1).astype(np.uint16)

    def pair(self, electrons):
        return FramePair.of(self.frame(electrons), self.frame(electrons))

    def measured(self, levels_e=LEVELS_E, *, dark=True, **options):
        flats = [self.pair(level) for level in levels_e]
        return photon_transfer(
            flats, codes=CodeRange(self.bits), dark=self.pair(0) if dark else None, **options
        )


SENSORS = {
    "fine codes": Sensor(0.45, 1.4, 100, 16),
    "12 bits": Sensor(2.6, 2.4, 40, 12),
    "coarse codes": Sensor(21.6, 12.0, 5, 8, seed=1),
    "much read noise": Sensor(4.9, 30.0, 80, 12),
}


@pytest.mark.parametrize("name", SENSORS)
def test_gain_within_2_and_read_noise_within_5_percent(name):
    sensor = SENSORS[name]
    found = sensor.measured(
        [level for level in LEVELS_E if level * 1.2 < sensor.gain * 2**sensor.bits * 0.9]
    )
    assert found.gain_e_per_dn == pytest.approx(sensor.gain, rel=0.02)
    assert found.read_noise_e == pytest.approx(sensor.read, rel=0.05)
    assert found.black_dn == pytest.approx(sensor.black, abs=0.05)
    assert found.full_well_e is None
    assert not found.warnings


@pytest.mark.parametrize("percent", [-4, 1, 3])
def test_frames_of_a_pair_need_not_be_equally_bright(percent):
    """Uneven light and unequal pixels cancel only between frames of the same light: the second is
    scaled to it."""
    sensor = Sensor(2.6, 2.4, 40, 14, side=300, seed=4)
    sensor.light **= 4  # of a lens that is darker in the corners
    flats = [
        FramePair.of(sensor.frame(level), sensor.frame(level * (1 + percent / 100)))
        for level in (1000, 5000, 15_000)
    ]
    found = photon_transfer(flats, codes=CodeRange(14), dark=sensor.pair(0))
    assert found.gain_e_per_dn == pytest.approx(2.6, abs=4 * found.gain_error)
    assert found.gain_error < 0.01 * 2.6
    assert not found.warnings


def test_light_that_flickers_within_a_frame_is_warned_of():
    """A rolling shutter sees a lamp's flicker as bands, which no scaling mends."""
    sensor = Sensor(2.6, 2.4, 40, 14)
    still = sensor.light
    flats = []
    for level in (1000, 5000, 15_000):
        sensor.light = still
        first = sensor.frame(level)
        sensor.light = still * (1 + 0.03 * np.sin(np.arange(256) / 9))[:, None]
        flats.append(FramePair.of(first, sensor.frame(level)))
    sensor.light = still
    found = photon_transfer(flats, codes=CodeRange(14), dark=sensor.pair(0))
    assert sum("differs from line to line" in line for line in found.warnings) == 3


def test_the_errors_are_those_that_repeats_show():
    found = [
        Sensor(2.6, 5.0, 60, 12, side=96, seed=seed).measured((500, 2000, 6000))
        for seed in range(40)
    ]
    gains = np.array([one.gain_e_per_dn for one in found])
    noises = np.array([one.read_noise_e for one in found])
    # the spread of 40 draws has a standard error of 11 %
    assert gains.std() == pytest.approx(np.mean([one.gain_error for one in found]), rel=0.4)
    assert noises.std() == pytest.approx(np.mean([one.read_noise_error for one in found]), rel=0.4)
    assert abs(gains.mean() - 2.6) < 4 * gains.std() / math.sqrt(40)


def test_a_full_pixel_ends_the_curve():
    found = Sensor(7.9, 6.7, 60, 14, well=32_400).measured((1000, 5000, 20_000, 28_000, 60_000))
    assert found.full_well_is == "pixel"
    assert found.full_well_e == pytest.approx(32_400, rel=0.02)
    assert [point.use for point in found.points] == ["fitted"] * 3 + ["above the fit", "saturated"]
    assert found.gain_e_per_dn == pytest.approx(7.9, rel=0.02)


def test_the_end_of_the_codes_ends_the_curve():
    sensor = Sensor(2.0, 5.0, 100, 12)
    found = sensor.measured((500, 2000, 5000, 7600, 20_000))
    assert found.full_well_is == "code range"
    assert found.full_well_e == pytest.approx(2.0 * (4095 - 100), rel=0.02)
    assert (
        found.points[-1].use == found.points[-2].use == "saturated"
    )  # the fourth is clipped where the light is most


def test_one_bright_pair_and_a_dark_one_are_enough():
    found = SENSORS["12 bits"].measured((4000,))
    assert found.gain_e_per_dn == pytest.approx(2.6, rel=0.02)
    assert found.read_noise_e == pytest.approx(2.4, rel=0.05)


def test_without_dark_frames_the_black_level_must_be_known():
    sensor = Sensor(2.6, 12.0, 40, 12)
    levels = (60, 200, 1000, 5000)
    known = sensor.measured(levels, dark=False, black_dn=40.0)
    assert known.gain_e_per_dn == pytest.approx(2.6, rel=0.02)
    assert known.read_noise_e == pytest.approx(12.0, rel=0.05)
    assert known.dark_variance_dn2 is None
    with pytest.raises(ValueError, match="black is not code value 0"):
        Sensor(2.6, 3.0, 40, 12).measured((1000, 3000, 9000), dark=False)
    assert any(
        "dark" in line
        for line in Sensor(2.6, 12.0, 0.0, 12).measured((1000, 5000), dark=False).warnings
    )


def test_the_camera_has_the_noise_of_the_frames():
    sensor = Sensor(2.6, 6.0, 40, 12)
    camera = sensor.measured((500, 2000, 6000, 20_000)).camera(name="mine")
    first = sensor.frame(4000)
    second = sensor.frame(4000)
    light = (first.mean() - 40) * 2.6 / camera.photons_full_scale
    seen = (second - first.astype(float)).var() / 2 * (2.6 / camera.photons_full_scale) ** 2
    assert float(camera.noise_variance(light)) == pytest.approx(seen, rel=0.03)
    assert camera.black_level * camera.photons_full_scale == pytest.approx(40 * 2.6, rel=0.02)
    assert camera.saturation_e == pytest.approx(2.6 * 4055, rel=0.02)
    assert (camera.name, camera.bits) == ("mine", 12)


def test_codes_on_the_srgb_curve():
    rng = np.random.default_rng(0)
    table = to_linear(np.arange(65536) / 255) * 255
    full_e = 8000.0

    def frame(electrons):
        light = (rng.poisson(electrons, (256, 256)) + rng.normal(100, 10, (256, 256))) / full_e
        return np.clip(np.rint(to_display(np.clip(light, 0, 1)) * 255), 0, 255).astype(np.uint16)

    flats = [FramePair.of(frame(level), frame(level), codes=table) for level in (400, 1500, 5000)]
    dark = FramePair.of(frame(0), frame(0), codes=table)
    found = photon_transfer(flats, codes=CodeRange(8), dark=dark, response="srgb")
    assert found.gain_e_per_dn * 255 == pytest.approx(full_e, rel=0.03)
    assert found.read_noise_e == pytest.approx(10, rel=0.1)
    camera = found.camera()
    assert (camera.response, camera.gain_e_per_dn) == ("srgb", None)


# -- code values in files -------------------------------------------------------------------------


@pytest.mark.parametrize("bits", [8, 10, 12, 14])
@pytest.mark.parametrize("kept", ["low", "shifted", "spread", "replicated"])
def test_the_bits_of_a_camera_are_found_in_16_bit_files(bits, kept):
    codes = np.random.default_rng(0).normal(2 ** (bits - 1) * 1.5, 2 ** (bits - 4), (64, 64))
    codes = np.clip(np.rint(codes), 0, 2**bits - 1).astype(np.int64)
    held = {
        "low": codes,
        "shifted": codes << (16 - bits),
        "spread": np.rint(codes * 65535 / (2**bits - 1)).astype(np.int64),
        "replicated": codes << (16 - bits) | codes >> (2 * bits - 16),
    }[kept].astype(np.uint16)
    found = find_code_range([FramePair.of(held, held)], file_bits=16)
    assert found.bits == bits
    np.testing.assert_allclose(held / found.spacing, codes, atol=0.51)
    assert (
        find_code_range([FramePair.of(held, held)], file_bits=16, bits=bits).spacing
        == found.spacing
    )


def test_stated_bits_and_bits_that_cannot_be():
    held = np.arange(1000, 3000, dtype=np.uint16).reshape(40, 50)
    pair = FramePair.of(held, held)
    assert find_code_range([pair], file_bits=16).assumed
    stated = find_code_range([pair], file_bits=16, bits=14)
    assert (stated.bits, stated.spacing, stated.top_dn, stated.assumed) == (14, 1.0, 16383.0, "")
    with pytest.raises(ValueError, match=r"^bits: must lie within 1\.\.8"):
        find_code_range([FramePair.of(held >> 8, held >> 8)], file_bits=8, bits=12)


# -- frames that show no camera -------------------------------------------------------------------


def refused(said, flats, **options):
    with pytest.raises(ValueError, match=said) as caught:
        photon_transfer(flats, codes=CodeRange(12), **options)
    assert "\n" not in str(caught.value)


def test_frames_without_a_curve_are_refused():
    sensor = Sensor(2.6, 6.0, 40, 12, side=64)
    dark = sensor.pair(0)
    flat = sensor.pair(3000)
    same = sensor.frame(3000)
    refused("pair 2: its frames are the same", [flat, FramePair.of(same, same)], dark=dark)
    refused("saturated throughout", [sensor.pair(40_000), sensor.pair(90_000)], dark=dark)
    refused("pair 1: its mean of .* is not above that of the dark frames", [dark, flat], dark=flat)
    refused("pair 1: .* is not above", [sensor.pair(0)], dark=sensor.pair(0))
    unequal = FramePair.of(sensor.frame(1000), sensor.frame(2000))
    refused("pair 2: its frames differ in light by 6.%", [flat, unequal], dark=dark)
    refused("one level of light", [flat, sensor.pair(3000)])
    refused(
        "dark: .* at code value 0; raise", [flat], dark=Sensor(2.6, 6.0, 0, 12, side=64).pair(0)
    )
    refused(
        "dark: its frames are the same",
        [flat],
        dark=FramePair.of(np.full_like(same, 40), np.full_like(same, 40)),
    )
    with pytest.raises(ValueError, match="differ in size, 64 x 64 and 32 x 64 px"):
        FramePair.of(same, same[:, :32])


def test_noise_that_does_not_grow_with_the_light_is_no_sensors():
    rng = np.random.default_rng(0)

    def frame(level):
        return np.rint(level + rng.normal(0, 3, (128, 128))).astype(np.uint16)

    flats = [FramePair.of(frame(level), frame(level)) for level in (500, 1500, 3000)]
    refused(
        "does not grow with the light|hardly grows", flats, dark=FramePair.of(frame(40), frame(40))
    )


def test_a_bent_response_is_warned_of():
    sensor = Sensor(2.6, 6.0, 40, 12)

    def bent(electrons):
        values = sensor.frame(electrons).astype(float)
        return np.rint(values * (1 - values / 20_000)).astype(np.uint16)

    pairs = [FramePair.of(bent(level), bent(level)) for level in (0, 500, 2000, 5000, 8000)]
    found = photon_transfer(pairs[1:], codes=CodeRange(12), dark=pairs[0])
    assert any("off the line" in line for line in found.warnings)


def test_a_measured_camera_loads_again(tmp_path):
    camera = (
        Sensor(2.6, 6.0, 40, 12).measured((500, 3000, 20_000)).camera(name="mine", source="frames")
    )
    camera.to_file(tmp_path / "mine.toml")
    assert Camera.load(tmp_path / "mine.toml") == camera
