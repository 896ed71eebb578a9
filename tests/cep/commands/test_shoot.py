"""``cep shoot`` and ``cep deblur`` of its photos, as a user types them."""

import json
import os
import shutil
import sys
from functools import partial
from importlib import resources

import cv2
import numpy as np
import pytest
from emulators.tools import require_simavr

from cep.calibration.calibrate import Calibration
from cep.calibration.closed_loop import calibration_steps
from cep.commands.main import main
from cep.files.images import read_image, write_image
from cep.files.shot_files import ShotRecord, record_beside
from cep.optics.code import ShutterCode
from cep.photographs.scenes import NAMES, photographs
from hw.emulation.uno import EmulatedUno
from motdiff.estimators.base import MotionEstimate
from motdiff.files.trajectories import read_motion
from motdiff.trajectory import Trajectory

CODE = "1011001110100110"
TIMED = ("--code", CODE, "--chip-ns", 400_000)


@pytest.fixture
def twin(tmp_path, monkeypatch):
    require_simavr()
    monkeypatch.chdir(tmp_path)
    blocks = np.random.default_rng(0).uniform(0.1, 0.8, (12, 12))
    write_image("scene.png", np.kron(blocks, np.ones((8, 8))), bits=16)
    return "twin:scene=scene.png"


def part_of_a_photograph():
    """Write a scene in which motion is searched well, as it is not in blocks; the file's name."""
    raccoon = photographs()[NAMES.index("raccoon")]
    write_image("raccoon.png", raccoon[48:208, 48:208], bits=16)
    return "raccoon.png"


@pytest.fixture(scope="module")
def taken(tmp_path_factory):
    """Folder with a photo and its record, to be copied from."""
    require_simavr()
    folder = tmp_path_factory.mktemp("taken")
    write_image(folder / "scene.png", np.random.default_rng(0).uniform(0.1, 0.8, (96, 96)))
    arguments = (
        "shoot",
        "--camera",
        f"twin:scene={folder}/scene.png",
        *TIMED,
        "-o",
        folder / "shot",
    )
    assert main([str(argument) for argument in arguments]) == 0
    return folder / "shot"


def test_one_photo_brings_all_that_its_restoration_needs(cep, twin, tmp_path):
    result = cep.succeeds("shoot", "--camera", twin, *TIMED, "--linear", 16)
    assert result["counts"]
    assert (result["plays"], result["missed_edges"], result["trigger"]) == (1, 0, "shutter")
    assert result["exposure_s"] > 16 * 4e-4 + result["lead_in_ns"] * 1e-9 - 4e-4
    record = json.loads((tmp_path / "shot" / "photo.json").read_text(encoding="utf-8"))
    assert record["code"] == {"bits": CODE, "chip_ns": 400_000}
    values = cv2.imread("shot/photo.tif", cv2.IMREAD_UNCHANGED)
    assert values.dtype == np.uint16
    assert 64 < values.max() <= 4095
    again = cep.succeeds("deblur", "shot/photo.tif")
    assert again["method"] == "pnp"
    sharp, restored = (read_image(f"shot/{name}.png") for name in ("photo_sharp", "restored"))
    assert (sharp == restored).all()


def test_the_first_line_says_what_was_taken_and_whether_it_counts(cep, twin):
    cep("shoot", "--camera", twin, *TIMED, "-o", "out")
    assert cep.code == 0
    first, last = cep.out.splitlines()
    assert first.startswith("out/photo.tif: counts: 96 x 96 px of 12 bits; 16 chips of 400 us")
    assert last == "then: cep deblur out/photo.tif"


def test_an_option_replaces_what_the_record_says(cep, twin):
    cep.succeeds("shoot", "--camera", twin, *TIMED, "--linear", 16)
    cep("deblur", "shot/photo.tif", "--linear", 9, "--code", "1101", "-o", "other.png")
    assert cep.code == 0, cep.err
    assert (read_image("other.png") != read_image("shot/restored.png")).any()


def test_a_photo_that_does_not_count_says_so_when_it_is_restored(cep, twin, tmp_path):
    cep.succeeds("shoot", "--camera", twin, *TIMED, "--linear", 16)
    path = tmp_path / "shot" / "photo.json"
    record = json.loads(path.read_text(encoding="utf-8"))
    record["problems"] = ["the code was played 2 times"]
    path.write_text(json.dumps(record), encoding="utf-8")
    warnings = cep.succeeds("deblur", "shot/photo.tif")["warnings"]
    assert "shot/photo.tif: does not count: the code was played 2 times" in warnings


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"bits": 10}, "has code values up to"),
        ({"bits": 17}, "bits: must be a whole number within 1..16"),
        ({"black_level": 5000}, "black_level 5000 is not below white"),
        ({"code": {"bits": "12", "chip_ns": 1}}, "code.bits"),
        ({"bayer": "XYZW"}, "bayer"),
        ({"trajectory": {"schema": "cep.trajectory/1", "t": [0, 1]}}, 'field "x" is missing'),
    ],
)
def test_a_damaged_record_is_one_line(cep, taken, tmp_path, monkeypatch, change, words):
    shutil.copytree(taken, tmp_path / "shot")
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "shot" / "photo.json"
    path.write_text(json.dumps(json.loads(path.read_text("utf-8")) | change), encoding="utf-8")
    assert words in cep.refuses("deblur", "shot/photo.tif")


def test_several_photos_say_how_repeatable_they_are(cep, twin, tmp_path):
    result = cep.succeeds("shoot", "--camera", twin, *TIMED, "--repeat", 3)
    assert len(result["photos"]) == 3
    assert result["repeatability"]["brightness_spread"] < 0.01
    names = {path.name for path in (tmp_path / "shot").iterdir()}
    assert names == {f"photo_00{k}{suffix}" for k in (1, 2, 3) for suffix in (".tif", ".json")}


@pytest.mark.slow(reason="the motion is searched in one photo, then in two")
def test_a_calibration_takes_photos_through_codes_that_it_chooses(
    cep, twin, workplace, monkeypatch, short_search
):
    """Two of the five it may take: that it goes on until the order is sure has tests of its
    own."""
    two = partial(calibration_steps, most_photos=2)
    monkeypatch.setattr("cep.calibration.closed_loop.calibration_steps", two)
    twin = f"twin:scene={part_of_a_photograph()},photons=50000"
    motion = ("--trajectory", "trajectory.json")
    result = cep.succeeds(
        "shoot", "--camera", twin, "--calibrate", *motion, "--chip-ns", 400_000, "-o", "loop"
    )
    assert len(result["photos"]) == 2
    assert [len(bits) for bits in result["codes"]] == [52] * len(result["photos"])
    assert "0" not in result["codes"][0]
    assert result["sure"] == (result["confidence"] >= 0.95)
    assert result["confidence"] == result["confidences"][-1]
    assert read_motion("loop/motion/trajectory.json").trajectory.direction == "known"
    records = [record_beside(photo) for photo in result["photos"]]
    assert [record.code.bits for record in records] == result["codes"]
    assert (workplace / result["trajectory"]).exists()


def test_a_camera_at_rest_has_nothing_to_calibrate(cep, twin, workplace, monkeypatch):
    """What an earlier run left under other names goes."""
    monkeypatch.setattr("cep.calibration.closed_loop.estimate_motion", at_rest)
    loop = workplace / "loop"
    loop.mkdir()
    for name in ("P1.tif", "P4.tif", "P4.json", "restored.png"):
        (loop / name).touch()
    arguments = ("shoot", "--camera", "twin:scene=sharp.png", "--calibrate", "-o", "loop")
    assert "P1.tif" in cep.refuses(*arguments)
    cep(*arguments, "--force")
    assert (cep.code, cep.out.splitlines()[0]) == (
        0,
        "The photo shows no motion blur: there is nothing to calibrate.",
    )
    names = {path.name for path in loop.iterdir()}
    assert names == {"P1.tif", "P1.json", "motion"}


def test_a_photo_that_cannot_be_searched_is_named_and_stays(cep, twin, workplace, monkeypatch):
    def searched(_photos, **_options):
        raise ValueError("photo 1: has no texture")

    monkeypatch.setattr("cep.calibration.closed_loop.estimate_motion", searched)
    line = cep.refuses("shoot", "--camera", "twin:scene=sharp.png", "--calibrate", "-o", "loop")
    photo = os.path.join("loop", "P1.tif")
    assert f"{photo}: has no texture" in line
    assert f"photos so far: {photo}" in line
    assert (workplace / photo).exists()


def write_set(folder):
    """Write a calibration set of an open shutter and CODE."""
    folder.mkdir()
    bits = ["1" * 16, CODE]
    contrast = {"walks": 1, "length_px": 1, "walks_told": 1, "median": 1, "worst_tenth": 1}
    document = {
        "schema": "cep.calibration-set/2",
        "summary": "",
        "photos": [
            {
                "photo": f"P{k}",
                "code": "open" if k == 1 else "code_2.json",
                "bits": text,
                "open": text.count("1"),
                "pulses": 1,
            }
            for k, text in enumerate(bits, 1)
        ],
        "command": "",
        "chips": 16,
        "chip_ns": 400_000,
        "device": None,
        "contrast": contrast,
    }
    (folder / "set.json").write_text(json.dumps(document), encoding="utf-8")


def at_rest(photos, **_options):
    """Estimate of photos without motion blur."""
    point = Trajectory.straight(1e-3)
    warnings = ("The photo shows no motion blur",)
    motion = MotionEstimate(
        "oracle",
        (point,),
        (1.0,),
        point.psf(),
        0.9,
        warnings=warnings,
        details={"motion_blur": False},
    )
    return Calibration.of(motion, photos[0])


def test_what_the_photos_of_a_set_cannot_show_is_said(cep, twin, tmp_path, monkeypatch):
    write_set(tmp_path / "set")
    arguments = ("shoot", "--camera", twin, "--set", "set", "-o", "taken")

    def searched(_photos, **_options):
        raise ValueError("photo 2: has no texture")

    monkeypatch.setattr("cep.calibration.calibrate.estimate_motion", searched)
    line = cep.refuses(*arguments)
    assert "taken/P2.tif: has no texture" in line
    assert "photos so far: taken/P1.tif, taken/P2.tif" in line
    monkeypatch.setattr("cep.calibration.calibrate.estimate_motion", at_rest)
    result = cep.succeeds(*arguments, "--force")
    assert "The photo shows no motion blur" in result["warnings"]
    cep(*arguments, "--force")
    assert cep.out.startswith("The photos show no motion blur: there is nothing to calibrate.")
    assert "cep optimize" not in cep.out


@pytest.mark.slow(reason="the motion is searched in both photos, and its order in time")
def test_a_calibration_set_is_taken_and_calibrated(cep, twin, tmp_path, short_search):
    write_set(tmp_path / "set")
    picture = resources.files("cep.photographs") / "pictures" / "raccoon.jpg"
    twin = f"twin:scene={picture}"  # motion is not searched well in blocks
    result = cep.succeeds("shoot", "--camera", twin, "--set", "set", "--linear", 16, "-o", "taken")
    assert result["counts"]
    assert result["photos"] == ["taken/P1.tif", "taken/P2.tif"]
    motion = json.loads((tmp_path / result["trajectory"]).read_text(encoding="utf-8"))
    assert np.ptp(motion["x"]) == pytest.approx(16, abs=1.5)
    assert np.ptp(motion["y"]) < 1.5


def test_a_belt_is_played(cep, twin):
    with EmulatedUno() as uno:
        uno.trigger(pulses=1000, hertz=20)
        result = cep.succeeds("shoot", "--arm", 2, "--port", uno.port, *TIMED)
    assert (result["plays"], result["missed_edges"]) == (2, 0)


def test_a_belt_that_stands_is_a_failure(cep, twin):
    with EmulatedUno() as uno:
        cep("shoot", "--arm", 2, "--port", uno.port, *TIMED, "--wait", "0.2")
    assert cep.code == 1
    assert cep.err == "cep: no trigger within 0.2: 2 plays are missing\n"


def test_wiring_is_told_without_hardware(cep):
    lines = cep.succeeds("shoot", "--wiring", "--camera", "pylon:", *TIMED)["wiring"]
    assert any("D9" in line for line in lines)
    assert any("GP15" in line for line in lines)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "--camera: is needed"),
        (("--camera", "twin:"), "--code: is needed"),
        (("--camera", "leica:", *TIMED), "--camera: kind 'leica' is not known; known are"),
        (("--camera", "twin", *TIMED), "--camera: 'twin' has no colon"),
        (("--camera", "twin:speed=1", *TIMED), "--camera: twin has no 'speed=1'"),
        (("--camera", "twin:", *TIMED, "--trigger", "me"), "--trigger: must be one of shutter"),
        (("--camera", "twin:", "--set", "x", "--arm", "2"), "--set and --arm: give one"),
        (("--camera", "twin:", *TIMED, "--set", "x"), "--code and --repeat: not valid with --set"),
        (("--camera", "twin:", "--calibrate", "--set", "x"), "--set and --calibrate: give one"),
        (("--camera", "twin:", "--calibrate", *TIMED), "not valid with --calibrate, which"),
        (("--arm", "2", *TIMED), "--arm: needs --port"),
        (("--arm", "soon", "--port", "x", *TIMED), "--arm: must be a number of plays or always"),
        (("--camera", "folder:.", *TIMED), "--port: camera folder: needs a controller"),
        (("--camera", "folder:.", *TIMED, "--port", "/dev/no"), "/dev/no cannot be opened"),
        (("--camera", "burst:no.mp4", *TIMED), "--camera: no.mp4: there is no such video"),
        (("--wiring", "--camera", "folder:", *TIMED, "--trigger", "host"), "cannot fire"),
    ],
)
def test_wrong_input_is_one_line(cep, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    assert words in cep.refuses("shoot", *arguments)
    assert not (tmp_path / "shot").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--exposure", "5ms"), "--exposure: 5 ms is shorter than the code with its lead-in"),
        (("--lead-in", "2"), "--lead-in: must be a time within 0..1 s"),
        (("--lead-in", "900ms"), "is too long; at most 1024"),
        (("--port", "/dev/ttyS9"), "--port: not valid with a twin"),
    ],
)
def test_what_the_rig_cannot_do_is_one_line(cep, twin, tmp_path, options, words):
    assert words in cep.refuses("shoot", "--camera", twin, *TIMED, *options)
    assert not (tmp_path / "shot").exists()


def test_photos_that_are_there_are_not_replaced(cep, twin):
    cep.succeeds("shoot", "--camera", twin, *TIMED)
    assert "exists already" in cep.refuses("shoot", "--camera", twin, *TIMED)
    cep.succeeds("shoot", "--camera", twin, *TIMED, "--force")


def test_a_restored_photo_does_not_outlive_its_photo(cep, twin, tmp_path):
    cep.succeeds("shoot", "--camera", twin, *TIMED, "--linear", 16)
    assert (tmp_path / "shot" / "restored.png").exists()
    cep.succeeds("shoot", "--camera", twin, *TIMED, "--force")
    assert not (tmp_path / "shot" / "restored.png").exists()


def test_a_photo_that_cannot_be_restored_is_kept(cep, twin, tmp_path):
    line = cep.refuses("shoot", "--camera", twin, *TIMED, "--linear", 60)
    assert line.endswith("; shot/photo.tif was taken, and counts\n")
    assert (tmp_path / "shot" / "photo.tif").exists()


def test_an_interrupted_restoration_says_that_the_photo_counts(cep, twin, tmp_path, monkeypatch):
    def interrupted(*_arguments, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr("cep.shutter.shot_folder.restored_shot", interrupted)
    cep("shoot", "--camera", twin, *TIMED, "--linear", 16)
    assert "shot/photo.tif was taken, and counts" in cep.err
    assert record_beside("shot/photo.tif").counts


@pytest.mark.skipif(sys.platform == "win32", reason="limits of a process")
def test_a_disk_that_takes_a_part_is_named_and_nothing_is_half_written(cep, twin, tmp_path):
    import resource

    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, limits[1]))
    try:
        line = cep.refuses("shoot", "--camera", twin, *TIMED)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert line == "cep: shot/photo.tif: cannot be written whole: free space on its disk\n"
    assert list((tmp_path / "shot").iterdir()) == []


def test_light_that_the_open_shutter_would_have_clipped_fits_the_restored_photo(cep, twin):
    # 30,000 electrons in a full well of 32,000: half of them came through the code
    bright = f"{twin},camera=sony-imx174,photons=60000"
    result = cep.succeeds("shoot", "--camera", bright, *TIMED, "--linear", 16)
    assert any("times darker than the light" in text for text in result["warnings"])
    assert (read_image("shot/restored.png") >= 1).mean() < 0.002


def test_a_mosaic_becomes_colours():
    light = np.broadcast_to([0.2, 0.5, 0.8], (8, 8, 3))
    mosaic = np.zeros((8, 8))
    for row, column, colour in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        mosaic[row::2, column::2] = light[row::2, column::2, colour]
    record = ShotRecord(code=ShutterCode("1"), bits=16, bayer="RGGB", black_level=0.0)
    colours = record.light(np.rint(mosaic * 65535).astype(np.uint16))
    assert colours == pytest.approx(light, abs=1e-4)
