"""Small lights' trails through codes, drawn pixel by pixel from closed forms."""

import numpy as np
import pytest
import torch
from scipy.special import erf

from motdiff.estimators.coded.misfit import Roughness, descend
from motdiff.estimators.coded.trail_estimator import TrailEstimator
from motdiff.estimators.coded.trail_term import TrailTerm, TrailUnknowns
from motdiff.trajectory import Trajectory

CODE = "1011011101011110110101110011"
SPOT_PX = 0.6


def drawn(path, code, *, side_px=48, spot_px=SPOT_PX, centre_px=(0.0, 0.0), moments=20_000):
    """Trail (side, side) of a Gaussian spot seen by square pixels, with the light of the whole
    exposure 1."""
    t = (np.arange(moments) + 0.5) / moments
    shown = np.array(list(code))[(t * len(code)).astype(int)] == "1"
    at = path.at(t)[shown] + np.asarray(centre_px)
    pixels = np.arange(side_px) - side_px // 2

    def seen(place):
        high, low = (
            (pixels[:, None] - place + edge) / (spot_px * np.sqrt(2)) for edge in (0.5, -0.5)
        )
        return 0.5 * (erf(high) - erf(low))

    return seen(at[:, 1]) @ seen(at[:, 0]).T / moments


def photo(path, code, *, peak=0.8, background=0.03, noise=0.004, seed=0, **options):
    trail = drawn(path, code, **options)
    rng = np.random.default_rng(seed)
    return np.clip(
        background + peak * trail / trail.max() + noise * rng.standard_normal(trail.shape), 0, 1
    )


def apart_px(a, b):
    t = np.linspace(0, 1, 401)
    d = a.at(t) - b.at(t)
    return np.sqrt(((d - d.mean(axis=0)) ** 2).sum(axis=1).mean())


def arc(turn_rad=2.0, length_px=30.0):
    angle = np.linspace(0, turn_rad, 200)
    return Trajectory.from_samples(
        length_px / turn_rad * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    )


def candidate(unknowns, path, light, shifts=None):
    knots = torch.tensor(path.at(np.linspace(0, 1, unknowns.knots))[None], dtype=torch.float32)
    moved = (
        torch.zeros(1, unknowns.exposures, 2)
        if shifts is None
        else torch.tensor(shifts, dtype=torch.float32)[None]
    )
    return unknowns.pack_trails(
        knots, moved, torch.tensor([light], dtype=torch.float32), torch.tensor([SPOT_PX])
    )


def test_the_true_path_explains_its_trails_to_the_last_pixel():
    path = arc()
    codes = (CODE, CODE[::-1])
    shifts = [(0.0, 0.0), (1.3, -0.6)]
    images = [
        drawn(path, code, centre_px=shift) for code, shift in zip(codes, shifts, strict=True)
    ]
    unknowns = TrailUnknowns(2 * len(CODE) + 1, 2)
    term = TrailTerm(
        unknowns, codes, images, [np.full(image.shape, image.max()) for image in images]
    )
    residuals = term.residuals(candidate(unknowns, path, [1.0, 1.0], shifts))
    assert max(float(residual.abs().max()) for residual in residuals) < 2e-3


@pytest.mark.parametrize("blur_px", [0.0, 1.5])
def test_slopes_are_those_of_the_cost(blur_px):
    path = arc()
    codes = (CODE, CODE[::-1])
    images = [drawn(path, code) for code in codes]
    unknowns = TrailUnknowns(2 * len(CODE) + 1, 2)
    term = TrailTerm(unknowns, codes, images, [np.full((48, 48), 1e-3)] * 2, blur_px=blur_px)
    x = candidate(unknowns, arc(1.7, 31), [1.1, 0.9], [(0, 0), (0.4, 0.2)])
    matrix = torch.zeros(1, unknowns.size, unknowns.size)
    slope = torch.zeros(1, unknowns.size)
    term.add_normal(x, matrix, slope)
    for index in (
        0,
        31,
        unknowns.shift(1),
        unknowns.gain(0),
        unknowns.gain(1),
        unknowns.offset(1),
        unknowns.spot,
    ):
        step = torch.zeros_like(x)
        step[0, index] = 1e-4 if index == unknowns.offset(1) else 3e-3
        measured = float(term.cost(x + step) - term.cost(x - step)) / (4 * float(step.max()))
        assert measured == pytest.approx(
            float(slope[0, index]), rel=0.02, abs=1e-3 * float(slope.abs().max())
        )


def test_descent_recovers_path_light_and_spot():
    path = arc()
    image = 5 * drawn(path, CODE, spot_px=0.8)
    unknowns = TrailUnknowns(2 * len(CODE) + 1, 1)
    term = TrailTerm(unknowns, (CODE,), [image], [np.full(image.shape, 0.01 * image.max())])
    x, _ = descend(
        [term, Roughness(unknowns, 1.0)], candidate(unknowns, arc(1.9, 30), [4.0]), steps=30
    )
    assert apart_px(Trajectory.from_samples(unknowns.paths(x)[0].double().numpy()), path) < 0.05
    assert float(unknowns.light(x)[0, 0]) == pytest.approx(5, rel=0.01)
    assert float(unknowns.spot_px(x)[0]) == pytest.approx(0.8, rel=0.02)


@pytest.mark.slow(reason="two searches")
def test_a_loop_through_a_code_is_found_in_its_order_and_direction():
    angle = np.linspace(-0.6, 2 * np.pi + 0.3, 400)  # crosses itself once
    loop = Trajectory.from_samples(
        9 * np.stack([np.sin(angle) + 0.15 * angle, np.cos(angle)], axis=1)
    )
    found = TrailEstimator([CODE]).estimate(photo(loop, CODE))
    assert apart_px(found.best, loop) < 0.1 < 1 < apart_px(found.best.reversed(), loop)
    assert found.best.direction == "known"
    assert found.confidence > 0.5
    assert found.details["path_uncertainty_px"] < 0.3


@pytest.mark.slow(reason="four searches")
def test_a_direction_that_the_code_hides_is_not_stated_with_confidence():
    line = Trajectory.straight(20.0, angle_rad=0.4)
    nearly_its_mirror_image = "1" * 20 + "0" + "1" * 19  # the gap is half a pixel off the middle
    found = TrailEstimator([nearly_its_mirror_image]).estimate(
        photo(line, nearly_its_mirror_image, spot_px=1.5, noise=0.02)
    )
    assert found.confidence < 0.75


def test_refusals_name_the_photo():
    dark = np.full((64, 64), 0.02) + 0.002 * np.random.default_rng(0).standard_normal((64, 64))
    with pytest.raises(ValueError, match=r"^photo: shows no light"):
        TrailEstimator([CODE]).estimate(dark)
    at_border = np.roll(photo(arc(), CODE), 24, axis=1)
    with pytest.raises(ValueError, match=r"^photo 2: the light's trail is cut off"):
        TrailEstimator([CODE, CODE[::-1]]).estimate_from([photo(arc(), CODE), at_border])
    with pytest.raises(ValueError, match="saturated"):
        TrailEstimator([CODE]).estimate(photo(arc(), CODE, peak=3.0))
