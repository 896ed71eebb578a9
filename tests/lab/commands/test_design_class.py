"""``python -m lab design-class``: folders, walks, recordings, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from cep.files.code_files import read_code
from motdiff.files.trajectories import StoredMotion, write_motion
from motdiff.trajectory import Trajectory

SMALL = ("--chips", "8", "--open", "4", "--steps", "300")


def test_one_code_for_all_motions_of_a_folder(lab, workplace):
    for name, direction in (("first", "known"), ("second", "unknown")):
        Path("shots", name).mkdir(parents=True)
        bent = Trajectory.from_samples([[0, 0], [9, 3], [14, 12]], direction=direction)
        write_motion(Path("shots", name, "trajectory.json"), StoredMotion(bent))
    found = lab.succeeds("design-class", "shots", *SMALL, "-o", "all.json")
    assert (found["motions"], found["other_motions"], found["others_db"]) == (2, 0, None)
    assert read_code("all.json").code.bits == found["bits"]
    assert all(
        row["behind_db"] >= -1e-6 for row in found["baselines"].values() if row["within_limits"]
    )
    assert any("2 motions are few" in line for line in found["warnings"])
    told = lab("design-class", "shots", *SMALL, "-o", "told.json").out
    first, second, *_ = told.splitlines()
    assert first == found["verdict"]
    assert second == f"told.json: {found['bits']}"


def test_one_code_for_walks_and_for_shakes_of_a_recording(lab, workplace):
    options = ("--motions", "3", "--length", "20", *SMALL, "--objective", "noise")
    found = lab.succeeds("design-class", "walks", *options, "-o", "walks.json")
    assert (found["motions"], found["other_motions"], found["open"]) == (3, 300, 4)
    again = lab.succeeds("design-class", "walks", *options, "-o", "again.json")
    assert (again["bits"], again["others_db"]) == (found["bits"], found["others_db"])
    t = np.linspace(0, 2, 400)
    rows = np.column_stack([t, np.sin(9 * t), np.cos(7 * t), 0 * t])
    np.savetxt("gyro.csv", rows, delimiter=",", header="t [s],x [rad/s],y [rad/s],z [rad/s]")
    shaken = lab.succeeds(
        "design-class", "gyro.csv", "--exposure", "80ms", *options, "-o", "gyro.json"
    )
    assert read_code("gyro.json").problem["class"]["kind"] == "gyro.csv"
    assert shaken["chip_ns"] == 10_000_000
    line = lab.refuses("design-class", "gyro.csv", "--exposure", "8", *options, "-o", "long.json")
    assert (
        "gyro.csv: 8.0 s does not fit the trace of 2 s; --exposure says how long a shake is"
        in line
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("nowhere",), "CLASS: must be walks, a gyro recording or a folder, and there is no file"),
        (("empty",), "empty: holds no */trajectory.json"),
        (("empty", "--motions", "5"), "--motions: not valid with a folder"),
        (("walks", "--length", "0"), "--length: must lie within 1..1000 px, got 0"),
        (
            ("walks", "--objective", "min-mtf"),
            "--objective: a class is searched by ",
        ),
        (("trajectory.json",), "trajectory.json: "),
    ],
)
def test_a_class_and_what_does_not_go_with_it(lab, workplace, options, message):
    Path("empty").mkdir()
    assert message in lab.refuses("design-class", *options, "-o", "refused.json")
    assert not Path("refused.json").exists()
