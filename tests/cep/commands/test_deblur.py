"""``cep deblur`` along a motion that is known: from a file, or straight by its length."""

from pathlib import Path

import numpy as np
import pytest

from cep.codes.sources import load_code
from cep.files.images import read_photo, write_image
from cep.files.shot_files import ShotRecord, write_shot
from cep.optics.camera import Camera
from cep.optics.capture import capture
from hw.cameras.camera import Frame
from motdiff.files.trajectories import StoredMotion, read_motion, write_motion
from motdiff.trajectory import Trajectory

CODE = "1101000101101111"


def test_a_straight_motion_needs_its_length_only(cep, workplace):
    """The same as of a file with that path; a photo taken along it comes back sharp."""
    light = ("--camera", "sony-imx250")
    cep.succeeds("simulate", "sharp.png", "--linear", "16", "--code", CODE, "-o", "coded.png")
    by_length = cep.succeeds(
        "deblur", "coded.png", "--linear", "16", "--code", CODE, *light, "-o", "a.png"
    )
    assert by_length["psf_source"] == "trajectory"
    write_motion("line.json", StoredMotion(Trajectory.straight(16.0)))
    by_file = cep.succeeds(
        "deblur", "coded.png", "--trajectory", "line.json", "--code", CODE, *light, "-o", "b.png"
    )
    assert Path("a.png").read_bytes() == Path("b.png").read_bytes()
    assert by_length["direction"] == by_file["direction"]
    sharp = read_photo("sharp.png", gamma="srgb").pixels
    kept, coded = (read_photo(name, gamma="srgb").pixels for name in ("a.png", "coded.png"))
    duty = CODE.count("1") / len(CODE)
    rows, columns = (
        (one - other) // 2 for one, other in zip(sharp.shape, coded.shape, strict=True)
    )  # left out

    def error(image, scale=1.0):
        scene = sharp[rows : rows + image.shape[0], columns : columns + image.shape[1]]
        return np.sqrt(np.mean((image / scale - scene)[24:-24, 24:-24] ** 2))

    assert error(kept) < 0.5 * error(coded, duty)


@pytest.mark.parametrize("curve", ["srgb", "linear"])
def test_a_linear_file_read_as_srgb_is_noticed(cep, workplace, curve):
    cep.succeeds("simulate", "sharp.png", "--linear", "16", "--code", CODE, "-o", "a.png")
    write_image("coded.png", read_photo("a.png").pixels, gamma=curve)
    result = cep.succeeds("deblur", "coded.png", "--linear", "16", "--code", CODE)
    noticed = [warning for warning in result["warnings"] if "--gamma linear" in warning]
    assert bool(noticed) == (curve == "linear")
    again = cep.succeeds(
        "deblur", "coded.png", "--linear", "16", "--code", CODE, "--gamma", curve, "-o", "b.png"
    )
    assert not any("--gamma" in warning for warning in again["warnings"])


def test_a_photo_of_a_given_motion_is_never_kept(cep, workplace):
    line = cep.refuses("deblur", "blurred.png", "--linear", "9", "--anyway")
    assert line.startswith("cep: --anyway: not valid here")


def test_the_name_of_your_own_module_may_hold_auto(cep, workplace):
    Path("autodeblur.py").write_text("def automatic(photo, psf):\n    return photo\n")
    result = cep.succeeds(
        "deblur", "sharp.png", "--linear", "9", "--method", "autodeblur:automatic"
    )
    assert result["method"] == "autodeblur:automatic"


def test_one_source_of_the_motion(cep, workplace):
    for extra in (("--trajectory", "trajectory.json"), ("--psf", "psf.npy")):
        line = cep.refuses("deblur", "blurred.png", "--linear", "9", *extra)
        assert (
            line
            == "cep: --trajectory FILE, --linear PX and --psf FILE: give one of them at most\n"
        )
    assert "--linear: must be a length" in cep.refuses("deblur", "blurred.png", "--linear", "0")


# ---- several photos of one motion

COMPLEMENT = f"complement:{CODE}"


@pytest.fixture
def pair(cep, workplace):
    """Names of two photos of one exposure along trajectory.json, through a code and its
    complement."""
    for seed, (name, code) in enumerate([("left.png", CODE), ("right.png", COMPLEMENT)]):
        motion = ("--trajectory", "trajectory.json", "--code", code)
        cep.succeeds("simulate", "sharp.png", *motion, "--seed", str(seed), "-o", name)
    return "left.png", "right.png"


def test_two_photos_are_restored_together(cep, pair):
    """Along a path without direction: the photos have it run forward."""
    codes = ("--code", CODE, "--code", COMPLEMENT)
    both = cep.succeeds("deblur", *pair, *codes, "--trajectory", "trajectory.json", "-o", "c.png")
    assert both["images"] == list(pair)
    assert both["direction"] == "forward"
    assert both["psf_confidence"] is None
    assert both["residual"] < 0.01
    sharp = read_photo("sharp.png").pixels
    restored = read_photo("c.png").pixels
    margin = (sharp.shape[0] - restored.shape[0]) // 2
    scene = sharp[margin:, margin:][: restored.shape[0], : restored.shape[1]]
    assert np.sqrt(np.mean((restored - scene)[20:-20, 20:-20] ** 2)) < 0.03


@pytest.mark.slow(reason="searches the motion in two photos")
def test_the_motion_of_two_photos_is_found_in_them(cep, pair, short_search):
    cep("deblur", *pair, "--code", CODE, "--code", COMPLEMENT)
    assert cep.code == 0
    assert cep.out.startswith("left_sharp.png: restored from 2 photos together, along the motion")
    assert "right with probability" in cep.out
    assert Path("left_sharp.png").exists()


def test_the_motion_and_the_codes_of_two_shots_come_along(cep, workplace):
    """Beside each photo its record: nothing has to be said again."""
    path = read_motion("trajectory.json").trajectory
    for name, code in (("a", CODE), ("b", COMPLEMENT)):
        chips = load_code(code)
        photo = capture(
            read_photo("sharp.png").pixels, path, chips, rng=np.random.default_rng(len(name))
        )
        values = np.rint(4095 * photo).astype(np.uint16)
        record = ShotRecord(code=chips, bits=12, trajectory=path, noise=Camera())
        Path(name).mkdir()
        write_shot(
            Path(name),
            "photo",
            Frame(values=values, bits=12, frame_id=0, camera="test"),
            record,
            force=False,
        )
    both = cep.succeeds("deblur", "a/photo.tif", "b/photo.tif", "-o", "c.png")
    assert both["psf_source"] == "trajectory"
    assert both["residual"] < 0.01


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("left.png", "right.png"), "--code: needs one for each photo, got 0 for 2 photos"),
        (("left.png", "right.png", "--code", CODE), "--code: needs one for each photo, got 1"),
        (("left.png", "--code", CODE, "--code", CODE), "--code: needs one for each photo, got 2"),
        (
            ("left.png", "left.png", "--code", CODE, "--code", COMPLEMENT),
            "left.png: is the same as photo 1",
        ),
        (("left.png", "blurred.png", "--code", CODE, "--code", "11"), "--code 2: has 2 chips"),
        (("left.png", "right.png", "--psf", "p.npy"), "--psf: not valid with several photos"),
        (("left.png", "right.png", "--method", "tv"), "--method: several photos are restored by"),
        (("left.png", "right.png", "--anyway"), "--anyway: not valid here"),
        (
            ("left.png", "small.png", "--code", CODE, "--code", COMPLEMENT),
            "small.png: has 150 x 150 px",
        ),
        (
            ("left.png", "right.png", "--code", CODE, "--code", "complement:nil"),
            "'nil' is no code",
        ),
        (("left.png", "right.png", "--code", CODE, "--code", "complement:11"), "closed"),
    ],
)
def test_photos_and_codes_that_do_not_fit(cep, pair, arguments, named):
    write_image("small.png", read_photo("left.png").pixels[:150, :150])
    line = cep.refuses("deblur", *arguments)
    assert named in line
    assert not Path("left_sharp.png").exists()
