"""The error in a photo with borders: against dense linear algebra, and on photographs."""

import numpy as np
import pytest
from scipy.linalg import toeplitz
from skimage import data

import cep
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.optics.scene import PHOTO, noise_variance
from cep.photographs.scenes import photographs
from cep.photographs.trial import JUDGED_PX, PhotoTrial, border_px
from cep.search.cost import CodeCost
from cep.search.exposures import ExposureFinder, kind_of
from cep.search.frame_error import FrameError, codes_of_a_frame, is_framed
from cep.search.problem import Scenario, SearchProblem, speed_range
from motdiff.trajectory import Trajectory

CAMERA = Camera(photons_full_scale=9_000, read_noise_e=14)
# nearly equal by the objective
STEADY = ShutterCode("0111110100001100000101000100100010001000010000100001")
FRAGILE = ShutterCode("1100110001000000000010010010000001000011110000010101")


def problem_of(length_px=107.0, chips=52, angle_rad=0.0, **options):
    path = Trajectory.straight(length_px, angle_rad=angle_rad)
    return SearchProblem.along(path, chips=chips, camera=CAMERA, objective="mse", **options)


def test_it_is_the_error_of_dense_matrices():
    problem = problem_of(12.0, chips=6)
    code = ShutterCode("101100")
    path = problem.scenarios[0].trajectory
    size = path.frame_size() | 1
    h = coded_psf(path, code, size).sum(axis=0)
    pixels = JUDGED_PX + 2 * border_px(6)
    scene_pixels = pixels + size - 1
    # y[i] = sum_k h[k] x[i + size - 1 - k]
    A = np.zeros((pixels, scene_pixels))
    for i in range(pixels):
        A[i, i : i + size] = h[::-1]
    N = float(noise_variance(CAMERA, code.duty))
    u = np.fft.fftfreq(4096)
    first = scene_pixels // 2 - JUDGED_PX // 2
    middle = np.linspace(first, first + JUDGED_PX, 12, dtype=int)
    expected = 0.0
    for t in (1 / 6, 1 / 2, 5 / 6):
        R = toeplitz(np.fft.ifft(PHOTO.power(u**2 + (t**3 / 2) ** 2)).real[:scene_pixels])
        rest = R - R @ A.T @ np.linalg.solve(A @ R @ A.T + N * np.eye(pixels), A @ R)
        expected += t**2 * np.diag(rest)[middle].mean()
    (error_db,) = FrameError(problem).of_codes_db([code])
    assert error_db == pytest.approx(10 * np.log10(expected), abs=1e-6)


def test_neither_angle_nor_order_in_time_matters():
    mirrored = ShutterCode(STEADY.bits[::-1])
    along = FrameError(problem_of()).of_codes_db([STEADY, mirrored])
    across = FrameError(problem_of(angle_rad=np.pi / 2)).of_codes_db([STEADY])
    assert along[0] == pytest.approx(along[1], abs=0.02)  # the middle is no sample's own
    assert along[0] == pytest.approx(across[0], abs=1e-9)


def test_the_worst_motion_counts():
    path = Trajectory.straight(60.0)
    both = SearchProblem.along(*speed_range(path, 0.8, 1.2, 2), chips=52, camera=CAMERA)
    each = [
        SearchProblem.along(path.scaled(factor), chips=52, camera=CAMERA) for factor in (0.8, 1.2)
    ]
    errors_db = [FrameError(problem).of_codes_db([STEADY])[0] for problem in each]
    assert FrameError(both).of_codes_db([STEADY])[0] == pytest.approx(max(errors_db))
    paths = [problem.scenarios[0].trajectory for problem in each]
    weighted = SearchProblem(
        chips=52,
        camera=CAMERA,
        scenarios=(Scenario(paths[0], weight=3.0), Scenario(paths[1])),
        rule="mean",
    )
    expected_db = np.average(errors_db, weights=[3, 1])
    assert FrameError(weighted).of_codes_db([STEADY])[0] == pytest.approx(expected_db)


@pytest.mark.parametrize("width_px", [0, 16])
def test_it_tells_codes_apart_as_photographs_do_where_the_objective_does_not(width_px):
    t = np.linspace(-1, 1, 60)
    arc = Trajectory.from_samples(np.stack([53.5 * t, width_px * t**2], axis=1), direction="known")
    problem = SearchProblem.along(arc, chips=52, camera=CAMERA, objective="mse")
    codes = [STEADY, FRAGILE]
    objective_db = CodeCost.fine(problem).cost_of(np.array([code.array for code in codes]))
    assert np.diff(objective_db)[0] < 0.05
    assert np.diff(FrameError(problem).of_codes_db(codes))[0] > 1
    photographs = [(data.camera() / 255.0) ** 2.2, (data.astronaut().mean(axis=2) / 255) ** 2.2]
    trial = PhotoTrial(problem.directed_paths(), photographs, camera=CAMERA)
    steady_db, fragile_db = trial.psnr_db(codes)
    assert (steady_db > fragile_db + 1).all()


def test_a_descent_lowers_the_error_within_the_limits():
    problem = problem_of(40.0, chips=16, open_range=(6, 8))
    in_frame = FrameError(problem)
    start = ShutterCode("1111000011110000")
    code = in_frame.descended(start)
    assert problem.allows(code)
    before_db, after_db = in_frame.of_codes_db([start, code])
    assert after_db < before_db - 1
    flips = [ShutterCode(np.abs(code.array - chip)) for chip in np.eye(16)]
    near = [other for other in flips if problem.allows(other)]
    assert near
    assert in_frame.of_codes_db(near).min() >= after_db


def test_codes_are_searched_that_are_better_in_a_photo():
    problem = problem_of(20.0, chips=10)
    snapshot, code = ShutterCode("0001100000"), ShutterCode("1011000100")
    mirrored = ShutterCode(code.bits[::-1], chip_ns=123)
    shares = []
    codes = codes_of_a_frame(
        problem, [snapshot, code, mirrored], seed=0, threads=1, progress=shares.append
    )
    assert {kind_of(code) for code in codes} == {"code"}
    assert all(map(problem.allows, codes))
    errors_db = FrameError(problem).of_codes_db([*codes, code])
    assert errors_db[:-1].min() <= errors_db[-1]
    assert shares == sorted(shares)
    assert shares[-1] == 1
    dark = Camera(photons_full_scale=1e5, read_noise_e=14, full_well_e=1.0)
    saturated = SearchProblem.along(Trajectory.straight(20.0), chips=10, camera=dark)
    assert codes_of_a_frame(saturated, [code], seed=0, threads=1) == []


@pytest.mark.slow(reason="searches, judged on a photograph")
def test_optimize_and_advise_measure_what_is_better_in_a_photo():
    problem = problem_of(60.0, chips=32)
    in_frame = FrameError(problem)
    searched = ExposureFinder(problem).codes(CAMERA, (), seed=0, threads=1)
    (searched_db,) = in_frame.of_codes_db(searched)
    optimized = cep.optimize(problem, steps=20_000, photographs=photographs()[:1])
    advice = cep.advise(problem, levels=(), photographs=photographs()[:1])
    for verdict in (optimized.verdict, advice.here):
        codes = [
            exposure.code
            for exposure in verdict.exposures
            if exposure.kind == "code" and exposure.photo_psnr_db
        ]
        assert in_frame.of_codes_db(codes).min() < searched_db - 0.3


def test_which_problems_it_is_for():
    arc = Trajectory.from_samples([[0, 0], [8, 1], [12, 7]])
    assert is_framed(problem_of())
    for angle in np.deg2rad([0, 30, 45, 80]):
        turns = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        turned = Trajectory.from_samples(9 * arc.xy @ turns)
        assert is_framed(SearchProblem.along(turned, chips=16))
        assert not is_framed(problem_of(150.0, angle_rad=angle))
    assert not is_framed(problem_of(200.0))
    assert not is_framed(problem_of(40.0, frames=2))
    assert not is_framed(SearchProblem(chips=16))
    hook = Trajectory.from_samples([[0, 0], [8, 1], [9, 7]])
    assert not is_framed(SearchProblem.along(hook, chips=16))


def test_a_path_that_is_nearly_straight_counts_as_straight():
    nearly = Trajectory.from_samples([[0, 0], [20, 0.2], [40, 0]])
    codes = [ShutterCode("1011000111010010"), ShutterCode("1111000011110000")]
    straight_db = FrameError(problem_of(40.0, chips=16)).of_codes_db(codes)
    nearly_db = FrameError(
        SearchProblem.along(nearly, chips=16, camera=CAMERA, objective="mse")
    ).of_codes_db(codes)
    np.testing.assert_allclose(nearly_db, straight_db, atol=0.1)
