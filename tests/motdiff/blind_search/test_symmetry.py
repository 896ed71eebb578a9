"""The symmetries of the square: photo, PSF and HR map agree, and each has its inverse."""

import numpy as np
import pytest
import torch
from torch.nn import functional

from motdiff.blind_search.grids import QUARTER_TURNS, inverse_symmetry, mirrored
from motdiff.simulate import blur_symmetric
from motdiff.training.motion_bank import MotionMix, build_bank
from motdiff.trajectory import Trajectory

SYMMETRIES = range(8)
each_symmetry = pytest.mark.parametrize("symmetry", SYMMETRIES)


def bent_path():
    """No symmetry of its own, off centre, and no point halfway between two pixels of the map."""
    t = np.linspace(0, 1, 50)
    return Trajectory.from_samples(np.c_[17.3 * t, 8.1 * np.sin(2.7 * t) + 3.3 * t], t=t**1.4)


def turned(motion, symmetry):
    """The path of the mirrored photo."""
    xy = motion.xy * [-1 if symmetry & 2 else 1, -1 if symmetry & 1 else 1]
    return Trajectory(motion.t, xy[:, ::-1] if symmetry & 4 else xy)


@pytest.fixture(scope="module")
def bank():
    return build_bank(MotionMix(max_length_px=30), count=6, seed=0)


def noise(*shape):
    return torch.rand(*shape, generator=torch.Generator().manual_seed(1))


# ---- the photo's, the PSF's and the HR map's grid


@each_symmetry
def test_the_mirrored_photo_is_blurred_by_the_mirrored_psf(symmetry):
    sharp = torch.rand(
        1, 1, 80, 90, generator=torch.Generator().manual_seed(0), dtype=torch.float64
    )
    psf = torch.from_numpy(bent_path().psf(64))[None, None]
    photo = torch.from_numpy(blur_symmetric(sharp[0, 0], psf[0, 0]))[None, None]
    again = blur_symmetric(
        mirrored(sharp, symmetry, pitch=0)[0, 0], mirrored(psf, symmetry, pitch=1)[0, 0]
    )
    np.testing.assert_allclose(again, mirrored(photo, symmetry, pitch=0)[0, 0], atol=1e-12)


@each_symmetry
def test_mirrored_maps_are_those_of_the_mirrored_path(symmetry):
    motion = bent_path()
    other = turned(motion, symmetry)
    psf = torch.from_numpy(motion.psf(64))[None, None]
    hr_map = torch.from_numpy(motion.hr_map())[None, None]
    np.testing.assert_allclose(mirrored(psf, symmetry, pitch=1)[0, 0], other.psf(64), atol=1e-12)
    np.testing.assert_array_equal(mirrored(hr_map, symmetry, pitch=4)[0, 0], other.hr_map())


@each_symmetry
def test_box_means_of_the_mirrored_hr_map_are_the_mirrored_box_means(bank, symmetry):
    _, x0, dwell = bank.targets(torch.arange(6))
    for maps in (x0, dwell):
        fine = functional.avg_pool2d(mirrored(maps, symmetry, pitch=4), 4)
        torch.testing.assert_close(
            fine, mirrored(functional.avg_pool2d(maps, 4), symmetry, pitch=1)
        )


def test_the_eight_symmetries_differ_and_keep_the_zero_displacement():
    for pitch, side, zero in ((1, 64, [32]), (4, 256, [129, 130])):
        maps = noise(1, 1, side, side)
        middle = torch.zeros(1, 1, side, side)
        middle[..., zero[0] : zero[-1] + 1, zero[0] : zero[-1] + 1] = 1
        variants = [mirrored(maps, symmetry, pitch=pitch) for symmetry in SYMMETRIES]
        assert len({bytes(variant.contiguous().numpy()) for variant in variants}) == 8
        for symmetry in SYMMETRIES:
            assert torch.equal(mirrored(middle, symmetry, pitch=pitch), middle)
    assert torch.equal(mirrored(maps, 0, pitch=4), maps)


def test_symmetries_of_a_photo_by_hand():
    photo = torch.tensor([[[[1, 2, 3], [4, 5, 6]]]])
    expected = {
        0: [[1, 2, 3], [4, 5, 6]],
        1: [[4, 5, 6], [1, 2, 3]],
        2: [[3, 2, 1], [6, 5, 4]],
        3: [[6, 5, 4], [3, 2, 1]],
        4: [[1, 4], [2, 5], [3, 6]],
        5: [[4, 1], [5, 2], [6, 3]],
        6: [[3, 6], [2, 5], [1, 4]],
        7: [[6, 3], [5, 2], [4, 1]],
    }
    for symmetry, pixels in expected.items():
        assert mirrored(photo, symmetry, pitch=0)[0, 0].tolist() == pixels


# ---- and back


@pytest.mark.parametrize("pitch", [0, 1, 4])
@each_symmetry
def test_the_inverse_undoes_a_symmetry_on_either_side(symmetry, pitch):
    maps = noise(2, 3, 16, 16)
    inverse = inverse_symmetry(symmetry)
    assert torch.equal(mirrored(mirrored(maps, symmetry, pitch=pitch), inverse, pitch=pitch), maps)
    assert torch.equal(mirrored(mirrored(maps, inverse, pitch=pitch), symmetry, pitch=pitch), maps)


def test_only_the_two_quarter_turns_are_not_their_own_inverse():
    assert [inverse_symmetry(symmetry) for symmetry in SYMMETRIES] == [0, 1, 2, 3, 4, 6, 5, 7]
    maps = noise(1, 1, 6, 6)
    assert torch.equal(mirrored(maps, 5, pitch=0), maps.rot90(-1, (2, 3)))  # clockwise
    assert torch.equal(mirrored(maps, 6, pitch=0), maps.rot90(1, (2, 3)))


@each_symmetry
def test_a_photo_that_is_not_square_comes_back_too(symmetry):
    photo = noise(1, 1, 5, 8)
    there = mirrored(photo, symmetry, pitch=0)
    assert there.shape[2:] == ((8, 5) if symmetry & 4 else (5, 8))
    assert torch.equal(mirrored(there, inverse_symmetry(symmetry), pitch=0), photo)


def test_quarter_turns_are_the_symmetries_that_rotate():
    photo = noise(1, 1, 5, 5)
    rotated = [torch.rot90(photo, quarters, (2, 3)) for quarters in range(4)]
    for turn in QUARTER_TURNS:
        assert any(torch.equal(mirrored(photo, turn, pitch=0), one) for one in rotated)
    assert len(set(QUARTER_TURNS)) == len(rotated)
