"""The sensor's own code values of RAW files: the green ones, and black as the file states it."""

from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest

from cep.files import raw_files
from cep.files.raw_files import read_mosaic

VALUES = np.arange(24, dtype=np.uint16).reshape(4, 6)
BAYER = np.tile([[0, 1], [3, 2]], (2, 3))  # red, green; the second green, blue


@pytest.fixture
def read(monkeypatch):
    """Read a RAW file that LibRaw is said to decode so."""

    def read(**decoded):
        @contextmanager
        def opened(_path):
            yield SimpleNamespace(white_level=4095, raw_image_visible=VALUES, **decoded)

        monkeypatch.setattr(raw_files, "_opened_raw", opened)
        return read_mosaic("photo.dng")

    return read


def test_of_a_bayer_sensor_the_first_green_counts_with_its_black(read):
    mosaic = read(raw_colors_visible=BAYER, black_level_per_channel=[100, 200, 300, 400])
    assert mosaic.green.tolist() == [1, 3, 5, 13, 15, 17]
    assert (mosaic.black_dn, mosaic.white_dn) == (200.0, 4095)


def test_of_a_sensor_without_filters_all_pixels_count(read):
    without = np.full(VALUES.shape, 6)  # LibRaw's colour of none
    mosaic = read(raw_colors_visible=without, black_level_per_channel=[100, 200, 300, 400])
    assert mosaic.green.tolist() == list(range(24))
    assert mosaic.black_dn == 100.0


def test_interpolated_colours_are_refused(monkeypatch, read):
    monkeypatch.setattr(f"{__name__}.VALUES", np.zeros((4, 6, 3), dtype=np.uint16))
    with pytest.raises(ValueError, match=r"photo\.dng: holds colours that were interpolated"):
        read(raw_colors_visible=BAYER, black_level_per_channel=[0])
