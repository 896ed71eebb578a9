"""Codes of several frames from Python: never worse together than the single code repeated; saved
whole."""

from dataclasses import replace

import pytest

from cep.files.code_files import read_code
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.search.code_search import SearchOptions
from cep.search.problem import SearchProblem
from lab.frames.optimum import frames_verdict, optimize_frames
from motdiff.trajectory import Trajectory

BENT = Trajectory.from_samples([[0, 0], [6, 1], [9, 5]])
PROBLEM = SearchProblem.along(BENT, chips=10, objective="noise", chip_ns=5000)


def test_frames_gain_at_least_what_the_single_code_repeated_gains(tmp_path):
    kept = []
    best = optimize_frames(PROBLEM, SearchOptions(steps=500), 2, on_found=kept.append)
    assert best.joint.noise_gain_db <= best.repeated.noise_gain_db + 1e-9
    assert best.joint.min_chip is None
    (codes,) = kept
    assert [stored.code for stored in codes] == list(best.search.codes)
    files = [tmp_path / "a.json", tmp_path / "b.json"]
    best.save(files)
    stored = [read_code(file) for file in files]
    assert tuple(one.code for one in stored) == best.search.codes
    assert [one.problem["frame"] for one in stored] == [1, 2]
    assert all(
        one.code.chip_ns == 5000 and one.problem["joint"]["min_mtf"] == best.joint.min_mtf
        for one in stored
    )


def test_the_method_is_checked_before_the_search(monkeypatch):
    monkeypatch.setattr("lab.frames.optimum.search_code", None)  # not called
    with pytest.raises(ValueError, match=r"^frames: not valid with method='exact'"):
        optimize_frames(PROBLEM, SearchOptions(method="exact"), 2)


def test_the_verdict_on_frames_is_by_all_of_them_together():
    """A quiet camera exposes each frame for less; a noisy one codes, where the pair gains more
    than one code twice."""
    straight = SearchProblem.along(Trajectory.straight(24.0), chips=24, objective="min-mtf")
    quiet, noisy = (replace(straight, camera=Camera(read_noise_e=read)) for read in (2, 100))
    pair = [ShutterCode("110111011000001101001001"), ShutterCode("011000000100111000101011")]
    plain = frames_verdict(quiet, pair)
    coded = frames_verdict(noisy, pair)
    assert (plain.choice, coded.choice) == ("snapshot", "code")
    assert " dB over these codes. " in plain.sentence
    assert "10,000 photo-electrons at full scale in each of 2 frames" in plain.sentence
    assert coded.advised.psnr_db > frames_verdict(noisy, pair[:1] * 2).best("code").psnr_db


def test_frames_of_a_single_opening_each_are_called_a_shorter_exposure():
    quiet = SearchProblem.along(Trajectory.straight(24.0), chips=24, camera=Camera(read_noise_e=2))
    best = optimize_frames(replace(quiet, objective="mse"), SearchOptions(steps=2000), 2)
    assert {code.pulses for code in best.search.codes} == {1}
    assert best.to_dict()["choice"] == "snapshot"
    assert best.verdict.sentence.startswith("Coding does not pay here: expose 1/24 of the time")
    assert "no code that was tried is better" in best.verdict.sentence
