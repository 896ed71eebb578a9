"""The parts of the blind search against independent oracles: numpy FFTs, scipy labels, brute-force
least squares."""

import numpy as np
import pytest
import torch
from dead_leaves import dead_leaves
from scipy import ndimage, optimize, signal

from motdiff.blind_search import grids, kernel, latent
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory


def tensor(array):
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))


@pytest.fixture
def scene():
    return dead_leaves(200, 3)


def curved(size=25):
    t = np.linspace(0, 1, 60)
    return Trajectory.from_samples(np.c_[14 * t, 8 * np.sin(2.5 * t)], t=t**1.3).psf(size)


def test_fast_sizes_are_even_5_smooth_and_not_smaller():
    for size in range(1, 300):
        fast = grids.fast_size(size)
        rest = fast
        for prime in (2, 3, 5):
            while rest % prime == 0:
                rest //= prime
        assert fast >= size
        assert fast % 2 == 0
        assert rest == 1


def test_a_shift_moves_maps_down_and_right_and_brings_in_zeros():
    maps = np.random.default_rng(0).random((3, 2, 4, 9))
    shifts = [(1, -2), (-3, 6), (5, 0)]  # the last one leaves nothing
    moved = grids.shifted(tensor(maps), torch.tensor(shifts))
    expected = [
        ndimage.shift(one, (0, *by), order=0) for one, by in zip(maps, shifts, strict=True)
    ]
    np.testing.assert_allclose(moved.numpy(), expected, atol=1e-6)


@pytest.mark.parametrize("side", [5, 8])
def test_otf_is_that_of_a_kernel_centred_at_half_its_side(side):
    rng = np.random.default_rng(0)
    psf = rng.random((side, side))
    photo = rng.random((20, 24))
    otf = grids.psf_to_otf(tensor(psf)[None], (20, 24))[0].numpy()
    blurred = np.fft.irfft2(otf * np.fft.rfft2(photo), s=(20, 24))
    expected = ndimage.convolve(photo, psf, mode="wrap", origin=0 if side % 2 else (0, 0))
    np.testing.assert_allclose(blurred, expected, atol=2e-5)


def test_periodic_extension_keeps_the_photo_and_joins_its_edges():
    photo = np.random.default_rng(1).random((30, 41)).cumsum(0).cumsum(1)
    photo /= photo.max()
    wide = grids.periodic_extension(tensor(photo)[None], (48, 60))[0].numpy()
    np.testing.assert_array_equal(wide[:30, :41], photo.astype(np.float32))
    # harmonic: no value beyond those on the edges, no jump at the wrap larger than inside the
    # strip
    assert wide.max() <= photo.max() + 1e-5
    assert wide.min() >= photo.min() - 1e-5
    assert (
        np.abs(wide[0, :41] - wide[-1, :41]).max() < 2.5 * np.abs(photo[0] - photo[-1]).max() / 18
    )
    inside = wide[31:47, 5:35]
    laplacian = (
        inside[:-2, 1:-1]
        + inside[2:, 1:-1]
        + inside[1:-1, :-2]
        + inside[1:-1, 2:]
        - 4 * inside[1:-1, 1:-1]
    )
    assert np.abs(laplacian).max() < 1e-4


def test_downsampling_keeps_a_constant_and_halves_the_scale():
    flat = grids.downsampled(torch.full((1, 40, 40), 0.3), 0.5)
    torch.testing.assert_close(flat, torch.full_like(flat, 0.3))
    ramp = torch.arange(64.0).expand(1, 64, 64)
    small = grids.downsampled(ramp, 0.5)
    torch.testing.assert_close(
        small.diff(dim=2), torch.full_like(small.diff(dim=2), 2.0), atol=1e-4, rtol=0
    )


@pytest.mark.parametrize("side", [15, 21, 27])
def test_resized_kernels_keep_their_centre_and_light(side):
    psf = curved(19)
    grown = grids.resized_kernel(tensor(psf)[None], 2**0.5, side)[0].numpy()
    y, x = np.mgrid[:side, :side] - side // 2
    assert grown.sum() == pytest.approx(1, abs=1e-5)
    if side == 27:  # large enough to hold it all
        cy, cx = np.mgrid[:19, :19] - 9
        centroid = np.array([(psf * cx).sum(), (psf * cy).sum()]) * 2**0.5
        np.testing.assert_allclose([(grown * x).sum(), (grown * y).sum()], centroid, atol=0.1)


def test_specks_are_judged_as_by_a_label_of_connected_parts():
    rng = np.random.default_rng(4)
    for _ in range(20):
        psf = rng.random((15, 15)) * (rng.random((15, 15)) < 0.3)
        psf /= psf.sum()
        label, count = ndimage.label(psf, structure=np.ones((3, 3)))
        mass = ndimage.sum(psf, label, np.arange(count + 1))
        limit = min(0.1, mass[1:].max())
        expected = np.where((mass >= limit - 1e-7)[label] & (psf > 0), psf, 0)
        cleaned = kernel.without_specks(tensor(psf)[None])[0].numpy()
        np.testing.assert_allclose(cleaned, expected / expected.sum(), atol=1e-6)


def test_centring_puts_the_centroid_within_half_a_pixel_of_the_middle():
    psf = np.zeros((21, 21))
    psf[3:9, 2:12] = np.random.default_rng(5).random((6, 10))
    centred = kernel.centred(tensor(psf)[None])[0].numpy()
    y, x = np.mgrid[:21, :21] - 10
    assert abs((centred * x).sum()) <= 0.51
    assert abs((centred * y).sum()) <= 0.51
    np.testing.assert_allclose(
        np.sort(centred[centred > 0]), np.sort(psf[psf > 0] / psf.sum()), rtol=1e-5
    )


def test_kernel_fit_finds_the_kernel_between_sharp_and_blurred_gradients(scene):
    psf = curved(25)
    blurred = blur_valid(scene, psf)
    sharp = scene[12:-12, 12:-12]
    pairs = [
        latent.salient_gradients(tensor(image)[None], torch.zeros(1)) for image in (sharp, blurred)
    ]
    with_crops = [tuple(g[None] for g in pair) for pair in pairs]
    fitted = kernel.fit_kernel(
        *with_crops,
        size=25,
        ridge=1e-3,
        smoothness=0.0,
        sparsity=0.0,
        rounds=(25, 50),
        keep_share=0.0,
    )
    overlap = (fitted[0].numpy() * psf).sum() / np.linalg.norm(fitted[0]) / np.linalg.norm(psf)
    assert overlap > 0.99


def test_kernel_fit_solves_the_non_negative_least_squares_it_states():
    rng = np.random.default_rng(6)
    sharp = rng.random((2, 24, 24)) - 0.5
    side = 5
    ridge = 0.4
    smoothness = 0.3
    truth = np.abs(rng.random((side, side)) - 0.3)
    blurred = [signal.fftconvolve(g, truth / truth.sum(), mode="full")[2:-2, 2:-2] for g in sharp]
    columns = []
    for row in range(side):
        for column in range(side):
            unit = np.zeros((side, side))
            unit[row, column] = 1
            columns.append(
                np.concatenate(
                    [signal.fftconvolve(g, unit, mode="full")[2:-2, 2:-2].ravel() for g in sharp]
                )
            )
    design = np.stack(columns, axis=1)
    differences = []
    padded = {}
    for i in range(side * side):
        unit = np.zeros((side + 2, side + 2))
        unit[1 + i // side, 1 + i % side] = 1
        padded[i] = np.concatenate([np.diff(unit, axis=0).ravel(), np.diff(unit, axis=1).ravel()])
        differences.append(padded[i])
    stacked = np.vstack(
        [
            design,
            np.sqrt(ridge) * np.eye(side**2),
            np.sqrt(smoothness) * np.stack(differences, axis=1),
        ]
    )
    right = np.concatenate([*(b.ravel() for b in blurred), np.zeros(len(stacked) - len(design))])
    expected, _ = optimize.nnls(stacked, right)
    latent_pair = tuple(tensor(g)[None, None] for g in sharp)
    # what the frame cuts off at its edges is data that the periodic oracle has and a real photo
    # has not: compare inside
    blurred_pair = tuple(tensor(b)[None, None] for b in blurred)
    fitted = kernel.fit_kernel(
        latent_pair,
        blurred_pair,
        size=side,
        ridge=ridge,
        smoothness=smoothness,
        sparsity=0.0,
        rounds=(25, 50),
        keep_share=0.0,
    )[0].numpy()
    expected = expected.reshape(side, side) / expected.sum()
    assert np.abs(fitted - expected).max() < 0.1 * expected.max()


def test_salient_gradients_keep_what_reaches_the_threshold_and_never_nothing(scene):
    photo = tensor(scene)[None]
    gx, gy = latent.salient_gradients(photo, torch.tensor([0.01]))
    strength = gx**2 + gy**2
    assert float(strength[strength > 0].min()) >= 0.01
    gx, gy = latent.salient_gradients(photo, torch.tensor([1e6]))
    assert int(((gx != 0) | (gy != 0)).sum()) > 0


@pytest.mark.parametrize("weakest", range(4))
def test_start_threshold_is_reached_by_edges_of_each_orientation(weakest):
    slopes = np.radians([-67.5, -22.5, 22.5, 67.5])
    strengths = np.full(4, 0.02)
    strengths[weakest] = 0.01
    row, column = np.mgrid[:40, :40]
    planes = [
        strength * (np.cos(slope) * column + np.sin(slope) * row)
        for slope, strength in zip(slopes, strengths, strict=True)
    ]
    photo = np.block([planes[:2], planes[2:]])
    # 400 pixels: more than the borders between the planes have, fewer than a plane
    threshold = latent.start_threshold(tensor(photo)[None], size=20)
    assert threshold.numpy() == pytest.approx([0.01**2], rel=1e-3)


def test_couplings_grow_from_the_gradient_weight_to_their_end():
    steps = list(latent.Coupling(start=16.0, end=100.0, growth=1.5).steps(0.2))
    assert steps == pytest.approx([3.2 * 1.5**i for i in range(9)])
    assert 3.2 * 1.5**8 < 100 < 3.2 * 1.5**9
    assert list(latent.Coupling().steps(1.0)) == pytest.approx([2.0 ** (i + 1) for i in range(16)])
    assert list(latent.Coupling(start=16.0, end=100.0).steps(10.0)) == []


def test_latent_of_a_point_kernel_is_the_photo_where_every_edge_is_strong():
    blocks = np.random.default_rng(7).permutation(64).reshape(8, 8) / 63
    photo = tensor(np.kron(blocks, np.ones((4, 4))))[None]
    point = torch.zeros(1, 5, 5)
    point[0, 2, 2] = 1
    same = latent.l0_pmp_latent(
        photo,
        point,
        intensity_weight=0.0,
        gradient_weight=1e-3,
        patch_px=4,
        coarse=False,
        coupling=latent.Coupling(),
    )
    assert float((same - photo).abs().max()) < 0.03


def latent_of(photos, kernels, *, exposures):
    return latent.l0_pmp_latent(
        photos,
        kernels,
        intensity_weight=0.0,
        gradient_weight=1e-6,
        patch_px=1,
        coarse=False,
        coupling=latent.Coupling(start=16.0, end=1e-4, growth=1.5),
        exposures=exposures,
    )


def through(scene, kernel):
    """Photo of a periodic scene (1, H, W) through a kernel (1, k, k)."""
    spectrum = torch.fft.rfft2(scene) * grids.psf_to_otf(kernel, tuple(scene.shape[-2:]))
    return torch.fft.irfft2(spectrum, s=tuple(scene.shape[-2:]))


def test_copies_of_a_photo_share_its_latent_photo(scene):
    photos = torch.stack([tensor(scene), tensor(scene).T.contiguous()])
    kernels = torch.rand(2, 5, 5, generator=torch.Generator().manual_seed(0))
    kernels = kernels / kernels.sum((1, 2), keepdim=True)
    alone = latent_of(photos, kernels, exposures=1)
    # three photos of each of the two scenes, the exposure first
    shared = latent_of(photos.repeat(3, 1, 1), kernels.repeat(3, 1, 1), exposures=3)
    # rounding may carry a gradient across the threshold
    assert float((shared - alone).abs().mean()) < 1e-4


def test_two_exposures_restore_what_one_extinguishes(scene):
    truth = tensor(scene)[None]
    across = torch.zeros(1, 9, 9)
    across[0, 4] = 1 / 9
    kernels = torch.cat([across, across.transpose(1, 2)])
    photos = torch.cat([through(truth, kernels[:1]), through(truth, kernels[1:])])
    alone = latent_of(photos, kernels, exposures=1)
    shared = latent_of(photos, kernels, exposures=2)
    errors = (alone - truth).square().mean((1, 2))
    assert float((shared - truth).square().mean()) < 0.5 * float(errors.min())


@pytest.mark.parametrize("shape", [(2, 24, 30), (1, 7, 9)])
def test_divergence_of_the_strong_gradients_is_that_of_rolled_photos(shape):
    photos = torch.rand(shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    gx = photos.roll(-1, -1) - photos
    gy = photos.roll(-1, -2) - photos
    strong = gx**2 + gy**2 >= 0.3
    assert 0.2 < strong.double().mean() < 0.8
    gx = gx * strong
    gy = gy * strong
    expected = gx.roll(1, -1) - gx + gy.roll(1, -2) - gy
    torch.testing.assert_close(latent._salient_divergence(photos, 0.3), expected)


@pytest.mark.parametrize("soft", [True, False])
def test_only_the_darkest_pixel_of_each_patch_is_shrunk(soft):
    photos = (
        torch.rand((2, 14, 20), generator=torch.Generator().manual_seed(0), dtype=torch.float64)
        - 0.1
    )
    photos *= torch.tensor([1.0, 0.1])[:, None, None]  # thresholds differ
    expected = photos.clone()
    for photo in expected:
        patches = [
            photo[row : row + 6, column : column + 6]
            for row in (0, 6, 12)
            for column in (0, 6, 12, 18)
        ]
        level = np.clip(np.mean([abs(patch.min()) for patch in patches]), 0.02, 0.1)
        for patch in patches:
            darkest = patch.min()
            if soft:
                patch[patch == darkest] = torch.sign(darkest) * max(darkest - 0.02, 0)
            elif abs(darkest) < level:
                patch[patch == darkest] = 0
    assert not torch.equal(expected, photos)
    torch.testing.assert_close(latent._shrink_minimal_pixels(photos, 0.02, 6, soft=soft), expected)
