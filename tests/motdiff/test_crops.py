"""Crops land on texture of several directions, off saturation and apart; uniformity tells one blur
from two."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from motdiff.crops import blur_differs_warning, pick_crops, uniformity
from motdiff.motions import boracchi_foi


def blobs(shape: tuple[int, int], seed: int = 0) -> np.ndarray:
    image = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(shape), 1.5)
    return 0.5 + 0.1 * image / image.std()


def test_prefers_texture_to_flat_and_to_stripes() -> None:
    photo = np.full((200, 600), 0.5)
    photo[:, 200:400] += 0.4 * np.sin(np.arange(200) / 2)  # strong, but of one direction
    photo[60:140, 460:540] = blobs((80, 80))
    row, column = pick_crops(photo, size=80, count=1)[0]
    assert abs(row - 60) <= 10
    assert abs(column - 460) <= 10


def test_avoids_clipped_areas() -> None:
    photo = blobs((128, 384))
    photo[:, 256:] = np.where(
        photo[:, 256:] > 0.5, 1.0, 0.0
    )  # the strongest texture of all, saturated
    for _, column in pick_crops(photo, size=128, count=2):
        assert column <= 128 + 16


def test_everything_clipped_still_gives_a_crop() -> None:
    assert len(pick_crops(np.ones((100, 100)), size=50, count=3)) >= 1
    checks = np.kron(np.indices((20, 20)).sum(axis=0) % 2, np.ones((8, 8)))
    assert len(pick_crops(checks, size=64, count=2)) == 2


@given(
    height=st.integers(2, 300),
    width=st.integers(2, 300),
    size=st.integers(2, 150),
    count=st.integers(1, 6),
    colour=st.booleans(),
)
@settings(max_examples=40, deadline=None)
def test_crops_lie_inside_and_mostly_apart(
    height: int, width: int, size: int, count: int, colour: bool
) -> None:
    photo = np.random.default_rng(height).random((height, width, 3) if colour else (height, width))
    crops = pick_crops(photo, size=size, count=count)
    h = min(size, height)
    w = min(size, width)
    assert 1 <= len(crops) <= count
    for i, (row, column) in enumerate(crops):
        assert 0 <= row <= height - h
        assert 0 <= column <= width - w
        for r, c in crops[:i]:
            assert max(0, h - abs(row - r)) * max(0, w - abs(column - c)) <= 0.25 * h * w


def test_bad_photos_and_numbers() -> None:
    for photo in (np.zeros(5), np.zeros((0, 5)), np.full((5, 5), np.nan)):
        with pytest.raises(ValueError, match="photo"):
            pick_crops(photo)
    with pytest.raises(ValueError, match="size, count"):
        pick_crops(np.zeros((5, 5)), size=0)


def test_uniformity() -> None:
    a, b = (boracchi_foi(np.random.default_rng(seed)).psf(64) for seed in (1, 2))
    assert uniformity([a]) == 1
    assert uniformity([a, np.roll(a, 3, axis=0), 2 * a]) == pytest.approx(1, abs=1e-3)
    assert uniformity([a, b]) < 0.7
    assert blur_differs_warning([a, a]) is None
    warning = blur_differs_warning([a, b])
    assert warning is not None
    assert "differs across the photo" in warning
    with pytest.raises(ValueError, match="psfs"):
        uniformity([])
