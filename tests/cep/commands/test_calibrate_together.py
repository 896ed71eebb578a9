"""``cep calibrate P1 P2 P3``: photos of one motion with an open shutter."""

from pathlib import Path

import numpy as np
import pytest

import cep as front_door
from cep.files.images import write_image
from motdiff.estimators.base import MotionEstimate
from motdiff.files.trajectories import read_motion
from motdiff.trajectory import Trajectory

PATH = Trajectory.from_samples([[0, 0], [9, 2], [11, 11]])


class Together:
    """An estimator of photos of one motion, with what is told of them."""

    def __init__(self, **figures):
        self.figures = figures
        self.seen = []

    def estimate_from(self, photos):
        self.seen.append(photos)
        details = {
            "photos": len(photos),
            "seen_in": len(photos),
            "repeatability": [0.9] * len(photos),
            "repeatability_px": [0.2] * len(photos),
            "left_out": [],
        }
        return MotionEstimate(
            "pmp", (PATH,), (1.0,), PATH.psf(64), 0.9, details=details | self.figures
        )

    def estimate(self, photo):
        raise AssertionError("several photos are estimated together")


@pytest.fixture
def shots(tmp_path, monkeypatch):
    """Three photos, the last of another size."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(1)
    for i, shape in enumerate([(80, 90), (80, 90), (70, 100)], 1):
        write_image(f"run{i}.png", rng.random(shape))
    return ["run1.png", "run2.png", "run3.png"]


@pytest.fixture
def search(monkeypatch):
    made = Together()
    monkeypatch.setattr("motdiff.estimators.pmp.estimator.PmpEstimator", lambda **_: made)
    return made


def test_several_photos_give_one_calibration_and_its_repeatability(cep, shots, search):
    found = cep.succeeds("calibrate", *shots, "--method", "pmp", "-o", "motion")
    assert [photo.shape for photo in search.seen[0]] == [(80, 90), (80, 90), (70, 100)]
    assert (found["repeatability"], found["left_out"]) == ([0.9, 0.9, 0.9], [])
    assert read_motion(found["trajectory"]).source["images"] == shots


@pytest.mark.parametrize(
    ("figures", "said"),
    [
        ({}, "One motion of 18 px, seen alike in 3 of 3 photos: their paths differ by 0.24 px."),
        (
            {"seen_in": 2, "repeatability_px": [0.0, 0.3, None], "left_out": [3]},
            "One motion of 18 px, seen alike in 2 of 3 photos: their paths differ by 0.3 px.",
        ),
        (
            {"seen_in": 1, "repeatability_px": [0.0, None, None]},
            (
                "One motion of 18 px; no two of 3 photos alone show it alike: whether it repeats"
                " is not known."
            ),
        ),
    ],
)
def test_the_answer_comes_first(cep, shots, search, figures, said):
    search.figures = figures
    cep("calibrate", *shots, "--method", "pmp", "-o", "motion")
    first, second, *_ = cep.out.splitlines()
    assert first == said
    assert second.startswith("motion: path of")


def test_a_photo_left_out_is_not_the_one_shown(shots, search):
    photos = [front_door.read_image(shot) for shot in shots]
    search.figures = {"left_out": [1]}
    np.testing.assert_array_equal(
        front_door.estimate_motion(photos, method="pmp").photo, photos[1]
    )


@pytest.mark.parametrize("several", [list, tuple])
def test_the_library_takes_a_list_or_a_tuple_and_estimators_of_the_user_s(shots, several):
    photos = several(front_door.read_image(shot) for shot in shots)
    made = Together()
    assert front_door.estimate_motion(photos, method=made).best is PATH
    assert len(made.seen[0]) == 3


def test_nested_numbers_are_one_photo(shots):
    class Alone:
        def estimate(self, photo):
            return MotionEstimate("own", (PATH,), (1.0,), PATH.psf(64), photo.shape == (80, 90))

    photo = front_door.read_image(shots[0])
    assert front_door.estimate_motion(photo.tolist(), method=Alone()).confidence
    assert front_door.estimate_motion([photo], method=Alone()).confidence
    with pytest.raises(ValueError, match=r"takes one photo, for it has no method estimate_from"):
        front_door.estimate_motion([photo, 1 - photo], method=Alone())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["run1.png", "run2.png", "run1.png"],
            ["run1.png: is the same as photo 1; give each photo once"],
        ),
        (["run1.png", "copy.png"], ["copy.png: is the same as photo 1"]),
        (["run1.png", "small.png"], ["small.png: needs at least"]),
        (["run1.png", "grey.png"], ["grey.png: is the same all over"]),
        (["run1.png", "missing.png"], ["missing.png"]),
        (["run1.png", "."], ["IMAGE", "one folder alone"]),
        (
            ["run1.png", "run2.png", "--method", "point"],
            ["--method: point takes one photo", "motdiff or pmp"],
        ),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(cep, shots, arguments, words):
    Path("copy.png").write_bytes(Path("run1.png").read_bytes())
    write_image("small.png", np.random.default_rng(0).random((30, 35)))
    write_image("grey.png", np.full((80, 90), 0.5))
    before = sorted(Path().rglob("*"))
    line = cep.refuses("calibrate", *arguments)
    assert all(word in line for word in words), line
    assert sorted(Path().rglob("*")) == before


def test_ctrl_c_writes_nothing(cep, shots, search):
    def stopped(photos):
        raise KeyboardInterrupt

    search.estimate_from = stopped
    cep("calibrate", *shots, "--method", "pmp", "-o", "motion")
    assert cep.code == 130
    assert not Path("motion").exists()
