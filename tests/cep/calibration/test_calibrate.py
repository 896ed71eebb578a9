"""The choice of an estimator, and the files of a calibration."""

import json
import subprocess
import sys
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from cep.calibration.calibrate import CALIBRATION_FILES, Calibration, estimate_motion
from cep.files.images import read_image, write_image
from cep.files.psf_files import load_psf
from cep.optics.code import ShutterCode
from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.method import is_needed
from motdiff.estimators.registry import METHODS, make_method
from motdiff.files.trajectories import read_motion
from motdiff.gyro import GyroTrace
from motdiff.trajectory import Trajectory

TRACE = GyroTrace(np.linspace(0, 1, 101), np.tile([0.1, 0.2, 0.0], (101, 1)))
GYRO = {"gyro": TRACE, "focal_px": 500.0, "start_s": 0.2, "exposure_s": 0.1}
BENT = Trajectory.from_samples([[0, 0], [6, 1], [9, 5]])


def estimate(*paths):
    weights = tuple(1 / len(paths) for _ in paths)
    return MotionEstimate("pmp", paths, weights, paths[0].psf(max(64, paths[0].frame_size())), 0.5)


@pytest.fixture
def made(monkeypatch):
    """Options that the estimator of the diffusion model is made with; it finds a bent path."""
    seen = []

    def make(**options):
        seen.append(options)
        return SimpleNamespace(estimate=lambda photo: estimate(BENT))

    monkeypatch.setattr("motdiff.estimators.motdiff.estimator.MotDiffEstimator", make)
    return seen


def test_each_method_makes_its_estimator():
    values = {"sharp": np.eye(40), "codes": ("1011",), **GYRO}
    for name, method in METHODS.items():
        needs = {field.name: values[field.name] for field in fields(method) if is_needed(field)}
        estimator = make_method(name, needs).make()
        assert type(estimator).__module__.startswith(method.__module__)
        assert callable(estimator.estimate)


def test_a_light_through_codes_has_an_estimator_of_its_own():
    assert type(make_method("point", {"codes": ("1011",)}).make()).__name__ == "TrailEstimator"


@pytest.mark.parametrize(
    ("photos", "options", "words"),
    [
        ([0, 1], {"method": "motdiff"}, r"^codes: not valid with method='motdiff'"),
        (
            np.array([0, 1]),
            {},
            r"^photo: give the photos of several codes as a list or tuple, not as one array",
        ),
        (
            [0, 1],
            {"codes": [ShutterCode("1101", 2000), ShutterCode("1111", 1000)]},
            r"^code 2: its chips last 1000 ns",
        ),
    ],
)
def test_photos_and_codes_that_do_not_belong_together_are_refused(photos, options, words):
    noise = np.random.default_rng(0).random((2, 70, 80))
    given = noise if isinstance(photos, np.ndarray) else list(noise)
    with pytest.raises(ValueError, match=words):
        estimate_motion(given, **{"codes": [ShutterCode("1101"), ShutterCode("1111")], **options})


def test_a_photo_given_twice_through_two_codes_is_refused():
    photo = np.random.default_rng(0).random((70, 80))
    with pytest.raises(
        ValueError, match=r"^photo 2: is the same as photo 1; give each photo once"
    ):
        estimate_motion([photo, photo.copy()], codes=[ShutterCode("1101"), ShutterCode("1111")])


def test_the_diffusion_model_gets_its_seed(made):
    make_method("motdiff", {}).load(seed=5)
    make_method("motdiff", {}).load()
    assert all(callable(options.pop("progress")) for options in made)
    assert made == [{"seed": 5}, {"seed": 0}]


@pytest.mark.parametrize("method", ["motdiff", "pmp"])
def test_the_share_told_begins_before_torch_is_loaded_and_goes_on_with_the_estimator_s(method):
    """In a fresh interpreter, for torch is loaded here."""
    script = (
        "import json, sys; from motdiff.estimators.registry import METHODS; told = [];"
        " METHODS[sys.argv[1]]().load(progress=lambda share, _what: told.append(('torch' in"
        " sys.modules, f'motdiff.estimators.{sys.argv[1]}.estimator' in sys.modules, share)));"
        " print(json.dumps(told))"
    )
    ran = subprocess.run(
        [sys.executable, "-c", script, method], capture_output=True, text=True, check=True
    )
    loaded = [(torch, estimator) for torch, estimator, _ in json.loads(ran.stdout)]
    shares = [share for *_, share in json.loads(ran.stdout)]
    assert loaded == [(False, False), (True, False), (True, True)]
    assert shares == sorted(shares)


def test_calibration_is_blind_unless_told_otherwise(made):
    found = estimate_motion(np.random.default_rng(0).random((70, 80)))
    assert len(made) == 1
    assert found.trajectories == (BENT,)


def test_a_steady_turn_gives_a_straight_path():
    found = estimate_motion(np.random.default_rng(0).random((50, 60)), method="gyro", **GYRO)
    assert found.trajectories[0].direction == "known"
    assert found.trajectories[0].length_px == pytest.approx(
        500 * 0.1 * np.hypot(0.1, 0.2), rel=1e-3
    )


@pytest.mark.parametrize(
    ("method", "options", "message"),
    [
        (
            "magic",
            {},
            f"method: must be one of {', '.join(METHODS)}, or module:name, got .mag",
        ),
        ("reference", {}, "sharp: needed with method='reference'"),
        ("gyro", GYRO | {"focal_px": None}, "focal_px: needed with method='gyro'"),
        ("pmp", {"sharp": np.eye(40)}, "sharp: not valid with method='pmp'"),
        (
            "reference",
            {"sharp": np.eye(40), "start_s": 1.0},
            "^start_s: not valid with method='reference'$",
        ),
        ("gyro", GYRO | {"sharp": np.eye(40)}, "^sharp: not valid with method='gyro'$"),
        ("motdiff", {"sharp": np.eye(40)}, "^sharp: not valid with method='motdiff'$"),
        ("motdiff", {"samples": 8}, "^samples: not valid with method='motdiff'$"),
        ("point", {"start_s": 1.0}, "start_s: not valid with method='point'"),
    ],
)
def test_what_a_method_needs_is_said(method, options, message):
    with pytest.raises(ValueError, match=message):
        make_method(method, options).make()


@pytest.mark.parametrize(("level", "shade"), [(0.0, "black"), (1.0, "white"), (0.4, "the same")])
def test_a_photo_without_texture_is_refused(level, shade):
    with pytest.raises(ValueError, match=f"{shade} all over"):
        estimate_motion(np.full((64, 64, 3), level), method="point")


def test_the_files_hold_the_estimate(tmp_path):
    found = estimate(BENT, BENT.scaled(1.2))
    photo = np.random.default_rng(0).random((80, 90, 3))
    source = {"image": "a.png", "seed": 4}
    written = Calibration.of(found, photo).save(tmp_path / "m", source=source)
    assert (
        set(written)
        == set(CALIBRATION_FILES)
        == {item.name for item in (tmp_path / "m").iterdir()}
    )
    stored = read_motion(written["trajectory.json"])
    np.testing.assert_allclose(stored.trajectory.xy, BENT.xy)
    assert stored.weight == 0.5
    assert len(stored.alternatives) == 1
    assert stored.source == {"method": "pmp", "image": "a.png", "seed": 4}
    np.testing.assert_allclose(load_psf(written["psf.npy"])[0], found.psf, rtol=1e-6)
    np.testing.assert_array_equal(read_image(written["map.png"], gamma="linear"), BENT.hr_map())


def test_a_path_too_large_for_the_map_has_none(tmp_path):
    long = Calibration.of(estimate(Trajectory.straight(100.0)), np.zeros((60, 60)))
    written = long.save(tmp_path / "m")
    assert set(written) == set(CALIBRATION_FILES) - {
        "map.png",
        "sharpened.png",
    }  # no restoration was better


def test_nothing_is_replaced_or_half_written(tmp_path):
    Calibration.of(estimate(BENT), np.zeros((60, 60))).save(tmp_path / "m")
    before = (tmp_path / "m/trajectory.json").read_text()
    with pytest.raises(ValueError, match="use --force"):
        Calibration.of(estimate(BENT.scaled(2)), np.zeros((60, 60))).save(tmp_path / "m")
    with pytest.raises(TypeError, match="shape"):  # fails on the last file, the preview
        Calibration.of(estimate(BENT.scaled(2)), np.zeros((60, 60, 7))).save(
            tmp_path / "m", force=True
        )
    assert (tmp_path / "m/trajectory.json").read_text() == before
    assert [item.name for item in tmp_path.iterdir()] == ["m"]


# ---- the command


def test_the_command_is_blind_by_the_diffusion_model_unless_told_otherwise(cep, workplace, made):
    found = cep.succeeds("calibrate", "blurred.png", "-o", "motion")
    (options,) = made
    assert callable(options.pop("progress"))
    assert options == {"seed": 0}
    assert found["length_px"] == pytest.approx(BENT.length_px)
    assert read_motion(workplace / "motion/trajectory.json").source["seed"] == 0


def test_the_command_passes_on_the_seed(cep, workplace, made):
    cep.succeeds("calibrate", "blurred.png", "--seed", "7", "-o", "motion")
    (options,) = made
    assert options["seed"] == 7
    assert read_motion(workplace / "motion/trajectory.json").source["seed"] == 7


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--quick"], "--quick"),  # it saved a tenth of the time
        (["--samples", "3"], "--samples"),  # drew from the paper's network
        (["--sharp", "sharp.png"], "--sharp: not valid with --method motdiff"),
    ],
)
def test_the_command_says_which_method_an_option_is_for(cep, workplace, options, said):
    assert said in cep.refuses("calibrate", "blurred.png", *options)
    assert not (workplace / "blurred_motion").exists()


def test_a_photo_without_texture_is_refused_before_the_network_is_loaded(cep, workplace, made):
    write_image("grey.png", np.full((80, 90), 0.5))
    assert "motion shows only where the scene has texture" in cep.refuses("calibrate", "grey.png")
    assert made == []


@pytest.mark.parametrize(("method", "least_px"), [("motdiff", 64), ("pmp", 48)])
def test_a_photo_that_is_too_small_is_refused_before_anything_slow_is_loaded(
    workplace, method, least_px
):
    write_image("small.png", np.random.default_rng(0).random((30, 35)))
    script = (
        "import sys; from cep.commands.main import main; code = main(sys.argv[1:]); print(code,"
        " *{'torch', 'matplotlib', f'motdiff.estimators.{sys.argv[-1]}.estimator'}"
        " & {*sys.modules})"
    )
    command = [sys.executable, "-c", script, "calibrate", "small.png", "--method", method]
    ran = subprocess.run(command, capture_output=True, text=True, check=True)
    assert (
        ran.stderr == f"cep: small.png: needs at least {least_px} x {least_px} px, got 35 x 30\n"
    )
    assert ran.stdout == "2\n"
    assert not Path("small_motion").exists()


def test_the_command_searches_corrects_and_draws(cep, workplace):
    found = cep.succeeds("calibrate", "blurred.png", "-o", "motion")
    assert found["method"] == "motdiff"
    assert found["details"]["chosen"] in ("search", "search at half the size")
    written = {item.name for item in (workplace / "motion").iterdir()}
    # the photo is restored only where that makes it better
    assert written | {"sharpened.png"} == set(CALIBRATION_FILES)
    assert load_psf(found["psf"])[0].sum() == pytest.approx(1, rel=1e-5)
