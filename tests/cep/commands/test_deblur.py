"""``cep deblur`` along a motion that is known: from a file, or straight by its length."""

from pathlib import Path

import numpy as np

from cep.files.images import read_photo
from motdiff.files.trajectories import StoredMotion, write_motion
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


def test_one_source_of_the_motion(cep, workplace):
    for extra in (("--trajectory", "trajectory.json"), ("--psf", "psf.npy")):
        line = cep.refuses("deblur", "blurred.png", "--linear", "9", *extra)
        assert (
            line
            == "cep: --trajectory FILE, --linear PX and --psf FILE: give one of them at most\n"
        )
    assert "--linear: must be a length" in cep.refuses("deblur", "blurred.png", "--linear", "0")
