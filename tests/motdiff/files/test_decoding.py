"""Samples of TIFF files: right whatever the tags say, or refused in one line that says what would
be right."""

import struct
import tracemalloc
import zlib
from io import BytesIO

import cv2
import imagecodecs
import numpy as np
import pytest
import tifffile
from PIL import Image, ImageOps

from motdiff.files.decoding import decode

SCENE = np.random.default_rng(0).integers(0, 256, (37, 53, 5)).astype(np.uint8)

PLAIN = ("raw", "tiff_lzw", "packbits")


def tiff(image, **options):
    stream = BytesIO()
    tifffile.imwrite(stream, image, **options)
    return stream.getvalue()


def samples(kind, channels):
    image = SCENE[:, :, :channels] if channels > 1 else SCENE[:, :, 0]
    return (
        (image / 255).astype(kind)
        if kind.startswith("f")
        else image.astype(kind) * (257 if kind == "u2" else 1)
    )


def bits_packed(values, bits, *, photometric, compress):
    """A TIFF of integers (H, W) of any number of bits, written by the specification."""
    planes = (values[:, :, None] >> np.arange(bits)[::-1] & 1).astype(np.uint8)
    data = np.packbits(planes.reshape(len(values), -1), axis=1).tobytes()
    data = zlib.compress(data) if compress else data
    fields = {
        256: values.shape[1],
        257: values.shape[0],
        258: bits,
        259: 8 if compress else 1,
        262: photometric,
        273: 0,
        277: 1,
        278: values.shape[0],
        279: len(data),
    }
    fields[273] = 8 + 2 + 12 * len(fields) + 4
    entries = b"".join(struct.pack(">HHII", tag, 4, 1, value) for tag, value in fields.items())
    return b"MM\0*" + struct.pack(">IH", 8, len(fields)) + entries + bytes(4) + data


@pytest.mark.parametrize("kind", ["u1", "u2", "f2", "f4", "f8"])
@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("separate", [False, True])
@pytest.mark.parametrize("storage", [{}, {"rowsperstrip": 10}, {"tile": (16, 32)}])
@pytest.mark.parametrize("compression", [None, "adobe_deflate", "lzma", "zstd"])
def test_layouts_of_the_same_picture_are_the_same(kind, channels, separate, storage, compression):
    image = samples(kind, channels)
    whole = compression and not kind.startswith("f")
    data = tiff(
        np.moveaxis(image, -1, 0) if separate and channels > 1 else image,
        photometric="rgb" if channels > 1 else "minisblack",
        planarconfig=("separate" if separate else "contig") if channels > 1 else None,
        extrasamples=["unassalpha"] if channels == 4 else None,
        compression=compression,
        predictor=bool(whole),
        byteorder=">" if separate else "<",
        bigtiff=separate,
        **storage,
    )
    decoded, warnings = decode(data, "photo.tif")
    assert decoded.dtype == image.dtype
    np.testing.assert_array_equal(decoded, image[:, :, :3] if channels > 1 else image)
    assert [("transparency" in warning) for warning in warnings] == [True] * (channels == 4)


@pytest.mark.parametrize("kind", ["u1", "u2", "f4"])
@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize(
    "compression", [cv2.IMWRITE_TIFF_COMPRESSION_LZW, cv2.IMWRITE_TIFF_COMPRESSION_PACKBITS]
)
@pytest.mark.parametrize("predictor", [1, 2, 3])
def test_compressions_of_libtiff(kind, channels, compression, predictor):
    if predictor == 3 and not kind.startswith("f"):
        predictor = 2
    image = samples(kind, channels)
    stored = image if channels == 1 else np.dstack([image[:, :, 2::-1], image[:, :, 3:]])
    options = [cv2.IMWRITE_TIFF_COMPRESSION, compression, cv2.IMWRITE_TIFF_PREDICTOR, predictor]
    data = cv2.imencode(".tif", stored, options)[1].tobytes()
    np.testing.assert_array_equal(
        decode(data, "photo.tif")[0], image[:, :, :3] if channels > 1 else image
    )


@pytest.mark.parametrize(
    ("mode", "compression"),
    [
        *(
            (mode, compression)
            for mode in ("RGB", "RGBA", "L", "YCbCr")
            for compression in (*PLAIN, "jpeg")
        ),
        *((mode, compression) for mode in ("P", "LA") for compression in PLAIN),
        *(("1", compression) for compression in (*PLAIN, "group3", "group4")),
    ],
)
def test_pictures_of_another_writer(mode, compression):
    """Pillow writes, and is the witness."""
    image = Image.fromarray(cv2.blur(SCENE[:, :, :3], (9, 9)))
    image = (
        image.quantize(16)
        if mode == "P"
        else image.convert("L" if mode == "LA" else "RGB").convert(mode)
    )
    if mode in ("RGBA", "LA"):
        image.putalpha(Image.fromarray(SCENE[:, :, 3]))
    stream = BytesIO()
    image.save(stream, "tiff", compression=compression)
    wanted = np.asarray(Image.open(stream).convert("L" if mode in ("L", "LA", "1") else "RGB"))
    decoded, warnings = decode(stream.getvalue(), "photo.tif")
    assert np.abs(decoded.astype(int) - wanted).max() <= 1  # of the conversion from YCbCr
    assert len(warnings) == (mode in ("RGBA", "LA"))


@pytest.mark.parametrize("bits", [1, 2, 4, 7, 10, 12, 14, 15])
@pytest.mark.parametrize("photometric", [0, 1])
@pytest.mark.parametrize("compress", [False, True])
def test_samples_that_are_no_whole_bytes_fill_the_range(bits, photometric, compress):
    values = np.random.default_rng(bits).integers(0, 2**bits, (21, 27))
    decoded, _ = decode(
        bits_packed(values, bits, photometric=photometric, compress=compress), "photo.tif"
    )
    full = 255 if bits < 8 else 65535
    light = values / (2**bits - 1)
    assert decoded.dtype == (np.uint8 if bits < 8 else np.uint16)
    assert np.abs(decoded - full * (light if photometric else 1 - light)).max() <= 0.5


@pytest.mark.parametrize("kind", ["u1", "u2", "f4"])
def test_where_white_is_zero_the_picture_is_inverted(kind):
    image = samples(kind, 1)
    white = 1 if kind == "f4" else np.iinfo(kind).max
    np.testing.assert_array_equal(
        decode(tiff(white - image, photometric="miniswhite"), "a.tif")[0], white - (white - image)
    )


def test_channels_beside_the_colours_are_dropped_with_a_word():
    image, warnings = decode(tiff(SCENE, photometric="rgb", planarconfig="contig"), "photo.tif")
    np.testing.assert_array_equal(image, SCENE[:, :, :3])
    assert len(warnings) == 1
    assert "beside the colours" in warnings[0]


@pytest.mark.parametrize("associated", ["assocalpha", "unassalpha"])
def test_grey_of_16_bit_keeps_them_beside_transparency(associated):
    image = samples("u2", 2)
    data = tiff(image, photometric="minisblack", planarconfig="contig", extrasamples=[associated])
    decoded, warnings = decode(data, "photo.tif")
    np.testing.assert_array_equal(decoded, image[:, :, 0])
    assert len(warnings) == 1
    image[:, :, 1] = 65535
    data = tiff(image, photometric="minisblack", planarconfig="contig", extrasamples=[associated])
    assert decode(data, "photo.tif")[1] == ()


REFUSED = {
    "CMYK": (tiff(SCENE[:, :, :4], photometric="separated"), "CMYK.*RGB or grey"),
    "CIELab": (tiff(SCENE[:, :, :3], photometric="cielab"), "CIELab.*RGB or grey"),
    "mosaic": (tiff(SCENE[:, :, 0], photometric="cfa"), "colour filter mosaic.*RGB or grey"),
    "channels": (
        tiff(SCENE, photometric="minisblack", planarconfig="contig"),
        "5 channels of no colour",
    ),
    "signed": (
        tiff(SCENE[:, :, 0].astype(np.int16)),
        "16-bit integers with a sign.*floating point of 32",
    ),
    "uint32": (
        tiff(SCENE[:, :, 0].astype(np.uint32)),
        "32-bit integers, save.*floating point of 32",
    ),
    "complex": (tiff(SCENE[:, :, 0].astype(np.complex64)), "complex numbers"),
    "volume": (
        tiff(SCENE, volumetric=True, tile=(16, 16, 16), photometric="minisblack"),
        "37 layers",
    ),
    "JPEG XL": (tiff(SCENE[:, :, 0], compression="jpegxl"), "JPEGXL, save it uncompressed"),
    "unknown": (
        tiff(SCENE[:, :, 0]).replace(
            struct.pack("<HHII", 259, 3, 1, 1), struct.pack("<HHII", 259, 3, 1, 60000)
        ),
        "method 60000, save it uncompressed",
    ),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_what_is_not_read_is_refused_for_what_it_is(kind):
    data, message = REFUSED[kind]
    with pytest.raises(ValueError, match=rf"^photo\.tif: .*{message}") as caught:
        decode(data, "photo.tif")
    assert "damaged" not in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("compression", [None, "adobe_deflate", "lzma"])
def test_a_strip_that_is_missing_is_damage_and_no_black(compression):
    data = tiff(SCENE[:, :, :3], photometric="rgb", rowsperstrip=10, compression=compression)
    page = tifffile.TiffFile(BytesIO(data)).pages[0]
    for tag, place in ((273, 3), (279, 2)):
        if compression is None and tag == 279:
            continue  # the length of what is not compressed is known
        broken = bytearray(data)
        field = page.tags[tag]
        size = struct.calcsize("<" + field.dataformat[-1])
        at = field.valueoffset + place * size
        broken[at : at + size] = bytes(size)
        with pytest.raises(ValueError, match="damaged or cut short"):
            decode(bytes(broken), "photo.tif")


def with_strip(data, strip):
    """Put other bytes in the place of a file's first strip or tile."""
    page = tifffile.TiffFile(BytesIO(data)).pages[0]
    patched = bytearray(data)
    for field, value in (
        (page.tags.get(324) or page.tags[273], len(data)),
        (page.tags.get(325) or page.tags[279], len(strip)),
    ):
        struct.pack_into("<" + field.dataformat[-1], patched, field.valueoffset, value)
    return bytes(patched) + strip


def jpeg_of(width, height):
    """A small JPEG whose frame's header says another size."""
    data = bytearray(cv2.imencode(".jpg", SCENE[:, :, 0])[1].tobytes())
    struct.pack_into(">2H", data, data.index(b"\xff\xc0") + 5, height, width)
    return bytes(data)


BOMBS = {
    "a strip of Deflate": with_strip(
        tiff(SCENE[:, :, 0], compression="adobe_deflate"), zlib.compress(bytes(200_000_000))
    ),
    "a strip of ZSTD": with_strip(
        tiff(SCENE[:, :, 0], compression="zstd"), imagecodecs.zstd_encode(bytes(200_000_000))
    ),
    "a large tile": with_strip(
        tiff(SCENE[:, :, 0], compression="adobe_deflate", tile=(65_520, 65_520)),
        zlib.compress(bytes(1000)),
    ),
    "a large JPEG": with_strip(tiff(SCENE[:, :, 0], compression="jpeg"), jpeg_of(65_500, 65_500)),
}


@pytest.mark.parametrize("bomb", BOMBS)
def test_a_strip_or_tile_that_unpacks_to_much_more_than_its_image_is_damage(bomb):
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=r"^photo\.tif: the image is damaged or cut short"):
            decode(BOMBS[bomb], "photo.tif")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 5e6


@pytest.mark.parametrize("share", [0.3, 0.9, 0.99])
@pytest.mark.parametrize("compression", [None, "adobe_deflate", "lzma", "zstd", "jpeg"])
def test_a_file_whose_last_strips_are_cut_off_is_refused(share, compression):
    data = tiff(SCENE[:, :, :3], photometric="rgb", rowsperstrip=16, compression=compression)
    with pytest.raises(ValueError, match="damaged or cut short"):
        decode(data[: int(share * len(data))], "photo.tif")


def test_samples_of_reversed_bits_are_read():
    reversed_bits = np.packbits(np.unpackbits(SCENE[:, :, :1], axis=2), axis=2, bitorder="little")[
        :, :, 0
    ]
    unit = struct.pack("<HHII", 296, 3, 1, 1)
    fill_order = struct.pack("<HHII", 266, 3, 1, 2)
    data = tiff(reversed_bits).replace(unit, fill_order)
    np.testing.assert_array_equal(decode(data, "photo.tif")[0], SCENE[:, :, 0])


def test_the_first_of_several_pages_is_read_and_the_others_are_mentioned():
    pages = np.moveaxis(SCENE[:, :, :3], 2, 0)
    image, warnings = decode(tiff(pages, photometric="minisblack"), "stack.tif")
    np.testing.assert_array_equal(image, pages[0])
    assert len(warnings) == 1
    assert warnings[0].startswith("stack.tif: holds 3 pages, the first was read")
    assert decode(tiff(pages[0]), "photo.tif")[1] == ()


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_photo_is_turned_as_pillow_turns_it(orientation):
    data = tiff(SCENE[:, :, :3], extratags=[(274, "H", 1, orientation, True)])
    upright = np.asarray(ImageOps.exif_transpose(Image.open(BytesIO(data))))
    assert upright.shape == ((37, 53, 3) if orientation < 5 else (53, 37, 3))
    np.testing.assert_array_equal(decode(data, "photo.tif")[0], upright)
