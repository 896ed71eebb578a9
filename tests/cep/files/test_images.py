"""Photos in and out: light is preserved, depth is kept, and every broken file is refused in one
line."""

import struct
import sys
import tracemalloc

import cv2
import numpy as np
import pytest
from fuzz_readers import dng
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from cep.files.images import parse_gamma, read_detail, read_image, read_photo, write_image
from motdiff.photo_values import to_linear


@pytest.fixture
def ramp():
    """Sixteen-bit colours, every channel different, so that a swap of channels or axes shows."""
    rows, columns = np.mgrid[0:40, 0:56]
    return np.stack([rows / 39, columns / 55, (rows + columns) / 94], axis=-1)


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize(("bits", "step"), [(8, 1 / 255), (16, 1 / 65535)])
@pytest.mark.parametrize("gamma", ["linear", "srgb", 2.2])
def test_what_is_written_is_read_back(tmp_path, ramp, suffix, bits, step, gamma):
    path = tmp_path / f"a{suffix}"
    write_image(path, ramp, bits=bits, gamma=gamma)
    photo = read_photo(path, gamma=gamma)
    assert photo.bits == bits
    assert photo.warnings == ()
    # half a step of the file, as light: the curves' steepest slopes are 2.275 (sRGB) and 2.2
    assert (
        np.abs(photo.pixels - ramp).max() <= 0.5 * step * (1 if gamma == "linear" else 2.3) + 1e-12
    )


def test_float_tiff_is_linear_light_whatever_is_asked(tmp_path, ramp):
    path = tmp_path / "a.tiff"
    write_image(path, ramp, bits=32, gamma="srgb")
    photo = read_photo(path, gamma="srgb")
    assert photo.bits == 32
    np.testing.assert_array_equal(photo.pixels, ramp.astype(np.float32).astype(np.float64))


def test_sixteen_bit_stays_sixteen_bit(tmp_path):
    fine = np.linspace(0.5, 0.501, 64 * 64).reshape(64, 64)
    write_image(tmp_path / "a.png", fine, bits=16, gamma="linear")
    assert len(np.unique(cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED))) > 60
    assert len(np.unique(read_image(tmp_path / "a.png", gamma="linear"))) > 60


def test_srgb_is_linearised_unless_told_otherwise(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.full((20, 20), 188, np.uint8))
    assert read_image(tmp_path / "a.png") == pytest.approx(float(to_linear(188 / 255)))
    assert read_image(tmp_path / "a.png", gamma="linear") == pytest.approx(188 / 255)


def test_colours_are_red_green_blue(tmp_path):
    blue_in_opencv = np.zeros((20, 20, 3), np.uint8)
    blue_in_opencv[..., 0] = 255
    cv2.imwrite(str(tmp_path / "a.png"), blue_in_opencv)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png")[0, 0], [0, 0, 1])


def test_jpeg_is_read_and_turned_upright(tmp_path):
    image = np.zeros((32, 64), np.uint8)
    image[:, :32] = 255
    data = bytearray(cv2.imencode(".jpg", image)[1].tobytes())
    orientation_90 = struct.pack("<2sHLHHHLL", b"II", 42, 8, 1, 0x0112, 3, 1, 6) + b"\0" * 4
    exif = b"Exif\0\0" + orientation_90
    data[2:2] = b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif
    (tmp_path / "a.jpg").write_bytes(data)
    upright = read_image(tmp_path / "a.jpg")
    assert upright.shape == (64, 32)
    assert upright[:30].mean() > 0.9 > 0.1 > upright[34:].mean()


def test_grey_stays_grey_and_alpha_is_dropped_with_a_word(tmp_path):
    grey = np.tile(np.arange(0, 240, 10, dtype=np.uint8), (24, 1))
    cv2.imwrite(str(tmp_path / "grey.png"), grey)
    assert read_image(tmp_path / "grey.png").shape == (24, 24)

    opaque = np.dstack([grey, grey, grey, np.full_like(grey, 255)])
    cv2.imwrite(str(tmp_path / "opaque.png"), opaque)
    assert read_photo(tmp_path / "opaque.png").warnings == ()
    opaque[3, 3, 3] = 100
    cv2.imwrite(str(tmp_path / "glass.png"), opaque)
    photo = read_photo(tmp_path / "glass.png")
    assert photo.pixels.shape == (24, 24, 3)
    assert len(photo.warnings) == 1
    assert "transparency" in photo.warnings[0]


def _truncated(path, share):
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif"])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.99])
def test_a_cut_file_is_refused_in_one_line_and_in_silence(tmp_path, capfd, name, share):
    path = tmp_path / name
    write_image(path, np.random.default_rng(0).random((64, 64, 3)), bits=8)
    _truncated(path, share)
    with pytest.raises(ValueError, match=r"damaged or cut short") as caught:
        read_image(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_a_flipped_bit_in_a_png_is_found(tmp_path):
    path = tmp_path / "a.png"
    write_image(path, np.random.default_rng(0).random((64, 64)))
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(ValueError, match="damaged"):
        read_image(path)


@settings(max_examples=60, deadline=None)
@given(
    st.binary(max_size=80),
    st.sampled_from([b"", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"II*\0", b"MM\0*"]),
)
def test_garbage_never_crashes(tmp_path_factory, tail, head):
    path = tmp_path_factory.mktemp("garbage") / "a.png"
    path.write_bytes(head + tail)
    with pytest.raises(ValueError, match=r"empty|cut short|not a PNG"):
        read_image(path)


def test_other_broken_files(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_image(tmp_path / "missing.png")
    (tmp_path / "text.png").write_text("hello, world")
    with pytest.raises(ValueError, match=r"text\.png: not a PNG, JPEG, TIFF or WebP image"):
        read_image(tmp_path / "text.png")
    cv2.imwrite(str(tmp_path / "dot.png"), np.zeros((1, 1), np.uint8))
    with pytest.raises(ValueError, match="1 x 1 px is too small"):
        read_image(tmp_path / "dot.png")
    assert read_photo(tmp_path / "dot.png", min_side_px=1).pixels.shape == (1, 1)


@pytest.mark.parametrize(
    ("value", "message"), [(np.nan, "NaN"), (np.inf, "infinite"), (1.5, "scale them to 0..1")]
)
def test_float_tiff_with_impossible_light(tmp_path, value, message):
    image = np.full((32, 32), 0.5, np.float32)
    image[4, 5] = value
    cv2.imwrite(str(tmp_path / "a.tif"), image)
    with pytest.raises(ValueError, match=message):
        read_image(tmp_path / "a.tif")


def test_raw_without_the_package_that_reads_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rawpy", None)
    (tmp_path / "a.dng").write_bytes(b"II*\0")
    with pytest.raises(ValueError, match=r"a\.dng: .*pip install rawpy$"):
        read_image(tmp_path / "a.dng")
    with pytest.raises(FileNotFoundError):
        read_image(tmp_path / "missing.dng")


def test_raw_is_the_light_that_its_mosaic_recorded(tmp_path):
    """A camera with the primaries of sRGB, for which daylight is white: grey stays grey, and a red
    is that red."""
    pytest.importorskip("rawpy")
    wanted = np.array([[[0.1, 0.1, 0.1], [0.5, 0.5, 0.5]], [[0.8, 0.3, 0.2], [0.05, 0.2, 0.6]]])
    light = np.kron(wanted, np.ones((32, 32, 1)))
    mosaic = light[:, :, 1].copy()
    mosaic[::2, ::2], mosaic[1::2, 1::2] = light[::2, ::2, 0], light[1::2, 1::2, 2]
    (tmp_path / "a.dng").write_bytes(dng(np.rint(65535 * mosaic).astype(np.uint16)))
    photo = read_photo(tmp_path / "a.dng", gamma=2.2)
    assert photo.bits == 16
    assert photo.pixels.shape == (64, 64, 3)
    middles = photo.pixels.reshape(2, 32, 2, 32, 3)[:, 8:-8, :, 8:-8].mean(axis=(1, 3))
    np.testing.assert_allclose(middles, wanted, atol=2e-3)


@pytest.mark.parametrize("share", [0, 0.001, 0.3, 0.99])
def test_a_damaged_raw_file_is_refused_in_one_line_and_in_silence(tmp_path, capfd, share):
    pytest.importorskip("rawpy")
    data = dng(np.random.default_rng(0).integers(0, 65535, (64, 64)).astype(np.uint16))
    path = tmp_path / "a.dng"
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(
        ValueError, match=r"a\.dng: not a RAW file that LibRaw can read \([A-Za-z/ ]+\)$"
    ):
        read_image(path)
    assert capfd.readouterr() == ("", "")


def test_raw_files_are_limited_in_size_too(tmp_path, monkeypatch):
    pytest.importorskip("rawpy")
    (tmp_path / "a.dng").write_bytes(dng(np.full((64, 64), 9000, np.uint16)))
    monkeypatch.setattr("motdiff.files.photo_files.MOST_PX", 64 * 63)
    with pytest.raises(ValueError, match=r"a\.dng: 64 x 64 px"):
        read_image(tmp_path / "a.dng")


def test_webp(tmp_path, ramp):
    display = np.rint(255 * ramp).astype(np.uint8)
    opaque = np.dstack([display[:, :, ::-1], np.full(ramp.shape[:2], 255, np.uint8)])
    lossless = [cv2.IMWRITE_WEBP_QUALITY, 101]
    for name, image in {"a.webp": display[:, :, ::-1], "opaque.webp": opaque}.items():
        cv2.imwrite(str(tmp_path / name), image, lossless)
        photo = read_photo(tmp_path / name, gamma="linear")
        np.testing.assert_allclose(photo.pixels, display / 255, atol=1e-12)
        assert (photo.bits, photo.warnings) == (8, ())
    opaque[3, 3, 3] = 100
    cv2.imwrite(str(tmp_path / "glass.webp"), opaque, lossless)
    assert "transparency" in read_photo(tmp_path / "glass.webp").warnings[0]


def test_a_photo_in_a_mat_file_is_linear_light(tmp_path, ramp):
    grey = ramp[:, :, 0]
    savemat(
        tmp_path / "a.mat",
        {"x": ramp, "y": grey, "f": np.ones((3, 3)), "z": (255 * grey).astype(np.uint8)},
    )
    photo = read_photo(tmp_path / "a.mat", gamma="srgb")
    np.testing.assert_array_equal(photo.pixels, grey)
    assert len(photo.warnings) == 1
    assert '"y" was taken as linear light' in photo.warnings[0]
    np.testing.assert_array_equal(read_image(tmp_path / "a.mat", variable="x"), ramp)
    np.testing.assert_allclose(
        read_image(tmp_path / "a.mat", variable="z"), np.floor(255 * grey) / 255
    )
    with pytest.raises(ValueError, match="3 x 3 px is too small"):
        read_image(tmp_path / "a.mat", variable="f")


@pytest.mark.parametrize(
    ("photo", "message"),
    [
        (np.full((20, 20), np.nan), "NaN"),
        (np.full((20, 20), 200.0), "scale them to 0..1"),
        (np.zeros((20, 20, 4)), "wanted \\(H, W\\)"),
        (np.zeros((20, 20), complex), "complex128 samples"),
        (np.zeros((0, 20)), "wanted \\(H, W\\)"),
        (np.zeros((20, 20), np.int32), "int32 samples"),
    ],
)
def test_mat_files_that_hold_no_photo(tmp_path, photo, message):
    savemat(tmp_path / "a.mat", {"y": photo})
    with pytest.raises(ValueError, match=message) as caught:
        read_image(tmp_path / "a.mat")
    assert str(tmp_path / "a.mat") in str(caught.value)


def test_reading_floats_takes_little_more_memory_than_they_do(tmp_path):
    """The file's samples, half as large, are in memory as well; three whole copies were."""
    image = np.random.default_rng(0).random((900, 1200, 3)).astype(np.float32)
    cv2.imwrite(str(tmp_path / "a.tif"), image, [cv2.IMWRITE_TIFF_COMPRESSION, 1])
    tracemalloc.start()
    try:
        pixels = read_image(tmp_path / "a.tif")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 2.1 * pixels.nbytes


def test_writing_refuses_what_it_cannot_do_and_leaves_nothing(tmp_path):
    with pytest.raises(ValueError, match=r"\.png, \.tif or \.jpg"):
        write_image(tmp_path / "a.gif", np.zeros((20, 20)))
    with pytest.raises(ValueError, match="finite"):
        write_image(tmp_path / "a.png", np.full((20, 20), np.nan))
    with pytest.raises(ValueError, match="8, 16 or 32"):
        write_image(tmp_path / "a.png", np.zeros((20, 20)), bits=12)
    with pytest.raises(ValueError, match="shape"):
        write_image(tmp_path / "a.png", np.zeros(20))
    assert list(tmp_path.iterdir()) == []


def test_values_outside_the_range_are_clipped(tmp_path):
    write_image(tmp_path / "a.png", np.where(np.eye(20) > 0, 3.0, -1.0), bits=16, gamma="linear")
    np.testing.assert_array_equal(read_image(tmp_path / "a.png", gamma="linear"), np.eye(20))


@pytest.mark.parametrize("wrong", ["", "sRGB!", "0", "-1", "nan", "9"])
def test_gamma_is_checked(tmp_path, wrong):
    with pytest.raises(ValueError, match="gamma"):
        parse_gamma(wrong)
    with pytest.raises(ValueError, match="gamma"):
        read_image(tmp_path / "not even opened.png", gamma=wrong)


def test_forty_megapixels(tmp_path):
    """A camera's full frame: 7304 x 5476 px, 8 bit grey."""
    path = tmp_path / "large.png"
    image = np.zeros((5476, 7304), np.uint8)
    image[::64] = 200
    path.write_bytes(cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes())
    pixels = read_image(path)
    assert pixels.shape == (5476, 7304)
    assert pixels[64, 7303] == pytest.approx(float(to_linear(200 / 255)))


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif"])
def test_the_part_with_most_detail_is_read_as_the_whole_photo_is(tmp_path, suffix):
    photo = np.full((300, 400, 3), 0.3)
    photo[200:260, 260:330] = np.random.default_rng(0).random((60, 70, 3))
    path = tmp_path / f"photo{suffix}"
    write_image(path, photo, bits=16 if suffix != ".jpg" else 8)
    whole = read_photo(path)
    part, small, size = read_detail(path, side_px=100, preview_px=200)
    assert (part.bits, size, small.shape) == (whole.bits, (300, 400), (150, 200, 3))
    assert part.pixels.shape == (100, 100, 3)
    places = [(row, column) for row in range(201) for column in range(301)]
    assert any(
        np.array_equal(part.pixels, whole.pixels[r : r + 100, c : c + 100])
        for r, c in places
        if r > 150 and c > 200
    )
    assert np.var(part.pixels) > 0.9 * max(
        np.var(whole.pixels[160:260, 230:330]), np.var(whole.pixels[200:300, 260:360])
    )
    assert small.mean() == pytest.approx(whole.pixels.mean(), rel=0.02)


def test_a_small_photo_is_its_own_part(tmp_path, ramp):
    write_image(tmp_path / "photo.png", ramp, bits=16)
    part, small, size = read_detail(tmp_path / "photo.png", side_px=100, preview_px=200)
    assert np.array_equal(part.pixels, read_photo(tmp_path / "photo.png").pixels)
    assert np.array_equal(part.pixels, small)
    assert size == ramp.shape[:2]
