"""Codes of several frames from Python: never worse together than the single code repeated; saved whole."""

import pytest

from cep.io.files import read_code
from cep.search.problem import SearchProblem
from cep.workflows.frames import optimize_frames
from cep.workflows.optimize import Search
from motdiff.trajectory import Trajectory

BENT = Trajectory.from_samples([[0, 0], [6, 1], [9, 5]])
PROBLEM = SearchProblem.along(BENT, chips=10, objective="noise", chip_ns=5000)


def test_frames_gain_at_least_what_the_single_code_repeated_gains(tmp_path):
    kept = []
    best = optimize_frames(PROBLEM, Search(steps=500), 2, on_found=kept.append)
    assert best.joint.noise_gain_db <= best.repeated.noise_gain_db + 1e-9
    assert best.joint.min_chip is None
    assert kept == [best.found]
    files = [tmp_path / "a.json", tmp_path / "b.json"]
    best.save(files, described={"seed": 0})
    stored = [read_code(file) for file in files]
    assert tuple(one.code for one in stored) == best.found.codes
    assert [one.problem["frame"] for one in stored] == [1, 2]
    assert all(one.code.chip_ns == 5000 and one.problem["joint"]["min_mtf"] == best.joint.min_mtf for one in stored)


def test_the_method_is_checked_before_outputs_and_outputs_before_the_search(monkeypatch):
    def claimed():
        raise RuntimeError("outputs")

    monkeypatch.setattr("cep.workflows.frames.search_code", None)  # not called
    with pytest.raises(ValueError, match=r"^frames: not valid with method='exact'"):
        optimize_frames(PROBLEM, Search(method="exact"), 2, on_checked=claimed)
    with pytest.raises(RuntimeError, match="outputs"):
        optimize_frames(PROBLEM, Search(), 2, on_checked=claimed)
