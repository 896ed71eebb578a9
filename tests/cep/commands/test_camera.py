"""``cep camera``: known cameras, and one measured from frames in files."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from fuzz_readers import dng

from cep.files.images import write_image
from cep.files.raw_files import read_mosaic
from cep.optics.camera import Camera, camera_names

GAIN = 2.5
READ_E = 8.0
BLACK = 64


def frame(electrons, rng, *, top=4095, side=160):
    light = electrons * np.linspace(0.9, 1.1, side)
    values = (
        rng.poisson(light, (side, side)) + rng.normal(0, READ_E, (side, side))
    ) / GAIN + BLACK
    return np.clip(np.rint(values), 0, top).astype(np.uint16)


@pytest.fixture
def frames(tmp_path, monkeypatch):
    """A folder with pairs of flats of 12 bits and a dark pair, in which the process works."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    for name, level in {"dark": 0, "low": 400, "mid": 2000, "high": 6000, "over": 20_000}.items():
        for one in "ab":
            cv2.imwrite(f"{name}{one}.png", frame(level, rng))
    return ["lowa.png", "lowb.png", "mida.png", "midb.png", "higha.png", "highb.png"]


DARK = ("--dark", "darka.png", "darkb.png")


def test_known_cameras_are_listed(cep):
    listed = cep.succeeds("camera", "list")["cameras"]
    assert [one["name"] for one in listed] == list(camera_names())
    assert all(one["source"] for one in listed)
    assert "sony-imx250" in cep("camera", "list").out


def test_a_camera_is_shown_with_its_source(cep, tmp_path):
    assert (
        cep.succeeds("camera", "list", "sony-imx250")["camera"]
        == Camera.load("sony-imx250").to_dict()
    )
    assert "EMVA 1288" in cep("camera", "list", "sony-imx250").out
    Camera(bits=9, source="[bold] by hand").to_file(tmp_path / "mine.json")
    assert "[bold] by hand" in cep("camera", "list", tmp_path / "mine.json").out
    line = cep.refuses("camera", "list", "imx250")
    assert line.startswith("cep: NAME: 'imx250' is not known; did you mean sony-imx250")


def test_a_profile_serves_wherever_a_camera_is_asked_for(cep, workplace):
    taken = cep.succeeds(
        "simulate", "sharp.png", "--linear", "9", "--camera", "sony-imx250", "--photons", "500"
    )
    assert taken["camera"]["gain_e_per_dn"] == Camera.load("sony-imx250").gain_e_per_dn
    assert taken["camera"]["photons_full_scale"] == 500
    assert "--camera: 'imx250'" in cep.refuses(
        "simulate", "sharp.png", "--linear", "9", "--camera", "imx250"
    )
    assert "--photons: must lie within 1..1e7" in cep.refuses("audit", "1011", "--photons", "1e8")


def test_a_camera_is_measured(cep, frames):
    found = cep.succeeds("camera", "estimate", *frames, "overa.png", "overb.png", *DARK)
    assert found["gain_e_per_dn"] == pytest.approx(GAIN, rel=0.02)
    assert found["read_noise_e"] == pytest.approx(READ_E, rel=0.05)
    assert found["full_well_e"] == pytest.approx(GAIN * (4095 - BLACK), rel=0.02)
    assert found["bits"] == 12
    assert found["warnings"] == []
    camera = Camera.load("camera.toml")
    assert camera.to_dict() == found["camera"]
    assert camera.gain_e_per_dn == pytest.approx(GAIN, rel=0.02)
    assert cv2.imread("camera.png").shape[2] == 3
    cep("camera", "estimate", *frames, *DARK, "--force")
    assert cep.out.splitlines()[0].startswith("2.5")


def test_the_same_camera_in_8_bit_and_shifted_files(cep, frames):
    for name in Path().glob("*.png"):
        cv2.imwrite(
            str(name.with_suffix(".tif")), cv2.imread(str(name), cv2.IMREAD_UNCHANGED) << 4
        )
    plain = cep.succeeds("camera", "estimate", *frames, *DARK)
    shifted = cep.succeeds(
        "camera",
        "estimate",
        *(name.replace("png", "tif") for name in frames),
        "--dark",
        "darka.tif",
        "darkb.tif",
        "-o",
        "b.json",
    )
    assert shifted["gain_e_per_dn"] == pytest.approx(plain["gain_e_per_dn"])
    assert shifted["read_noise_e"] == pytest.approx(plain["read_noise_e"])
    assert json.loads(Path("b.json").read_text())["bits"] == 12


def test_a_raw_files_own_values_are_measured(cep, frames):
    """Neither balanced nor interpolated: those change the noise."""
    pytest.importorskip("rawpy")
    rng = np.random.default_rng(5)
    for name, level in {"flat": 5000, "dark": 0}.items():
        for one in "ab":
            Path(f"{name}{one}.dng").write_bytes(dng(frame(level, rng, side=300)))
    mosaic = read_mosaic("flata.dng")
    assert mosaic.green.size == 300 * 300 / 4
    assert (mosaic.black_dn, mosaic.white_dn) == (0.0, 65535)
    found = cep.succeeds(
        "camera", "estimate", "flata.dng", "flatb.dng", "--dark", "darka.dng", "darkb.dng"
    )
    assert found["gain_e_per_dn"] == pytest.approx(GAIN, rel=0.03)
    assert found["read_noise_e"] == pytest.approx(READ_E, rel=0.05)
    assert found["black_dn"] == pytest.approx(BLACK, abs=0.1)
    assert "another kind" in cep.refuses("camera", "estimate", "flata.dng", "lowb.png", "--force")


@pytest.mark.parametrize("filters", [(0, 0, 0, 0), (2, 2, 2, 2)])
def test_a_mosaic_of_one_colour_is_read(tmp_path, filters):
    """Of a camera without filters, LibRaw says that every pixel has colour 6."""
    pytest.importorskip("rawpy")
    values = np.random.default_rng(0).integers(2000, 60000, (40, 56)).astype(np.uint16)
    (tmp_path / "flat.dng").write_bytes(dng(values, filters=filters))
    mosaic = read_mosaic(tmp_path / "flat.dng")
    np.testing.assert_array_equal(np.sort(mosaic.green), np.sort(values, axis=None))
    assert mosaic.black_dn == 0


def test_a_stack_of_frames_is_told(cep, frames):
    stacked = [cv2.imread("higha.png", cv2.IMREAD_UNCHANGED)] * 2
    cv2.imwritemulti("stack.tif", stacked)
    found = cep.succeeds("camera", "estimate", *frames[:-2], "stack.tif", frames[-1], *DARK)
    assert found["warnings"][0].startswith("stack.tif: holds 2 pages, the first was read")


def test_bad_frames_are_one_line(cep, frames):
    before = sorted(Path().iterdir())

    def refused(*arguments):
        line = cep.refuses("camera", "estimate", *arguments)
        assert sorted(Path().iterdir()) == before
        return line

    assert "FLAT: must be two frames of each level of light, got 1" in refused("lowa.png")
    assert "got 3" in refused("lowa.png", "lowb.png", "mida.png")
    assert "saturated throughout" in refused("overa.png", "overb.png", *DARK)
    assert "lowa.png and lowa.png: its frames are the same" in refused(
        "lowa.png", "lowa.png", *DARK
    )
    assert "lowa.png and lowb.png: its mean" in refused(
        "lowa.png", "lowb.png", "--dark", "mida.png", "midb.png"
    )
    assert "lowa.png and higha.png: its frames differ in light" in refused(
        "lowa.png", "higha.png", *DARK
    )
    assert "--gamma: must be" in refused("lowa.png", "lowb.png", "--gamma", "2.2")
    assert "--black and --dark: give one of them" in refused(
        "lowa.png", "lowb.png", *DARK, "--black", "3"
    )
    assert "'--black'" in refused("lowa.png", "lowb.png", "--black", "nan")
    assert "--black: must be" in refused("lowa.png", "lowb.png", "--black", "inf")
    assert "missing.png" in refused("lowa.png", "missing.png", *DARK)
    assert "camera.txt: a camera file must end in" in refused(*frames, "-o", "camera.txt")
    assert "is what is read" in refused(*frames, "-o", "lowa.toml", "--force")


def test_files_that_are_no_frames_are_one_line(cep, frames):
    rng = np.random.default_rng(0)
    cv2.imwrite("small.png", frame(400, rng, side=40))
    cv2.imwrite("eight.png", frame(400, rng).astype(np.uint8))
    cv2.imwrite("flat.jpg", frame(400, rng).astype(np.uint8))
    write_image("colour.png", rng.random((160, 160, 3)), bits=16)
    write_image("float.tif", rng.random((160, 160)), bits=32)
    for name, said in {
        "small.png": "lowa.png and small.png: differ in size, 160 x 160 and 40 x 40 px",
        "eight.png": "eight.png: is of another kind",
        "flat.jpg": "flat.jpg: its noise was compressed away",
        "colour.png": "colour.png: is a colour picture",
        "float.tif": "float.tif: holds floating-point numbers",
    }.items():
        assert said in cep.refuses("camera", "estimate", "lowa.png", name)
    with pytest.raises(ValueError, match=r"not a RAW file|pip install"):
        read_mosaic("lowa.png")


def test_outputs_are_not_replaced_unasked(cep, frames):
    Path("camera.png").write_bytes(b"mine")
    assert "camera.png: exists already" in cep.refuses("camera", "estimate", *frames, *DARK)
    assert not Path("camera.toml").exists()
    assert Path("camera.png").read_bytes() == b"mine"


def test_the_curve_goes_where_it_is_wanted(cep, frames):
    found = cep.succeeds(
        "camera", "estimate", *frames, *DARK, "-o", "mine.toml", "--plot", "curve.svg"
    )
    assert found["image"] == "curve.svg"
    assert "<text" in Path("curve.svg").read_text(encoding="utf-8")
    assert not Path("mine.png").exists()
    line = cep.refuses(
        "camera", "estimate", *frames, *DARK, "-o", "other.toml", "--plot", "curve.gif"
    )
    assert line == "cep: --plot: curve.gif: figures are written as .png, .pdf or .svg\n"
