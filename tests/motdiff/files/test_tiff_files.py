"""Pages of TIFF files: the photo is read, and not its preview; where there are several photos,
that is told."""

import re
import struct
import subprocess
import sys
import tracemalloc
from contextlib import suppress
from io import BytesIO

import cv2
import numpy as np
import pytest
import tifffile

from motdiff.files.decoding import decode
from motdiff.files.photo_files import photo_bytes
from motdiff.files.tiff_files import photo_page, refusal

PHOTO = np.random.default_rng(0).integers(0, 65536, (40, 56), dtype=np.uint16)
SMALL = (PHOTO[::2, ::2] >> 8).astype(np.uint8)


def written(*pages, **options):
    stream = BytesIO()
    with tifffile.TiffWriter(stream, **options) as file:
        for image, fields in pages:
            file.write(image, photometric="minisblack", **fields)
    return stream.getvalue()


PREVIEWS = {
    "before it": [(SMALL, {"subfiletype": 1}), (PHOTO, {})],
    "behind it": [(PHOTO, {}), (SMALL, {"subfiletype": 1})],
    "above it": [(SMALL, {"subfiletype": 1, "subifds": 1}), (PHOTO, {})],
    "of the old kind": [(SMALL, {"extratags": [(255, 3, 1, 2, True)]}), (PHOTO, {})],
    "a mask": [(PHOTO > 9, {"subfiletype": 4}), (PHOTO, {})],
}


@pytest.mark.parametrize("place", PREVIEWS)
@pytest.mark.parametrize("options", [{}, {"bigtiff": True, "byteorder": ">"}])
def test_a_preview_is_not_the_photo(place, options):
    image, warnings = decode(written(*PREVIEWS[place], **options), "photo.tif")
    np.testing.assert_array_equal(image, PHOTO)
    assert warnings == ()


@pytest.mark.parametrize(
    ("images", "which"),
    [
        ([PHOTO, PHOTO[::-1], PHOTO[:, ::-1]], "3 pages, the first was"),
        ([SMALL, PHOTO], "2 pages, .* number 2, was"),
    ],
)
def test_several_photos_in_a_file_are_told(images, which):
    data = written(*((image, {}) for image in images))
    image, warnings = decode(data, "stack.tif")
    np.testing.assert_array_equal(image, PHOTO)
    assert len(warnings) == 1
    assert re.search(rf"^stack\.tif: holds {which}", warnings[0])


def test_the_limit_on_pixels_is_on_the_page_that_is_decoded(tmp_path, monkeypatch):
    path = tmp_path / "photo.tif"
    path.write_bytes(written(*PREVIEWS["before it"]))
    monkeypatch.setattr("motdiff.files.photo_files.MOST_PX", PHOTO.size - 1)
    with pytest.raises(ValueError, match=r"photo\.tif: 56 x 40 px"):
        photo_bytes(path)


def test_pages_in_a_circle_end():
    data = bytearray(written((PHOTO, {})))
    page = tifffile.TiffFile(BytesIO(data)).pages[0]
    following = page.offset + 2 + 12 * len(page.tags)
    data[following : following + 4] = page.offset.to_bytes(4, "little")
    assert photo_page(bytes(data))[1:] == (1, 1)


def test_what_follows_a_photo_and_is_damaged_does_not_matter():
    data = bytearray(written((PHOTO, {})))
    page = tifffile.TiffFile(BytesIO(data)).pages[0]
    following = page.offset + 2 + 12 * len(page.tags)
    data[following : following + 4] = (2**31).to_bytes(4, "little")
    np.testing.assert_array_equal(decode(bytes(data), "photo.tif")[0], PHOTO)


def directory(*fields, following=0):
    """Directory of fields of one tag, type, count and value each."""
    entries = b"".join(struct.pack("<HHII", *field) for field in fields)
    return struct.pack("<H", len(fields)) + entries + struct.pack("<I", following)


PAGE = [(256, 4, 1, 56), (257, 4, 1, 40), (258, 3, 1, 8), (273, 4, 1, 8), (279, 4, 1, 40 * 56)]
CROWD = (PAGE * 820)[:4096]
END = 8 + 2 + 12 * len(CROWD) + 4
HOSTILE = {
    "a page of many fields that follows itself": directory(*CROWD, following=8),
    "many pages of many fields": b"".join(
        directory(*CROWD, following=8 + at * (END - 8)) for at in range(1, 40)
    ),
    "many fields of the same million offsets": directory(*[(273, 3, 10**6, END)] * 4096)
    + bytes(2 * 10**6),
    "a million pages below one": directory(*CROWD[:-1], (330, 4, 10**6, END))
    + (8).to_bytes(4, "little") * 10**6,
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_directories_made_to_keep_a_reader_busy_end(kind):
    data = b"II*\0" + struct.pack("<I", 8) + HOSTILE[kind]
    parsed = 0

    def count(frame, event, argument):
        nonlocal parsed
        parsed += event == "call" and frame.f_code.co_name == "fromfile"  # of each field

    tracemalloc.start()
    sys.setprofile(count)
    try:
        with suppress(ValueError):
            decode(data, "photo.tif")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        sys.setprofile(None)
        tracemalloc.stop()
    assert parsed < 50_000
    assert peak < 400e6


PROGRAM = """
import sys
from motdiff.files.decoding import decode
from motdiff.files.photo_files import photo_bytes
decode(photo_bytes(sys.argv[1]), "photo")
print("tifffile" in sys.modules)
"""


@pytest.mark.parametrize(("suffix", "loaded"), [(".png", "False"), (".tif", "True")])
def test_the_library_is_loaded_for_tiff_files_alone_and_prints_nothing(tmp_path, suffix, loaded):
    path = tmp_path / f"photo{suffix}"
    cv2.imwrite(str(path), PHOTO)
    if suffix == ".tif":
        path.write_bytes(
            written((PHOTO, {"extratags": [(42113, 2, 4, "none", True)]}))
        )  # a value that is no number
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(path)], capture_output=True, text=True, check=True
    )
    assert (done.stdout.strip(), done.stderr) == (loaded, "")


@pytest.mark.parametrize(
    ("extra", "line"),
    [
        (["unassalpha"], ""),
        (["unspecified"], "has 2 channels of no colour, save one of them, or three as RGB"),
        (
            ["unspecified", "unassalpha"],
            "has 2 channels of no colour, save one of them, or three as RGB",
        ),
    ],
)
def test_grey_may_have_transparency_and_no_other_channel(extra, line):
    stream = BytesIO()
    tifffile.imwrite(
        stream,
        np.stack([SMALL] * (1 + len(extra)), axis=-1),
        photometric="minisblack",
        planarconfig="contig",
        extrasamples=extra,
    )
    page = tifffile.TiffFile(BytesIO(stream.getvalue())).pages[0]
    assert page.samplesperpixel == 1 + len(extra)
    assert refusal(page) == line
