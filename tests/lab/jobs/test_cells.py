"""Cells of a benchmark: what their fingerprints tell apart, what they refuse, what becomes of
their figures."""

import enum
import math
import pickle
import subprocess
import sys
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import bench_work
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from lab.jobs.cells import Cell, fingerprints, pinned, worked
from motdiff.trajectory import Trajectory

plain_data = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.binary(),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.lists(inner, max_size=3).map(tuple)
        | st.dictionaries(st.text(), inner, max_size=3)
    ),
    max_leaves=8,
)


class Kind(enum.IntEnum):
    ONE = 1
    UNO = 2


@dataclass(frozen=True)
class Pair:
    first: object
    second: object


@dataclass(frozen=True)
class Couple:
    first: object
    second: object


def cell(value=1, *, name=("one",), work=bench_work.square, version="1"):
    return Cell(name, work, {"value": value}, version)


def fingerprint(*arguments, **options):
    return fingerprints([cell(*arguments, **options)])[0]


def exactly(value):
    """Spell a value with its types: what Python calls equal, as 1 and True, or 0.0 and -0.0, is
    told apart."""
    if isinstance(value, dict):
        return f"dict{sorted((key, exactly(item)) for key, item in value.items())}"
    if isinstance(value, list | tuple):
        return type(value).__name__ + str([exactly(item) for item in value])
    return f"{type(value).__name__} {value!r}"


@given(plain_data, plain_data)
def test_fingerprints_agree_where_the_arguments_do(one, other):
    assert (fingerprint(one) == fingerprint(other)) == (exactly(one) == exactly(other))


DIFFERENT = [
    None,
    True,
    1,
    1.0,
    "1",
    b"1",
    0.0,
    -0.0,
    math.nan,
    math.inf,
    [1],
    (1,),
    [[1]],
    [],
    (),
    {},
    {"a": 1},
    {"a": [1]},
    ["ab", "c"],
    ["a", "bc"],
    ["abc"],
    Kind.ONE,
    Kind.UNO,
    Pair(1, 2),
    Couple(1, 2),
    Pair(2, 1),
    Pair(1, Pair(2, None)),
    np.zeros(4),
    np.zeros((2, 2)),
    np.zeros((4, 1)),
    np.zeros(4, np.float32),
    np.zeros(4, ">f8"),
    np.zeros(8, np.int32),
    np.array([0.0, -0.0, 0.0, 0.0]),
    np.float64(1.0),
    np.float32(1.0),
    np.array("1"),
    ShutterCode("1101"),
    ShutterCode("1101", 2),
    Trajectory.from_samples([[0, 0], [5, 0]]),
    Trajectory.from_samples([[0, 0], [5, 1]]),
]


def test_different_arguments_have_different_fingerprints():
    found = [fingerprint(value) for value in DIFFERENT]
    found += [fingerprint(version="2"), fingerprint(work=bench_work.fails)]
    found += fingerprints([Cell(("a",), bench_work.square, {"other": 1})])
    assert len(set(found)) == len(found)
    assert all(len(text) == 64 for text in found)


def test_the_same_content_has_the_same_fingerprint():
    pixels = np.arange(12.0).reshape(3, 4)
    turned = np.asfortranarray(pixels)
    assert (
        fingerprint(pixels)
        == fingerprint(turned)
        == fingerprint(pixels[::-1][::-1])
        == fingerprint(pixels.copy())
    )
    assert fingerprint({"a": 1, "b": 2}) == fingerprint({"b": 2, "a": 1})
    assert fingerprint(Camera()) == fingerprint(replace(Camera()))
    assert fingerprint(name=("one",)) == fingerprint(name=("another", "name"))


def test_fingerprints_are_those_of_another_process():
    code = (
        "import numpy as np, bench_work; from lab.jobs.cells import Cell,"
        " fingerprints;print(*fingerprints([Cell(('x',), bench_work.square, {'value': {'b': (1.5,"
        " 'x'), 'a': np.arange(3)}})]))"
    )
    folders = [str(Path(bench_work.__file__).parent), str(Path(__file__).parents[3])]
    command = [sys.executable, "-c", f"import sys; sys.path[:0] = {folders!r}; {code}"]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    assert done.stdout.strip() == fingerprint({"a": np.arange(3), "b": (1.5, "x")})


def test_a_file_counts_by_what_is_in_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, content in (("a.png", b"12"), ("b.png", b"12"), ("c.png", b"21")):
        Path(name).write_bytes(content)
    one, moved, other = (
        Cell((name,), bench_work.size_of, {"file": Path(name)})
        for name in ("a.png", "b.png", "c.png")
    )
    first, second, third = fingerprints([one, moved, other])
    assert first == second != third
    assert first != fingerprints([Cell(("a",), bench_work.size_of, {"file": b"12"})])[0]
    Path("a.png").write_bytes(b"13")
    assert fingerprints([one])[0] not in (first, third)
    # where a worker stands does not matter
    monkeypatch.chdir("/")
    assert worked(one.work, one.arguments).figures == {"bytes": 2}
    with pytest.raises(FileNotFoundError) as caught:
        fingerprints([replace(one, arguments={"file": tmp_path / "no.png"})])
    assert str(caught.value.filename) == str(tmp_path / "no.png")


def test_another_file_of_that_name_is_not_worked_on(tmp_path):
    path = tmp_path / "a.png"
    path.write_bytes(b"12")
    cell = Cell(("a",), bench_work.size_of, {"file": path})
    (given,) = pinned([cell])
    assert worked(cell.work, given).figures == {"bytes": 2}
    path.write_bytes(b"123")
    done = worked(cell.work, pickle.loads(pickle.dumps(given)))
    assert (done.figures, done.failure) == (
        {},
        f"{path}: another file than the one that the benchmark began with",
    )
    path.unlink()
    assert "FileNotFoundError" in worked(cell.work, given).failure


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (np.random.default_rng(0), r"one: argument value: a Generator has no content to hash"),
        ({"deep": [1, object()]}, r"one: argument value\.deep\[1\]: a object"),
        (Pair(1, {2, 3}), r"argument value\.second: a set"),
        (np.array([object()]), "a ndarray"),
        (np.ma.masked_array([1.0], [True]), "a MaskedArray"),
        ({1: 2}, "a dict"),
        ([Path("a")], r"argument value\[0\]: .* give a file as an argument of its own"),
        (math.sqrt, "a builtin_function_or_method"),
    ],
)
def test_what_has_no_fingerprint(value, message):
    with pytest.raises(ValueError, match=message):
        fingerprint(value)


class Methods:
    def work(self):
        """No function at the top of a module."""


def nested():
    def work():
        return {}

    return work


@pytest.mark.parametrize(
    "work",
    [
        lambda: {},
        nested(),
        partial(bench_work.square, value=1),
        Methods.work,
        math.sqrt,
        Methods,
        np.sum,
    ],
)
def test_work_must_be_found_by_name(work):
    with pytest.raises(ValueError, match=r"work: must be a function at the top .* for one"):
        cell(work=work)


def test_work_of_a_script_is_refused(monkeypatch):
    """Two scripts may both have a ``run``, and one cache."""
    monkeypatch.setattr(bench_work.square, "__module__", "__main__")
    with pytest.raises(ValueError, match="importable module"):
        cell()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": ()}, "name: "),
        ({"name": ("a", "")}, "name: "),
        ({"name": (1,)}, "name: "),
        ({"version": ""}, "version: "),
        ({"version": 2}, "version: "),
    ],
)
def test_names_and_versions_are_texts(changes, message):
    with pytest.raises(ValueError, match=message):
        cell(**changes)


def test_figures_are_plain():
    done = worked(bench_work.returns, {"what": "numpy"})
    assert done.figures == {"a": float(np.float32(0.1)), "b": 3, "c": True}
    assert [type(figure) for figure in done.figures.values()] == [float, int, bool]
    assert done.failure == ""
    assert done.seconds >= 0
    assert done.machine["cores"] >= 1


@pytest.mark.parametrize(
    ("work", "arguments", "reason"),
    [
        (bench_work.fails, {"value": 3}, "value: must be even, got 3"),
        (bench_work.fails, {"value": 0}, "ZeroDivisionError"),
        (
            bench_work.fails,
            {},
            "TypeError: fails() missing 1 required keyword-only argument: 'value'",
        ),
        (
            bench_work.returns,
            {"what": "nothing"},
            "the work must return a mapping of figures, got NoneType",
        ),
        (
            bench_work.returns,
            {"what": "list"},
            "figure 'a': must be a number, a text or None, got list",
        ),
    ],
)
def test_what_is_raised_becomes_a_line(work, arguments, reason):
    done = worked(work, arguments)
    assert done.failure == reason
    assert done.figures == {}
