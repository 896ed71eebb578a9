"""``python -m lab bench blind`` and ``python -m lab bench speed``: from photos to tables, going on
where they stopped, and refusals."""

import csv
import errno
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cep.commands.console import FAILURE, INTERRUPTED
from cep.files.images import read_image, write_image
from lab.bench.blind import cells
from lab.bench.blind.job import blind_job, speed_job
from lab.evaluation.quadratic_limits import nearest_quadratic
from motdiff.estimators.base import MotionEstimate
from motdiff.trajectory import Trajectory

TINY = """\
photos = 2
motions = 2
crop_px = 96
psf_px = 32
[motion]
max_length_px = 16.0
[quick]
motions = 1
"""
FLOORS = ["delta", "gaussian", "mean-kernel"]
CEILINGS = ["best-quadratic", "true-path", "true-kernel"]


@pytest.fixture
def studio(tmp_path, monkeypatch):
    """A folder with two sharp photos and a small protocol; the process works in it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("lab.bench.blind.plan._OTHERS", 5)
    # the search for the best one takes 7 CPU-s a motion, and has tests of its own
    monkeypatch.setattr(
        "lab.evaluation.floors.most_alike_quadratic", lambda path, *, size: nearest_quadratic(path)
    )
    cells._best_quadratic.cache_clear()
    rng = np.random.default_rng(0)
    for name in ("a", "b"):
        blocks = np.kron(rng.random((16, 17, 3)), np.ones((8, 8, 1)))
        Path("photos").mkdir(exist_ok=True)
        write_image(f"photos/{name}.png", 0.1 + 0.8 * blocks, gamma="linear")
    Path("tiny.toml").write_text(TINY)
    return tmp_path


@pytest.fixture
def guesses(monkeypatch):
    """Stand in for the slow estimator: always the same motion; ``at`` a photo it stops or
    fails."""

    class Guess:
        calls = 0
        fails = 0
        stops = 0

        def __init__(self, *_arguments, **_options):
            pass

        def estimate(self, photo):
            Guess.calls += 1
            if Guess.calls == Guess.stops:
                raise KeyboardInterrupt
            if Guess.calls == Guess.fails:
                raise ValueError("photo: too dark")
            motion = Trajectory.straight(7.0)
            return MotionEstimate("guess", (motion,), (1.0,), motion.psf(32), 0.4)

    cells._estimator.cache_clear()
    monkeypatch.setattr("motdiff.estimators.pmp.estimator.PmpEstimator", Guess)
    yield Guess
    cells._estimator.cache_clear()


BLIND = (
    "bench",
    "blind",
    "--data",
    "photos",
    "--protocol",
    "tiny.toml",
    "--methods",
    "pmp",
    "--workers",
    "1",
)
SPEED = ("bench", "speed", "--data", "photos", "--protocol", "tiny.toml", "--methods", "pmp")


@pytest.mark.slow(reason="four blind estimates")
def test_a_real_estimator_from_photos_to_every_output(lab, studio):
    cells._estimator.cache_clear()
    found = lab.succeeds(*BLIND, "-o", "out")
    table, limits = (
        found["tables"][title]
        for title in (
            "Blind, tiny, no noise",
            "Blind, tiny, no noise: kernels that know the truth",
        )
    )
    assert list(table) == [*FLOORS, "pmp"]
    assert list(limits) == CEILINGS
    assert table["pmp"]["mnc_subpixel"]["n"] == 4
    assert table["pmp"]["mnc_subpixel"]["mean"] > max(
        table[floor]["mnc_subpixel"]["mean"] for floor in FLOORS
    )
    assert table["pmp"]["cpu_s"]["mean"] > 0
    assert limits["true-kernel"]["mnc"]["mean"] == pytest.approx(1.0)
    assert limits["true-kernel"]["psnr_db"]["mean"] > table["delta"]["psnr_db"]["mean"]
    assert (found["failures"], found["missing"]) == ({}, 0)
    assert [Path(file).name for file in found["files"]] == [
        "blind-cells.csv",
        "blind.csv",
        "blind.json",
        "blind.md",
        "blind.pdf",
        "blind.png",
        "blind.svg",
        "blind.tex",
    ]
    with open("out/blind-cells.csv", newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 2 * 2 * 7
    own = [float(row["mnc_subpixel"]) for row in rows if row["method"] == "pmp"]
    assert table["pmp"]["mnc_subpixel"]["mean"] == pytest.approx(np.mean(own), rel=1e-4)
    kept = json.loads(Path("out/blind.json").read_text())
    assert (
        kept["command"]
        == "python -m lab bench blind --data photos --protocol tiny.toml --methods pmp"
    )
    assert (kept["seed"], kept["machines"][0]["versions"]["numpy"]) == (0, np.__version__)
    text = Path("out/blind.md").read_text()
    assert "| pmp |" in text
    assert "2 photos, each with 2 motions.\n" in text
    assert (
        "restored, up to shift, by L0 gradients, whose weight is 2.5 times the variance of the"
        " noise" in text
    )
    assert "scikit-image" not in text
    assert "smaller training budgets" not in text
    assert str(studio) not in text + Path("out/blind.json").read_text()
    height, width = read_image("out/blind.png").shape[:2]
    assert width > height  # two lines of four


OWN = """
from motdiff.estimators.base import MotionEstimate
from motdiff.trajectory import Trajectory

LENGTH_PX = {length}

class Always:
    def estimate(self, photo):
        motion = Trajectory.straight(LENGTH_PX)
        return MotionEstimate("always", (motion,), (1.0,), motion.psf(), 0.5)
"""


def test_an_estimator_of_ones_own_stands_in_the_table(lab, studio):
    Path("own_blind.py").write_text(OWN.format(length=7.0))
    command = [
        "bench",
        "blind",
        "--data",
        "photos",
        "--protocol",
        "tiny.toml",
        "--methods",
        "own_blind:Always",
    ]
    found = lab.succeeds(*command, "--workers", "2", "-o", "out")
    assert found["tables"]["Blind, tiny, no noise"]["own_blind:Always"]["mnc_subpixel"]["n"] == 4
    line = lab.refuses(*command[:-1], "own_blind:Nothing", "-o", "other")
    assert "own_blind has no 'Nothing'" in line
    assert "no method estimate" in lab.refuses(*command[:-1], "own_blind:LENGTH_PX", "-o", "other")


def test_finished_cells_are_found_again_and_a_quick_run_is_a_part(lab, studio, guesses):
    first = lab.succeeds(*BLIND, "-o", "out", "--cache", "cells")
    assert guesses.calls == 4
    assert "--force" in lab.refuses(*BLIND, "-o", "out", "--cache", "cells")
    again = lab.succeeds(*BLIND, "-o", "out", "--cache", "cells", "--force")
    assert again["tables"] == first["tables"]
    lab.succeeds(*BLIND, "-o", "quick", "--cache", "cells", "--quick")
    speed = lab.succeeds(*SPEED, "-o", "speed", "--cache", "cells")
    assert guesses.calls == 4
    ((title, rows),) = speed["tables"].items()
    assert "96 px" in title
    assert list(rows) == ["pmp"]
    assert rows["pmp"]["cpu_s"]["n"] == rows["pmp"]["wall_s"]["n"] == 2
    assert not Path("speed/speed.png").exists()
    text = Path("speed/speed.md").read_text()
    assert "PSNR" not in text
    assert "2 photos, 2 motions, 2 pairs of them.\n" in text


def test_intervals_are_promised_only_where_the_tables_have_some(lab, studio, guesses):
    """Two photos give none."""
    write_image("photos/c.png", read_image("photos/a.png")[::-1, ::-1])
    Path("tiny.toml").write_text(TINY.replace(" = 2\n", " = 3\n") + "photos = 2\n")
    for options, promised in ((), True), (("--quick",), False):
        lab.succeeds(*BLIND, *options, "-o", f"out{promised}", "--cache", "cells")
        introduction, *tables = Path(f"out{promised}/blind.md").read_text().split("\n\n**")
        assert ("95 % intervals" in introduction) == promised
        assert any(".." in table for table in tables) == promised


CLAIMED = ("--protocol", "tiny.toml", "--methods", "pmp,parametric", "--quick")
RESERVATIONS = (
    "photos are those of scikit-image: too few",
    "smaller training budgets than MoTDiff's 209,600",
)


def test_what_keeps_figures_from_a_claim_is_told(lab, studio, guesses):
    """Once each, and the same everywhere: on the console, in the JSON object, and in the files."""
    carried = ("bench", "blind", *CLAIMED, "--workers", "1")
    found = lab.succeeds(*carried, "-o", "out")
    text = Path("out/blind.md").read_text()
    kept = json.loads(Path("out/blind.json").read_text())
    assert kept["warnings"] == found["warnings"]
    for said in RESERVATIONS:
        assert sum(warning.startswith(said) for warning in found["warnings"]) == 1
        assert text.count(f"- {said}") == 1
    assert "2 photos, each with 1 motion.\n" in text
    lab(*carried, "-o", "out", "--force")
    assert lab.err.splitlines() == [f"lab: warning: {warning}" for warning in found["warnings"]]


def test_what_keeps_figures_from_a_claim_is_told_of_costs_and_of_real_photos(lab, studio, guesses):
    found = lab.succeeds("bench", "speed", *CLAIMED, "-o", "out")
    assert found["warnings"] == json.loads(Path("out/speed.json").read_text())["warnings"]
    assert [warning[:20] for warning in found["warnings"]] == [said[:20] for said in RESERVATIONS]
    # photos named are no carried ones; what the methods are stays
    Path("real").mkdir()
    write_image("real/Blurry1_1.png", np.random.default_rng(0).random((96, 96)))
    found = lab.succeeds(
        "bench", "blind", "--data", "real", *CLAIMED, "--workers", "1", "-o", "koehler"
    )
    (warning,) = found["warnings"]
    assert warning.startswith(RESERVATIONS[1])


def test_all_tables_in_one_folder_tell_it_too(lab, studio, guesses, monkeypatch):
    def few(request, *, gyro, search_s):
        options = {"protocol": "tiny.toml", "methods": ["pmp", "parametric"], "gyro": gyro}
        return {
            name: plan(replace(request, output=request.output / name), **options)
            for name, plan in (("blind", blind_job), ("speed", speed_job))
        }

    monkeypatch.setattr("lab.bench.all_jobs._jobs", few)
    command = ("bench", "--quick", "--workers", "1", "-o", "out")
    found = lab.succeeds(*command)
    starts = [f"{name}: {said}" for name in ("blind", "speed") for said in RESERVATIONS]
    assert [
        warning[: len(start)] for warning, start in zip(found["warnings"], starts, strict=True)
    ] == starts
    index = Path("out/README.md").read_text()
    for name, section in zip(("blind", "speed"), index.split("\n## ")[1:], strict=True):
        kept = json.loads(Path("out", name, f"{name}.json").read_text())["warnings"]
        assert [line[2:] for line in section.splitlines() if line.startswith("- ")] == kept
        assert [f"{name}: {warning}" for warning in kept] == [
            w for w in found["warnings"] if w.startswith(name)
        ]
    lab(*command, "--force")
    assert lab.err.splitlines() == [f"lab: warning: {warning}" for warning in found["warnings"]]


def test_cells_of_another_engine_are_made_again_and_told(lab, studio, guesses):
    lab.succeeds(*BLIND, "-o", "out", "--quick")
    for path in Path("out/cells").iterdir():
        path.write_text(path.read_text().replace('"engine": 1', '"engine": 0'))
    found = lab.succeeds(*BLIND, "-o", "out", "--quick", "--force")
    assert guesses.calls == 4
    assert any("another version of the engine" in warning for warning in found["warnings"])


def test_stopped_it_writes_what_is_there_and_goes_on_later(lab, studio, guesses):
    guesses.stops = 3
    lab(*BLIND, "-o", "out", "--json")
    assert (lab.code, lab.err) == (INTERRUPTED, "lab: interrupted\n")
    assert lab.json["missing"] > 0
    assert any(
        "stopped early" in warning and "--force goes on" in warning
        for warning in lab.json["warnings"]
    )
    assert "stopped early" in Path("out/blind.md").read_text()
    whole = lab.succeeds(*BLIND, "-o", "out", "--force")
    assert whole["missing"] == 0
    assert guesses.calls == 5  # two before, the one that was stopped, and the two left


def test_a_failed_estimate_is_told_and_tried_again(lab, studio, guesses):
    guesses.fails = 2
    lab(*BLIND, "-o", "out", "--json")
    assert lab.code == FAILURE
    found = lab.json
    assert list(found["failures"].values()) == ["photo: too dark"]
    assert any("1 of 28 cells failed" in warning for warning in found["warnings"])
    assert found["tables"]["Blind, tiny, no noise"]["pmp"]["mnc"]["n"] == 3
    assert "3 of 4" in Path("out/blind.md").read_text()
    assert lab.succeeds(*BLIND, "-o", "out", "--force")["failures"] == {}


def test_a_method_that_never_answers_is_told_with_its_reason(lab, studio, guesses):
    lab(*BLIND, "--methods", "pmp,blinddps", "-o", "out", "--quick", "--json")
    assert lab.code == FAILURE
    found = lab.json
    assert found["tables"]["Blind, tiny, no noise"]["blinddps"] == {
        figure: {"n": 0, "mean": None, "median": None, "interval": None, "bold": False}
        for figure in found["tables"]["Blind, tiny, no noise"]["pmp"]
    }
    assert "blinddps is not measured: needs weights" in Path("out/blind.md").read_text()


def test_a_full_disk_keeps_the_finished_cells(lab, studio, guesses, monkeypatch):
    from lab.jobs import cache

    real = cache.write_text
    written = []

    def full(path, text):
        if len(written) == 5:
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        written.append(path)
        real(path, text)

    monkeypatch.setattr("lab.jobs.cache.write_text", full)
    lab(*BLIND, "-o", "out", "--cache", "cells")
    assert lab.code == 1
    assert "No space left on device" in lab.err
    assert lab.err.count("\n") == 1
    assert len(list(Path("cells").iterdir())) == 5
    assert not Path("out").exists()


def test_people_see_a_table_and_where_the_files_are(lab, studio, guesses):
    lab(*BLIND, "--quick", "-o", "out")
    assert lab.code == 0, lab.err
    assert "sub-pixel MNC" in lab.out
    assert "mean-kernel" in lab.out
    assert "out: blind-cells.csv" in lab.out


def test_speed_leaves_no_figure_and_an_older_one_goes(lab, studio, guesses):
    Path("out").mkdir()
    for name in ("speed.pdf", "speed.png"):
        Path("out", name).write_text("older")
    assert "--force" in lab.refuses(*SPEED, "--quick", "-o", "out")
    lab.succeeds(*SPEED, "--quick", "-o", "out", "--force")
    assert {path.suffix for path in Path("out").glob("speed.*")} == {
        ".md",
        ".tex",
        ".csv",
        ".json",
    }


def test_speed_ends_as_the_others_do(lab, studio, guesses):
    guesses.fails = 1
    lab(*SPEED, "-o", "out", "--json")
    assert (lab.code, list(lab.json["failures"].values())) == (FAILURE, ["photo: too dark"])
    guesses.calls, guesses.fails, guesses.stops = 0, 0, 1
    lab(*SPEED, "-o", "out", "--json", "--force")
    assert (lab.code, lab.json["missing"]) == (INTERRUPTED, 1)
    assert Path("out/speed.md").is_file()


def test_speed_tells_which_methods_it_leaves_out_and_takes_no_cluster(
    lab, studio, guesses, monkeypatch
):
    monkeypatch.setattr("lab.bench.blind.methods.USUAL", ("pmp",))
    lab.succeeds(*SPEED[:-2], "--quick", "-o", "out")
    text = Path("out/speed.md").read_text()
    assert "selfdeblur is not measured: takes hours a photo." in text
    assert "blinddps is not measured: needs weights" in text
    lab.succeeds(*SPEED, "--quick", "-o", "named")  # who names methods knows what is left out
    assert "not measured" not in Path("named/speed.md").read_text()
    assert "--dask" in lab.refuses(*SPEED, "--dask", "tcp://127.0.0.1:9", "-o", "other")


def swapped(_studio):
    for half, image in (
        ("blur", np.random.default_rng(0).random((100, 100))),
        ("sharp", np.full((100, 100), 0.5)),
    ):
        Path("gopro/GOPR01", half).mkdir(parents=True)
        write_image(f"gopro/GOPR01/{half}/1.png", image)


def small(_studio):
    Path("small").mkdir()
    write_image("small/c.png", np.random.default_rng(0).random((95, 120)))


def text_file(_studio):
    Path("notes").write_text("no folder")


@pytest.mark.parametrize(
    ("options", "prepared", "message"),
    [
        (("--data", "nowhere"), None, "nowhere: no such folder"),
        (("--data", "notes"), text_file, "notes: is a file"),
        (("--data", "gopro"), swapped, "seem to be swapped"),
        (("--data", "small"), small, "c.png: 120 x 95 px is too small, the protocol needs 96 px"),
        (("--methods", "guess"), None, "--methods: must be one of"),
        (("--methods", "pmp,pmp"), None, "pmp comes twice"),
        (("--methods", "network:euler"), None, "network:euler"),
        (("--protocol", "theirs"), None, "protocol: must be paper, ours"),
        (("--protocol", "nowhere.toml"), None, "nowhere.toml"),
        (("--gyro", "nowhere.txt"), None, "--gyro: the protocol tiny has no hand shake"),
        (("--protocol", "ours", "--gyro", "nowhere.txt"), None, "nowhere.txt"),
        (("--cache", "notes"), text_file, "notes: is a file"),
        (("--workers", "0"), None, "--workers"),
        (("--dask", "tcp://127.0.0.1:9"), None, "dask: no scheduler answers at tcp://127.0.0.1:9"),
    ],
)
def test_refusals(lab, studio, guesses, options, prepared, message):
    if "--dask" in options:
        pytest.importorskip("distributed")
    if prepared is not None:
        prepared(studio)
    assert message in lab.refuses(*BLIND, "-o", "out", *options)
    assert guesses.calls == 0
    assert not Path("out").exists()
