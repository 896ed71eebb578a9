"""Trajectory files: exact round trips, and one clear line for every bad one."""

import errno
import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motdiff.files.outputs import write_text
from motdiff.files.trajectories import SCHEMA, StoredMotion, read_motion, write_motion
from motdiff.motions import boracchi_foi, quadratic
from motdiff.trajectory import Trajectory


def document(**changes: object) -> dict[str, object]:
    base: dict[str, object] = {
        "schema": SCHEMA,
        "units": "px",
        "direction": "unknown",
        "t": [0, 0.25, 1],
        "x": [0.0, 1.0, 4.0],
        "y": [0.0, 2.0, -1.0],
        "weight": 1.0,
        "alternatives": [],
        "source": {},
    }
    return {key: value for key, value in {**base, **changes}.items() if value is not ...}


@given(seed=st.integers(0, 2**31), weight=st.floats(0, 1))
@settings(max_examples=15, deadline=None)
def test_round_trip(tmp_path_factory: pytest.TempPathFactory, seed: int, weight: float) -> None:
    rng = np.random.default_rng(seed)
    motion = StoredMotion(
        quadratic(rng),
        weight,
        ((1 - weight, boracchi_foi(rng, samples=50)),),
        {"method": "test", "seed": seed},
    )
    path = tmp_path_factory.mktemp("motion") / "trajectory.json"
    write_motion(path, motion)
    back = read_motion(path)
    for was, now in zip(
        [motion.trajectory, motion.alternatives[0][1]],
        [back.trajectory, back.alternatives[0][1]],
        strict=True,
    ):
        np.testing.assert_array_equal(now.t, was.t)
        np.testing.assert_allclose(now.xy, was.xy, atol=1e-12)
    assert back.trajectory.direction == motion.trajectory.direction == "known"
    assert back.weight == motion.weight
    assert back.alternatives[0][0] == motion.alternatives[0][0]
    assert back.source == motion.source


def test_a_path_off_centre_is_centred_on_reading(tmp_path: Path) -> None:
    path = tmp_path / "t.json"
    path.write_text(json.dumps(document()))
    motion = read_motion(path).trajectory
    expected = Trajectory.from_samples([[0, 0], [1, 2], [4, -1]], t=[0, 0.25, 1])
    np.testing.assert_allclose(motion.xy, expected.xy)


def test_a_byte_order_mark_as_windows_editors_write_is_no_harm(tmp_path: Path) -> None:
    plain = tmp_path / "plain.json"
    marked = tmp_path / "marked.json"
    plain.write_text(json.dumps(document()), encoding="utf-8")
    marked.write_text(json.dumps(document()), encoding="utf-8-sig")
    np.testing.assert_array_equal(
        read_motion(marked).trajectory.xy, read_motion(plain).trajectory.xy
    )


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"schema": "cep.trajectory/9"}, "wanted schema"),
        ({"schema": ...}, "wanted schema"),
        ({"units": "mm"}, "units"),
        ({"direction": "left"}, "direction"),
        ({"t": [0, 0.5, 0.5], "x": [0, 1, 2], "y": [0, 1, 2]}, "strictly increasing"),
        ({"t": [0, 2, 1]}, r"t\[1\]: must be a number within 0\.\.1, got 2"),
        ({"t": [1, 0.5, 0]}, "strictly increasing"),
        ({"t": [0, 0.5, 2]}, r"t\[2\]: must be a number within 0\.\.1"),
        ({"t": [0.1, 0.5, 1]}, "from 0 to 1"),
        ({"t": [0], "x": [0], "y": [0]}, "t: must be a list of at least 2, got a list of 1"),
        ({"t": [], "x": [], "y": []}, "t: must be a list of at least 2"),
        ({"x": [0, float("nan"), 1]}, "finite"),
        ({"t": [0, float("nan"), 1]}, "finite"),
        ({"y": [0, float("inf"), 1]}, "finite"),
        ({"x": [0, 1]}, "equally long"),
        ({"x": [0, "one", 2]}, r"x\[1\]: must be a number"),
        ({"x": ["0", "1", "2"]}, r"x\[0\]: must be a number"),
        ({"x": None}, "x: must be a list of at least 2, got null"),
        ({"x": [0, 1e300, 2]}, r"x\[1\]: must be a number within -100000\.\.100000"),
        ({"alternatives": None}, "alternatives: must be a list"),
        ({"alternatives": [3]}, r"alternatives\[0\]: must be an object, got 3"),
        ({"source": None}, "source: must be an object"),
        ({"weight": None}, r"weight: must be a number within 0\.\.1"),
        ({"y": ...}, 'field "y" is missing'),
        ({"weight": 3}, "weight"),
        ({"weight": "heavy"}, "heavy"),
        ({"alternatives": [{"weight": 0.5}]}, "missing"),
        ({"alternatives": [3]}, "t.json"),
    ],
)
def test_bad_documents(tmp_path: Path, changes: dict[str, object], said: str) -> None:
    path = tmp_path / "t.json"
    path.write_text(json.dumps(document(**changes)))
    with pytest.raises(ValueError, match=said) as caught:
        read_motion(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "content", [b"", b"{", b'{"schema": "cep.traj', b"\xff\xd8\xff\xe0JFIF", b"[1, 2]", b"3"]
)
def test_files_that_are_no_such_json(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "t.json"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"t\.json") as caught:
        read_motion(path)
    assert "\n" not in str(caught.value)


def test_numbers_and_depths_beyond_python(tmp_path: Path) -> None:
    path = tmp_path / "t.json"
    huge = "1" + 400 * "0"
    path.write_text(f'{{"schema": "{SCHEMA}", "t": [0, 1], "x": [0, {huge}], "y": [0, 0]}}')
    with pytest.raises(ValueError, match=re.escape(str(path))):
        read_motion(path)
    path.write_text("[" * 200_000)
    with pytest.raises(ValueError, match="not a JSON file"):
        read_motion(path)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        read_motion(tmp_path / "nowhere.json")


def test_writing_leaves_the_old_file_when_it_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "t.json"
    write_text(path, "old")

    def full(_descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as disk:
        disk.setattr("os.fsync", full)
        with pytest.raises(OSError, match="No space left"):
            write_text(path, "new")
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["t.json"]
    with pytest.raises(FileNotFoundError):
        write_text(tmp_path / "no" / "t.json", "text")


def test_source_must_be_json(tmp_path: Path) -> None:
    with pytest.raises(TypeError):
        write_motion(
            tmp_path / "t.json", StoredMotion(Trajectory.straight(3.0), source={"bad": object()})
        )
    assert list(tmp_path.iterdir()) == []


def test_a_dense_path_is_thinned_on_reading_and_others_are_as_they_were(tmp_path: Path) -> None:
    t = np.linspace(0, 1, 100_000)
    path = Trajectory.from_samples(np.stack([20 * np.sin(5 * t), 15 * np.cos(4 * t)], axis=1), t=t)
    write_motion(tmp_path / "t.json", StoredMotion(path, 0.6, ((0.4, path.reversed()),)))
    read = read_motion(tmp_path / "t.json")
    for was, now in ((path, read.trajectory), (path.reversed(), read.alternatives[0][1])):
        assert now.t.size < 2000
        assert np.linalg.norm(now.at(t) - was.at(t), axis=1).max() <= 1e-4
    few = Trajectory.from_samples(path.at(np.linspace(0, 1, 2000)))
    write_motion(tmp_path / "few.json", StoredMotion(few))
    np.testing.assert_array_equal(read_motion(tmp_path / "few.json").trajectory.t, few.t)


def test_a_path_of_thousands_of_px_is_read_and_a_longer_one_refused(tmp_path):
    for length_px in (300.0, 4096.0):
        write_motion(tmp_path / "t.json", StoredMotion(Trajectory.straight(length_px)))
        assert read_motion(tmp_path / "t.json").trajectory.length_px == pytest.approx(length_px)
    good = StoredMotion(Trajectory.straight(20.0), 0.6, ((0.4, Trajectory.straight(4096.1)),))
    write_motion(tmp_path / "t.json", good)
    with pytest.raises(
        ValueError, match=r"t\.json: trajectory: the path is 4096\.1 px long, at most 4096 px"
    ):
        read_motion(tmp_path / "t.json")
