"""Ways to expose: fewer samples along long motions, with the same figures."""

import numpy as np
import pytest

from cep.optics.camera import Camera
from cep.search.annealing.anneal import anneal
from cep.search.cost import CodeCost
from cep.search.expected import ExpectedPsnr, light_noise
from cep.search.exposures import ExposureFinder
from cep.search.problem import SearchProblem
from motdiff.trajectory import Trajectory


def expected_psnr_db(problem, codes, *, noise, path_error_px=0.0):
    return ExpectedPsnr(problem, path_error_px=path_error_px).psnr_db(codes, noise=noise)


def test_a_code_of_a_long_motion_is_found_on_fewer_samples():
    """As good to 0.1 dB, by the fine figures, as one that is searched and judged on all
    samples."""
    camera = Camera(read_noise_e=50)
    problem = SearchProblem.along(
        Trajectory.straight(300.0), chips=24, camera=camera, objective="mse"
    )
    whole = CodeCost(problem, oversampling=16, dtype=np.float64)
    thorough = anneal(
        problem, rng=np.random.default_rng(0), steps=100_000, time_s=np.inf, judge=whole
    )
    finder = ExposureFinder(problem)
    found = finder.codes(camera, finder.ordinary(camera), seed=0, threads=None)
    codes = [*found, thorough.code]
    quick, slow = expected_psnr_db(problem, codes, noise=[light_noise(camera, codes)])[:, 0]
    assert quick == pytest.approx(slow, abs=0.1) or quick > slow


@pytest.mark.parametrize("length", [30.0, 300.0])
def test_six_nodes_across_a_straight_motion_are_as_good_as_twelve(length):
    for read_noise in (2, 50):
        camera = Camera(read_noise_e=read_noise)
        path = Trajectory.straight(length, angle_rad=0.4)
        problem = SearchProblem.along(path, chips=24, camera=camera, objective="mse")
        codes = problem.random_codes(50, rng=np.random.default_rng(1))
        few, many = (
            CodeCost(problem, oversampling=16, across=n, dtype=np.float64).cost_of(codes)
            for n in (6, 12)
        )
        np.testing.assert_allclose(few, many, atol=0.03)


def test_light_that_no_code_can_record_leaves_single_exposures():
    camera = Camera(photons_full_scale=30_000, full_well_e=4_000.0)  # an eighth: one chip of eight
    problem = SearchProblem.along(Trajectory.straight(8.0), chips=8, camera=camera)
    finder = ExposureFinder(problem)
    tried = finder.ordinary(camera)
    assert any(code.open_chips == 1 for code in tried)
    assert all(code.open_chips == 1 for code in finder.codes(camera, tried, seed=0, threads=None))
