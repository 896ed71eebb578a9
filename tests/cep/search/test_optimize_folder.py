"""``cep optimize --each``: the code of the single command for each motion, what fails is told,
what stops goes on."""

import csv
import shutil
from pathlib import Path

import pytest

from cep.commands.console import FAILURE, INTERRUPTED
from cep.files.files import read_code
from cep.optics.camera import Camera
from cep.search import recipe
from cep.search.optimize import Search
from cep.search.optimize_folder import optimize_folder
from cep.search.problem import SearchProblem
from cep.search.search_options import Task
from motdiff.files.trajectories import StoredMotion, write_motion
from motdiff.trajectory import Trajectory

BENT = Trajectory.from_samples([[0, 0], [6, 1], [9, 5], [10, 11]])
MOTIONS = {"a": BENT, "b[1]": BENT.scaled(0.8), "c": Trajectory.straight(12.0)}
OPTIONS = ("--chips", "12", "--duty", "0.4:0.7", "--steps", "3000", "--seed", "3")
EACH = ("optimize", "--each", "motions", *OPTIONS, "--workers", "1")


@pytest.fixture
def motions(tmp_path, monkeypatch):
    """A folder as ``cep calibrate FOLDER`` writes it; the process works beside it."""
    monkeypatch.chdir(tmp_path)
    for name, motion in MOTIONS.items():
        Path("motions", name).mkdir(parents=True)
        write_motion(
            f"motions/{name}/trajectory.json", StoredMotion(motion, source={"method": "test"})
        )
    Path("motions/cells").mkdir()
    Path("motions/motions.csv").write_text("photo\n")
    return tmp_path


def rows_of(path):
    with open(path, newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.parametrize(
    ("workers", "more"),
    [("1", ("--speed", "0.9:1.1", "--device", "flc")), ("2", ("--objective", "noise"))],
)
def test_each_motion_gets_the_code_of_the_single_command(cep, motions, workers, more):
    found = cep.succeeds(*EACH[:-1], workers, *more)
    assert list(found["codes"]) == list(MOTIONS)
    assert (found["failures"], found["missing"]) == ({}, 0)
    rows = {row["motion"]: row for row in rows_of("motions/codes.csv")}
    for name in MOTIONS:
        single = cep.succeeds(
            "optimize",
            "--trajectory",
            f"motions/{name}/trajectory.json",
            *OPTIONS,
            *more,
            "-o",
            "one.json",
            "--force",
        )
        one = found["codes"][name]
        assert Path(one["file"]).read_bytes() == Path("one.json").read_bytes()
        same = set(single) - {"file", "seconds", "seed"}
        assert {key: one[key] for key in same} == {key: single[key] for key in same}
        assert rows[name]["bits"] == single["bits"]
    assert Path("motions/motions.csv").read_text() == "photo\n"


def test_a_proof_for_each_is_that_of_the_single_command(cep, motions):
    options = ("--chips", "8", "--open", "4", "--objective", "min-mtf", "--method", "exact")
    found = cep.succeeds(
        "optimize", "--each", "motions", *options, "--workers", "1", "-o", "codes"
    )
    for name in ("a", "c"):
        cep.succeeds(
            "optimize",
            "--trajectory",
            f"motions/{name}/trajectory.json",
            *options,
            "-o",
            f"{name}.json",
        )
        ours = read_code(f"codes/{name}/code.json")
        single = read_code(f"{name}.json")
        assert ours.code == single.code
        assert found["codes"][name]["proven"]
        assert ours.problem["proof"]["bits"] == single.problem["proof"]["bits"]


def test_motions_that_fail_are_told_by_name_and_the_others_kept(cep, motions):
    Path("motions/b[1]/trajectory.json").write_text("{")
    write_motion("motions/c/trajectory.json", StoredMotion(Trajectory.straight(2.0)))
    cep(*EACH, "-o", "codes", "--json")
    assert cep.code == FAILURE
    assert list(cep.json["codes"]) == ["a"]
    failures = cep.json["failures"]
    assert list(failures) == ["b[1]", "c"]
    assert failures["b[1]"].startswith("not a JSON file")
    assert failures["c"].startswith("--chips: 12 chips are too many for a path of 2.0 px")
    in_table = {
        row["motion"]: row["failure"] for row in rows_of("codes/codes.csv") if row["failure"]
    }
    assert in_table == failures | {
        "c": f"'{failures['c']}"
    }  # a spreadsheet takes "--chips" for a formula
    assert sorted(path.name for path in Path("codes").iterdir()) == ["a", "cells", "codes.csv"]


@pytest.mark.parametrize("damaged", [["a"], list(MOTIONS)])
def test_damaged_motions_keep_their_names_however_many(cep, motions, damaged):
    for name in MOTIONS:
        if name in damaged:
            Path("motions", name, "trajectory.json").write_text("{")
        else:
            shutil.rmtree(Path("motions", name))
    if damaged == ["a"]:
        assert list(Path("motions").glob("*/trajectory.json")) == [
            Path("motions/a/trajectory.json")
        ]
    cep(*EACH, "--json", "-o", "codes")
    assert (cep.code, list(cep.json["failures"])) == (FAILURE, damaged)
    assert all(reason.startswith("not a JSON file") for reason in cep.json["failures"].values())
    assert [row["motion"] for row in rows_of("codes/codes.csv")] == damaged
    cep(*EACH, "-o", "codes", "--force")
    assert [line.split(": not")[0] for line in cep.err.splitlines()] == [
        f"cep: warning: {name}" for name in damaged
    ]


def test_motions_that_all_fail_for_the_same_reason_keep_their_names(cep, motions):
    for name in MOTIONS:
        write_motion(f"motions/{name}/trajectory.json", StoredMotion(Trajectory.straight(2.0)))
    cep(*EACH, "--json")
    assert (cep.code, list(cep.json["failures"])) == (FAILURE, list(MOTIONS))
    assert len(set(cep.json["failures"].values())) == 1


def test_what_is_wrong_with_the_options_is_one_line_whatever_else_is_wrong(cep, motions):
    Path("motions/a/trajectory.json").write_text("{")
    Path("motions/c/code.json").write_text("precious")
    line = cep.refuses(*EACH, "--speed", "1.2:0.8", "--force")
    assert line.startswith("cep: --speed: factors must be above 0 and in order")
    assert Path("motions/c/code.json").read_text() == "precious"
    assert not Path("motions/codes.csv").exists()


def test_of_a_motion_that_fails_now_no_older_code_stays(cep, motions):
    cep.succeeds(*EACH)
    Path("motions/a/trajectory.json").write_text("{")
    write_motion("motions/c/trajectory.json", StoredMotion(Trajectory.straight(2.0)))
    cep(*EACH, "--json", "--force")
    assert (cep.code, list(cep.json["codes"])) == (FAILURE, ["b[1]"])
    assert sorted(path.parent.name for path in Path("motions").glob("*/code.json")) == ["b[1]"]
    assert len(list(Path("motions").glob("*/trajectory.json"))) == 3


def test_stopped_it_writes_what_is_finished_and_goes_on(cep, motions, monkeypatch):
    """A search that Ctrl-C ends gives its best so far, which must not pass for a finished one."""
    calls = []
    real = recipe.anneal

    def interrupted(problem, *, progress, **options):
        def stop(_fraction, _best):
            raise KeyboardInterrupt

        calls.append(problem)
        return real(problem, progress=stop if len(calls) == 2 else progress, **options)

    monkeypatch.setattr(recipe, "anneal", interrupted)
    cep(*EACH, "--json")
    assert cep.code == INTERRUPTED
    assert (list(cep.json["codes"]), cep.json["missing"], cep.json["failures"]) == (["a"], 2, {})
    assert any("--force goes on" in line for line in cep.json["warnings"])
    assert not Path("motions/b[1]/code.json").exists()
    assert "use --force" in cep.refuses(*EACH)
    assert list(cep.succeeds(*EACH, "--force")["codes"]) == list(MOTIONS)
    assert len(calls) == 4
    # other options are other searches
    cep.succeeds(*EACH, "--force", "--max-pulses", "3")
    assert len(calls) == 7


def test_each_code_is_written_before_the_next_search(cep, motions, monkeypatch):
    from cep.search import optimize

    real = optimize.compare
    seen = []

    def compare(*arguments, **options):
        seen.append(sorted(path.parent.name for path in Path("motions").glob("*/code.json")))
        return real(*arguments, **options)

    monkeypatch.setattr(optimize, "compare", compare)
    assert list(cep.succeeds(*EACH)["codes"]) == list(MOTIONS)
    assert seen == [[], ["a"], ["a", "b[1]"]]


def test_a_search_that_the_time_ended_is_told(cep, motions):
    found = cep.succeeds(
        "optimize",
        "--each",
        "motions",
        "--chips",
        "12",
        "--steps",
        "1000000000",
        "--time",
        "0.01",
        "--workers",
        "1",
    )
    assert len(found["codes"]) == 3
    told = (
        "the limit of 0.01 s ended the search before its 1,000,000,000 moves: another run may give"
        " another code"
    )
    assert all(
        told in one["warnings"] and one["stopped"] == "time" for one in found["codes"].values()
    )
    assert f"a: {told}" in found["warnings"]
    assert {row["stopped"] for row in rows_of("motions/codes.csv")} == {"time"}


def test_a_time_without_moves_is_no_cut(cep, motions):
    found = cep.succeeds(
        "optimize", "--each", "motions", "--chips", "12", "--time", "0.1", "--workers", "1"
    )
    assert {one["stopped"] for one in found["codes"].values()} == {"time"}
    assert not any("ended the search" in line for line in found["warnings"])


def test_people_see_a_table(cep, motions):
    cep(*EACH)
    assert cep.code == 0, cep.err
    for text in ("b[1]", "min MTF", "advised", "motions/codes.csv"):
        assert text in cep.out


def single_motion(_):
    Path("one").mkdir()
    Path("one/trajectory.json").write_bytes(Path("motions/a/trajectory.json").read_bytes())


def empty(_):
    Path("one").mkdir()


def taken(_):
    Path("motions/c/code.json").write_text("precious")


@pytest.mark.parametrize(
    ("arguments", "prepared", "message"),
    [
        (
            ("--each", "one"),
            single_motion,
            "for a single motion give --trajectory one/trajectory.json",
        ),
        (
            ("--each", "one"),
            empty,
            "one: holds no */trajectory.json, as cep calibrate FOLDER writes them",
        ),
        (("--each", "nowhere"), None, "nowhere: no such folder"),
        (("--each", "motions/motions.csv"), None, "is a file, a folder of motions is needed"),
        (("--each", "motions"), taken, "motions/c/code.json: exists already, use --force"),
        (
            ("--each", "motions", "--linear", "9"),
            None,
            "--each: takes the place of --trajectory and --linear",
        ),
        (
            ("--each", "motions", "--trajectory", "motions/a/trajectory.json"),
            None,
            "--each: takes the place",
        ),
        (("--each", "motions", "--frames", "2"), None, "--each: takes the place"),
        (("--each", "motions", "--open", "40"), None, "--open: must lie within 1..12, got 40"),
        (("--each", "motions", "--time", "0"), None, "--time: must be above 0 seconds"),
        (("--each", "motions", "--open", "40"), taken, "--open: must lie within 1..12, got 40"),
        (("--each", "motions", "--open", "13", "--chips", "13", "--max-open", "2"), None, "open"),
        (
            ("--each", "motions", "--method", "exact"),
            None,
            "--steps: not valid with --method exact",
        ),
        (("--each", "motions", "--workers", "0"), None, "--workers"),
        (
            ("--trajectory", "motions"),
            None,
            "motions: is a folder; --each FOLDER searches a code for each",
        ),
        (("--linear", "12", "--cache", "cells"), None, "--cache: is for a folder (--each)"),
    ],
)
def test_refusals(cep, motions, arguments, prepared, message):
    if prepared is not None:
        prepared(motions)
    assert message in cep.refuses("optimize", "--chips", "12", "--steps", "3000", *arguments)
    assert not Path("motions/codes.csv").exists()


def test_from_python_each_motion_has_its_own_search(motions):
    def task(stored, path):
        if path.parent.name == "a":
            raise ValueError("no code for this one")
        motion = stored.trajectory
        problem = SearchProblem.along(
            motion, chips=8, open_range=(4, 4), objective="mse", camera=Camera()
        )
        return Task(problem, motion, {"trajectory": str(path)})

    made = optimize_folder(
        Path("motions"), task, Search(steps=500, seed=1), Path("codes"), workers=1
    )
    assert (made.folder, made.summary, made.missing) == (Path("codes"), Path("codes/codes.csv"), 0)
    assert list(made.found) == ["b[1]", "c"]
    assert [row["failure"] for row in made.rows] == ["no code for this one", "", ""]
    for name, one in made.found.items():
        assert one["file"] == Path("codes", name, "code.json")
        assert read_code(one["file"]).code.open_chips == 4
