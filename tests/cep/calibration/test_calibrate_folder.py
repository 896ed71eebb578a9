"""``cep calibrate FOLDER``: the files of the single command for each photo, what fails is told,
what stops goes on."""

import csv
import json
import os
from pathlib import Path

import numpy as np
import pytest

from cep.calibration.calibrate import CALIBRATION_FILES, Calibration
from cep.calibration.calibrate_folder import calibrate_folder, photos_in, sharp_of
from cep.commands.console import FAILURE, INTERRUPTED
from cep.files import images
from cep.files.images import write_image
from cep.files.psf_files import load_psf
from motdiff.estimators.base import MotionEstimate
from motdiff.metrics import mnc_subpixel
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory

BENT = Trajectory.from_samples([[0, 0], [6, 1], [9, 5], [10, 11]])
MOTIONS = {"a.png": BENT, "b.tif": Trajectory.straight(9.0), "c[1].x.PNG": BENT.scaled(0.7)}
REFERENCE = (
    "calibrate",
    "shots",
    "--method",
    "reference",
    "--sharp",
    "sharp.png",
    "--workers",
    "1",
)

WRITTEN = set(CALIBRATION_FILES) - {"sharpened.png"}
"""Files of these photos, of which no restoration is better."""


@pytest.fixture
def shots(workplace):
    """A folder with photos of one scene, each with a motion of its own, and things that are no
    photos."""
    sharp = images.read_image("sharp.png")
    Path("shots/sub.png").mkdir(parents=True)
    for name, motion in MOTIONS.items():
        other = f"shots/other{Path(name).suffix.lower()}"
        write_image(other, blur_valid(sharp, motion.psf(motion.frame_size() | 1)), bits=16)
        Path(other).rename(f"shots/{name}")
    Path("shots/notes.txt").write_text("no photo")
    Path("shots/.hidden.png").write_bytes(b"")
    return workplace


@pytest.fixture
def guesses(monkeypatch):
    """Stand in for the estimator: always the same motion; ``stops`` at a photo as Ctrl-C does."""

    class Guess:
        calls = 0
        stops = 0

        def __init__(self, _sharp):
            pass

        def estimate(self, photo):
            Guess.calls += 1
            if Guess.calls == Guess.stops:
                raise KeyboardInterrupt
            return MotionEstimate(
                "guess", (BENT,), (1.0,), BENT.psf(64), 0.4, ("a guess",), {"figure": 1.5}
            )

    monkeypatch.setattr("motdiff.estimators.reference.estimator.ReferenceEstimator", Guess)
    return Guess


def rows_of(path):
    with open(path, newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_each_photo_gets_the_files_of_the_single_command(cep, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("lamps").mkdir()
    for name, motion in MOTIONS.items():
        night = np.full((128, 128), 0.01)
        night[32:96, 32:96] += 4 * motion.psf(64)
        other = f"lamps/other{Path(name).suffix.lower()}"
        write_image(other, night, bits=16)
        Path(other).rename(f"lamps/{name}")
    found = cep.succeeds("calibrate", "lamps", "--method", "point", "--workers", "2")
    assert list(found["photos"]) == list(MOTIONS)
    assert (found["failures"], found["missing"]) == ({}, 0)
    assert sorted(path.name for path in Path("lamps_motion").iterdir()) == [
        ".finished.jsonl",
        "a",
        "b",
        "c[1].x",
        "motions.csv",
    ]
    rows = rows_of(found["summary"])
    assert [row["photo"] for row in rows] == list(MOTIONS)
    for row, (name, motion) in zip(rows, MOTIONS.items(), strict=True):
        one = found["photos"][name]
        assert mnc_subpixel(load_psf(one["psf"])[0], motion.psf(64)) > 0.95
        assert float(row["length_px"]) == one["length_px"]
        single = cep.succeeds(
            "calibrate", f"lamps/{name}", "--method", "point", "-o", "single", "--force"
        )
        same = set(single) - {"trajectory", "psf", "seconds", "files"}
        assert {key: one[key] for key in same} == {key: single[key] for key in same}
        for file in WRITTEN - {"psf.mat"}:  # whose header has the time of day
            assert (Path("lamps_motion") / Path(name).stem / file).read_bytes() == Path(
                "single", file
            ).read_bytes()


def test_the_current_folder_has_a_name_too(cep, shots, guesses, monkeypatch):
    monkeypatch.chdir("shots")
    cep.succeeds(
        "calibrate", ".", "--method", "reference", "--sharp", "../sharp.png", "--workers", "1"
    )
    assert Path("../shots_motion/a/trajectory.json").is_file()


def test_photos_that_fail_are_told_by_name_and_the_others_kept(cep, shots, guesses):
    whole = Path("shots/a.png").read_bytes()
    Path("shots/broken.png").write_bytes(whole[: len(whole) // 2])
    write_image("shots/flat.png", np.full((80, 90), 0.5))
    Path("shots/gone.jpg").symlink_to("nowhere.jpg")
    cep(*REFERENCE, "--json")
    assert cep.code == FAILURE
    assert list(cep.json["photos"]) == list(MOTIONS)
    failures = cep.json["failures"]
    assert failures == {
        "broken.png": f"the image is damaged or cut short after {len(whole) // 2} bytes",
        "flat.png": "photo: is the same all over; motion shows only where the scene has texture",
        "gone.jpg": "No such file or directory",
    }
    assert [line for line in cep.json["warnings"] if "broken" in line] == [
        f"broken.png: {failures['broken.png']}"
    ]
    assert {
        row["photo"]: row["failure"]
        for row in rows_of("shots_motion/motions.csv")
        if row["failure"]
    } == failures
    assert not Path("shots_motion/broken").exists()
    assert not Path("shots_motion/flat").exists()
    # mended, they alone are estimated
    Path("shots/broken.png").write_bytes(whole)
    for name in ("flat.png", "gone.jpg"):
        Path("shots", name).unlink()
    calls = guesses.calls
    assert set(cep.succeeds(*REFERENCE, "--force")["photos"]) == {*MOTIONS, "broken.png"}
    assert guesses.calls == calls + 1


def test_a_photo_that_is_too_small_fails_before_an_estimator_is_made(
    cep, shots, guesses, monkeypatch
):
    made = []

    def make(seed, progress):
        made.append((seed, progress))
        return guesses(None)

    monkeypatch.setattr("motdiff.estimators.pmp.estimator.PmpEstimator", make)
    write_image("shots/small.png", np.random.default_rng(0).random((30, 90)))
    cep("calibrate", "shots", "--method", "pmp", "--workers", "1", "--json")
    assert cep.code == FAILURE
    assert cep.json["failures"] == {"small.png": "photo: needs at least 48 x 48 px, got 90 x 30"}
    assert list(cep.json["photos"]) == list(MOTIONS)
    assert len(made) == len(MOTIONS)


def test_the_psf_that_a_simulation_writes_beside_its_photo_is_no_photo(cep, shots):
    cep.succeeds("simulate", "sharp.png", "--linear", "9", "-o", "shots/made.png")
    assert Path("shots/made_psf.png").is_file()
    write_image("shots/own_psf.png", np.random.default_rng(0).random((30, 90)))
    assert {path.name for path in photos_in("shots")} == {*MOTIONS, "made.png", "own_psf.png"}


def test_of_a_photo_that_fails_now_nothing_older_stays(cep, shots, guesses):
    whole = Path("shots/a.png").read_bytes()
    cep.succeeds(*REFERENCE)
    Path("shots_motion/b/code.json").write_text("mine")
    Path("shots/a.png").write_bytes(whole[:100])
    Path("shots/b.tif").write_bytes(b"rubbish")
    cep(*REFERENCE, "--json", "--force")
    assert (cep.code, set(cep.json["failures"])) == (FAILURE, {"a.png", "b.tif"})
    assert not Path("shots_motion/a").exists()
    assert [path.name for path in Path("shots_motion/b").iterdir()] == ["code.json"]
    assert {path.name for path in Path("shots_motion/c[1].x").iterdir()} == WRITTEN


def test_stopped_it_removes_nothing(cep, shots, guesses):
    cep.succeeds(*REFERENCE)
    before = Path("shots_motion/c[1].x/trajectory.json").read_bytes()
    guesses.stops = guesses.calls + 2
    cep(*REFERENCE, "--json", "--force", "--seed", "1")
    assert (cep.code, cep.json["missing"]) == (INTERRUPTED, 2)
    assert Path("shots_motion/c[1].x/trajectory.json").read_bytes() == before


def test_where_every_photo_fails_each_is_told(cep, shots, guesses):
    for name in MOTIONS:
        Path("shots", name).write_bytes(b"rubbish")
    cep(*REFERENCE, "--json")
    assert (cep.code, list(cep.json["failures"])) == (FAILURE, list(MOTIONS))
    assert [row["photo"] for row in rows_of("shots_motion/motions.csv")] == list(MOTIONS)


def test_people_see_names_whole_and_reasons(cep, shots, guesses):
    long = "a photo's very long name with [red] brackets, of a camera that counts to 00000001.png"
    Path("shots/a.png").rename(f"shots/{long}")
    Path("shots/b.tif").write_bytes(b"rubbish")
    cep(*REFERENCE)
    assert cep.code == FAILURE
    lines = cep.out.splitlines()
    width = next(line.index("long,") for line in lines if "long," in line)
    folded = "".join(line[:width] for line in lines)
    assert long.replace(" ", "") in folded.replace(" ", "")
    assert "failed" in cep.out
    assert "cep: warning: b.tif: not a PNG, JPEG, TIFF or WebP image" in cep.err
    assert f"cep: warning: {long}: a guess" in cep.err


def test_a_name_that_no_table_can_hold_is_refused_alone(cep, shots, guesses):
    try:
        Path("shots/b.tif").rename(os.fsdecode(b"shots/b\xff.tif"))
    except OSError:
        pytest.skip("this file system knows UTF-8 names only")
    cep(*REFERENCE, "--json")
    assert cep.code == FAILURE
    assert cep.json["failures"] == {"b\\udcff.tif": "the name is no UTF-8, rename it"}
    assert len(cep.json["photos"]) == 2


def test_stopped_it_writes_what_is_finished_and_goes_on(cep, shots, guesses):
    guesses.stops = 2
    cep(*REFERENCE, "--json")
    assert cep.code == INTERRUPTED
    assert (list(cep.json["photos"]), cep.json["missing"], cep.json["failures"]) == (
        ["a.png"],
        2,
        {},
    )
    assert any("--force goes on" in line for line in cep.json["warnings"])
    assert Path("shots_motion/a/trajectory.json").is_file()
    assert [row["failure"] for row in rows_of("shots_motion/motions.csv")] == [
        "",
        "left out",
        "left out",
    ]
    assert "use --force" in cep.refuses(*REFERENCE)
    assert len(cep.succeeds(*REFERENCE, "--force")["photos"]) == 3
    assert guesses.calls == 4  # one before, the one that was stopped, and the two left
    assert [row["failure"] for row in rows_of("shots_motion/motions.csv")] == [""] * 3
    # another option makes other estimates
    cep.succeeds(*REFERENCE, "--force", "--seed", "1")
    assert guesses.calls == 7


def test_each_photo_is_written_before_the_next_one_is_begun(cep, shots, guesses, monkeypatch):
    """Whatever ends the command then, what is finished is there: a crash and a full disk as well
    as Ctrl-C."""
    real = guesses.estimate
    seen = []

    def estimate(self, photo):
        seen.append(
            sorted(path.parent.name for path in Path("shots_motion").glob("*/preview.png"))
        )
        return real(self, photo)

    monkeypatch.setattr(guesses, "estimate", estimate)
    guesses.stops = 3
    assert cep(*REFERENCE, "--json").code == INTERRUPTED
    assert seen == [[], ["a"], ["a", "b"]]
    assert [row["failure"] for row in rows_of("shots_motion/motions.csv")] == ["", "", "left out"]


@pytest.mark.parametrize("stopped_at", [1, 2])
def test_stopped_while_processes_work_it_keeps_what_came_and_tells(
    cep, shots, monkeypatch, stopped_at
):
    """Ctrl-C in the midst of writing: that photo is finished, the others of the pool are left
    out."""
    real = Calibration.save
    begun = []

    def interrupted(self, folder, **options):
        begun.append(Path(folder).name)
        if len(begun) == stopped_at:
            raise KeyboardInterrupt
        return real(self, folder, **options)

    monkeypatch.setattr(Calibration, "save", interrupted)
    cep(*REFERENCE[:-1], "2", "--json")
    assert cep.code == INTERRUPTED
    done = {Path(name).stem for name in cep.json["photos"]}
    assert (
        done
        == {*begun}
        == {path.parent.name for path in Path("shots_motion").glob("*/preview.png")}
    )
    assert (len(done), cep.json["missing"]) == (stopped_at, 3 - stopped_at)
    assert sorted(row["failure"] for row in rows_of("shots_motion/motions.csv")) == (
        [""] * stopped_at + ["left out"] * (3 - stopped_at)
    )


def test_a_photo_that_goes_meanwhile_loses_no_other(cep, shots, guesses, monkeypatch):
    real = images.read_photo

    def vanishing(path, **options):
        if Path(path).name == "b.tif":
            raise FileNotFoundError(2, "No such file or directory", str(path))
        return real(path, **options)

    monkeypatch.setattr("cep.calibration.folder_processes.read_photo", vanishing)
    cep(*REFERENCE, "--json")
    assert cep.code == FAILURE
    assert list(cep.json["failures"]) == ["b.tif"]
    assert Path("shots_motion/c[1].x/trajectory.json").is_file()


def test_a_finished_photo_comes_back_unless_its_files_or_what_made_them_changed(
    cep, shots, guesses
):
    first = cep.succeeds(*REFERENCE)
    table = Path("shots_motion/.finished.jsonl")
    with table.open("a") as stream:
        stream.write('{"photo": "a.png", "key": ')  # cut short by a killed run
    again = cep.succeeds(*REFERENCE, "--force")
    assert guesses.calls == 3
    assert again["photos"] == first["photos"]
    before = Path("shots_motion/b/psf.npy").read_bytes()
    Path("shots_motion/b/psf.npy").write_bytes(before[:-1])
    Path("shots_motion/a/preview.png").unlink()
    cep.succeeds(*REFERENCE, "--force")
    assert guesses.calls == 5
    assert Path("shots_motion/b/psf.npy").read_bytes() == before
    Path("sharp.png").write_bytes(Path("shots/a.png").read_bytes())
    cep.succeeds(*REFERENCE, "--force")
    assert guesses.calls == 8


def test_a_photo_that_ends_its_process_fails_alone(cep, shots, monkeypatch):
    Path("fatal.py").write_text(
        "import os\nfrom motdiff.trajectory import Trajectory\n\n\nclass Fatal:\n"
        "    def estimate(self, photo):\n        if photo.shape[0] == 70:\n"
        "            os._exit(1)\n        return Trajectory.straight(7.0)\n"
    )
    write_image("shots/fatal.png", np.random.default_rng(0).random((70, 90)))
    cep("calibrate", "shots", "--method", "fatal:Fatal", "--workers", "2", "--json")
    assert cep.code == FAILURE
    assert list(cep.json["photos"]) == list(MOTIONS)
    assert list(cep.json["failures"]) == ["fatal.png"]
    assert "its process died" in cep.json["failures"]["fatal.png"]


def test_photos_are_those_that_can_be_read(shots):
    Path("shots/raw.NEF").write_bytes(b"")
    assert [path.name for path in photos_in("shots")] == [*MOTIONS, "raw.NEF"]
    assert [path.name for path in photos_in("shots", but=Path("shots/../shots/a.png"))] == [
        *list(MOTIONS)[1:],
        "raw.NEF",
    ]


def test_sharp_photos_may_be_one_each_by_name(cep, shots, guesses):
    Path("sharp").mkdir()
    for stem in ("a", "b", "c[1].x"):
        Path(f"sharp/{stem}.png").write_bytes(Path("sharp.png").read_bytes())
    pairs = sharp_of(photos_in("shots"), Path("sharp"))
    assert {blurred.name: sharp.name for blurred, sharp in pairs.items()} == {
        "a.png": "a.png",
        "b.tif": "b.png",
        "c[1].x.PNG": "c[1].x.png",
    }
    arguments = ["sharp" if part == "sharp.png" else part for part in REFERENCE]
    assert len(cep.succeeds(*arguments)["photos"]) == 3
    Path("sharp/b.png").unlink()
    assert "sharp: holds no sharp photo named b, for shots/b.tif" in cep.refuses(
        *arguments, "--force"
    )


def test_a_sharp_photo_among_the_blurred_is_not_one_of_them(cep, shots, guesses):
    Path("sharp.png").rename("shots/sharp.png")
    arguments = ["shots/sharp.png" if part == "sharp.png" else part for part in REFERENCE]
    assert list(cep.succeeds(*arguments)["photos"]) == list(MOTIONS)


def twins():
    Path("shots/a.JPG").write_bytes(Path("shots/a.png").read_bytes())


def emptied():
    for path in Path("shots").iterdir():
        if path.is_file() and path.suffix != ".txt":
            path.unlink()


def taken():
    Path("shots_motion/b").mkdir(parents=True)
    Path("shots_motion/b/trajectory.json").write_text("precious")


def broken_sharp():
    Path("sharp.png").write_bytes(b"rubbish")


@pytest.mark.parametrize(
    ("options", "prepared", "message"),
    [
        ((), twins, "shots: a.JPG and a.png would be written to one folder a; rename one of them"),
        ((), emptied, "shots: holds no photos (.png, .tif, .jpg, .webp or RAW files"),
        ((), taken, "shots_motion/b/trajectory.json: exists already, use --force"),
        ((), broken_sharp, "sharp.png: not a PNG, JPEG, TIFF or WebP image"),
        (("--sharp", "nowhere.png"), None, "nowhere.png"),
        (("--method", "pmp"), None, "--sharp: not valid with --method pmp"),
        (("--method", "magic"), None, "method: must be one of"),
        (("--gamma", "9"), None, "gamma: must be"),
        (("--workers", "0"), None, "--workers"),
        (("-o", "sharp.png"), None, "sharp.png: is a file"),
    ],
)
def test_refusals(cep, shots, guesses, options, prepared, message):
    if prepared is not None:
        prepared()
    assert message in cep.refuses(*REFERENCE, *options)
    assert guesses.calls == 0
    assert not Path("shots_motion/motions.csv").exists()


def test_a_gyroscope_is_for_one_photo(cep, shots):
    options = ("--gyro", "gyro.csv", "--focal", "1000", "--start", "0", "--exposure", "0.1")
    assert "--start is the opening of one photo" in cep.refuses(
        "calibrate", "shots", "--method", "gyro", *options
    )


def test_workers_are_for_a_folder(cep, shots):
    assert "--workers: is for a folder" in cep.refuses("calibrate", "blurred.png", "--workers", 2)


def test_motions_are_found_as_they_were_written(cep, shots, guesses):
    cep.succeeds(*REFERENCE)
    files = sorted(Path("shots_motion").glob("*/trajectory.json"))
    assert [file.parent.name for file in files] == [Path(name).stem for name in MOTIONS]
    assert all(json.loads(file.read_text())["schema"] == "cep.trajectory/1" for file in files)


def test_from_python_it_gives_what_the_command_prints(cep, shots, guesses):
    told = []
    made = calibrate_folder(
        Path("shots"),
        method="reference",
        options={"sharp": Path("sharp.png")},
        workers=1,
        progress=lambda fraction, note: told.append((fraction, note)),
    )
    assert (made.folder, made.summary, made.missing) == (
        Path("shots_motion"),
        Path("shots_motion/motions.csv"),
        0,
    )
    assert (told[0], told[-1][0]) == ((0.0, "0 of 3 photos"), 1.0)
    printed = cep.succeeds(*REFERENCE, "--force")  # found on disk
    assert guesses.calls == 3
    assert list(made.figures) == list(printed["photos"]) == [row["photo"] for row in made.rows]
    assert [one["length_px"] for one in made.figures.values()] == [
        one["length_px"] for one in printed["photos"].values()
    ]
    assert made.warnings == printed["warnings"]
    with pytest.raises(ValueError, match=r"motions\.csv: exists already"):
        calibrate_folder(Path("shots"), method="reference", options={"sharp": Path("sharp.png")})
    with pytest.raises(ValueError, match="start_s is the opening of one photo"):
        calibrate_folder(Path("shots"), Path("other"), method="gyro")
