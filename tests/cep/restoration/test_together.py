"""One scene from several photos of one motion, each through its own code."""

from contextlib import suppress

import numpy as np
import pytest
from scipy import ndimage

from cep.optics.camera import Camera
from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.restoration.plug_and_play import pnp, pnp_together
from cep.restoration.restore import restore
from cep.restoration.together import registered_psfs, restore_together, shift_and_gain
from motdiff.metrics import psnr_up_to_shift, timed_distance_px
from motdiff.path_psfs import slice_psfs
from motdiff.psf_frame import in_frame
from motdiff.simulate import visible
from motdiff.trajectory import Trajectory

CODE = ShutterCode("1010000111000001010000110011110111010111001001100111")
PAIR = (CODE, CODE.complement())
CAMERA = Camera(photons_full_scale=10_000, read_noise_e=50)
CAMERAS = (CAMERA, CAMERA)


def hook():
    """Path that turns and changes its speed: no order in time is like another."""
    t = np.linspace(0, 1, 60)
    angle = 2.5 * t**1.5
    return Trajectory.from_samples(
        9 * np.stack([np.cos(angle) + 0.8 * t, np.sin(1.3 * angle)], axis=1), direction="known"
    )


def blocks(side_px=200, seed=0):
    """Scene of sharp random blocks of three sizes."""
    rng = np.random.default_rng(seed)
    scene = np.zeros((side_px, side_px))
    for size_px in (5, 13, 40):
        cells = rng.random((side_px // size_px + 1,) * 2)
        scene += np.kron(cells, np.ones((size_px, size_px)))[:side_px, :side_px] / 3
    return scene


def photos_of(scene, path, codes, *, camera=CAMERA, seed=1):
    rng = np.random.default_rng(seed)
    return [capture(scene, path, code, camera, rng=rng) for code in codes]


def test_a_code_and_its_complement_share_the_light():
    opened, closed = (code.array for code in PAIR)
    np.testing.assert_array_equal(opened + closed, 1)
    assert CODE.complement().complement() == CODE
    with pytest.raises(ValueError, match="closed"):
        ShutterCode("11").complement()


@pytest.mark.parametrize(("right", "down", "gain"), [(0, 0, 1), (2.3, -1.6, 0.7), (-6, 4.5, 1.2)])
def test_shift_and_gain_are_those_of_a_band_limited_image(right, down, gain):
    image = ndimage.gaussian_filter(blocks(160), 2)
    moved = gain * ndimage.shift(image, (down, right), order=5, mode="nearest")
    shift, factor, rms = shift_and_gain(image, moved)
    assert shift == pytest.approx((right, down), abs=0.02)
    assert factor == pytest.approx(gain, rel=1e-3)
    assert rms < 2e-3


def test_flat_photos_are_not_moved():
    shift, gain, _ = shift_and_gain(np.full((40, 50), 0.5), np.full((40, 50), 0.25))
    assert shift == (0, 0)
    assert gain == pytest.approx(0.5)


def test_photos_are_registered_through_their_blur():
    """The second photo shows the scene 1.4 px right and 2.2 px up, and is darker."""
    path = hook()
    scene = blocks()
    frame = 31
    chips = slice_psfs(
        path.t, path.xy + np.array([1.4, -2.2]), np.linspace(0, 1, CODE.chips + 1), frame
    )
    psfs = [coded_psf(path, PAIR[0], frame), 0.8 * np.tensordot(PAIR[1].array, chips, axes=1)]
    rng = np.random.default_rng(0)
    first, second = (capture(scene, psf, camera=CAMERA, rng=rng) for psf in psfs)
    drawn, apart = registered_psfs([first, second], path, PAIR)
    for psf, true in zip(drawn, psfs, strict=True):
        np.testing.assert_allclose(in_frame(psf, frame), true, atol=0.05 * true.max())
        assert psf.sum() == pytest.approx(true.sum(), rel=0.01)
        centre, true_centre = (
            ndimage.center_of_mass(in_frame(kernel, frame)) for kernel in (psf, true)
        )
        np.testing.assert_allclose(centre, true_centre, atol=0.03)
    assert apart == pytest.approx(np.sqrt(CAMERA.noise_variance(first).mean()), rel=0.3)


def test_the_misfit_tells_the_order_in_time():
    path = hook()
    photos = photos_of(blocks(), path, PAIR)
    true, reverse = (registered_psfs(photos, way, PAIR)[1] for way in (path, path.reversed()))
    assert true < 0.5 * reverse


def test_two_photos_that_are_one_have_half_its_noise():
    """The same photo twice, with independent noise, is restored as their mean."""
    path = Trajectory.straight(5.0)
    scene = blocks()
    photos = photos_of(scene, path, (ShutterCode("1"), ShutterCode("1")))
    psf = coded_psf(path, ShutterCode("1"), 11)
    together = pnp_together(photos, [psf, psf], cameras=CAMERAS)
    mean = np.mean(photos, axis=0)
    halved = pnp(mean, psf, noise_variance=CAMERA.noise_variance(mean).mean() / 2)
    # their scenes' spectra are fitted apart: far below the noise of 0.006
    assert np.sqrt(np.mean((together - halved) ** 2)) < 1e-3


def test_a_noisier_photo_counts_less():
    """Beside a good photo one of noise alone changes next to nothing."""
    path = Trajectory.straight(5.0)
    psf = coded_psf(path, ShutterCode("1"), 11)
    good = photos_of(blocks(), path, (ShutterCode("1"),), camera=Camera(read_noise_e=20))[0]
    noisy = good + np.random.default_rng(0).normal(0, 0.5, good.shape)
    np.testing.assert_allclose(pnp_together([good, noisy], [psf, psf]), pnp(good, psf), atol=5e-3)


@pytest.mark.slow(reason="restores three photos, one with the trained denoiser twice")
def test_a_pair_keeps_what_each_photo_loses():
    path = hook()
    scene = blocks()
    photos = photos_of(scene, path, PAIR)
    sharp = visible(scene, path.frame_size() | 1)

    def psnr_db(image):
        return psnr_up_to_shift(np.clip(image, 0, 1), sharp, crop_px=25)

    both = restore_together(photos, PAIR, path, cameras=CAMERAS)
    singles = [
        restore(photo, trajectory=path, code=code, camera=CAMERA)
        for photo, code in zip(photos, PAIR, strict=True)
    ]
    assert psnr_db(both.image) > max(psnr_db(single.image) for single in singles) + 1


def test_of_a_path_without_direction_the_photos_tell_it():
    path = hook()
    photos = photos_of(blocks(), path.reversed(), PAIR)
    unknown = Trajectory(path.t, path.xy, direction="unknown")
    restored = restore_together(photos, PAIR, unknown, cameras=CAMERAS)
    assert timed_distance_px(restored.trajectory, path.reversed()) < 0.1
    assert restored.direction == "reverse"
    assert restored.trajectory.direction == "known"


def test_an_order_that_lays_the_photos_far_apart_is_only_wrong():
    """Of the reverse a long motion's halves lie its own length from where they are."""
    path = Trajectory.straight(48.0)
    halves = ShutterCode("1" * 8 + "0" * 8)
    codes = (halves, halves.complement())
    photos = photos_of(blocks(246), path, codes)
    unknown = Trajectory(path.t, path.xy, direction="unknown")
    with pytest.raises(ValueError, match="photo 2"):
        registered_psfs(photos, path.reversed(), codes)
    restored = restore_together(photos, codes, unknown, cameras=CAMERAS)
    assert restored.direction == "forward"


def test_photos_that_do_not_belong_together_are_noticed():
    path = hook()
    photos = photos_of(blocks(), path, PAIR)
    (elsewhere,) = photos_of(blocks(seed=9), path, PAIR[1:])
    for second, codes in ((elsewhere, PAIR), (photos[1], (CODE, CODE))):
        try:
            warnings = restore_together([photos[0], second], codes, path).warnings
        except ValueError as error:
            warnings = (str(error),)
        assert any("scene" in text for text in warnings)
    assert not restore_together(photos, PAIR, path).warnings


def test_clipped_light_is_inferred():
    """A lamp that is white in both photos: around it the scene is restored as without it."""
    path = hook()
    scene = blocks()
    lamp = scene.copy()
    lamp[95:105, 95:105] = 12
    photos = photos_of(lamp, path, PAIR)
    restored = restore_together(photos, PAIR, path)
    assert restored.saturated_fraction > 0.005
    assert any("clipped" in text for text in restored.warnings)
    frame = path.frame_size() | 1
    sharp = visible(scene, frame)
    far = np.ones(sharp.shape, dtype=bool)
    far[40:-40, 40:-40] = False
    far[:20] = far[-20:] = far[:, :20] = far[:, -20:] = False
    assert np.sqrt(np.mean((restored.image - sharp)[far] ** 2)) < 0.05


def test_three_photos_in_colour():
    path = hook()
    scene = np.stack([blocks(), blocks(seed=1), blocks(seed=2)], axis=-1)
    codes = (*PAIR, ShutterCode("1" * CODE.chips))
    photos = photos_of(scene, path, codes)
    restored = restore_together(photos, codes, path)
    sharp = visible(scene, path.frame_size() | 1)
    assert restored.image.shape == sharp.shape
    assert np.sqrt(np.mean((restored.image - sharp)[25:-25, 25:-25] ** 2)) < 0.05


@pytest.mark.parametrize("seed", range(3))
def test_photos_without_a_common_scene_do_not_run_away(seed):
    """Neither noise nor opposite slopes have a shift: none is made up that is out of reach."""
    rng = np.random.default_rng(seed)
    slope = np.linspace(0.2, 0.8, 120) * np.ones((100, 1))
    pairs = [(slope, slope[:, ::-1]), tuple(0.5 + 0.02 * rng.standard_normal((2, 100, 120)))]
    for pair in pairs:
        shift_px, gain, rms = shift_and_gain(*pair)
        assert np.abs(shift_px).max() < 70  # half a side, and steps from there
        assert np.isfinite([gain, rms]).all()
        with suppress(ValueError):  # the other outcome: refused, as photos of different scenes
            assert np.isfinite(registered_psfs(pair, Trajectory.straight(9.0), PAIR)[0]).all()


@pytest.mark.slow(reason="searches the motion of two photos")
def test_an_unknown_motion_is_estimated_from_the_pair(short_search):
    path = hook()
    scene = blocks(240)
    photos = photos_of(scene, path, PAIR)
    shares = []
    restored = restore_together(
        photos, PAIR, cameras=CAMERAS, progress=lambda share, _: shares.append(share)
    )
    assert timed_distance_px(restored.trajectory, path) < 0.5
    assert restored.psf_confidence >= 0.5
    assert shares == sorted(shares)
    sharp = visible(scene, path.frame_size() | 1)
    told = restore_together(photos, PAIR, path, cameras=CAMERAS)
    gap_db = psnr_up_to_shift(told.image, sharp) - psnr_up_to_shift(restored.image, sharp)
    assert gap_db < 1.5


@pytest.mark.parametrize(
    ("photos", "codes", "path", "named"),
    [
        ([np.zeros((64, 64))], PAIR[:1], hook(), "photos: need at least two"),
        ([np.zeros((64, 64))] * 2, PAIR[:1], hook(), "code: needs one for each photo"),
        ([np.zeros((64, 64)), np.zeros((64, 65))], PAIR, hook(), "photo 2: has"),
        ([np.zeros((64, 64)), np.zeros((64, 64, 3))], PAIR, hook(), "photo 2: has"),
        ([np.zeros((12, 12))] * 2, PAIR, hook(), "trajectory: the motion spans"),
    ],
)
def test_what_does_not_fit_is_refused(photos, codes, path, named):
    with pytest.raises(ValueError, match=named):
        restore_together(photos, codes, path)
