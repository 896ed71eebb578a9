import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cep.optics.camera import SCHEMA, Camera, camera_names
from cep.optics.capture import capture
from motdiff.simulate import visible
from motdiff.trajectory import Trajectory

SILENT = Camera(photons_full_scale=1e9, read_noise_e=0.0, bits=16)


@pytest.mark.parametrize("light", [0.02, 0.3, 0.8])
@pytest.mark.parametrize("response", ["linear", "srgb"])
def test_mean_and_variance_of_many_pixels(light, response):
    camera = Camera(photons_full_scale=2000.0, read_noise_e=10.0, bits=10, response=response)
    pixels = camera.expose(np.full(40_000, light), rng=np.random.default_rng(1))
    variance = float(camera.noise_variance(light))
    # standard errors: sqrt(v / n) of the mean, v sqrt(2 / n) of the variance; 5 of them, plus 1/4
    # % for the curve
    assert abs(pixels.mean() - light) < 5 * math.sqrt(variance / pixels.size) + 0.0025 * light
    assert abs(pixels.var() / variance - 1) < 5 * math.sqrt(2 / pixels.size) + 0.01


def test_shot_noise_is_mean_over_gain_and_adds_to_read_noise():
    camera = Camera(photons_full_scale=500.0, read_noise_e=7.0, bits=16)
    step = 1 / (2**16 - 1)
    np.testing.assert_allclose(
        camera.noise_variance([0.0, 0.5, 1.0]),
        [49 / 500**2 + step**2 / 12 + s / 500 for s in (0, 0.5, 1)],
        rtol=1e-12,
    )


@pytest.mark.parametrize("bits", [1, 3, 8])
def test_linear_code_values(bits):
    values = np.unique(Camera(bits=bits).quantise(np.linspace(-0.5, 1.5, 5000)))
    np.testing.assert_allclose(values, np.arange(2**bits) / (2**bits - 1), atol=1e-15)


def test_srgb_codes_are_finer_in_the_dark():
    values = np.unique(Camera(bits=8, response="srgb").quantise(np.linspace(0, 1, 200_000)))
    assert values.size == 256
    assert values[1] == pytest.approx(1 / 255 / 12.92)
    assert np.ptp(values[[-2, -1]]) > 10 * values[1]


def test_black_level_keeps_dark_photos_unbiased():
    dark = np.zeros(20_000)
    with_pedestal = Camera(100.0, 5.0, black_level=0.3).expose(dark, rng=np.random.default_rng(0))
    without = Camera(100.0, 5.0).expose(dark, rng=np.random.default_rng(0))
    assert abs(with_pedestal.mean()) < 5 * 0.05 / math.sqrt(dark.size)
    assert without.mean() == pytest.approx(
        0.05 / math.sqrt(2 * math.pi), rel=0.05
    )  # half a Gaussian
    assert with_pedestal.min() < 0 <= without.min()


@given(st.floats(0, 1), st.integers(1, 16), st.sampled_from(["linear", "srgb"]))
def test_quantising_twice_changes_nothing(light, bits, response):
    camera = Camera(bits=bits, response=response)
    once = camera.quantise(light)
    np.testing.assert_allclose(camera.quantise(once), once, atol=1e-12)


def test_capture_is_darker_by_the_duty_and_shows_the_visible_part():
    scene = np.random.default_rng(0).uniform(0.2, 0.9, (80, 90))
    psf = np.zeros((32, 32))
    psf[16 + 3, 16 - 5] = 0.4  # a still camera, 3 px down and 5 px left, open for 40 % of the time
    photo = capture(scene, psf, camera=SILENT, rng=np.random.default_rng(0))
    assert photo.shape == (80 - 31, 90 - 31)
    shifted = np.roll(scene, (3, -5), axis=(0, 1))
    np.testing.assert_allclose(photo, 0.4 * visible(shifted, 32), atol=2e-4)


def test_capture_of_a_flat_colour_scene_has_no_border_effect():
    scene = np.ones((70, 72, 3)) * np.array([0.1, 0.5, 0.8])
    photo = capture(
        scene, 0.5 * Trajectory.straight(12.0).psf(33), camera=SILENT, rng=np.random.default_rng(0)
    )
    assert photo.shape == (38, 40, 3)
    np.testing.assert_allclose(photo, np.broadcast_to([0.05, 0.25, 0.4], photo.shape), atol=3e-4)


def test_bright_scene_clips_at_full_scale():
    photo = capture(
        np.full((9, 9), 3.0), np.ones((1, 1)), camera=Camera(), rng=np.random.default_rng(0)
    )
    assert (photo == 1.0).all()


def test_same_seed_same_photo():
    scene = np.random.default_rng(0).random((40, 40))
    first, second = (
        capture(scene, np.ones((1, 1)), camera=Camera(), rng=np.random.default_rng(7))
        for _ in range(2)
    )
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("name", ["camera.json", "camera.toml"])
def test_file_round_trip(tmp_path, name):
    camera = Camera(
        1234.5,
        0.5,
        10,
        "srgb",
        name="b",
        source='"x" \\ é',
        full_well_e=9.5,
        least_exposure_s=1e-6,
    )
    camera.to_file(tmp_path / name)
    assert Camera.from_file(tmp_path / name) == camera
    assert [p.name for p in tmp_path.iterdir()] == [name]


def test_hand_written_file_may_be_short(tmp_path):
    (tmp_path / "c.toml").write_text("bits = 8\nphotons_full_scale = 300\n")
    assert Camera.from_file(tmp_path / "c.toml") == Camera(photons_full_scale=300.0, bits=8)


@pytest.mark.parametrize(("name", "text"), [("c.toml", "bits = 8\n"), ("c.json", '{"bits": 8}')])
def test_a_byte_order_mark_as_windows_editors_write_is_no_harm(tmp_path, name, text):
    (tmp_path / name).write_text(text, encoding="utf-8-sig")
    assert Camera.from_file(tmp_path / name) == Camera(bits=8)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("c.yaml", "bits: 8", "must end in .json or .toml"),
        ("c.json", "{", "not a JSON file"),
        ("c.toml", "bits = ", "not a TOML file"),
        ("c.json", "[1]", "found list"),
        ("c.json", json.dumps({"schema": "cep.camera/9"}), f'wanted schema "{SCHEMA}"'),
        ("c.json", json.dumps({"iso": 100}), "unknown field 'iso'"),
        ("c.json", json.dumps({"bits": 8.5}), "bits: must be a whole number"),
        (
            "c.json",
            json.dumps({"photons_full_scale": "many"}),
            "photons_full_scale: must be a number",
        ),
        ("c.json", '{"read_noise_e": NaN}', "read_noise_e: must be a finite number of 0 or more"),
        ("c.json", f'{{"read_noise_e": {"9" * 5000}}}', "not a JSON file"),
        ("c.json", f'{{"read_noise_e": {"9" * 400}}}', "read_noise_e: must be a number below"),
        ("c.json", "[" * 100_000, "not a JSON file"),
        ("c.json", f'{{"response": "{"x" * 100_000}"}}', "response: must be"),
        ("c.toml", f"bits = {'9' * 5000}", "not a TOML file"),
        ("c.toml", f"read_noise_e = 0x{'f' * 5000}", "read_noise_e: must be a number below"),
        ("c.toml", f"bits = {'[' * 5000}", "not a TOML file"),
    ],
)
def test_bad_file_says_one_line_with_its_name(tmp_path, name, text, said):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(ValueError, match="c\\.") as caught:
        Camera.from_file(path)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    "fields",
    [
        {"photons_full_scale": 0},
        {"photons_full_scale": float("inf")},
        {"read_noise_e": -1},
        {"bits": 0},
        {"bits": 17},
        {"bits": True},
        {"response": "gamma"},
        {"black_level": -0.1},
        {"read_noise_e": None},
        *({"read_noise_e": bad} for bad in (float("nan"), "5")),
        *({"full_well_e": bad} for bad in (0, -1, float("nan"), float("inf"), True)),
        *({"gain_e_per_dn": bad} for bad in (0, -2.0, float("nan"))),
        {"gain_e_per_dn": 2.0, "response": "srgb"},
        *({"dark_current_e_s": bad} for bad in (-1, float("nan"))),
        *({"least_exposure_s": bad} for bad in (-1e-6, float("inf"))),
        *({"name": bad} for bad in (None, "a\nb", "\x7f")),
    ],
)
def test_bad_camera(fields):
    with pytest.raises(ValueError, match=next(iter(fields))):
        Camera(**fields)


# -- light levels ---------------------------------------------------------------------------------


def test_a_fixed_gain_gives_steps_of_the_same_electrons_at_every_level():
    camera = Camera(photons_full_scale=8000.0, read_noise_e=2.0, bits=12, gain_e_per_dn=2.0)
    for photons in (50.0, 1000.0, 8000.0):
        values = np.unique(camera.at(photons).quantise(np.linspace(0, 1, 20_001))) * photons
        np.testing.assert_allclose(values, 2.0 * np.arange(photons / 2 + 1), atol=1e-9)
        quantisation = camera.at(photons).noise_variance(0.0) * photons**2 - 2.0**2
        assert quantisation == pytest.approx(2.0**2 / 12)


def test_without_a_gain_the_code_range_follows_the_light_as_it_always_did():
    camera = Camera(photons_full_scale=8000.0, bits=3, full_well_e=9000.0)
    np.testing.assert_array_equal(
        camera.at(50).quantise([0.2, 0.5]), Camera(bits=3).quantise([0.2, 0.5])
    )


@given(st.floats(0, 1), st.floats(0.3, 3000))
def test_light_is_never_recorded_above_full_scale(light, gain):
    camera = Camera(photons_full_scale=1000.0, gain_e_per_dn=gain)
    assert 0 <= camera.quantise(light) <= 1
    assert camera.quantise(light) == camera.quantise(camera.quantise(light))


def test_dark_current_adds_its_shot_noise_once():
    camera = Camera(read_noise_e=3.0, dark_current_e_s=800.0)
    long = camera.at(1000, exposure_s=0.02)
    assert long.read_noise_e == pytest.approx(5.0)  # sqrt(3^2 + 800 * 0.02)
    assert long.at(1000, exposure_s=0.02) == long
    assert camera.at(1000).read_noise_e == 3.0


def test_a_pedestal_of_code_values_keeps_dim_exposures_unbiased():
    camera = Camera(
        photons_full_scale=10_000.0, read_noise_e=5.0, gain_e_per_dn=2.5, black_level=0.01
    )
    dim = camera.at(200)
    assert dim.black_level * 200 == pytest.approx(100.0)  # electrons
    dark = dim.expose(np.zeros(40_000), rng=np.random.default_rng(0))
    assert abs(dark.mean() * 200) < 5 * 5.05 / 200


def test_simulated_noise_of_a_fixed_gain_is_the_one_that_is_computed():
    camera = Camera(
        photons_full_scale=5500.0, read_noise_e=10.0, bits=8, gain_e_per_dn=21.6, black_level=0.1
    ).at(300)
    pixels = camera.expose(np.full(100_000, 0.5), rng=np.random.default_rng(2))
    assert pixels.var() == pytest.approx(float(camera.noise_variance(0.5)), rel=0.03)


def test_saturation_is_the_smaller_of_well_and_code_range():
    assert Camera(full_well_e=900.0, gain_e_per_dn=1.0, bits=10).saturation_e == 900
    assert Camera(full_well_e=2000.0, gain_e_per_dn=1.0, bits=10).saturation_e == 1023
    assert Camera(full_well_e=2000.0).saturation_e == 2000
    assert Camera().saturation_e == math.inf
    assert Camera(full_well_e=900.0).at(5000).photons_full_scale == 5000


def test_the_pedestal_takes_from_the_code_range_and_not_from_the_well():
    camera = Camera(photons_full_scale=900.0, gain_e_per_dn=1.0, bits=10, black_level=0.1)
    assert camera.saturation_e == pytest.approx(1023 - 90)
    assert camera.at(300).saturation_e == pytest.approx(
        1023 - 90
    )  # so many code values, whatever the light
    assert replace(camera, full_well_e=920.0).saturation_e == 920.0
    assert Camera(full_well_e=900.0, black_level=0.1).saturation_e == 900.0


@pytest.mark.parametrize(
    "photons", [0, 0.99, -5, 1.01e7, float("nan"), float("inf"), True, "many"]
)
def test_a_level_out_of_range_is_refused(photons):
    with pytest.raises(ValueError, match=r"^photons: must .*got"):
        Camera().at(photons)


@pytest.mark.parametrize("exposure_s", [0, -1, float("nan"), float("inf"), "1"])
def test_an_exposure_out_of_range_is_refused(exposure_s):
    with pytest.raises(ValueError, match=r"^exposure_s: must .*got"):
        Camera(dark_current_e_s=1.0).at(100, exposure_s=exposure_s)


# -- profiles -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", camera_names())
def test_every_profile_is_a_camera_that_can_exist(name):
    camera = Camera.load(name)
    assert camera.name == name
    assert camera.kind
    assert "typical of its kind" in camera.source or any(
        mark in camera.source for mark in (".com", ".net", "manual")
    )
    assert camera.read_noise_e < camera.photons_full_scale / 10
    assert camera.photons_full_scale <= camera.saturation_e
    assert 0.95 * camera.full_well_e < camera.saturation_e
    if (
        camera.gain_e_per_dn is not None
    ):  # the steps are no coarser than twice the noise, nor absurdly fine
        assert camera.read_noise_e / 20 < camera.gain_e_per_dn < 2.5 * camera.read_noise_e
        assert camera.black_level * camera.photons_full_scale > 2 * camera.read_noise_e
    assert 0 <= camera.dark_current_e_s < 1e4
    assert camera.least_exposure_s < 0.1
    assert Camera.from_dict(camera.to_dict()) == camera


def test_profiles_are_of_a_dozen_kinds():
    kinds = [Camera.load(name).kind for name in camera_names()]
    assert len(kinds) >= 12
    for kind in (
        "machine-vision CMOS",
        "phone",
        "full-frame",
        "sCMOS",
        "interline CCD",
        "slow-scan",
        "InGaAs",
        "EMCCD",
        "thermal",
        "8-bit video",
        "sent as 8 bit",
        "high-speed",
    ):
        assert any(kind in one for one in kinds), kind


def test_a_profile_or_a_file_is_loaded(tmp_path):
    camera = Camera.load("sony-imx250")
    for name in ("mine.toml", "mine.json"):
        camera.to_file(tmp_path / name)
        assert Camera.load(tmp_path / name) == Camera.load(str(tmp_path / name)) == camera


@pytest.mark.parametrize(
    ("name", "near"), [("imx250", "sony-imx250"), ("Sony IMX174", "sony-imx174"), ("zzz", "known")]
)
def test_an_unknown_name_is_answered_with_the_nearest(name, near):
    with pytest.raises(ValueError, match=rf"^camera: .*{name}.*{near}[^\n]*$"):
        Camera.load(name)


def test_a_camera_without_a_profiles_figures_has_the_document_it_always_had():
    assert Camera(name="a").to_dict() == {**Camera().to_dict(), "name": "a"}
    assert set(Camera().to_dict()) == {
        "schema",
        "photons_full_scale",
        "read_noise_e",
        "bits",
        "response",
        "black_level",
    }


@pytest.mark.parametrize(
    ("scene", "psf", "said"),
    [
        (np.ones(5), np.ones((1, 1)), "scene"),
        (np.full((9, 9), np.nan), np.ones((1, 1)), "scene"),
        (-np.ones((9, 9)), np.ones((1, 1)), "scene"),
        (np.ones((9, 9)), -np.ones((3, 3)), "psf"),
        (np.ones((9, 9)), np.ones(3), "psf"),
        (np.ones((9, 9)), np.ones((16, 16)) / 256, "scene"),
    ],
)
def test_bad_capture(scene, psf, said):
    with pytest.raises(ValueError, match=said):
        capture(scene, psf, camera=Camera(), rng=np.random.default_rng(0))
