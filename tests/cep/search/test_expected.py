"""Expected PSNR of the restoration: against the metrics, sampled paths and simulated photos."""

from dataclasses import replace

import numpy as np
import pytest

from cep.optics.band import grid_samples
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.exposure import chip_rows, coded_otf
from cep.optics.scene import inverse_scene, noise_variance
from cep.proofs.measure import measure, measure_worst
from cep.search.cost import CodeCost
from cep.search.expected import (
    ExpectedPsnr,
    equal_light_noise,
    joint_psnr_db,
    light_noise,
    worst_psnr_db,
)
from cep.search.problem import Scenario, SearchProblem
from motdiff.motions import boracchi_foi, with_smooth_error
from motdiff.trajectory import Trajectory

BENT = Trajectory.from_samples([[0, 0], [6, 1], [9, 5], [10, 11]])
CODES = [ShutterCode("110100011"), ShutterCode("1" * 9), ShutterCode("000011000")]
CAMERA = Camera(photons_full_scale=2_000, read_noise_e=20)


def expected_psnr_db(problem, codes, *, noise, path_error_px=0.0):
    return ExpectedPsnr(problem, path_error_px=path_error_px).psnr_db(codes, noise=noise)


def problem(path=BENT, chips=9, **options):
    return SearchProblem.along(path, chips=chips, camera=CAMERA, **options)


def test_it_is_that_of_the_metrics():
    dim = replace(CAMERA, photons_full_scale=500.0)
    table = expected_psnr_db(
        problem(), CODES, noise=[light_noise(dim, CODES), light_noise(CAMERA, CODES)]
    )
    assert table.shape == (3, 2)
    for row, code in zip(table, CODES, strict=True):
        assert -row[1] == pytest.approx(measure_worst(BENT, code, camera=CAMERA).mse_db, abs=0.1)
        assert row[1] > row[0]  # more light never hurts


@pytest.mark.parametrize("device", [None, "flc"])
@pytest.mark.parametrize("path_error_px", [0.0, 0.4])
def test_otfs_are_kept_where_the_memory_allows_it(monkeypatch, path_error_px, device):
    both = problem(replace(BENT, direction="unknown"), exposure_s=0.02, device=device)
    noise = [light_noise(CAMERA, CODES, response=both.response)]
    expected = expected_psnr_db(both, CODES, noise=noise, path_error_px=path_error_px)
    kept = ExpectedPsnr(both, path_error_px=path_error_px, most_bytes=2**30)
    fresh = ExpectedPsnr(both, path_error_px=path_error_px, most_bytes=1_000)
    computed = []
    monkeypatch.setattr(
        "cep.search.expected.chip_rows",
        lambda *args, **more: computed.append(1) or chip_rows(*args, **more),
    )
    assert kept.psnr_db(CODES, noise=noise) == pytest.approx(expected, abs=1e-4)
    assert not computed
    assert np.array_equal(fresh.psnr_db(CODES, noise=noise), expected)
    assert len(computed) == (
        2 if path_error_px == 0 else 64
    )  # both directions, and 32 paths near each


@pytest.mark.parametrize(
    "camera", [Camera(photons_full_scale=1_000, read_noise_e=40, bits=8), CAMERA]
)
def test_at_equal_light_the_signal_to_noise_of_a_pixel_is_the_open_shutters(camera):
    codes = [ShutterCode("1" * k + "0" * (8 - k)) for k in range(1, 9)]
    equal = equal_light_noise(camera, codes)
    opened = light_noise(camera, codes)[-1]
    duty = np.arange(1, 9) / 8  # of the signal, in the lamp's full scale
    np.testing.assert_allclose(equal / duty**2, opened)


def test_a_very_bright_lamp_is_no_error():
    equal_light_noise(Camera(photons_full_scale=1e7), [ShutterCode("1" + "0" * 511)])


def test_a_snapshot_has_the_dark_current_of_its_own_exposure():
    """A single opening of 2 of 9 chips integrates 2/9 of the dark electrons that a code or the
    open shutter does."""
    dark = replace(CAMERA, dark_current_e_s=1e5)
    chip_e = 1e5 * 0.02  # electrons in a chip
    codes = [ShutterCode(code.bits, 20_000_000) for code in CODES]
    for model, scale in (
        (light_noise, np.ones(3)),
        (equal_light_noise, np.array([code.duty for code in codes]) ** 2),
    ):
        added = (model(dark, codes) - model(CAMERA, codes)) / scale * CAMERA.photons_full_scale**2
        np.testing.assert_allclose(added, [9 * chip_e, 9 * chip_e, 2 * chip_e])


def test_dark_current_counts_alike_in_figures_objectives_and_expectations():
    dark = replace(CAMERA, dark_current_e_s=1e5)
    warm = replace(problem(objective="mse", direction="forward"), camera=dark, chip_ns=20_000_000)
    codes = [ShutterCode(code.bits, warm.chip_ns) for code in CODES]
    judged = CodeCost.fine(warm)
    expected = expected_psnr_db(warm, codes, noise=[light_noise(dark, codes)])[:, 0]
    for code, psnr in zip(codes, expected, strict=True):
        assert warm.measure(code).mse_db == pytest.approx(measure(BENT, code, camera=dark).mse_db)
        assert warm.measure(code).mse_db == pytest.approx(judged.exact_cost(code), abs=1e-6)
        assert warm.measure(code).mse_db == pytest.approx(-psnr, abs=0.1)
        assert warm.measure(code).mse_db > measure(BENT, code, camera=CAMERA).mse_db


def test_a_path_known_exactly_is_the_limit_of_one_that_is_not():
    noise = [light_noise(CAMERA, CODES)]
    exact = expected_psnr_db(problem(), CODES, noise=noise)
    near = expected_psnr_db(problem(), CODES, noise=noise, path_error_px=1e-4)
    np.testing.assert_allclose(near, exact, atol=0.1)  # on other samples


def test_an_error_of_the_path_costs_long_exposures_more_than_short_ones():
    noise = [light_noise(CAMERA, CODES)]
    lost = [
        expected_psnr_db(problem(), CODES, noise=noise, path_error_px=error)[:, 0]
        for error in (0.0, 0.25, 0.5, 1.0)
    ]
    code, opened, snapshot = np.array(lost).T
    assert (np.diff(code) < 0).all()
    assert (np.diff(opened) < 0).all()
    assert code[0] - code[-1] > 1.0 > snapshot[0] - snapshot[-1]


@pytest.mark.parametrize("path", [BENT, Trajectory.straight(12.0)], ids=["bent", "straight"])
def test_the_filter_that_knows_the_error_does_as_expected_on_other_paths(path):
    """Monte Carlo with paths of its own: the filter of the mean and the scatter has the error that
    is expected."""
    error_px = 0.4
    code = CODES[0]
    path = replace(path, direction="known")
    expected = expected_psnr_db(
        problem(path), [code], noise=[light_noise(CAMERA, [code])], path_error_px=error_px
    )[0, 0]
    rng = np.random.default_rng(5)
    samples = grid_samples(64)
    otfs = []
    for _ in range(200):
        near = with_smooth_error(path, error_px, rng=rng)
        at = (np.arange(9) + 0.5) / 9
        shift = code.array @ (near.at(at) - path.at(at)) / code.open_chips
        turn = np.exp(2j * np.pi * (shift[0] * samples.fx + shift[1] * samples.fy))
        otfs.append(coded_otf(near, code, samples.fx, samples.fy) * turn)
    known = np.array(otfs[:100])
    other = np.array(otfs[100:])
    inverse = inverse_scene(samples)[:, 0]
    noise = noise_variance(CAMERA, code.duty)
    gain = np.conj(known.mean(axis=0)) / ((np.abs(known) ** 2).mean(axis=0) + noise * inverse)
    errors = np.abs(1 - gain * other) ** 2 / inverse + np.abs(gain) ** 2 * noise
    assert expected == pytest.approx(-10 * np.log10((errors @ samples.weight).mean()), abs=0.3)


def test_a_straight_path_that_is_known_to_so_much_bends():
    straight = SearchProblem.along(Trajectory.straight(12.0), chips=12, camera=CAMERA)
    codes = [ShutterCode("1" * 12), ShutterCode("110100011101")]
    noise = [light_noise(CAMERA, codes)]
    exact, uncertain = (
        expected_psnr_db(straight, codes, noise=noise, path_error_px=e) for e in (0.0, 0.5)
    )
    assert (uncertain < exact).all()


@pytest.mark.parametrize("error_px", [-1.0, float("nan"), float("inf")])
def test_a_wrong_error_is_refused(error_px):
    with pytest.raises(ValueError, match="path_error_px: must be 0 px or more"):
        expected_psnr_db(
            problem(), CODES, noise=[light_noise(CAMERA, CODES)], path_error_px=error_px
        )
    with pytest.raises(ValueError, match="need a motion"):
        expected_psnr_db(SearchProblem(chips=9), CODES, noise=[light_noise(CAMERA, CODES)])


def test_frames_through_one_code_divide_its_noise_and_through_others_fill_its_zeros():
    straight = SearchProblem.along(Trajectory.straight(12.0), chips=12, camera=CAMERA)
    codes = [ShutterCode("111100000000"), ShutterCode("110100011101")]
    noise = np.array([light_noise(CAMERA, codes)])
    single = ExpectedPsnr(straight).psnr_db(codes, noise=noise)[:, 0]
    twice = ExpectedPsnr(straight).psnr_db(codes, noise=noise / 2)[:, 0]
    same = [
        joint_psnr_db(straight, [code] * 2, noise=noise[:, [i, i]])[0]
        for i, code in enumerate(codes)
    ]
    assert same == pytest.approx(twice)
    assert joint_psnr_db(straight, codes, noise=noise)[0] > single.max()


def test_frames_along_an_unknown_direction_are_as_good_as_along_the_worse_one():
    path = boracchi_foi(np.random.default_rng(4), max_length_px=20, samples=60)
    codes = [ShutterCode("110100000"), ShutterCode("000010111")]
    noise = np.array([light_noise(CAMERA, codes), light_noise(CAMERA, codes) * 4])
    ways = [replace(one, direction="known") for one in (path, path.reversed())]
    both, *each = (
        joint_psnr_db(SearchProblem.along(one, chips=9, camera=CAMERA), codes, noise=noise)
        for one in (replace(path, direction="unknown"), *ways)
    )
    assert both == pytest.approx(np.minimum(*each))


def test_motions_count_by_the_worst_or_by_their_weights():
    short, long = (Scenario(Trajectory.straight(px), weight=w) for px, w in [(6, 3), (9, 1)])
    errors = [[np.array([1e-3, 1e-2])], [np.array([1e-1, 1e-4]), np.array([1e-2, 1e-2])]]
    worst = SearchProblem(chips=9, scenarios=(short, long), rule="worst")
    # of the second motion the worse direction: 10 and 20 dB
    np.testing.assert_allclose(worst_psnr_db(worst, errors), [10, 20])
    mean = replace(worst, rule="mean")
    np.testing.assert_allclose(worst_psnr_db(mean, errors), [(3 * 30 + 10) / 4, 20])
