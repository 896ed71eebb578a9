"""Which path is kept after a refinement, with kernels that are found beside the sharp scene."""

import numpy as np
import pytest

from cep.calibration.refine import _stands_alone, refine_motion
from cep.optics.camera import Camera
from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from motdiff.estimators.coded.refine import RefinedPath
from motdiff.estimators.reference.estimator import ReferenceEstimator
from motdiff.metrics import timed_distance_px
from motdiff.trajectory import Trajectory

CODES = (ShutterCode("110100010110111011010001"), ShutterCode("1" * 12 + "0" * 12))
PATH = Trajectory.from_samples([[0, 0], [5, 0], [9, 2], [11, 6], [11, 11]], direction="known")
CAMERA = Camera(photons_full_scale=1e6, read_noise_e=3000)
SCENE = 0.1 + 0.8 * np.kron(np.random.default_rng(3).random((20, 20)), np.ones((8, 8)))


def photos_along(path):
    rng = np.random.default_rng(1)
    return [capture(SCENE, path, code, camera=CAMERA, rng=rng) for code in CODES]


def rough(path, error_px):
    t = np.linspace(0, 1, 101)
    wave = np.stack([np.sin(2 * np.pi * t), np.cos(2 * np.pi * t)], axis=1)
    return Trajectory.from_samples(path.at(t) + error_px * wave, t=t, direction=path.direction)


def refined(photos, path, **options):
    return refine_motion(
        photos, CODES[: len(photos)], path, kernels=ReferenceEstimator(SCENE), **options
    )


@pytest.mark.parametrize(
    "photos", [1, pytest.param(2, marks=pytest.mark.slow(reason="fits to two photos"))]
)
def test_a_rough_path_is_refined(photos):
    shares = []
    found = refined(
        photos_along(PATH)[:photos],
        rough(PATH, 1.0),
        progress=lambda share, _what: shares.append(share),
    )
    assert found.kept == "refined"
    assert found.confidence is None if photos == 2 else found.confidence > 0.8
    assert timed_distance_px(found.trajectory, PATH) < 0.4
    assert found.trajectory.direction == "known"
    assert found.moved_px > 0.5
    assert found.uncertainty_px <= 1.0
    assert (found.misfit is None) == (photos == 1)
    assert shares == sorted(shares)
    assert shares[-1] == 1


@pytest.mark.parametrize(
    "photos", [1, pytest.param(2, marks=pytest.mark.slow(reason="fits to two photos"))]
)
def test_the_true_path_is_kept(photos):
    found = refined(photos_along(PATH)[:photos], PATH)
    assert (found.kept, found.moved_px) == ("given", 0.0)
    assert found.trajectory.xy is not None
    np.testing.assert_allclose(found.trajectory.xy, PATH.xy, atol=1e-9)
    assert found.uncertainty_px == 1.0


@pytest.mark.slow(reason="fits to two photos from both directions")
def test_two_photos_tell_the_direction_of_a_path_that_runs_backwards():
    backwards = rough(Trajectory(PATH.t, PATH.xy).reversed(), 0.5)
    assert backwards.direction == "unknown"
    found = refined(photos_along(PATH), backwards)
    assert timed_distance_px(found.trajectory, PATH) < 0.4
    assert found.trajectory.direction == "known"


@pytest.mark.slow(reason="a long descent")
def test_photos_of_another_motion_are_told():
    other = Trajectory.from_samples([[0, 0], [-6, 4], [-12, 2], [-14, -6]])
    found = refined(photos_along(other), PATH)
    assert any("was the motion the same" in line for line in found.warnings)
    assert (found.kept, found.moved_px, found.uncertainty_px) == ("given", 0.0, 1.0)
    assert found.trajectory is PATH


@pytest.mark.slow(reason="a long descent")
def test_swapped_codes_are_told():
    found = refined(photos_along(PATH)[::-1], PATH)
    assert any("are the codes given in the photos' order" in line for line in found.warnings)
    assert (found.kept, found.uncertainty_px) == ("given", 1.0)


class OfScenes:
    """Finds the kernels of photos of different scenes, each beside its own."""

    def __init__(self, *scenes):
        self.beside = [ReferenceEstimator(scene) for scene in scenes]

    def estimate(self, photo):
        return self.beside.pop(0).estimate(photo)


def test_among_photos_of_different_scenes_the_coded_one_decides_the_order_to_beat():
    """An open shutter shows no order: the true path, given backwards, would be bettered by its
    reverse."""
    other = 0.1 + 0.8 * np.kron(np.random.default_rng(8).random((20, 20)), np.ones((8, 8)))
    codes = (ShutterCode("1" * CODES[0].chips), CODES[0])
    rng = np.random.default_rng(1)
    photos = [
        capture(scene, PATH, code, camera=CAMERA, rng=rng)
        for scene, code in zip((SCENE, other), codes, strict=True)
    ]
    backwards = Trajectory(PATH.t, PATH.xy).reversed()
    found = refine_motion(photos, codes, backwards, kernels=OfScenes(SCENE, other))
    assert (found.kept, found.misfit) == ("given", None)


@pytest.mark.parametrize(
    ("other_order_cost", "alone"), [(1000.0, True), (101.0, False)], ids=["dearer", "as cheap"]
)
def test_only_another_order_that_fits_as_well_leaves_the_direction_open(other_order_cost, alone):
    """Another fit of the same order, however far, does not."""
    bend = np.stack([np.linspace(0, 30, 40), np.linspace(0, 3, 40) ** 2], axis=1)
    path = Trajectory.from_samples(bend, direction="known")

    def refined(given, trajectory, cost):
        return RefinedPath(given, trajectory, cost, 1.0, 1.0, 1000.0, 0.1)

    fits = [
        refined(path, path, 100.0),
        refined(path, Trajectory.from_samples(1.3 * bend, direction="known"), 101.0),
        refined(path.reversed(), path.reversed(), other_order_cost),
    ]
    assert _stands_alone(fits, least_gain=10.0) == alone


def test_codes_of_different_speeds_are_refused():
    slow = (CODES[0], ShutterCode(CODES[1].bits, 2 * CODES[1].chip_ns))
    with pytest.raises(ValueError, match=r"^code 2: its chips last"):
        refine_motion(photos_along(PATH), slow, PATH)


def test_a_flat_photo_is_named_by_its_number_where_there_are_several():
    flat = np.full((80, 80), 0.4)
    with pytest.raises(ValueError, match=r"^photo 2: is the same all over"):
        refined([photos_along(PATH)[0], flat], PATH)
    with pytest.raises(ValueError, match=r"^photo: is the same all over"):
        refined([flat], PATH)


def test_an_uncertainty_of_nothing_is_refused():
    with pytest.raises(ValueError, match=r"^uncertainty_px: must be above 0"):
        refined(photos_along(PATH), PATH, uncertainty_px=0.0)


def test_a_photo_given_twice_is_refused():
    photo = photos_along(PATH)[0]
    with pytest.raises(ValueError, match=r"^photo 2: is the same as photo 1"):
        refined([photo, photo], PATH)
