import numpy as np
import pytest

from cep.optics.camera import Camera
from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.restoration.wiener import wiener
from lab.rivals.inverse_filter import inverse_filter
from motdiff.metrics import psnr
from motdiff.simulate import visible
from motdiff.trajectory import Trajectory

PSF = coded_psf(Trajectory.straight(9.0, angle_rad=0.5), ShutterCode("1011000110111010"), 32)
SCENE = np.kron(np.random.default_rng(0).random((12, 12)), np.ones((12, 12)))


def test_without_a_floor_it_is_the_wiener_filter_without_noise():
    photo = 0.5 * SCENE
    np.testing.assert_allclose(
        inverse_filter(photo, PSF, floor=0.0, border="periodic"),
        wiener(photo, PSF, noise_variance=0.0, border="periodic"),
        atol=1e-9,
    )


@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_a_photo_is_restored_at_the_scale_of_the_full_exposure_also_where_it_is_clipped(scale):
    camera = Camera(photons_full_scale=1e6)
    light = capture(SCENE, PSF, camera=camera, rng=np.random.default_rng(0))
    photo = np.clip(scale * light, 0, 1)
    restored = inverse_filter(photo, scale * PSF)
    truth = visible(SCENE, 32)
    assert psnr(restored, truth) > psnr(photo / (scale * PSF.sum()), truth) + 3


def test_a_floor_is_a_share_of_the_open_time():
    with pytest.raises(ValueError, match=r"^floor: must lie within 0\.\.1"):
        inverse_filter(SCENE, PSF, floor=1.0)
