"""Code value of white: cameras of fewer bits than their files, saturation below the last code, and
what is neither."""

import numpy as np
import pytest
import tifffile

from cep.files.images import read_code_values, read_detail, read_photo
from cep.files.white_level import white_level

SIDE = 160


def codes(bits, *, light=0.9, top=None, shift=0, spread=False, seed=0):
    """Frame of a camera of 10,000 electrons: smooth light up to ``light``, full at the code
    ``top``."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[0:SIDE, 0:SIDE] / SIDE
    scene = light * (0.5 + 0.5 * np.sin(7 * rows + 3 * columns**2)) ** 2
    electrons = rng.poisson(10_000 * scene) + rng.normal(0, 3, scene.shape)
    last = 2**bits - 1
    values = np.clip(np.rint(electrons / 10_000 * last), 0, top or last)
    return np.rint(values / last * 65535 if spread else values * 2**shift).astype(np.uint16)


@pytest.mark.parametrize("bits", [8, 10, 12])
def test_few_bits_at_the_lower_end_of_16_are_brought_to_full_scale(tmp_path, bits):
    low = codes(bits)
    high = codes(bits, shift=16 - bits)
    photos = {}
    for name, image in {"low": low, "high": high}.items():
        tifffile.imwrite(tmp_path / f"{name}.tif", image)
        photos[name] = read_photo(tmp_path / f"{name}.tif", gamma="srgb")
    # the two scales of white differ by less than a code value
    np.testing.assert_allclose(
        photos["low"].pixels, photos["high"].pixels, rtol=3 * 2.0**-bits, atol=2.0**-bits
    )
    assert photos["high"].warnings == ()
    assert len(photos["low"].warnings) == 1
    assert f"taken as {bits}-bit values, white at {2**bits - 1}" in photos["low"].warnings[0]
    assert photos["low"].warnings[0].startswith(f"{tmp_path / 'low.tif'}: no value exceeds ")
    part, small, _ = read_detail(tmp_path / "low.tif", side_px=SIDE, preview_px=SIDE)
    np.testing.assert_array_equal(part.pixels, photos["low"].pixels)
    np.testing.assert_array_equal(small, photos["low"].pixels)
    np.testing.assert_array_equal(read_code_values(tmp_path / "low.tif")[0], low)


def test_a_quarter_of_full_scale_is_not_rescaled_but_told():
    for frame in (codes(14), codes(16, light=0.2)):
        found = white_level(frame)
        assert found.code == 65535
        assert "if its camera has 14 bits, it is 4 times brighter" in found.assumption


@pytest.mark.parametrize(
    "frame",
    [
        codes(12, shift=4),
        codes(12, spread=True),
        codes(
            12, spread=True, light=0.05
        ),  # dark, but with the gaps of 12 bits over the range of 16
        codes(16),
        codes(16, light=0.4),
        codes(8).astype(np.uint8),
        codes(8, light=0.3).astype(np.uint8),
        np.zeros((SIDE, SIDE), np.uint16),
        (codes(16) > 9000).astype(np.uint16),  # a mask
    ],
    ids=[
        "shifted",
        "spread",
        "dark and spread",
        "16 bits",
        "dim",
        "8 bits",
        "dim 8 bits",
        "black",
        "mask",
    ],
)
def test_what_fills_its_range_or_tells_nothing_is_left_alone(frame):
    found = white_level(frame)
    assert (found.code, found.assumption) == (np.iinfo(frame.dtype).max, "")


@pytest.mark.parametrize("options", [{}, {"shift": 4}, {"spread": True}])
@pytest.mark.parametrize("colours", [1, 3])
def test_a_camera_that_saturates_below_its_last_code_is_full_there(options, colours):
    frame = codes(12, light=1.2, top=3800, **options)
    found = white_level(frame if colours == 1 else np.dstack([frame] * 3))
    assert found.code == frame.max()
    share = (frame == frame.max()).mean()
    assert found.assumption.startswith(
        f"{share:.1%} of its values are at its largest, {frame.max()}"
    )


def test_pixels_that_are_full_at_slightly_different_codes_are_saturated():
    frame = codes(12, light=1.3, top=3800)
    full = frame == 3800
    frame[full] -= np.random.default_rng(1).integers(0, 5, full.sum()).astype(np.uint16)
    assert white_level(frame).code == 3800


def test_the_flat_top_of_a_drawing_is_not_saturated():
    rows, columns = np.mgrid[0:SIDE, 0:SIDE] / SIDE
    drawing = np.minimum(0.5 + 0.5 * np.sin(7 * rows + 3 * columns**2), 0.8)
    assert white_level(np.rint(drawing * 65535).astype(np.uint16)).assumption == ""
