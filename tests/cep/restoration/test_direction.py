import numpy as np
import pytest
from skimage import data

from cep.optics.camera import Camera
from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.restoration import direction
from cep.restoration.direction import compare_psfs
from motdiff.estimators.coded.starts import orders
from motdiff.metrics import mnc_subpixel
from motdiff.motions import boracchi_foi
from motdiff.trajectory import Trajectory

RASKAR_52 = ShutterCode("1010000111000001010000110011110111010111001001100111")
PALINDROME = ShutterCode("1101000110110001011")


def linear(name):
    image = getattr(data, name)() / 255.0
    return (image**2.2)[:300, :300]


def curved():
    t = np.linspace(0, 1, 80)
    return Trajectory.from_samples(np.stack([15.7 * t, 8.9 * np.sin(2.4 * t)], axis=1))


def photo_along(path, code, *, scene="camera", sigma=0.005, seed=0):
    camera = Camera(photons_full_scale=1e6, read_noise_e=sigma * 1e6)
    return capture(
        linear(scene), coded_psf(path, code), camera=camera, rng=np.random.default_rng(seed)
    )


@pytest.mark.parametrize("scene", ["camera", "coffee"])
@pytest.mark.parametrize("sigma", [0.002, 0.01])
@pytest.mark.parametrize(
    "path", [curved(), Trajectory.straight(22.0, angle_rad=0.3)], ids=["curved", "straight"]
)
def test_says_which_way_the_camera_ran(path, scene, sigma):
    result = direction.detect_direction(
        photo_along(path, RASKAR_52, scene=scene, sigma=sigma), path, RASKAR_52
    )
    assert result.direction == "forward"
    assert result.confidence > 0.6
    np.testing.assert_allclose(result.psf, coded_psf(path, RASKAR_52))


def test_swapping_the_paths_swaps_the_answer():
    path = curved()
    photo = photo_along(path, RASKAR_52)
    one = direction.detect_direction(photo, path, RASKAR_52)
    other = direction.detect_direction(photo, path.reversed(), RASKAR_52)
    assert (one.direction, other.direction) == ("forward", "reverse")
    assert one.confidence == pytest.approx(other.confidence, rel=1e-6)
    assert one.residuals == pytest.approx(other.residuals[::-1], rel=1e-6)
    np.testing.assert_allclose(one.psf, other.psf, atol=1e-12)


def test_random_hand_shakes():
    rng = np.random.default_rng(5)
    right = []
    for _ in range(10):
        path = boracchi_foi(rng)
        sigma = float(np.exp(rng.uniform(np.log(0.002), np.log(0.01))))
        psfs = [coded_psf(p, RASKAR_52) for p in (path, path.reversed())]
        photo = photo_along(path, RASKAR_52, sigma=sigma, seed=int(rng.integers(1 << 30)))
        right.append(compare_psfs(photo, *psfs).direction == "forward")
    assert sum(right) >= 9


@pytest.mark.parametrize(
    ("path", "code"),
    [(curved(), ShutterCode("1" * 20)), (Trajectory.straight(15.0), PALINDROME)],
    ids=["uncoded", "palindrome on a straight path"],
)
def test_symmetric_cases_are_undecidable(path, code):
    result = direction.detect_direction(photo_along(path, code), path, code)
    assert result.direction == "undecidable"
    assert result.confidence == 0.5
    np.testing.assert_allclose(result.psf, coded_psf(path, code))


def eight():
    """A figure of eight that is open at one end: four orders draw its PSF."""
    turn = np.linspace(-0.3 * np.pi, 1.3 * np.pi, 200)
    return Trajectory.from_samples(np.stack([9 * np.sin(turn), 6 * np.sin(2 * turn)], axis=1))


def test_a_loop_that_was_run_the_other_way_round_is_found():
    path = eight()
    others = orders(path, knots=201, count=24)
    assert len(others) == 4
    for i, xy in enumerate(others):
        taken = Trajectory.from_samples(xy)
        result = direction.detect_direction(photo_along(taken, RASKAR_52), path, RASKAR_52)
        assert result.direction == ("forward", "reverse", "reordered", "reordered")[i]
        assert len(result.likelihoods) == len(result.residuals) == 4
        assert mnc_subpixel(result.psf, coded_psf(taken, RASKAR_52)) > 0.99
        np.testing.assert_allclose(coded_psf(result.trajectory, RASKAR_52), result.psf, atol=1e-12)
        assert 0.5 < result.confidence <= 1


def test_a_path_without_loops_has_two_orders():
    result = direction.detect_direction(photo_along(curved(), RASKAR_52), curved(), RASKAR_52)
    assert len(result.likelihoods) == 2
    np.testing.assert_array_equal(result.trajectory.xy, curved().xy)


def test_featureless_photo_is_undecidable():
    assert compare_psfs(np.full((60, 60), 0.2), *_pair()).direction == "undecidable"


def test_colour_and_large_photos():
    scene = np.stack([linear("camera")] * 3, axis=-1) * np.array([1.0, 0.8, 0.6])
    scene = np.tile(scene, (3, 3, 1))
    photo = capture(scene, _pair()[0], camera=Camera(1e5), rng=np.random.default_rng(0))
    assert photo.shape[0] > 512
    assert compare_psfs(photo, *_pair()).direction == "forward"


def test_bad_photo():
    with pytest.raises(ValueError, match="photo"):
        direction.detect_direction(np.full((20, 20), np.nan), curved(), RASKAR_52)


def _pair():
    return coded_psf(curved(), RASKAR_52), coded_psf(curved().reversed(), RASKAR_52)
