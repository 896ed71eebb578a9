"""Uploads of the studio: kept by what they are, whatever their name says."""

import asyncio

import cv2
import numpy as np
import pytest

from cep.studio.fields import FieldError
from cep.studio.uploads import Uploads

IMAGE = np.random.default_rng(0).integers(0, 256, (20, 30, 3), dtype=np.uint8)


@pytest.fixture
def uploads():
    uploads = Uploads()
    yield uploads
    uploads.close()


def kept(uploads, data, **options):
    async def chunks():
        yield data[:7]
        yield data[7:]

    return uploads.path(asyncio.run(uploads.photo(chunks(), **options)))


@pytest.mark.parametrize("ending", [".jpg", ".png", ".tif", ".webp"])
def test_a_photo_is_recognised_by_its_first_bytes(uploads, ending):
    data = cv2.imencode(ending, IMAGE)[1].tobytes()
    file = kept(uploads, data, suffix=".txt")
    assert file.suffix == ending
    assert file.read_bytes() == data


def test_a_raw_file_is_recognised_by_its_suffix(uploads):
    data = cv2.imencode(".tif", IMAGE)[1].tobytes()
    assert kept(uploads, data, suffix=".DNG").suffix == ".dng"
    assert kept(uploads, b"\x00" * 100, suffix=".nef").suffix == ".nef"


@pytest.mark.parametrize("data", [b"", b"RIFF\x10\0\0\0WAVEfmt ", b"x" * 8 + b"WEBP" + b"x" * 9])
def test_other_files_leave_nothing_behind(uploads, data):
    with pytest.raises(FieldError, match="this file is none of them"):
        kept(uploads, data)
    assert list(uploads.folder.iterdir()) == []


def test_the_oldest_of_nine_goes(uploads):
    data = cv2.imencode(".png", IMAGE)[1].tobytes()
    files = [kept(uploads, data) for _ in range(9)]
    assert [file.exists() for file in files] == [False] + [True] * 8
    with pytest.raises(FieldError, match="drop it again"):
        uploads.path(files[0].stem)
    assert uploads.path(files[1].stem) == files[1]
