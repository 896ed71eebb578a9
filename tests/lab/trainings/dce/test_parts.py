"""DCE's parts: the straight-through code, its coded photos, the losses and the network, against
closed forms."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from cep.optics.code import ShutterCode
from cep.optics.exposure import chip_psfs, coded_psf
from lab.trainings.dce.model import (
    RestorationNetwork,
    binarise,
    charbonnier,
    code_of,
    coded_photos,
    edge_loss,
    restoration_loss,
    spectral_loss,
    weights_of,
)
from lab.trainings.dce.samples import Batch
from lab.trainings.dce.training import photos_of
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory

BENT = Trajectory.from_samples([[0, 0], [3, 1], [5, 3], [6, 6]])
WEIGHTS = hnp.arrays(np.float64, st.integers(1, 12), elements=st.floats(-2, 3))


def batch(chips, *, count=2, side=12, size=9, seed=0):
    """A tiny batch in double precision; the paths fit 9 px."""
    rng = np.random.default_rng(seed)
    scenes = torch.from_numpy(rng.random((count, 1, side + size - 1, side + size - 1)))
    psfs = np.stack([chip_psfs(motion, chips, size) for motion in (BENT, BENT.reversed())[:count]])
    edge = size - 1 - size // 2
    sharp = scenes[..., edge : edge + side, edge : edge + side]
    return Batch(
        scenes,
        sharp,
        torch.from_numpy(psfs),
        torch.from_numpy(0.01 * rng.standard_normal(sharp.shape)),
    )


# ---- the binariser


@given(WEIGHTS)
def test_a_code_is_of_zeros_and_ones_and_lets_light_through(values):
    chips = binarise(torch.from_numpy(values)).numpy()
    assert set(chips) <= {0.0, 1.0}
    assert chips.any()
    if (values > 0.5).any():
        np.testing.assert_array_equal(chips, values > 0.5)
    else:
        assert chips.sum() == 1
        assert values[chips.argmax()] == values.max()


def test_backward_it_is_the_relaxed_code():
    """The gradient by a weight is the slope of the loss in the chip's opening, about the binary
    code."""
    sample = batch(6)
    weights = torch.tensor(
        [0.9, 0.2, 0.51, 0.49, 0.7, 0.1], dtype=torch.float64, requires_grad=True
    )

    def loss(chips):
        return restoration_loss(photos_of(sample, chips), sample.sharp)

    loss(binarise(weights)).backward()
    chips = binarise(weights.detach())
    step = 1e-6
    for k in range(6):
        shift = torch.zeros(6, dtype=torch.float64)
        shift[k] = step
        slope = (loss(chips + shift) - loss(chips - shift)) / (2 * step)
        assert weights.grad[k].item() == pytest.approx(slope.item(), rel=1e-5)
    assert weights.grad.abs().min() > 0


def test_a_weight_outside_the_range_has_no_gradient():
    weights = torch.tensor([-0.1, 0.3, 1.0, 1.2], requires_grad=True)
    binarise(weights).sum().backward()
    assert weights.grad.tolist() == [0, 1, 1, 0]


def test_weights_stand_for_their_code():
    code = ShutterCode("1101000101", 250_000)
    weights = weights_of(code, margin=0.1)
    assert code_of(weights, chip_ns=250_000) == code
    np.testing.assert_allclose((weights - 0.5).abs(), 0.1, rtol=1e-6)
    for margin in (0, 0.6):
        with pytest.raises(ValueError, match=r"^margin: must be above 0"):
            weights_of(code, margin=margin)


# ---- coded photos


def test_a_coded_photo_is_the_one_of_the_physics():
    sample = batch(7)
    code = ShutterCode("1011001")
    photos = coded_photos(sample.scenes, sample.chip_psfs, torch.from_numpy(code.array)).numpy()
    for photo, scene, motion in zip(
        photos, sample.scenes.numpy(), (BENT, BENT.reversed()), strict=True
    ):
        np.testing.assert_allclose(
            photo[0], blur_valid(scene[0], coded_psf(motion, code, 9)), atol=1e-12
        )


def test_it_is_the_mean_of_shifted_frames_closed_ones_dark():
    shifts = [(-2, 1), (0, 0), (1, 2), (2, -2)]
    psfs = np.zeros((1, 4, 5, 5))
    for k, (dx, dy) in enumerate(shifts):
        psfs[0, k, 2 + dy, 2 + dx] = 1 / 4
    scene = np.random.default_rng(0).random((12, 13))
    chips = np.array([1.0, 0.0, 1.0, 1.0])
    frames = [np.roll(scene, (dy, dx), axis=(0, 1))[2:-2, 2:-2] for dx, dy in shifts]
    found = coded_photos(
        torch.from_numpy(scene)[None, None], torch.from_numpy(psfs), torch.from_numpy(chips)
    )
    np.testing.assert_allclose(found[0, 0], np.tensordot(chips, frames, axes=1) / 4, atol=1e-12)


def test_a_dark_code_pays_with_noise():
    sample = batch(8)
    still = Batch(
        torch.full_like(sample.scenes, 0.3), sample.sharp, sample.chip_psfs, sample.noise
    )
    for k in (1, 4, 8):
        photos = photos_of(still, torch.tensor([1.0] * k + [0.0] * (8 - k), dtype=torch.float64))
        torch.testing.assert_close(photos - 0.3, sample.noise * 8 / k, rtol=1e-6, atol=1e-9)


# ---- losses


def images(difference):
    sharp = torch.from_numpy(np.random.default_rng(1).random((2, 1, 16, 12)))
    return sharp + difference, sharp


def test_of_a_constant_difference():
    d = 0.25
    restored, sharp = images(d)
    assert charbonnier(restored, sharp).item() == pytest.approx(np.hypot(d, 1e-3))
    assert edge_loss(restored, sharp).item() == pytest.approx(
        1e-3
    )  # no edges: what is left is the smoothing
    assert spectral_loss(restored, sharp).item() == pytest.approx(d)  # d N at one frequency of N


def test_of_a_single_wrong_pixel():
    a = 0.5
    impulse = torch.zeros(2, 1, 16, 12, dtype=torch.float64)
    impulse[:, :, 8, 6] = a
    restored, sharp = images(impulse)
    pixels = 16 * 12
    assert charbonnier(restored, sharp).item() == pytest.approx(
        (np.hypot(a, 1e-3) + (pixels - 1) * 1e-3) / pixels
    )
    assert spectral_loss(restored, sharp).item() == pytest.approx(
        a
    )  # as strong at every frequency
    line = np.array([1, 4, 6, 4, 1]) / 16
    edges = -np.outer(line, line)
    edges[2, 2] += 1
    expected = (np.hypot(a * edges, 1e-3).sum() + (pixels - 25) * 1e-3) / pixels
    assert edge_loss(restored, sharp).item() == pytest.approx(expected)


def test_the_weights_are_those_published():
    restored, sharp = images(
        torch.from_numpy(np.random.default_rng(2).normal(0, 0.1, (2, 1, 16, 12)))
    )
    parts = [part(restored, sharp).item() for part in (charbonnier, edge_loss, spectral_loss)]
    assert restoration_loss(restored, sharp).item() == pytest.approx(
        np.dot([1, 0.05, 0.01], parts)
    )


# ---- the network


@pytest.mark.parametrize("shape", [(16, 16), (33, 50), (5, 3)])
def test_an_untrained_network_returns_the_photo_of_any_size(shape):
    photo = torch.rand(2, 1, *shape, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        assert torch.equal(RestorationNetwork()(photo), photo)


def test_the_network_is_small_and_sees_farther_than_a_path_of_60_px():
    network = RestorationNetwork()
    assert sum(parameter.numel() for parameter in network.parameters()) <= 1.2e6
    torch.nn.init.ones_(network.head.weight)
    photo = torch.zeros(1, 1, 192, 192, requires_grad=True)
    network(photo)[0, 0, 96, 96].backward()
    rows = photo.grad[0, 0].abs().sum(dim=1).nonzero()
    assert rows.min() <= 96 - 60
    assert rows.max() >= 96 + 60
