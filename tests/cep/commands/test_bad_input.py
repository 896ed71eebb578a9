"""Bad input of every kind, from the command line: one clear line, exit code 2, and nothing
written."""

import json
import os
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from fuzz_readers import dng
from named_pipes import empty_pipe
from scipy.io import savemat

from cep.files.images import write_image
from motdiff.files.trajectories import StoredMotion, write_motion
from motdiff.trajectory import Trajectory

GOOD = {
    "schema": "cep.trajectory/1",
    "units": "px",
    "direction": "unknown",
    "t": [0.0, 0.5, 1.0],
    "x": [-5.0, 0.0, 5.0],
    "y": [0.0, 0.0, 0.0],
    "weight": 1.0,
    "alternatives": [],
    "source": {},
}


def everything(folder):
    """Names and contents of all files, so that any change shows."""
    return {
        str(item): item.read_bytes() if item.is_file() else None
        for item in sorted(Path(folder).rglob("*"))
    }


@pytest.fixture
def refused(cep, workplace):
    """Run a command that must be refused and leave the folder untouched; return the line it
    printed."""

    def run(*arguments):
        before = everything(workplace)
        line = cep.refuses(*arguments)
        assert everything(workplace) == before
        return line

    return run


# -- photos ---------------------------------------------------------------------------------------


def _missing(path):
    """Leave the path free."""


def _empty(path):
    path.write_bytes(b"")


def _truncated(path):
    write_image(path, np.random.default_rng(0).random((64, 64)))
    path.write_bytes(path.read_bytes()[:-200])


def _text(path):
    path.write_text("I am not a photo.")


def _one_pixel(path):
    cv2.imwrite(str(path), np.full((1, 1, 3), 128, np.uint8))


def _black(path):
    cv2.imwrite(str(path), np.zeros((96, 96, 3), np.uint8))


def _white(path):
    cv2.imwrite(str(path), np.full((96, 96, 3), 255, np.uint8))


def _constant(path):
    cv2.imwrite(str(path), np.full((96, 96), 130, np.uint8))


def _constant_16(path):
    cv2.imwrite(str(path), np.full((96, 96), 30000, np.uint16))


def _constant_alpha(path):
    cv2.imwrite(str(path), np.full((96, 96, 4), 130, np.uint8))


def _folder(path):
    path.mkdir()


BROKEN = {
    _missing: "No such file",
    _empty: "empty",
    _truncated: "cut short",
    _text: "not a PNG, JPEG, TIFF or WebP",
    _one_pixel: "1 x 1 px is too small",
    _folder: "folder",
}
FEATURELESS = {
    _black: "black all over",
    _white: "white all over",
    _constant: "the same all over",
    _constant_16: "the same all over",
    _constant_alpha: "the same all over",
}


@pytest.mark.parametrize("make", [*BROKEN, *FEATURELESS], ids=lambda make: make.__name__)
@pytest.mark.parametrize("command", ["calibrate", "demo", "deblur"])
def test_photos_that_no_motion_can_be_estimated_from(refused, workplace, make, command):
    make(Path("photo.png"))
    arguments = {
        "calibrate": ["calibrate", "photo.png"],
        "demo": ["demo", "--photo", "photo.png"],
        "deblur": ["deblur", "photo.png", "--trajectory", "trajectory.json"],
    }
    line = refused(*arguments[command])
    assert "photo.png" in line
    assert (BROKEN | FEATURELESS)[make].lower() in line.lower()


@pytest.mark.parametrize("make", BROKEN, ids=lambda make: make.__name__)
@pytest.mark.parametrize(
    "arguments",
    [
        ["deblur", "photo.png", "--trajectory", "trajectory.json"],
        ["deblur", "blurred.png", "--psf", "photo.png"],
        ["simulate", "photo.png", "--trajectory", "trajectory.json"],
        ["calibrate", "blurred.png", "--method", "reference", "--sharp", "photo.png"],
    ],
    ids=["deblur", "psf", "simulate", "sharp"],
)
def test_broken_photos_elsewhere(refused, workplace, make, arguments):
    if "--psf" in arguments and make is _one_pixel:
        return  # a PSF of one pixel is a camera at rest: fine
    make(Path("photo.png"))
    assert "photo.png" in refused(*arguments)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_tiff_with_nan(refused, workplace, value):
    image = np.random.default_rng(0).random((64, 64)).astype(np.float32)
    image[3, 4] = value
    cv2.imwrite("nan.tif", image)
    assert "NaN" in refused("calibrate", "nan.tif")
    assert "NaN" in refused("deblur", "nan.tif", "--trajectory", "trajectory.json")


def test_good_photos_of_unusual_kinds_are_taken(cep, workplace):
    """Sixteen bit, transparent, grey: read for what they are, with a word where something is
    lost."""
    rng = np.random.default_rng(1)
    for name, image in {
        "deep.png": rng.integers(0, 2**16, (64, 64, 3)).astype(np.uint16),
        "glass.png": rng.integers(0, 256, (64, 64, 4)).astype(np.uint8),
        "grey.png": rng.integers(0, 256, (64, 64)).astype(np.uint8),
    }.items():
        cv2.imwrite(name, image)
        found = cep.succeeds(
            "deblur", name, "--trajectory", "trajectory.json", "--method", "wiener"
        )
        assert any("transparency" in warning for warning in found["warnings"]) == (
            name == "glass.png"
        )
        written = cv2.imread(found["image"], cv2.IMREAD_UNCHANGED)
        assert written.dtype == image.dtype
        assert written.ndim == min(image.ndim, 3)


@pytest.mark.slow  # a photo of 40 megapixels
def test_forty_megapixels_by_gyroscope(cep, workplace):
    """A full frame goes through; the estimators look at crops of it."""
    large = np.zeros((5476, 7304), np.uint8)
    large[1000:1100, 1000:1100] = 200
    cv2.imwrite("large.png", large, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    t = np.arange(0, 1, 0.01)
    Path("g.csv").write_text(
        "\n".join(["t_s,wx,wy,wz", *(f"{s:.2f},0.05,{0.1 * s:.4f},0" for s in t)])
    )
    options = ["--gyro", "g.csv", "--focal", "800", "--start", "0.2", "--exposure", "0.2"]
    found = cep.succeeds("calibrate", "large.png", "--method", "gyro", *options)
    assert found["length_px"] > 1


# -- trajectories ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"t": [0.0, 0.7, 0.4]}, "increasing"),
        ({"t": [1.0, 0.5, 0.0]}, "increasing"),
        ({"t": [0.0, 0.0, 1.0]}, "increasing"),
        ({"t": [0.0], "x": [0.0], "y": [0.0]}, "at least 2"),
        ({"t": [], "x": [], "y": []}, "at least 2"),
        ({"x": [0.0, float("nan"), 1.0]}, "NaN"),
        ({"y": [0.0, float("inf"), 1.0]}, "Infinity"),
        ({"x": [0.0, 1.0]}, "equally long"),
        ({"x": ["a", "b", "c"]}, "trajectory.json"),
        ({"x": None}, "trajectory.json"),
        ({"schema": "cep.trajectory/2"}, 'wanted schema "cep.trajectory/1"'),
        ({"schema": None}, "wanted schema"),
        ({"units": "mm"}, 'units: must be "px", got "mm"'),
        ({"direction": "sideways"}, "direction"),
        ({"weight": 2}, "weight"),
    ],
)
@pytest.mark.parametrize("command", ["optimize", "audit", "mtf", "simulate", "deblur"])
def test_bad_trajectories(refused, workplace, command, change, message):
    Path("trajectory.json").write_text(json.dumps(GOOD | change))
    first = {"audit": "1011", "simulate": "sharp.png", "deblur": "blurred.png"}.get(command)
    line = refused(
        *filter(None, [command, first]), "--trajectory", "trajectory.json", "-o", "out.png"
    )
    assert "trajectory.json" in line
    assert message in line


def test_motions_wider_than_the_photo_or_any_frame(refused, workplace):
    Path("wide.json").write_text(
        json.dumps(GOOD | {"x": [-2000.0, 0.0, 2000.0], "y": [0.0, 3.0, 0.0]})
    )
    np.save("wide.npy", np.full((301, 301), 1e-5))
    for option, name in (("--trajectory", "wide.json"), ("--psf", "wide.npy")):
        line = refused("deblur", "blurred.png", option, name)
        assert f"{option}: " in line
        assert "the photo is only" in line
    for arguments in (["mtf"], ["audit", "1011"], ["optimize", "--chips", "20"]):
        assert "at most 1024" in refused(*arguments, "--trajectory", "wide.json", "-o", "new.png")


def dense(noise_px):
    t = np.linspace(0, 1, 50_000)
    xy = np.stack([20 * np.sin(5 * t), 15 * np.cos(4 * t)], axis=1)
    xy += noise_px * np.random.default_rng(0).standard_normal(xy.shape)
    write_motion("dense.json", StoredMotion(Trajectory.from_samples(xy, t=t)))


def test_a_dense_path_is_searched_as_quickly_as_any(cep, workplace, monkeypatch):
    """Shown by what the search is given: no test asserts a wall time."""
    seen = []
    monkeypatch.setattr(
        "cep.search.optimize.search_code", lambda problem, *_, **__: seen.append(problem) or 1 / 0
    )
    dense(0.0)
    cep("optimize", "--trajectory", "dense.json", "--chips", "8", "-o", "new.json")
    assert seen[0].scenarios[0].trajectory.t.size < 2000


@pytest.mark.parametrize("command", ["optimize --chips 8", "audit 11010011", "mtf"])
def test_noise_between_samples_is_refused_at_once(refused, workplace, command):
    dense(0.01)
    line = refused(*command.split(), "--trajectory", "dense.json")
    assert "samples, at most 20000" in line


def test_a_large_empty_frame_around_a_psf_is_fine(cep, workplace):
    psf = np.zeros((301, 301))
    psf[150, 148:153] = 0.2
    np.save("psf.npy", psf)
    assert not cep.succeeds("deblur", "blurred.png", "--psf", "psf.npy")["warnings"]


def test_a_psf_of_more_light_than_there_is(cep, workplace):
    np.save("psf.npy", np.full((3, 3), 0.2))
    warnings = cep.succeeds("deblur", "blurred.png", "--psf", "psf.npy")["warnings"]
    assert any("the PSF sums to 1.8" in warning for warning in warnings)


@pytest.mark.parametrize("content", [b"", b"{", b"[1, 2]", b"\xff\xfe\x00", b"null"])
def test_trajectories_that_are_no_json_object(refused, workplace, content):
    Path("trajectory.json").write_bytes(content)
    assert "trajectory.json" in refused("mtf", "--trajectory", "trajectory.json")


def test_no_trajectory_or_two_of_them(refused, workplace):
    for arguments in ([], ["--trajectory", "trajectory.json", "--linear", "5"]):
        assert "exactly one" in refused("mtf", *arguments)
    for length in ("0", "-3", "nan", "inf", "1e9"):
        assert "--linear" in refused("mtf", "--linear", length)


# -- codes ----------------------------------------------------------------------------------------

BAD_CODES = {
    "10201": "only 0 and 1",
    "1 0 1": "only 0 and 1",
    "0000": "closed",
    "": "empty",
    "hello": "is no code",
}


@pytest.mark.parametrize(("bits", "message"), BAD_CODES.items())
@pytest.mark.parametrize(
    "arguments",
    [
        ["audit", "{}"],
        ["export", "{}", "--format", "csv"],
        ["upload", "{}", "--port", "/dev/null"],
        ["mtf", "--linear", "10", "--code", "{}"],
        ["simulate", "sharp.png", "--linear", "10", "--code", "{}"],
        ["deblur", "blurred.png", "--trajectory", "trajectory.json", "--code", "{}"],
    ],
    ids=lambda arguments: arguments[0],
)
def test_bad_codes(refused, arguments, bits, message):
    assert message in refused(*(part.replace("{}", bits) for part in arguments))


@pytest.mark.parametrize(
    "document",
    [
        {"schema": "cep.code/9", "bits": "1011", "chip_ns": 1},
        {"schema": "cep.code/1", "bits": "0000", "chip_ns": 1},
        {"schema": "cep.code/1", "bits": "1011", "chip_ns": -1},
        {"schema": "cep.code/1", "chip_ns": 1},
    ],
)
def test_bad_code_files(refused, workplace, document):
    Path("code.json").write_text(json.dumps(document))
    assert "code.json" in refused("audit", "code.json")


def test_codes_longer_than_the_trajectory_can_resolve(refused, workplace):
    long = "10" * 100
    for arguments in (
        ["optimize", "--linear", "10", "--chips", "200", "-o", "new.json"],
        ["audit", long, "--linear", "10"],
        ["mtf", "--linear", "10", "--code", long],
        ["simulate", "sharp.png", "--linear", "10", "--code", long],
        ["deblur", "blurred.png", "--trajectory", "trajectory.json", "--code", long],
    ):
        line = refused(*arguments)
        assert "at most" in line
        assert "can be resolved" in line


@pytest.mark.parametrize(
    "options",
    [
        ["--chips", "0"],
        ["--open", "11"],
        ["--open", "6:3"],
        ["--open", "half"],
        ["--open", "90%:10%"],
        ["--open", "200%"],
        ["--open", "51%:52%"],
        ["--open", "50%:5"],
        ["--objective", "beauty"],
        ["--method", "guess"],
        ["--min-open", "11"],
        ["--min-open", "4", "--open", "3"],
        ["--device", "nothing"],
        ["--device", "missing.toml"],
        ["--time", "0"],
        ["--camera", "missing.json"],
        ["--camera", "blurred.png"],
        ["--photons", "-5"],
        ["--photons", "nan"],
        ["--read-noise", "-1"],
    ],
)
def test_searches_that_cannot_be(refused, options):
    refused("optimize", "--linear", "10", "--chips", "10", *options, "-o", "new.json")


# -- outputs --------------------------------------------------------------------------------------

WRITERS = {
    "calibrate": [
        "calibrate",
        "blurred.png",
        "--method",
        "reference",
        "--sharp",
        "sharp.png",
        "-o",
        "OUT",
    ],
    "optimize": ["optimize", "--linear", "8", "--chips", "8", "--steps", "100", "-o", "OUT"],
    "audit": ["audit", "1011", "-o", "OUT"],
    "mtf": ["mtf", "--linear", "8", "-o", "OUT"],
    "simulate": ["simulate", "sharp.png", "--linear", "8", "-o", "OUT"],
    "deblur": ["deblur", "blurred.png", "--trajectory", "trajectory.json", "-o", "OUT"],
    "export": ["export", "1011", "--format", "csv", "-o", "OUT"],
    "demo": ["demo", "-o", "OUT"],
}


def put_in_the_way(command):
    """Something precious where the command would write: a folder's file, or a file."""
    taken = Path("out.png")
    if command in ("calibrate", "demo"):
        taken.mkdir()
        (taken / "trajectory.json").write_text("precious")
    else:
        taken.write_text("precious")
    return taken


@pytest.mark.parametrize("command", WRITERS)
def test_existing_outputs_are_kept(refused, cep, workplace, command):
    taken = put_in_the_way(command)
    line = refused(*(part.replace("OUT", "out.png") for part in WRITERS[command]))
    assert "out.png" in line
    assert "--force" in line
    if command in ("calibrate", "optimize", "audit", "mtf", "simulate", "deblur", "export"):
        assert (
            cep(*(part.replace("OUT", "out.png") for part in WRITERS[command]), "--force").code
            == 0
        )
        kept = taken / "trajectory.json" if taken.is_dir() else taken
        assert kept.read_bytes() != b"precious"


@pytest.mark.parametrize(
    ("command", "options", "named"),
    [
        ("calibrate", ["--method", "zzz"], "method"),
        ("calibrate", ["--focal", "3"], "focal"),
        ("calibrate", ["--gamma", "7"], "gamma"),
        ("optimize", ["--objective", "beauty"], "objective"),
        ("audit", ["--linear", "0.5"], "chips"),
        ("simulate", ["--gamma", "7"], "gamma"),
        ("simulate", ["--code", "10201"], "only 0 and 1"),
        ("deblur", ["--gamma", "7"], "gamma"),
        ("deblur", ["--code", "10201"], "only 0 and 1"),
        ("export", ["--chip-ns", "1", "--device", "nothing"], "nothing"),
        ("demo", ["--photons", "-5"], "photons"),
        ("demo", ["--gamma", "7"], "gamma"),
    ],
    ids=lambda part: part if isinstance(part, str) else " ".join(part),
)
def test_wrong_options_are_told_before_outputs_in_the_way(
    refused, workplace, command, options, named
):
    put_in_the_way(command)
    line = refused(*(part.replace("OUT", "out.png") for part in WRITERS[command]), *options)
    assert named in line
    assert "--force" not in line


@pytest.mark.parametrize("command", WRITERS)
def test_unwritable_folders(refused, workplace, monkeypatch, command):
    real = os.access
    # root may write everywhere: the answer of the operating system is replaced, for writing only
    monkeypatch.setattr(
        os, "access", lambda path, mode, **how: not mode & os.W_OK and real(path, mode, **how)
    )
    assert "cannot be written to" in refused(
        *(part.replace("OUT", "out.png") for part in WRITERS[command])
    )


@pytest.mark.parametrize("command", WRITERS)
def test_a_file_where_a_folder_should_be(refused, workplace, command):
    Path("file").write_text("")
    refused(*(part.replace("OUT", "file/out.png") for part in WRITERS[command]))


def test_missing_folders_are_named(refused, workplace):
    assert "no folder nowhere" in refused(
        "export", "1011", "--format", "csv", "-o", "nowhere/out.csv"
    )


@pytest.mark.parametrize(
    "arguments",
    [
        ["mtf", "--linear", "5", "-o", "mtf.gif"],
        ["simulate", "sharp.png", "--linear", "5", "-o", "coded.gif"],
        ["deblur", "blurred.png", "--trajectory", "trajectory.json", "-o", "sharp"],
    ],
)
def test_unknown_kinds_of_output(refused, workplace, arguments):
    assert ".png" in refused(*arguments)
    Path(arguments[-1]).write_text("precious")
    assert "are written as .png" in refused(*arguments)  # another name is what helps, not --force


# -- the rest -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments",
    [
        ["calibrate", "blurred.png", "--method", "magic"],
        ["calibrate", "blurred.png", "--method", "reference"],
        ["calibrate", "blurred.png", "--method", "gyro", "--focal", "1000"],
        ["calibrate", "blurred.png", "--method", "point", "--sharp", "sharp.png"],
        ["calibrate", "blurred.png", "--gamma", "7"],
        [
            "calibrate",
            "blurred.png",
            "--method=gyro",
            "--gyro=blurred.png",
            "--focal=1",
            "--start=0",
            "--exposure=1",
        ],
        ["calibrate", ".", "--method", "gyro"],
        ["deblur", "blurred.png", "--trajectory", "trajectory.json", "--psf", "psf.npy"],
        ["deblur", "blurred.png", "--psf", "psf.npy", "--code", "1011"],
        ["deblur", "blurred.png", "--psf", "psf.npy"],
        ["deblur", "blurred.png", "--trajectory", "trajectory.json", "--method", "magic"],
        [
            "deblur",
            "blurred.png",
            "--trajectory",
            "trajectory.json",
            "--method",
            "tv",
            "--photons",
            "100",
        ],
        ["simulate", "sharp.png", "--linear", "5000"],
        ["export", "1011", "--format", "morse"],
        ["export", "1011", "--format", "csv", "--device", "nothing"],
        ["upload", "1011", "--port", "/dev/nothing-there"],
        ["upload", "1011", "--port", "blurred.png"],
    ],
    ids=lambda arguments: " ".join(arguments[:4]),
)
def test_other_wrong_options(refused, arguments):
    refused(*arguments)


# -- what is no file to read ----------------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments",
    [
        ["calibrate", "PIPE.png"],
        ["calibrate", "PIPE.mat"],
        ["calibrate", "PIPE.dng"],
        ["calibrate", "blurred.png", "--method", "reference", "--sharp", "PIPE.png"],
        [
            "calibrate",
            "blurred.png",
            "--method",
            "gyro",
            "--gyro",
            "PIPE.csv",
            "--focal",
            "800",
            "--start",
            "0",
            "--exposure",
            "1",
        ],
        ["demo", "--photo", "PIPE.png"],
        ["deblur", "PIPE.png", "--trajectory", "trajectory.json"],
        ["deblur", "blurred.png", "--trajectory", "PIPE.json"],
        ["deblur", "blurred.png", "--trajectory", "trajectory.json", "--code", "PIPE.json"],
        ["deblur", "blurred.png", "--trajectory", "trajectory.json", "--camera", "PIPE.toml"],
        ["deblur", "blurred.png", "--psf", "PIPE.npy"],
        ["deblur", "blurred.png", "--psf", "PIPE.mat"],
        ["simulate", "PIPE.tif", "--linear", "10"],
        ["optimize", "--trajectory", "PIPE.json", "--chips", "20", "-o", "new.json"],
        ["optimize", "--linear", "10", "--chips", "20", "--device", "PIPE.toml", "-o", "new.json"],
        ["audit", "PIPE.json"],
        ["mtf", "--trajectory", "PIPE.json"],
        ["hw", "verify", "1011", "--vcd", "PIPE.vcd"],
    ],
    ids=" ".join,
)
def test_a_pipe_is_no_input(refused, workplace, arguments):
    name = next(part for part in arguments if part.startswith("PIPE"))
    with empty_pipe(name):
        line = refused(*arguments)
    assert name in line
    assert "regular file" in line


def test_a_small_file_of_a_very_large_photo(refused, workplace):
    """It takes gigabytes once it is decoded."""
    row = zlib.compress(b"\0" + b"\xff" * 3750)
    parts = (b"IHDR" + struct.pack(">2I5B", 30_000, 30_000, 1, 0, 0, 0, 0), b"IDAT" + row, b"IEND")
    chunks = (
        struct.pack(">I", len(part) - 4) + part + struct.pack(">I", zlib.crc32(part))
        for part in parts
    )
    Path("white.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(chunks))
    for arguments in (
        ["calibrate", "white.png"],
        ["simulate", "white.png", "--linear", "9"],
        ["deblur", "blurred.png", "--psf", "white.png"],
    ):
        line = refused(*arguments)
        assert "white.png: 30000 x 30000 px" in line
        assert "at most 120" in line
        assert "crop" in line


@pytest.mark.parametrize(
    ("variable", "arguments"),
    [
        ("psf", ["deblur", "blurred.png", "--psf", "bad.mat"]),
        ("y", ["calibrate", "bad.mat"]),
        ("x", ["calibrate", "blurred.png", "--method", "reference", "--sharp", "bad.mat"]),
    ],
)
def test_mat_files_that_kill_scipy(refused, workplace, variable, arguments):
    """The type of the numbers is one that there is none of: version 1.17 is ended by a
    segmentation fault."""
    savemat("bad.mat", {variable: np.eye(64)})
    data = Path("bad.mat").read_bytes()
    at = data.index(b"\t\0\0\0", 168)  # behind the name: numbers of 8 bytes follow
    Path("bad.mat").write_bytes(data[:at] + bytes(4) + data[at + 4 :])
    assert "bad.mat: cannot be read as a .mat file" in refused(*arguments)


def test_damaged_raw_files(refused, workplace):
    pytest.importorskip("rawpy")
    Path("a.dng").write_bytes(dng(np.full((64, 64), 9000, np.uint16))[:-100])
    assert "a.dng: not a RAW file that LibRaw can read" in refused("calibrate", "a.dng")
    assert "a.dng" in refused("simulate", "a.dng", "--linear", "9")


# -- light ----------------------------------------------------------------------------------------


def test_light_that_cannot_be_judged_is_refused_before_a_code_is_written(refused, workplace):
    (workplace / "bright.toml").write_text("photons_full_scale = 1e8")
    (workplace / "full.toml").write_text("photons_full_scale = 1e6\nfull_well_e = 1000.0")
    asked = (
        "optimize",
        "--linear",
        "8",
        "--chips",
        "8",
        "--steps",
        "10",
        "-o",
        "new.json",
        "--camera",
    )
    assert "--camera: the light level must lie within 1..1e7 photo-electrons" in refused(
        *asked, "bright.toml"
    )
    assert "this camera is full at 1,000 electrons" in refused(*asked, "full.toml")
    assert "--linear: must be a length above 0 and up to 4096 px" in refused(
        "advise", "--linear", "1e9"
    )


def path_of(length_px, *, turns=0):
    """A trajectory.json of a path so long: straight, or to and fro within 8 px and so many
    times."""
    t = np.linspace(0, 1, 2 if turns == 0 else 2 * turns + 1)
    x = length_px * (t - 0.5) if turns == 0 else np.arange(t.size) % 2 * (length_px / (2 * turns))
    y = 3 * t**2 if turns else 0 * t
    return json.dumps(
        {"schema": "cep.trajectory/1", "t": t.tolist(), "x": x.tolist(), "y": y.tolist()}
    )


@pytest.mark.parametrize(
    "path", [path_of(4100), path_of(200_000), path_of(20_000, turns=1250)], ids=len
)
@pytest.mark.parametrize(
    "command",
    [
        ("optimize", "--chips", "12", "-o", "new.json"),
        ("audit", "101100111000"),
        ("mtf", "--code", "101100111000", "-o", "new.png"),
        ("advise",),
        ("simulate", "sharp.png", "-o", "new.png"),
        ("deblur", "sharp.png", "-o", "new.png"),
        ("calibrate", "sharp.png", "--code", "101100111000", "-o", "new"),
    ],
    ids=lambda command: command[0],
)
def test_a_path_too_long_is_refused_before_any_work(refused, command, path):
    """A PSF of it has gigabytes, and a search goes on for minutes beyond its time."""
    Path("long.json").write_text(path)
    write_image("sharp.png", np.random.default_rng(0).random((64, 64)))
    line = refused(*command, "--trajectory", "long.json")
    assert "long.json: trajectory: the path is " in line
    assert "at most 4096 px can be handled" in line
    if command[0] != "calibrate":
        assert "--linear: must be a length above 0 and up to 4096 px" in refused(
            *command, "--linear", "4097"
        )
