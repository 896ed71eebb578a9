"""A front from Python: searched, compared with the published codes, saved; its inputs checked
before any work."""

import json

import pytest

from cep.codes.published import for_chips
from cep.optics.camera import Camera
from cep.search.problem import SearchProblem
from lab.fronts.comparison import pareto
from motdiff.trajectory import Trajectory


def test_a_front_is_compared_with_the_published_codes_and_saved(tmp_path):
    found = pareto(SearchProblem(chips=13, open_range=(6, 10)), steps=500, seed=2)
    assert found.published.keys() == {entry.name for entry in for_chips(13)} != set()
    assert found.knees["most light"].open_chips == max(
        point.open_chips for point in found.front.points
    )
    assert found.warnings == ()
    found.save(tmp_path / "front.json", tmp_path / "front.svg", source={"linear_px": None})
    stored = json.loads((tmp_path / "front.json").read_text())
    assert stored["points"] == found.to_dict()["points"]
    assert (stored["problem"]["linear_px"], stored["problem"]["seed"]) == (None, 2)
    assert (tmp_path / "front.svg").read_text().startswith("<?xml")


def test_moves_that_the_time_ended_are_told():
    found = pareto(SearchProblem(chips=13, open_range=(6, 10)), steps=10**12, time_s=0.01)
    assert found.front.stopped == "time"
    assert found.warnings[0].startswith(
        "the limit of 0.01 s ended the search before its 1,000,000,000,000 moves: "
    )


def test_inputs_are_checked_before_outputs_and_outputs_before_the_search(monkeypatch):
    def claimed():
        raise RuntimeError("outputs")

    monkeypatch.setattr("lab.fronts.comparison.pareto_front", None)  # not called
    short = SearchProblem.along(Trajectory.straight(2.0), chips=13)
    for problem, options in ((short, {}), (SearchProblem(chips=13), {"time_s": 0.0})):
        with pytest.raises(ValueError, match=r"^(chips|time_s): "):
            pareto(problem, **options, on_checked=claimed)
    with pytest.raises(RuntimeError, match="outputs"):
        pareto(SearchProblem(chips=13), on_checked=claimed)


def test_a_front_without_codes_names_their_light():
    with pytest.raises(ValueError, match=r"^open_range: every code found"):
        pareto(SearchProblem(chips=4, open_range=(4, 4)), steps=0)


def test_along_a_motion_the_front_is_judged_beside_the_best_single_exposure():
    quiet = SearchProblem.along(Trajectory.straight(16.0), chips=16, camera=Camera(read_noise_e=2))
    found = pareto(quiet, steps=300)
    assert found.verdict.choice == "snapshot"
    assert found.single.code == found.verdict.best("snapshot").code
    assert found.single.mse_db < min(point.mse_db for point in found.front.points)
    assert found.to_dict()["verdict"].startswith("Coding does not pay here")
    assert (
        pareto(SearchProblem(chips=13, open_range=(6, 10)), steps=100).to_dict()["verdict"] is None
    )
