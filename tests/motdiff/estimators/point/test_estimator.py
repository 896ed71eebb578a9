"""The point estimator on drawn lights."""

import json

import numpy as np
import pytest

from motdiff.estimators.point import estimator
from motdiff.estimators.point.estimator import PointEstimator
from motdiff.metrics import mnc_subpixel
from motdiff.motions import boracchi_foi, quadratic
from motdiff.simulate import blur_valid, photograph


def night(lights: list[tuple[int, int, float]], *, level: float = 0.02) -> np.ndarray:
    scene = np.full((300, 400), level)
    for row, column, strength in lights:
        scene[row, column] += strength
    return scene


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("colour", [False, True])
def test_one_light(seed: int, colour: bool) -> None:
    rng = np.random.default_rng(seed)
    motion = (boracchi_foi if seed % 2 else quadratic)(rng)
    scene = night([(150, 180, 4.0)])
    scene = np.stack([scene, 0.7 * scene, 0.4 * scene], axis=2) if colour else scene
    photo = photograph(scene, motion.psf(64), rng=rng, photons_full_scale=10_000, read_sigma=0.003)
    estimate = PointEstimator().estimate(photo)
    assert mnc_subpixel(estimate.psf, motion.psf(64)) >= 0.98
    assert estimate.psf.shape == (64, 64)
    assert estimate.psf.sum() == pytest.approx(1)
    assert estimate.psf.min() >= 0
    at = np.arange(64) - 32
    assert max(abs(at @ estimate.psf.sum(axis=0)), abs(at @ estimate.psf.sum(axis=1))) <= 0.51
    assert estimate.confidence > 0.9
    assert estimate.warnings == ()
    assert mnc_subpixel(estimate.trajectories[0].psf(96), motion.psf(64)) > 0.85
    json.dumps(estimate.details, allow_nan=False)


def test_several_lights_are_averaged_and_beat_the_best_alone(monkeypatch) -> None:
    rng = np.random.default_rng(1)
    psf = boracchi_foi(rng).psf(64)
    places = [(80, 90), (90, 300), (200, 100), (210, 300), (140, 200)]
    photo = photograph(night([(r, c, 3.0) for r, c in places]), psf, rng=rng, read_sigma=0.01)
    together = PointEstimator().estimate(photo)
    monkeypatch.setattr(estimator, "_MOST_LIGHTS", 1)
    alone = PointEstimator().estimate(photo)
    assert together.details["streaks"] == 5
    assert together.details["averaged"] == 5
    assert alone.details["averaged"] == 1
    assert mnc_subpixel(together.psf, psf) > mnc_subpixel(alone.psf, psf)


def test_saturation_is_told_and_an_unsaturated_light_preferred() -> None:
    rng = np.random.default_rng(0)
    psf = quadratic(rng, min_length_px=20, max_length_px=20).psf(64)
    bright = photograph(night([(150, 180, 60.0)]), psf, rng=rng, read_sigma=0.003)
    estimate = PointEstimator().estimate(bright)
    assert any("saturated" in warning for warning in estimate.warnings)
    assert estimate.confidence < 0.7
    both = photograph(night([(150, 120, 60.0), (150, 280, 4.0)]), psf, rng=rng, read_sigma=0.003)
    preferred = PointEstimator().estimate(both)
    assert preferred.warnings == ()
    assert mnc_subpixel(preferred.psf, psf) > 0.98


def test_lights_that_disagree_are_told() -> None:
    rng = np.random.default_rng(0)
    psfs = [boracchi_foi(np.random.default_rng(seed)).psf(64) for seed in range(3)]
    strips = [blur_valid(night([(150, 200, 4.0)]), psf) for psf in psfs]
    photo = np.hstack(strips)
    photo = photo + 0.002 * rng.standard_normal(photo.shape)
    estimate = PointEstimator().estimate(photo)
    assert any("agree" in warning for warning in estimate.warnings)


def test_a_sloping_background_is_removed() -> None:
    rng = np.random.default_rng(2)
    psf = quadratic(rng, min_length_px=25, max_length_px=25).psf(64)
    scene = night([(150, 180, 6.0)]) + np.linspace(0.05, 0.12, 400)
    photo = photograph(scene, psf, rng=rng, read_sigma=0.003)
    assert mnc_subpixel(PointEstimator().estimate(photo).psf, psf) > 0.97


def test_no_light_cut_off_or_too_long() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="no light streak"):
        PointEstimator().estimate(0.1 + 0.01 * rng.standard_normal((200, 200)))
    for flat in (np.zeros((100, 100)), np.ones((100, 100)), np.zeros((1, 1))):
        with pytest.raises(ValueError, match="no light streak"):
            PointEstimator().estimate(flat)
    cut = 0.02 + 0.002 * rng.standard_normal((100, 100))
    cut[40, :20] += 0.3
    with pytest.raises(ValueError, match="1 cut off"):
        PointEstimator().estimate(cut)
    long = 0.02 + 0.002 * rng.standard_normal((200, 200))
    long[100, 20:180] += 0.3
    with pytest.raises(ValueError, match="1 longer than the 64 px frame"):
        PointEstimator().estimate(long)
