"""``python -m motdiff eval`` from photos to report, with estimators that take no time."""

import csv
import json
import sys
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from full_disk import full_disk
from scipy import io

from motdiff.commands import run
from motdiff.estimators.base import MotionEstimate
from motdiff.evaluation.floors import gaussian
from motdiff.evaluation.methods import named_estimators
from motdiff.trajectory import Trajectory

FLOORS, CEILINGS = ["delta", "gaussian", "mean-kernel"], ["best-quadratic", "true-path", "true-kernel"]


def quick(calls_until_stop=None, fails_at=None):
    """Make an estimator class whose every answer is a straight motion."""
    calls = []

    class Quick:
        def __init__(self, **options):
            self.options = options

        def estimate(self, photo):
            assert photo.shape[:2] == (256, 256)
            calls.append(photo)
            if len(calls) == calls_until_stop:
                raise KeyboardInterrupt
            if len(calls) == fails_at:
                raise ValueError("photo: too dark")
            motion = Trajectory.straight(12.0)
            return MotionEstimate("quick", (motion,), (1.0,), motion.psf(), 0.6)

    return Quick


@pytest.fixture
def photos(tmp_path):
    folder = tmp_path / "photos"
    folder.mkdir()
    light = np.random.default_rng(0).integers(0, 256, (11, 11, 3), np.uint8)
    assert cv2.imwrite(str(folder / "a.png"), np.kron(light, np.ones((30, 30, 1), np.uint8)))
    return folder


@pytest.fixture
def evaluate(tmp_path, photos, monkeypatch):
    def given(*arguments, estimator=None):
        monkeypatch.setattr("motdiff.estimators.pmp.PmpEstimator", estimator or quick())
        monkeypatch.setattr("motdiff.evaluation.run.mean_kernel", lambda _mix, *, seed: gaussian(3.0 + seed))
        monkeypatch.setattr("motdiff.evaluation.measure._restoration", lambda _case, psf: (20 + psf.max(), 0.5))
        method = [] if {"--method", "--weights"} & set(arguments) else ["--method", "pmp"]
        return run(["eval", "--photos", str(photos), "-o", str(tmp_path / "out"), "--shown", "1", *method, *arguments])

    return given


def rows_of(folder):
    with (folder / "out" / "rows.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_tables_rows_and_pictures(evaluate, tmp_path, capsys):
    assert evaluate("--set", "paper", "--set", "boracchi-foi", "--count", "2", "--no-restore") == 0
    told = capsys.readouterr()
    methods = [*FLOORS, "pmp", *CEILINGS]
    assert [line.split()[0] for line in told.out.splitlines()[:8]] == ["paper", *methods]
    assert "boracchi-foi" in told.out
    assert "confidence" in told.out
    assert "paper 2/2  pmp  MNC" in told.err
    assert "boracchi-foi 2/2 done, 0.0 min left" in told.err
    rows = rows_of(tmp_path)
    assert [(row["set"], row["case"], row["method"]) for row in rows] == [
        (name, case, method) for name in ("paper", "boracchi-foi") for case in ("0000", "0001") for method in methods
    ]
    assert all(row["psnr_db"] == "" for row in rows)
    assert {float(row["mnc"]) for row in rows if row["method"] == "true-kernel"} == {1.0}
    made = {path.name for path in (tmp_path / "out").iterdir()}
    assert made == {
        "rows.csv", "tables.csv", "tables.json", "reliability.png", "sheet_paper.png", "sheet_boracchi-foi.png",
    }  # fmt: skip


def test_json_is_one_object_without_nan(evaluate, tmp_path, capsys):
    assert evaluate("--set", "paper", "--count", "1", "--json", "--grey", "--sigma", "0.02") == 0
    document = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert document == json.loads((tmp_path / "out" / "tables.json").read_text())
    assert document["stopped"] is False
    assert document["options"]["sigma"] == 0.02
    figures = {table["method"]: table["figures"] for table in document["tables"]}
    assert figures["delta"]["psnr_db"]["mean"] == 21
    assert figures["pmp"]["ssim"]["mean"] == 0.5
    assert figures["delta"]["confidence"] == {"mean": None, "sd": None, "min": None}
    assert document["calibration"][0]["said"] == pytest.approx(0.6)


def test_failures_are_counted(evaluate, tmp_path, capsys):
    assert evaluate("--set", "paper", "--count", "2", "--no-restore", "--json", estimator=quick(fails_at=1)) == 0
    told = capsys.readouterr()
    assert "pmp  failed: photo: too dark" in told.err
    document = json.loads(told.out)
    (pmp,) = (table for table in document["tables"] if table["method"] == "pmp")
    assert (pmp["n"], pmp["failed"]) == (2, 1)
    assert document["failures"] == [{"set": "paper", "case": "0000", "method": "pmp", "failure": "photo: too dark"}]


def test_ctrl_c_keeps_what_is_done(evaluate, tmp_path, capsys):
    stops = quick(calls_until_stop=3)
    assert evaluate("--set", "paper", "--count", "4", "--no-restore", estimator=stops) == 130
    told = capsys.readouterr()
    assert told.err.endswith("error: stopped\n")
    rows = rows_of(tmp_path)
    assert [row["case"] for row in rows if row["method"] == "pmp"] == ["0000", "0001"]
    assert [row["case"] for row in rows if row["method"] == "delta"] == ["0000", "0001", "0002"]
    assert told.out.splitlines()[4].split()[:2] == ["pmp", "2"]
    assert (tmp_path / "out" / "sheet_paper.png").exists()
    assert json.loads((tmp_path / "out" / "tables.json").read_text())["stopped"] is True


def test_ctrl_c_before_anything_is_done(evaluate, tmp_path, capsys, monkeypatch):
    def stop(*_given, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr("motdiff.evaluation.run.measure_psf", stop)
    assert evaluate("--set", "paper", "--count", "1") == 130
    assert capsys.readouterr().out == "nothing was measured\n"


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ([], "--set"),
        (["--set", "nothing"], "set: must be one of paper, boracchi-foi, gyro"),
        (["--set", "gyro"], "gyro_trace"),
        (["--set", "paper", "--method", "magic"], "method: must be one of pmp, motdiff"),
        (["--set", "paper", "--count", "0"], "count"),
        (["--set", "paper", "--method", "pmp", "--weights", "a"], "weights: are for the methods motdiff"),
        (["--set", "paper", "--weights", "missing.safetensors"], "missing.safetensors: no such file"),
        (["--levin", "missing"], "missing"),
    ],
)
def test_what_cannot_be_done_is_one_line(evaluate, capsys, arguments, told):
    assert evaluate(*arguments) == 2
    err = capsys.readouterr().err
    assert err.startswith("error: ")
    assert told in err
    assert err.count("\n") == 1


def test_levins_photos_have_no_path_and_no_kind(evaluate, tmp_path, capsys):
    for name in ("im01_ker01", "im01_ker02"):
        photo = np.random.default_rng(0).random((256, 256))
        io.savemat(tmp_path / f"{name}.mat", {"x": photo, "y": photo, "f": gaussian(2.0, 15)})
    assert evaluate("--levin", str(tmp_path)) == 0
    assert "levin 2/2 done" in capsys.readouterr().err
    rows = rows_of(tmp_path)
    assert [(row["case"], row["method"]) for row in rows] == [
        (case, method)
        for case in ("im01_ker01", "im01_ker02")
        for method in ("delta", "gaussian", "pmp", "true-kernel")
    ]
    assert {row["path_px"] for row in rows} == {""}


def test_simulated_sets_need_photos(capsys):
    assert run(["eval", "--set", "paper"]) == 2
    assert "--photos" in capsys.readouterr().err


def test_every_file_of_weights_is_a_row(tmp_path, monkeypatch):
    made = SimpleNamespace(MotDiffEstimator=quick())
    monkeypatch.setitem(sys.modules, "motdiff.estimators.motdiff", made)
    files = [tmp_path / "small.safetensors", tmp_path / "large.safetensors", tmp_path / "small.bin"]
    for path in files:
        path.touch()
    both = named_estimators(["motdiff"], files[:2])
    assert {name: estimator.options for name, estimator in both.items()} == {
        "small": {"weights": files[0]},
        "large": {"weights": files[1]},
    }
    assert list(named_estimators(["motdiff"])) == ["motdiff"]
    with pytest.raises(ValueError, match="weights: need different file names"):
        named_estimators(["motdiff"], files)


def test_the_report_is_whole_or_not_there(evaluate, tmp_path, monkeypatch):
    """Rows are kept as they come; the tables and pictures made of them appear together."""
    monkeypatch.setattr("motdiff.evaluation.report.contact_sheet", lambda *_: b"sheet")
    monkeypatch.setattr("motdiff.evaluation.report.reliability_plot", lambda *_: b"plot")
    options = ("--set", "paper", "--count", "1", "--no-restore")
    with full_disk(monkeypatch) as written:
        assert evaluate(*options) == 0
    report = {"tables.csv", "tables.json", "reliability.png", "sheet_paper.png"}
    assert {item.name for item in (tmp_path / "out").iterdir()} == {*report, "rows.csv"}
    for item in report:
        (tmp_path / "out" / item).write_text("old")
    for number in range(2, len(written)):  # from after the folder and rows.csv
        with full_disk(monkeypatch, writes=number):
            assert evaluate(*options) == 1
        assert {item.name: item.read_text() for item in (tmp_path / "out").iterdir() if item.name != "rows.csv"} == (
            dict.fromkeys(report, "old")
        )
