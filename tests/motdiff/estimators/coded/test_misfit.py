"""Terms of the sum of squares: what the true motion leaves, their derivatives, and what no photo
can tell."""

import numpy as np
import pytest
import torch
from scipy import special

from motdiff.estimators.coded.misfit import (
    KernelTerm,
    Roughness,
    SmoothMotion,
    Unknowns,
    descend,
)
from motdiff.estimators.coded.otfs import CodedOtfs
from motdiff.estimators.coded.scene_term import SceneTerm, scene_spectra
from motdiff.motions import boracchi_foi
from motdiff.trajectory import Trajectory

KNOTS = 53
SIDE_PX = 216
WALK = boracchi_foi(np.random.default_rng(3), max_length_px=40)
TRUTH = Trajectory.from_samples(WALK.at(np.linspace(0, 1, KNOTS)))
SHIFTS_PX = np.array([[0, 0], [1.3, -0.6], [-1.8, 0.4], [0.5, 2.0]])
GAINS = np.array([1, 0.8, 1.1, 0.95])
UNKNOWNS = Unknowns(KNOTS, 4)


def vector(path, *, shifts=SHIFTS_PX, gains=GAINS) -> torch.Tensor:
    """One candidate (1, N) whose photos and kernels lie at the same shifts."""
    tensors = (
        torch.tensor(np.array(values)[None], dtype=torch.float32)
        for values in (path, gains, shifts)
    )
    x = UNKNOWNS.pack(*tensors)
    x[:, UNKNOWNS.shift(1) : UNKNOWNS.gain(1)] = torch.tensor(
        np.ravel(shifts[1:]), dtype=torch.float32
    )
    return x


def disturbed(count: int, *, size: float = 0.3) -> torch.Tensor:
    """Candidates (count, N) around the truth: path, shifts and logarithms of the gains all off."""
    noise = torch.randn(count, UNKNOWNS.size, generator=torch.Generator().manual_seed(0))
    noise[:, UNKNOWNS.gain(1) : UNKNOWNS.kernel_shift(0)] *= 0.1
    return vector(TRUTH.xy) + size * noise


def scene_term(
    taken, *, part: int = 2, path_error_px: float = 0.0, brightness: float = 1.0
) -> SceneTerm:
    photos = [brightness * photo for photo in taken.photos]
    (spectra,) = scene_spectra(photos, grids=[SIDE_PX // part], margin_px=30)
    return SceneTerm(UNKNOWNS, CodedOtfs(taken.codes, KNOTS), spectra, path_error_px=path_error_px)


def kernel_term(taken, *, sigma_px: float = 1.5, saturation: float | None = None) -> KernelTerm:
    otfs = CodedOtfs(taken.codes, KNOTS)
    weights = np.array([200.0, 100.0, 50.0, 150.0])
    return KernelTerm(
        UNKNOWNS, otfs, taken.psfs, sigma_px=sigma_px, weights=weights, saturation=saturation
    )


def relative(term: SceneTerm, x: torch.Tensor) -> float:
    return float(term.cost(x)) / term.values


@pytest.fixture(scope="module")
def noisy(shots):
    return shots(TRUTH, side_px=SIDE_PX, shifts_px=SHIFTS_PX, gains=GAINS, read_sigma=0.005)


@pytest.fixture(scope="module")
def clean(shots):
    return shots(TRUTH, side_px=SIDE_PX, shifts_px=SHIFTS_PX, gains=GAINS, read_sigma=0.0)


# -- the unknowns ---------------------------------------------------------------------------------


def test_a_vector_holds_every_unknown_once() -> None:
    x = torch.arange(UNKNOWNS.size)[None].float()
    parts = [
        UNKNOWNS.paths(x).ravel(),
        UNKNOWNS.shifts(x)[0, 1:].ravel(),
        UNKNOWNS.gains(x)[0, 1:].log(),
        UNKNOWNS.kernel_shifts(x).ravel(),
    ]
    gains = slice(UNKNOWNS.gain(1), UNKNOWNS.kernel_shift(0))
    x[:, gains] /= UNKNOWNS.size  # their exponentials are finite
    parts[2] = UNKNOWNS.gains(x)[0, 1:].log() * UNKNOWNS.size
    np.testing.assert_allclose(torch.cat(parts), torch.arange(UNKNOWNS.size), rtol=1e-5)
    assert UNKNOWNS.shifts(x)[0, 0].tolist() == [0, 0]
    assert UNKNOWNS.gains(x)[0, 0] == 1


def test_packing_and_reading() -> None:
    x = vector(TRUTH.xy)
    np.testing.assert_allclose(UNKNOWNS.paths(x)[0], TRUTH.xy, atol=1e-5)
    np.testing.assert_allclose(UNKNOWNS.shifts(x)[0], SHIFTS_PX, atol=1e-6)
    np.testing.assert_allclose(UNKNOWNS.gains(x)[0], GAINS, atol=1e-6)
    np.testing.assert_allclose(UNKNOWNS.kernel_shifts(x)[0], SHIFTS_PX, atol=1e-6)


# -- photos of one scene --------------------------------------------------------------------------


def test_the_true_motion_explains_clean_photos(clean) -> None:
    term = scene_term(
        clean, path_error_px=0.1
    )  # a misfit of 1 is what a path that is off by 0.1 px leaves
    assert relative(term, vector(TRUTH.xy)) < 0.1
    assert relative(term, vector(TRUTH.xy[::-1])) > 20


@pytest.mark.parametrize("sigma", [0.005, 0.02])
def test_the_true_motion_leaves_the_noise_alone(shots, sigma: float) -> None:
    term = scene_term(shots(TRUTH, side_px=SIDE_PX, shifts_px=SHIFTS_PX, read_sigma=sigma))
    x = vector(TRUTH.xy, gains=np.ones(4))
    assert relative(term, x) == pytest.approx(
        1, abs=0.08
    )  # 3 to 5 % by chance: some thousand values, smoothed by the window
    assert relative(term, vector(TRUTH.xy[::-1], gains=np.ones(4))) > 3


def test_paths_have_nothing_to_explain_in_noise(noisy) -> None:
    rng = np.random.default_rng(0)
    photos = [0.5 + 0.01 * rng.standard_normal((SIDE_PX, SIDE_PX)) for _ in range(4)]
    (spectra,) = scene_spectra(photos, grids=[SIDE_PX // 2], margin_px=30)
    term = SceneTerm(UNKNOWNS, CodedOtfs(noisy.codes, KNOTS), spectra, path_error_px=0.0)
    paths = [boracchi_foi(rng, max_length_px=40) for _ in range(6)]
    t = np.linspace(0, 1, KNOTS)
    costs = [float(term.cost(vector(path.at(t)))) for path in paths]
    # noise that counts as the scene's light makes them differ by about the root of their number
    assert np.ptp(costs) < 0.5 * np.sqrt(3 * len(spectra.f))


def test_every_unknown_of_the_photos_counts(noisy) -> None:
    term = scene_term(noisy)
    best = relative(term, vector(TRUTH.xy))
    bent = TRUTH.xy.copy()
    bent[20:30] += (0.5, -0.5)
    shifted = SHIFTS_PX + np.array([[0, 0], [0, 0], [0.3, 0], [0, 0]])
    for wrong in (
        vector(bent),
        vector(TRUTH.xy, shifts=shifted),
        vector(TRUTH.xy, gains=GAINS * [1, 1, 1, 1.1]),
        vector(TRUTH.xy, gains=np.ones(4)),
    ):
        assert relative(term, wrong) > 1.2 * best


def test_where_the_scene_lies_does_not_count(noisy) -> None:
    term = scene_term(noisy)
    assert relative(term, vector(TRUTH.xy + np.array([3, -2]))) == pytest.approx(
        relative(term, vector(TRUTH.xy)), rel=0.01
    )


def test_common_brightness_does_not_count(noisy) -> None:
    for x in (vector(TRUTH.xy), disturbed(1)):
        half, whole = (
            relative(scene_term(noisy, brightness=brightness), x) for brightness in (0.5, 1.0)
        )
        assert half == pytest.approx(whole, rel=1e-3)


def test_gains_are_found(noisy) -> None:
    x, _ = descend([scene_term(noisy)], vector(TRUTH.xy, gains=np.ones(4)), steps=12)
    np.testing.assert_allclose(UNKNOWNS.gains(x)[0], GAINS, rtol=0.02)


@pytest.mark.parametrize(("part", "within_px"), [(2, 0.2), (3, 0.4), (6, 1.0)])
def test_shifts_are_found(noisy, part: int, within_px: float) -> None:
    start = torch.cat([vector(TRUTH.xy, shifts=shifts) for shifts in (0 * SHIFTS_PX, -SHIFTS_PX)])
    x = scene_term(noisy, part=part, path_error_px=0.3).registered(start)
    np.testing.assert_allclose(UNKNOWNS.shifts(x), [SHIFTS_PX] * 2, atol=within_px)
    rest = torch.cat(
        [torch.arange(UNKNOWNS.shift(1)), torch.arange(UNKNOWNS.gain(1), UNKNOWNS.size)]
    )
    assert torch.equal(x[:, rest], start[:, rest])


def test_the_fit_to_photos_comes_back_to_the_truth(noisy) -> None:
    terms = [scene_term(noisy), Roughness(UNKNOWNS, 30.0)]
    t = np.linspace(0, 1, KNOTS)
    bent = TRUTH.xy + 0.4 * np.stack([np.sin(5 * t), np.cos(7 * t)], axis=1)
    x, _ = descend(terms, vector(bent, gains=np.ones(4)), steps=20, tolerance=1e-5)
    apart = UNKNOWNS.paths(x)[0].numpy() - TRUTH.xy
    apart -= apart.mean(axis=0)
    assert np.sqrt((apart**2).sum(axis=1).mean()) < 0.15


# -- kernels --------------------------------------------------------------------------------------


@pytest.mark.parametrize("sigma_px", [4.0, 1.5, 1.0])
def test_the_true_motion_explains_exact_kernels(clean, sigma_px: float) -> None:
    term = kernel_term(clean, sigma_px=sigma_px)
    assert (
        float(term.cost(vector(TRUTH.xy))) < 5e-4 * 500
    )  # of a cost of 500 where all is off: pixels alias a little
    assert float(term.cost(vector(TRUTH.xy + np.array([0.1, 0])))) > 2 * float(
        term.cost(vector(TRUTH.xy))
    )
    assert float(term.cost(vector(TRUTH.xy[::-1]))) > 50


def test_the_brightness_of_kernels_does_not_count(clean) -> None:
    terms = [
        KernelTerm(
            UNKNOWNS,
            CodedOtfs(clean.codes, KNOTS),
            [f * k for f, k in zip(factors, clean.psfs, strict=True)],
            sigma_px=1.5,
            weights=np.ones(4),
        )
        for factors in ((1, 1, 1, 1), (3, 0.5, 7, 1))
    ]
    x = disturbed(3)
    np.testing.assert_allclose(terms[0].cost(x), terms[1].cost(x), rtol=1e-5)


def test_saturation_bounds_the_cost_of_a_kernel(clean) -> None:
    limit = 5.0
    far = vector(TRUTH.xy + 40)
    assert float(kernel_term(clean).cost(far)) > 100
    assert 0.9 * 4 * limit < float(kernel_term(clean, saturation=limit).cost(far)) < 4 * limit
    near = disturbed(1, size=0.003)
    plain = float(kernel_term(clean).cost(near))
    assert plain < 0.1
    assert float(kernel_term(clean, saturation=limit).cost(near)) == pytest.approx(plain, rel=0.03)


# -- roughness ------------------------------------------------------------------------------------


def test_uniform_straight_motion_has_no_roughness() -> None:
    term = Roughness(UNKNOWNS, 30.0)
    line = np.linspace(0, 1, KNOTS)[:, None] * (30.0, -12.0) + (4.0, 7.0)
    wavy = TRUTH.xy
    assert abs(float(term.cost(vector(line)))) < 1e-3 * float(term.cost(vector(wavy)))
    assert float(term.cost(vector(wavy + line))) == pytest.approx(
        float(term.cost(vector(wavy))), rel=1e-2
    )
    assert float(term.cost(vector(2 * wavy))) == pytest.approx(
        4 * float(term.cost(vector(wavy))), rel=1e-4
    )


def test_roughness_hardly_depends_on_the_number_of_knots() -> None:
    def cost(knots: int) -> float:
        t = torch.linspace(0, 1, knots)
        unknowns = Unknowns(knots, 1)
        path = 10 * torch.stack([torch.sin(6 * t), torch.cos(4 * t)], dim=1)[None]
        return float(
            Roughness(unknowns, 1.0).cost(
                unknowns.pack(path, torch.ones(1, 1), torch.zeros(1, 1, 2))
            )
        )

    assert cost(27) == pytest.approx(cost(53), rel=0.08)
    assert cost(105) == pytest.approx(cost(53), rel=0.08)


def test_smooth_motions_have_second_differences_of_an_unknown_variance() -> None:
    """The oracle integrates their normal density over ``p(v) ~ exp(-n s^2 / 2 v) / v``."""
    knots, least_px = 53, 0.04
    unknowns = Unknowns(knots, 1)
    count = 2 * (knots - 2)
    noise = np.random.default_rng(0).standard_normal((knots, 2))

    def cost(path: np.ndarray) -> float:
        packed = unknowns.pack(
            torch.tensor(path[None], dtype=torch.float32),
            torch.ones(1, 1),
            torch.zeros(1, 1, 2),
        )
        return float(SmoothMotion(unknowns).cost(packed))

    def minus_twice_log_density(path: np.ndarray) -> float:
        squares = float((np.diff(path, n=2, axis=0) ** 2).sum())
        log_v = np.linspace(-20, 10, 200_001)
        exponent = -0.5 * count * log_v - 0.5 * (squares + count * least_px**2) / np.exp(log_v)
        return -2 * float(special.logsumexp(exponent))

    smooth, rough = 0.01 * noise, 0.5 * noise
    assert cost(rough) - cost(smooth) == pytest.approx(
        minus_twice_log_density(rough) - minus_twice_log_density(smooth), rel=1e-3
    )


# -- derivatives and descent ----------------------------------------------------------------------


def all_terms(taken) -> dict[str, object]:
    return {
        "scene, fine": scene_term(taken),
        "scene, coarse": scene_term(taken, part=6, path_error_px=1.0),
        "kernels": kernel_term(taken, sigma_px=2.5),
        "kernels, saturated": kernel_term(taken, saturation=20.0),
        "roughness": Roughness(UNKNOWNS, 0.3),
        "smooth motion": SmoothMotion(UNKNOWNS),
    }


@pytest.mark.parametrize(
    "name",
    [
        "scene, fine",
        "scene, coarse",
        "kernels",
        "kernels, saturated",
        "roughness",
        "smooth motion",
    ],
)
def test_the_slope_is_half_the_derivative_of_the_cost(noisy, name: str) -> None:
    term = all_terms(noisy)[name]
    x = disturbed(2)
    matrix = torch.zeros(2, UNKNOWNS.size, UNKNOWNS.size)
    slope = torch.zeros(2, UNKNOWNS.size)
    term.add_normal(x, matrix, slope)
    assert torch.allclose(
        matrix, matrix.transpose(1, 2), rtol=1e-3, atol=1e-4 * float(matrix.abs().max())
    )
    assert float(torch.linalg.eigvalsh(matrix.double()).min()) > -1e-4 * float(matrix.abs().max())
    directions = torch.randn(8, UNKNOWNS.size, generator=torch.Generator().manual_seed(1))
    step = 1e-2
    for direction in directions:
        ahead = term.cost(x + step * direction)
        behind = term.cost(x - step * direction)
        measured = (ahead - behind).double() / (2 * step)
        scale = float((2 * slope).norm(dim=1).max())  # of a direction drawn by chance
        np.testing.assert_allclose(2 * (slope @ direction), measured, atol=0.01 * scale, rtol=0.01)


def test_a_sample_of_the_frequencies_has_the_curvature_of_all(noisy, monkeypatch) -> None:
    def curvature() -> torch.Tensor:
        matrix = torch.zeros(1, UNKNOWNS.size, UNKNOWNS.size)
        scene_term(noisy).add_normal(disturbed(1), matrix, torch.zeros(1, UNKNOWNS.size))
        photos = UNKNOWNS.kernel_shift(0)
        return matrix[0, :photos, :photos].double()

    sample = curvature()
    monkeypatch.setattr("motdiff.estimators.coded.scene_term._FREQUENCIES_PER_UNKNOWN", 10**6)
    entire = curvature()
    assert (sample != entire).any()
    # in units in which that of all is the identity; a little is added where they tell nothing
    least = 1e-3 * torch.diag(entire.diagonal())
    factor = torch.linalg.cholesky(entire + least)
    ratios = torch.linalg.solve(factor, torch.linalg.solve(factor, sample + least).T).diagonal()
    assert float(ratios.mean()) == pytest.approx(1, abs=0.1)
    assert float(ratios.min()) > 0.5
    assert float(ratios.max()) < 2


def test_a_second_call_adds(noisy) -> None:
    x = disturbed(1)
    for term in all_terms(noisy).values():
        matrix = torch.zeros(1, UNKNOWNS.size, UNKNOWNS.size)
        slope = torch.zeros(1, UNKNOWNS.size)
        term.add_normal(x, matrix, slope)
        once = matrix.clone()
        slope_once = slope.clone()
        term.add_normal(x, matrix, slope)
        torch.testing.assert_close(matrix, 2 * once)
        torch.testing.assert_close(slope, 2 * slope_once)


@pytest.mark.parametrize(
    "names",
    [
        ("kernels",),
        ("kernels, saturated", "roughness"),
        ("scene, coarse", "roughness"),
        ("scene, coarse", "smooth motion"),
    ],
)
def test_descent_never_raises_the_cost(noisy, names: tuple[str, ...]) -> None:
    terms = [all_terms(noisy)[name] for name in names]
    x = disturbed(5, size=2.0)
    before = sum(term.cost(x) for term in terms)
    given = x.clone()
    for steps in (1, 4):
        found, costs = descend(terms, x, steps=steps)
        assert (costs <= before).all()
        torch.testing.assert_close(
            costs, sum(term.cost(found) for term in terms), rtol=1e-4, atol=1e-3
        )
        before = costs
    assert torch.equal(x, given)
    assert (costs < 0.9 * sum(term.cost(x) for term in terms)).all()


def test_candidates_descend_independently(noisy) -> None:
    terms = [kernel_term(noisy), Roughness(UNKNOWNS, 0.3)]
    x = disturbed(4, size=1.0)
    together, _ = descend(terms, x, steps=4)
    alone = torch.cat([descend(terms, row[None], steps=4)[0] for row in x])
    torch.testing.assert_close(together, alone, atol=2e-2, rtol=0)


def test_a_trajectory_of_more_samples_is_the_same_motion(noisy) -> None:
    fine = Trajectory.from_samples(TRUTH.at(np.linspace(0, 1, 4 * (KNOTS - 1) + 1)))
    unknowns = Unknowns(len(fine.t), 4)
    x = unknowns.pack(
        torch.tensor(fine.xy.copy(), dtype=torch.float32)[None],
        torch.tensor(GAINS, dtype=torch.float32)[None],
        torch.tensor(SHIFTS_PX, dtype=torch.float32)[None],
    )
    otfs = CodedOtfs(noisy.codes, len(fine.t))
    term = KernelTerm(unknowns, otfs, noisy.psfs, sigma_px=1.5, weights=np.full(4, 200.0))
    assert float(term.cost(x)) < 5e-4 * 800


def test_more_knots_leave_the_path_and_what_is_each_photos_own_as_they_are():
    few = Unknowns(27, 4)
    x = torch.randn(2, few.size, generator=torch.Generator().manual_seed(1))
    more = few.resampled(x, KNOTS)
    paths = UNKNOWNS.paths(more)
    assert torch.allclose(paths[:, ::2], few.paths(x), atol=1e-6)
    middles = 0.5 * (few.paths(x)[:, 1:] + few.paths(x)[:, :-1])
    assert torch.allclose(paths[:, 1::2], middles, atol=1e-6)
    assert torch.equal(UNKNOWNS.shifts(more), few.shifts(x))
    assert torch.equal(UNKNOWNS.gains(more), few.gains(x))
    assert torch.equal(UNKNOWNS.kernel_shifts(more), few.kernel_shifts(x))
