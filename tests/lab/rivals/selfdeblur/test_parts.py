"""What SelfDeblur is made of: its blur, its loss, its generators, and what is made of an unjudged
kernel."""

import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity as reference_similarity

from lab.rivals.selfdeblur import SelfDeblurConfig
from lab.rivals.selfdeblur.fit import structural_similarity
from lab.rivals.selfdeblur.generators import ImageGenerator, KernelGenerator, _NonLocal
from motdiff.estimators.description import estimate_from_kernel
from motdiff.metrics import mnc
from motdiff.simulate import blur_valid
from motdiff.training.simulation import blurred
from motdiff.trajectory import Trajectory

TINY = SelfDeblurConfig(
    kernel_px=9,
    levels=3,
    channels=6,
    skip_channels=2,
    input_channels=3,
    kernel_inputs=4,
    kernel_hidden=8,
)


@pytest.mark.parametrize(("shape", "kernel_px"), [((3, 40, 31), 9), ((29, 37), 8), ((20, 20), 20)])
def test_the_blur_is_the_projects_true_convolution(shape, kernel_px):
    rng = np.random.default_rng(0)
    sharp = rng.random(shape)
    kernel = rng.random((kernel_px, kernel_px))
    found = blurred(torch.from_numpy(sharp), torch.from_numpy(kernel)).numpy()
    expected = np.stack([blur_valid(image, kernel) for image in sharp.reshape(-1, *shape[-2:])])
    np.testing.assert_allclose(found.reshape(expected.shape), expected, atol=1e-10)


def test_the_structural_similarity_is_the_published_one():
    rng = np.random.default_rng(1)
    a = rng.random((40, 52))
    b = np.clip(0.7 * a + 0.2 * rng.random(a.shape), 0, 1)
    expected = reference_similarity(
        a, b, data_range=1.0, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
    )
    found = structural_similarity(torch.from_numpy(a), torch.from_numpy(b)).item()
    assert found == pytest.approx(expected, abs=1e-9)
    assert structural_similarity(torch.from_numpy(a), torch.from_numpy(a)).item() == pytest.approx(
        1
    )


def test_the_generators_have_the_published_sizes():
    """2.37 M and 0.93 M parameters were counted in the published program at Levin's 27-px
    kernel."""
    config = SelfDeblurConfig(kernel_px=27)
    counts = [
        sum(p.numel() for p in made(config).parameters())
        for made in (ImageGenerator, KernelGenerator)
    ]
    assert counts == pytest.approx([2.37e6, 0.93e6], rel=3e-3)


def test_whatever_the_weights_a_kernel_and_a_photo_come_out():
    for scale in (0.0, 1.0, 30.0):
        torch.manual_seed(0)
        image = ImageGenerator(TINY)
        kernel = KernelGenerator(TINY)
        with torch.no_grad():
            for parameter in [*image.parameters(), *kernel.parameters()]:
                parameter.mul_(scale)
            photo = image(torch.rand(1, 3, 32, 48))
            light = kernel(torch.rand(4))
        assert photo.shape == (1, 1, 32, 48)
        assert 0 <= photo.min() <= photo.max() <= 1
        assert light.shape == (9, 9)
        assert light.min() >= 0
        assert light.sum().item() == pytest.approx(1, abs=1e-6)


def test_a_non_local_block_gathers_from_all_places():
    torch.manual_seed(0)
    block = _NonLocal(6).double()
    features = torch.randn(1, 6, 4, 5, dtype=torch.float64)
    torch.testing.assert_close(block(features), features)  # before it is fitted
    with torch.no_grad():
        block.back[1].weight.fill_(1.0)
        asked, offered, content = (
            np.einsum("oi,ihw->ohw", part.weight[:, :, 0, 0].numpy(), features[0].numpy())
            + part.bias.numpy()[:, None, None]
            for part in (block.asked, block.offered, block.content)
        )
        gathered = np.zeros_like(content)
        for i in np.ndindex(4, 5):
            for j in np.ndindex(4, 5):
                gathered[:, *i] += asked[:, *i] @ offered[:, *j] * content[:, *j] / 20
        expected = features + block.back(torch.from_numpy(gathered)[None])
        torch.testing.assert_close(block(features), expected)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"kernel_px": 8}, "kernel_px: must be odd and at least 3, got 8"),
        ({"kernel_px": 1}, "kernel_px: must be odd and at least 3, got 1"),
        ({"iterations": 0}, "iterations: must be at least 1, got 0"),
        ({"channels": -1}, "channels: must be at least 1, got -1"),
        ({"kernel_rate": 0.0}, r"kernel_rate: must be positive, got 0\.0"),
        ({"image_rate": float("nan")}, "image_rate: must be positive, got nan"),
        ({"input_noise": -1.0}, r"input_noise: must be at least 0, got -1\.0"),
        ({"seed": -1}, "seed: must be at least 0, got -1"),
    ],
)
def test_unusable_recipes_are_refused(options, words):
    with pytest.raises(ValueError, match=f"^{words}$"):
        SelfDeblurConfig(**options)


def test_rates_are_halved_at_each_milestone():
    config = SelfDeblurConfig()
    assert [config.decay(i) for i in (0, 1999, 2000, 3000, 4999)] == [1, 1, 0.5, 0.25, 0.125]


# ---- a kernel that nothing judges


@pytest.mark.parametrize(
    ("pads", "frame"), [(((0, 40), (31, 9)), 64), (((0, 0), (0, 0)), 64), (((3, 0), (90, 2)), 64)]
)
def test_an_unjudged_kernel_is_centred_wherever_it_lay(pads, frame):
    truth = Trajectory.straight(12.0, angle_rad=0.5).psf(23)
    estimate = estimate_from_kernel("some", np.pad(7 * truth, pads), {"a": 1})
    assert (estimate.method, estimate.confidence, estimate.details) == ("some", 0.0, {"a": 1})
    assert estimate.psf.shape == (frame, frame)
    assert estimate.psf.sum() == pytest.approx(1)
    assert mnc(estimate.psf, truth) > 0.999
    y, x = np.mgrid[:frame, :frame] - frame // 2
    assert abs((estimate.psf * x).sum()) <= 0.5
    assert abs((estimate.psf * y).sum()) <= 0.5
    assert estimate.trajectories[0].length_px == pytest.approx(12, abs=1)


def test_an_unjudged_kernel_loses_its_dust_and_no_long_arm():
    kernel = np.full((99, 99), 1e-5)
    kernel[50, 2:95] = 1.0
    kernel[50, 2:40] = 4.0  # the centroid, column 33, lies off the middle: the frame grows
    psf = estimate_from_kernel("some", kernel, {}).psf
    assert (psf > 0).sum() == 93
    assert psf.shape == (2 * (94 - 33 + 1),) * 2
