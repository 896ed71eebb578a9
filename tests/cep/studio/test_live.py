import numpy as np
import pytest

from cep.optics.camera import Camera
from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf, mtf
from cep.search.limits import RunLimits
from cep.search.measured import shifts_db
from cep.search.problem import SearchProblem
from cep.search.verdict import verdict
from cep.studio.live import MAP_COLUMNS, MAP_ROWS, LiveBench, LiveScene, broken_limits
from cep.studio.motions import example_motion
from hw.device import load_profile
from motdiff.trajectory import Trajectory

CAMERA = Camera.load("video-8bit").at(2000)
CODE = ShutterCode("1101000111010110", 1_250_000)


@pytest.mark.parametrize("device", [None, "flc"])
@pytest.mark.parametrize("name", ["shake", "walk"])
def test_figures_are_those_of_the_problem_and_the_exact_mtf(name, device):
    path = example_motion(name)
    problem = SearchProblem.along(
        path, chips=16, exposure_s=0.02, camera=CAMERA, objective="mse", device=device
    )
    bench = LiveBench(problem)
    seen = bench.figures(CODE)
    exact = problem.measure(CODE)
    assert seen.metrics.mse_db == pytest.approx(exact.mse_db)
    assert seen.metrics.noise_gain_db == pytest.approx(exact.noise_gain_db)
    assert seen.metrics.min_mtf_lower <= exact.min_mtf
    if device is None:
        fx, fy = np.meshgrid(np.linspace(-0.5, 0.5, MAP_COLUMNS), np.linspace(0, 0.5, MAP_ROWS))
        assert np.abs(seen.band - mtf(path, CODE, fx, fy)).max() < 1e-5  # single precision
        along = mtf(path, CODE, bench.freq_cy_px * bench.axis[0], bench.freq_cy_px * bench.axis[1])
        assert np.abs(seen.curve - along).max() < 1e-5
    else:  # ramps pass other light than the chips, and are in every figure
        psf = coded_psf(path, CODE, bench.psf(CODE).shape[0], response=problem.response)
        assert np.array_equal(psf, bench.psf(CODE))
        assert seen.curve[0] == pytest.approx(psf.sum(), rel=1e-5)


def test_the_verdict_does_not_depend_on_what_was_judged_before():
    problem = SearchProblem.along(
        example_motion("shake"), chips=16, exposure_s=0.02, camera=CAMERA, objective="mse"
    )
    bench = LiveBench(problem)
    for code in (ShutterCode("1100000000000001", 1_250_000), CODE):
        assert bench.verdict(code).sentence == LiveBench(problem).verdict(code).sentence


def test_the_verdict_follows_the_error_of_the_path():
    """A path known less well restores every photo less well."""
    code = ShutterCode("11010001")
    bench = LiveBench(SearchProblem.along(Trajectory.straight(10.0), chips=8, camera=CAMERA))
    known = {way.code.bits: way.psnr_db for way in bench.verdict(code).exposures}
    unsure = {
        way.code.bits: way.psnr_db for way in bench.verdict(code, path_error_px=1.0).exposures
    }
    assert code.bits in known
    assert "11111111" in known
    assert all(unsure[bits] < psnr_db for bits, psnr_db in known.items())


def test_gains_are_the_models_shifted_by_what_photographs_show():
    problem = SearchProblem.along(
        example_motion("shake"), chips=16, exposure_s=0.02, camera=CAMERA, objective="mse"
    )
    bench = LiveBench(problem)
    table_db = shifts_db(example_motion("shake"), CAMERA)
    modelled = {way.code.bits: way for way in verdict(problem, CODE, photographs=()).exposures}
    for way in bench.verdict(CODE).exposures:
        expected_db = modelled[way.code.bits].psnr_db + table_db[way.kind]
        assert way.psnr_db == pytest.approx(expected_db, abs=1e-4)
    live = bench.figures(CODE)
    assert live.psnr_db == pytest.approx(table_db["code"] - live.metrics.mse_db)


def test_where_the_open_shutter_wins_the_best_single_exposure_is_a_long_one():
    path = Trajectory.straight(10.0)
    bench = LiveBench(SearchProblem.along(path, chips=40, camera=CAMERA.at(100)))
    seen = bench.verdict(ShutterCode("10" * 20))
    assert seen.choice == "open"
    assert seen.best("snapshot").code.open_chips > 30


@pytest.mark.parametrize("name", ["shake", "walk"])
def test_photos_of_two_codes_have_the_same_noise_and_restore_towards_the_scene(name):
    problem = SearchProblem.along(
        example_motion(name), chips=16, exposure_s=0.02, camera=CAMERA.at(50_000)
    )
    bench = LiveBench(problem)
    light = 0.2 + 0.6 * np.kron(np.random.default_rng(1).random((40, 40)), np.ones((6, 6)))
    scene = LiveScene(light)
    photo = bench.photo(CODE, scene, side_px=120)
    assert photo.shape == (120, 120)
    assert np.array_equal(photo, bench.photo(CODE, scene, side_px=120))
    assert photo.mean() == pytest.approx(CODE.duty * light.mean(), rel=0.05)
    reach = (len(light) - len(photo)) // 2
    still = light[reach : reach + len(photo), reach : reach + len(photo)]
    error = np.abs(bench.restored(CODE, photo) - still)[20:-20, 20:-20].mean()
    assert error < 0.5 * np.abs(photo / CODE.duty - still)[20:-20, 20:-20].mean()


def test_a_live_photo_is_the_middle_of_the_one_that_capture_takes():
    bright = Camera(photons_full_scale=1e9, read_noise_e=0, bits=16, response="linear")
    path = example_motion("shake")
    bench = LiveBench(SearchProblem.along(path, chips=16, camera=bright))
    light = np.random.default_rng(1).random((90, 101, 3))
    whole = capture(light, path, CODE, bright, rng=np.random.default_rng(0))
    rows, columns = ((size - 40) // 2 for size in whole.shape[:2])
    photo = bench.photo(CODE, LiveScene(light), side_px=40)
    assert photo == pytest.approx(whole[rows : rows + 40, columns : columns + 40], abs=2e-4)
    assert bench.photo(CODE, LiveScene(light), side_px=1000) == pytest.approx(whole, abs=2e-4)
    with pytest.raises(ValueError, match="psf"):
        bench.photo(CODE, LiveScene(light[:10]), side_px=40)


@pytest.mark.parametrize("electrons", [2.0, 40.0])
def test_live_noise_has_the_moments_of_counted_photons(electrons):
    camera = Camera(photons_full_scale=4 * electrons, read_noise_e=0, bits=16, response="linear")
    photo = LiveScene(np.full((400, 400), 0.25)).photo(np.ones((1, 1)), camera, side_px=400)
    counted = 4 * electrons * photo
    assert counted == pytest.approx(np.rint(counted), abs=electrons * 1e-4)  # steps of 16 bits
    assert counted.mean() == pytest.approx(electrons, rel=0.01)
    assert counted.var() == pytest.approx(electrons, rel=0.06)
    assert ((counted - counted.mean()) ** 3).mean() == pytest.approx(
        electrons, rel=0.15, abs=0.03 * electrons**1.5
    )


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"open_range": (2, 4)}, "9 chips are open; the limit is 2 to 4"),
        ({"runs": RunLimits(min_open=2)}, "an opening is shorter than 2 chips"),
        ({"runs": RunLimits(max_open=2)}, "an opening is longer than 2 chips"),
        ({"runs": RunLimits(min_closed=2)}, "a gap is shorter than 2 chips"),
        ({"runs": RunLimits(max_pulses=4)}, "the shutter opens 5 times; the limit is 4"),
        ({"runs": RunLimits(min_period=4)}, "openings begin less than 4 chips apart"),
    ],
)
def test_each_broken_limit_is_a_sentence(limits, words):
    problem = SearchProblem.along(example_motion("shake"), chips=16, **limits)
    assert broken_limits(problem, CODE) == (words,)
    assert broken_limits(SearchProblem.along(example_motion("shake"), chips=16), CODE) == ()


def test_a_device_says_itself_what_it_cannot_play():
    profile = load_profile("mechanical-fast")
    problem = SearchProblem.along(example_motion("shake"), chips=16)
    said = broken_limits(problem, CODE, profile)
    assert said
    assert all(line.startswith("mechanical-fast: ") for line in said)
