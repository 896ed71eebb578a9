"""The JPEG of the simulation against a JPEG library's, and what quantised cosine blocks must
keep."""

import cv2
import numpy as np
import pytest
import torch
from scipy import fft

from motdiff.training.simulation import jpeg_loss


@pytest.fixture(scope="module")
def picture():
    """Soft-edged blocks with some noise, (96, 128) uint8."""
    rng = np.random.default_rng(0)
    blocks = np.kron(rng.integers(0, 256, (12, 16)), np.ones((8, 8)))
    return (
        (cv2.GaussianBlur(blocks, (0, 0), 2) + rng.normal(0, 3, blocks.shape))
        .clip(0, 255)
        .round()
        .astype(np.uint8)
    )


def library_jpeg(picture, quality):
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return cv2.imdecode(data, cv2.IMREAD_GRAYSCALE).astype(np.float64)


def compressed(picture, quality, dtype=torch.float64):
    """Levels 0..255 after :func:`jpeg_loss`."""
    photo = torch.from_numpy(picture / 255).to(dtype)[None, None]
    return 255 * jpeg_loss(photo, torch.tensor([quality], dtype=dtype))[0, 0].double().numpy()


@pytest.mark.parametrize("quality", [30, 50, 75, 90, 95, 98])
def test_levels_are_those_of_a_jpeg_library(picture, quality):
    """Rounded to levels most pixels agree; a coefficient halfway between two steps may go to
    either."""
    library = library_jpeg(picture, quality)
    own = compressed(picture, quality)
    differing = np.abs(own.round() - library)
    assert (differing == 0).mean() > 0.7
    assert differing.mean() < 0.35
    lost_by_library, lost = (np.sqrt(((image - picture) ** 2).mean()) for image in (library, own))
    assert lost == pytest.approx(lost_by_library, rel=0.08)


def test_a_neighbouring_quality_is_farther_from_the_library(picture):
    """So the comparison above tells quality 75 from 70 and 80."""
    library = library_jpeg(picture, 75)
    error = {
        quality: np.abs(compressed(picture, quality) - library).mean() for quality in (70, 75, 80)
    }
    assert error[75] < 0.5 * min(error[70], error[80])


@pytest.mark.parametrize("quality", [30.0, 75.0, 92.0])
def test_a_second_compression_changes_next_to_nothing(picture, quality):
    soft = (
        (64 + picture / 2).round().astype(np.uint8)
    )  # far from black and white, where clipping loses something too
    once = compressed(soft, quality)
    photo = torch.from_numpy(once / 255)[None, None]
    twice = 255 * jpeg_loss(photo, torch.tensor([quality], dtype=torch.float64))[0, 0].numpy()
    np.testing.assert_allclose(twice, once, atol=1e-9)


@pytest.mark.parametrize("quality", [50, 75, 92])
def test_coefficients_are_whole_steps_of_the_librarys_table(quality):
    """A noise photo, so that every coefficient has its first step in some block."""
    table = library_table(quality)
    photo = 0.5 + 0.5 * (
        torch.rand(1, 1, 256, 256, generator=torch.Generator().manual_seed(0)).double() - 0.5
    )
    levels = 255 * jpeg_loss(photo, torch.tensor([quality]).double())[0, 0].numpy() - 128
    blocks = levels.reshape(32, 8, 32, 8).transpose(0, 2, 1, 3).reshape(-1, 8, 8)
    blocks = blocks[
        (np.abs(blocks + 0.5) < 127.4).all(axis=(1, 2))
    ]  # clipping is no part of the transform
    steps = fft.dctn(blocks, axes=(1, 2), norm="ortho") / table
    np.testing.assert_allclose(steps, steps.round(), atol=1e-9)
    assert (np.abs(steps.round()) == 1).any(axis=0).all()


def library_table(quality):
    """(8, 8) steps from the file's DQT segment, which holds them along the diagonals, to and
    fro."""
    _, data = cv2.imencode(".jpg", np.zeros((8, 8), np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality])
    stored = bytes(data).split(b"\xff\xdb", 1)[1][3:67]
    diagonal = sorted(np.ndindex(8, 8), key=lambda at: (sum(at), at[0] if sum(at) % 2 else at[1]))
    table = np.zeros((8, 8))
    table[tuple(np.transpose(diagonal))] = list(stored)
    return table


def test_quality_100_loses_less_than_a_level(picture):
    assert np.abs(compressed(picture, 100) - picture).mean() < 0.5


def test_qualities_outside_1_to_100_are_taken_as_the_nearest(picture):
    np.testing.assert_array_equal(compressed(picture, 130.0), compressed(picture, 100.0))
    np.testing.assert_array_equal(compressed(picture, -3.0), compressed(picture, 1.0))


def test_every_photo_has_its_own_quality_and_every_channel_stands_alone():
    photos = torch.rand(
        2, 3, 24, 32, generator=torch.Generator().manual_seed(0), dtype=torch.float64
    )
    qualities = torch.tensor([40.0, 90.0], dtype=torch.float64)
    both = jpeg_loss(photos, qualities)
    for index in range(2):
        for channel in range(3):
            alone = jpeg_loss(
                photos[index : index + 1, channel : channel + 1], qualities[index : index + 1]
            )
            torch.testing.assert_close(both[index, channel], alone[0, 0])
    assert 0 <= float(both.min()) <= float(both.max()) <= 1
    assert jpeg_loss(photos.float(), qualities.float()).dtype == torch.float32


def test_photos_stored_channel_last_are_read_right():
    photos = torch.rand(
        1, 3, 24, 32, generator=torch.Generator().manual_seed(1), dtype=torch.float64
    )
    quality = torch.tensor([60.0], dtype=torch.float64)
    last = photos.to(memory_format=torch.channels_last)
    torch.testing.assert_close(jpeg_loss(last, quality), jpeg_loss(photos, quality))
