"""``python -m lab frames``: a file for each exposure, a table, and refusals."""

from pathlib import Path

import numpy as np
import pytest

from cep.files.code_files import read_code
from cep.optics.code import ShutterCode
from cep.search.problem import SearchProblem
from lab.frames.annealing import joint_figures
from motdiff.trajectory import Trajectory


def test_the_command_writes_a_file_for_each_frame(cep, lab, workplace):
    options = (
        "--chips",
        "16",
        "--open",
        "8",
        "--objective",
        "noise",
        "--steps",
        "8000",
        "-o",
        "both.json",
    )
    found = lab.succeeds("frames", "--linear", "16", "--frames", "2", *options)
    assert found["files"] == ["both_1.json", "both_2.json"]
    assert not Path("both.json").exists()
    for number, (file, bits) in enumerate(zip(found["files"], found["bits"], strict=True), 1):
        stored = read_code(file)
        assert stored.code.bits == bits
        assert bits.count("1") == 8
        assert (stored.problem["frame"], stored.problem["frames"]) == (number, 2)
        assert stored.problem["joint"]["noise_gain_db"] == found["noise_gain_db"]
        cep.succeeds("audit", file)
    problem = SearchProblem.along(Trajectory.straight(16.0), chips=16, objective="noise")
    figures = joint_figures(problem, [ShutterCode(bits) for bits in found["bits"]])
    assert found["noise_gain_db"] == pytest.approx(figures.noise_gain_db)
    assert found["min_mtf"] == pytest.approx(figures.minimum)
    assert found["noise_gain_db"] < found["single"]["noise_gain_db"]
    alone = problem.measure(ShutterCode(found["single"]["bits"]))
    assert found["single"]["noise_gain_db"] == pytest.approx(
        alone.noise_gain_db - 10 * np.log10(2)
    )


def test_the_command_shows_a_table(lab, workplace):
    assert (
        lab(
            "frames",
            "--linear",
            "12",
            "-n",
            "12",
            "--frames",
            "3",
            "--steps",
            "4000",
            "-o",
            "x.json",
        ).code
        == 0
    )
    for words in ("x_1", "x_3", "together", "best single code, 3 times", "min |P|, chips"):
        assert words in lab.out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--frames", "0"), "--frames"),
        (("--frames", "two"), "--frames"),
        (("--frames", "1"), "--frames"),
        (("--frames", "2", "-o", "there.json"), "there_2.json: exists already"),
        (("--frames", "2", "--time", "-1"), "--time"),
    ],
)
def test_bad_options_are_one_line(lab, workplace, options, message):
    Path("there_2.json").write_text("{}")
    assert message in lab.refuses(
        "frames", "--linear", "12", "--chips", "12", "-o", "never.json", *options
    )
    assert not list(Path().glob("never*"))
