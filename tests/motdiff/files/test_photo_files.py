"""Image files before decoding: the size in their header is the one that is decoded, and it is
limited."""

import struct
import zlib
from io import BytesIO

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image, ImageOps

from motdiff.files.decoding import decode
from motdiff.files.photo_files import MOST_PX, check_px, orientation, photo_bytes


def encoded(suffix, image, *options):
    done, data = cv2.imencode(suffix, image, list(options))
    assert done
    return data.tobytes()


def tiff(image, **options):
    stream = BytesIO()
    tifffile.imwrite(stream, image, **options)
    return stream.getvalue()


def chunk(kind, body):
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png(width, height):
    """A whole PNG whose header promises white pixels, 1 bit each; a row of them is there."""
    row = b"\0" + b"\xff" * ((min(width, 80_000) + 7) // 8)
    header = struct.pack(">2I5B", width, height, 1, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(row))
        + chunk(b"IEND", b"")
    )


def with_thumbnail(jpeg):
    """Put another picture's header into the first segment, as cameras do."""
    small = b"Exif\0\0" + encoded(".jpg", np.zeros((8, 8), np.uint8))
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(small) + 2) + small + jpeg[2:]


def extended(webp, width, height):
    """Wrap a lossy picture into the extended format of WebP."""
    size = (width - 1).to_bytes(3, "little") + (height - 1).to_bytes(3, "little")
    body = b"WEBP" + b"VP8X" + struct.pack("<I", 10) + bytes(4) + size + webp[12:]
    return b"RIFF" + struct.pack("<I", len(body)) + body


SCENE = np.kron(np.random.default_rng(0).integers(0, 255, (5, 9, 3)), np.ones((5, 7, 1))).astype(
    np.uint8
)
GOOD = {
    "png": encoded(".png", SCENE),
    "jpeg": encoded(".jpg", SCENE),
    "progressive jpeg": encoded(".jpg", SCENE, cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
    "jpeg with a thumbnail": with_thumbnail(encoded(".jpg", SCENE)),
    "jpeg with padding": (lambda data: data[:2] + b"\xff\xff" + data[2:])(encoded(".jpg", SCENE)),
    "tiff": encoded(".tif", SCENE),
    "big-endian tiff": tiff(SCENE, byteorder=">", photometric="rgb"),
    "BigTIFF": tiff(SCENE, bigtiff=True, photometric="rgb"),
    "big-endian BigTIFF": tiff(SCENE, bigtiff=True, byteorder=">", photometric="rgb"),
    "lossy webp": encoded(".webp", SCENE, cv2.IMWRITE_WEBP_QUALITY, 80),
    "lossless webp": encoded(".webp", SCENE, cv2.IMWRITE_WEBP_QUALITY, 101),
    "extended webp": extended(encoded(".webp", SCENE, cv2.IMWRITE_WEBP_QUALITY, 80), 63, 25),
}


@pytest.mark.parametrize("kind", GOOD)
def test_the_size_in_the_header_is_the_one_that_is_decoded(tmp_path, monkeypatch, kind):
    path = tmp_path / "photo"
    path.write_bytes(GOOD[kind])
    seen = []
    monkeypatch.setattr("motdiff.files.photo_files.check_px", lambda *given: seen.append(given))
    image, damage = decode(photo_bytes(path), path)
    height, width = image.shape[:2]
    assert (width, height) == (63, 25)
    assert seen == [(width, height, path)]
    assert damage == ()


def test_a_small_file_of_a_large_image_is_refused_before_it_is_decoded(tmp_path):
    path = tmp_path / "white.png"
    path.write_bytes(png(30_000, 30_000))
    assert path.stat().st_size < 200
    with pytest.raises(
        ValueError, match=r"white\.png: 30000 x 30000 px .* at most 120 .* crop .* or scale"
    ):
        photo_bytes(path)
    path.write_bytes(png(15_000, 8_000))
    assert photo_bytes(path) == path.read_bytes()


def test_the_limit_is_on_pixels_whatever_their_shape():
    check_px(MOST_PX, 1, "strip.png")
    check_px(10_000, MOST_PX // 10_000, "photo.png")
    with pytest.raises(ValueError, match=r"strip\.png: 120000001 x 1 px"):
        check_px(MOST_PX + 1, 1, "strip.png")


def test_a_file_of_gigabytes_is_not_read(tmp_path):
    path = tmp_path / "long.tif"
    with path.open("wb") as stream:
        stream.write(GOOD["tiff"])
        stream.truncate(3 * 10**9)  # takes no room on the disk
    with pytest.raises(ValueError, match=r"long\.tif: has 3\.0 GB"):
        photo_bytes(path)


@pytest.mark.parametrize("kind", GOOD)
@pytest.mark.parametrize("share", [0.02, 0.1, 0.5, 0.97])
def test_a_cut_file_is_refused(tmp_path, capfd, kind, share):
    path = tmp_path / "photo"
    path.write_bytes(GOOD[kind][: int(share * len(GOOD[kind]))])
    with pytest.raises(
        ValueError, match=r"photo: (the image is damaged|not a PNG|the file is empty)"
    ):
        decode(photo_bytes(path), path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "missing", ["none", "", "MM\0*\0\0\0\x08\0\0", "\xff\xd8\xff\xda\0\2", "RIFF\4\0\0\0WEBP"]
)
def test_headers_without_a_size(tmp_path, missing):
    path = tmp_path / "photo"
    path.write_bytes(missing.encode("latin-1"))
    with pytest.raises(
        ValueError, match=r"photo: (the image is damaged|not a PNG|the file is empty)"
    ):
        photo_bytes(path)


def test_damage_that_a_jpegs_decoder_passes_over_is_told_and_not_printed(tmp_path, capfd):
    data = encoded(".jpg", cv2.resize(SCENE, (200, 200)))
    middle = len(data) // 2
    _, damage = decode(data[:middle] + data[middle + 200 :], "photo.jpg")
    assert len(damage) == 1
    assert damage[0].startswith("photo.jpg: the image is damaged in places (Corrupt JPEG data")
    assert capfd.readouterr() == ("", "")


def with_orientation(kind, value):
    image = Image.fromarray(SCENE)
    exif = image.getexif()
    exif[274] = value
    stream = BytesIO()
    image.save(stream, kind, exif=exif, **({"lossless": True} if kind == "webp" else {}))
    return stream.getvalue(), np.asarray(ImageOps.exif_transpose(Image.open(stream)))


@pytest.mark.parametrize("kind", ["png", "jpeg", "webp", "tiff"])
@pytest.mark.parametrize("value", [*range(10), 65535])
def test_photos_are_turned_upright_whatever_their_format(kind, value):
    """Pillow is the witness; what is no orientation leaves a photo as it is."""
    data, upright = with_orientation(kind, value)
    image, warnings = decode(data, "photo")
    assert image.shape == upright.shape
    assert np.abs(image.astype(int) - upright).max() <= (8 if kind == "jpeg" else 0)
    assert warnings == ()


def test_exif_data_of_a_png_count_behind_its_pixels_too():
    data, _ = with_orientation("png", 6)
    at = data.index(b"eXIf") - 4
    (length,) = struct.unpack_from(">I", data, at)
    exif = data[at : at + 12 + length]
    plain = data[:at] + data[at + len(exif) :]
    end = plain.index(b"IEND") - 4
    assert orientation(plain) == 1
    assert orientation(plain[:end] + exif + plain[end:]) == 6


def test_damaged_exif_data_leave_the_photo_as_it_is():
    data, _ = with_orientation("png", 6)
    at = data.index(b"eXIf") - 4
    (length,) = struct.unpack_from(">I", data, at)
    exif = data[at + 8 : at + 8 + length]
    for bad in (
        b"",
        exif[:5],
        exif[:12],
        b"XX" + exif[2:],
        exif[:4] + b"\xff\xff\xff\x7f" + exif[8:],
    ):
        image, _ = decode(data[:at] + chunk(b"eXIf", bad) + data[at + 12 + length :], "photo.png")
        np.testing.assert_array_equal(image, SCENE)


@pytest.mark.parametrize("kind", ["png", "webp"])
def test_of_an_animation_the_first_picture_is_read_with_a_word(kind):
    stream = BytesIO()
    first = Image.fromarray(SCENE)
    first.save(
        stream, kind, save_all=True, append_images=[Image.fromarray(SCENE[::-1])], lossless=True
    )
    image, warnings = decode(stream.getvalue(), "photo")
    np.testing.assert_array_equal(image, SCENE)
    assert len(warnings) == 1
    assert "animated" in warnings[0]
