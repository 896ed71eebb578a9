"""Samples of TIFF files: right whatever the tags say, or refused in one line that says what would be right."""

import struct
import zlib
from io import BytesIO

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image

from motdiff.io.decoding import decode

SCENE = np.random.default_rng(0).integers(0, 256, (37, 53, 5)).astype(np.uint8)

PLAIN = ("raw", "tiff_lzw", "packbits")


def tiff(image, **options):
    stream = BytesIO()
    tifffile.imwrite(stream, image, **options)
    return stream.getvalue()


def samples(kind, channels):
    image = SCENE[:, :, :channels] if channels > 1 else SCENE[:, :, 0]
    return (image / 255).astype(kind) if kind.startswith("f") else image.astype(kind) * (257 if kind == "u2" else 1)


def bits_packed(values, bits, *, photometric, compress):
    """A TIFF of integers (H, W) of any number of bits, written by the specification."""
    planes = (values[:, :, None] >> np.arange(bits)[::-1] & 1).astype(np.uint8)
    data = np.packbits(planes.reshape(len(values), -1), axis=1).tobytes()
    data = zlib.compress(data) if compress else data
    fields = {
        256: values.shape[1], 257: values.shape[0], 258: bits, 259: 8 if compress else 1, 262: photometric, 273: 0,
        277: 1, 278: values.shape[0], 279: len(data),
    }  # fmt: skip
    fields[273] = 8 + 2 + 12 * len(fields) + 4
    entries = b"".join(struct.pack(">HHII", tag, 4, 1, value) for tag, value in fields.items())
    return b"MM\0*" + struct.pack(">IH", 8, len(fields)) + entries + bytes(4) + data


@pytest.mark.parametrize("kind", ["u1", "u2", "f2", "f4", "f8"])
@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("separate", [False, True])
@pytest.mark.parametrize("storage", [{}, {"rowsperstrip": 10}, {"tile": (16, 32)}])
@pytest.mark.parametrize("compression", [None, "adobe_deflate", "lzma"])
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
@pytest.mark.parametrize("compression", [cv2.IMWRITE_TIFF_COMPRESSION_LZW, cv2.IMWRITE_TIFF_COMPRESSION_PACKBITS])
@pytest.mark.parametrize("predictor", [1, 2, 3])
def test_compressions_of_libtiff(kind, channels, compression, predictor):
    if predictor == 3 and not kind.startswith("f"):
        predictor = 2
    image = samples(kind, channels)
    stored = image if channels == 1 else np.dstack([image[:, :, 2::-1], image[:, :, 3:]])
    options = [cv2.IMWRITE_TIFF_COMPRESSION, compression, cv2.IMWRITE_TIFF_PREDICTOR, predictor]
    data = cv2.imencode(".tif", stored, options)[1].tobytes()
    np.testing.assert_array_equal(decode(data, "photo.tif")[0], image[:, :, :3] if channels > 1 else image)


@pytest.mark.parametrize(
    ("mode", "compression"),
    [
        *((mode, compression) for mode in ("RGB", "RGBA", "L", "YCbCr") for compression in (*PLAIN, "jpeg")),
        *((mode, compression) for mode in ("P", "LA") for compression in PLAIN),
        *(("1", compression) for compression in (*PLAIN, "group3", "group4")),
    ],
)
def test_pictures_of_another_writer(mode, compression):
    """Pillow writes, and is the witness."""
    image = Image.fromarray(cv2.blur(SCENE[:, :, :3], (9, 9)))
    image = image.quantize(16) if mode == "P" else image.convert("L" if mode == "LA" else "RGB").convert(mode)
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
    decoded, _ = decode(bits_packed(values, bits, photometric=photometric, compress=compress), "photo.tif")
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
    "channels": (tiff(SCENE, photometric="minisblack", planarconfig="contig"), "5 channels of no colour"),
    "signed": (tiff(SCENE[:, :, 0].astype(np.int16)), "16-bit integers with a sign.*floating point of 32"),
    "uint32": (tiff(SCENE[:, :, 0].astype(np.uint32)), "32-bit integers, save.*floating point of 32"),
    "complex": (tiff(SCENE[:, :, 0].astype(np.complex64)), "complex numbers"),
    "volume": (tiff(SCENE, volumetric=True, tile=(16, 16, 16), photometric="minisblack"), "37 layers"),
    "ZSTD": (
        tiff(SCENE[:, :, 0]).replace(struct.pack("<HHII", 259, 3, 1, 1), struct.pack("<HHII", 259, 3, 1, 50000)),
        "ZSTD, save it uncompressed",
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


def test_a_strip_is_not_unpacked_beyond_its_size():
    """A strip of zeros unpacks to 200 MB, of which 2 kB are its own."""
    import tracemalloc

    data = tiff(SCENE[:, :, 0], compression="adobe_deflate")
    page = tifffile.TiffFile(BytesIO(data)).pages[0]
    bomb = zlib.compress(bytes(200_000_000))
    patched = bytearray(data)
    for tag, value in ((273, len(data)), (279, len(bomb))):
        field = page.tags[tag]
        struct.pack_into("<" + field.dataformat[-1], patched, field.valueoffset, value)
    tracemalloc.start()
    try:
        image, _ = decode(bytes(patched) + bomb, "photo.tif")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert not image.any()
    assert peak < 5e6
