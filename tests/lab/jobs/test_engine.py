"""The engine of the benchmarks: what is finished stays, what changed runs again, what fails is
told."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import bench_work
import numpy as np
import pytest
from children import child

from cep.commands.console import FAILURE
from cep.commands.errors import explain
from lab.jobs.cells import Cell
from lab.jobs.engine import run_cells
from lab.jobs.executors import in_processes

ROOT = Path(__file__).parents[3]


@pytest.fixture
def log(tmp_path):
    return tmp_path / "log"


@pytest.fixture
def cache(tmp_path):
    return tmp_path / "cache"


def squares(values, log, version="1"):
    return [
        Cell((f"of {value}",), bench_work.square, {"value": value, "log": str(log)}, version)
        for value in values
    ]


def of(work, count, **arguments):
    return [Cell((str(value),), work, {"value": value, **arguments}) for value in range(count)]


def said(log):
    return log.read_text().splitlines() if log.exists() else []


def test_results_come_in_the_order_of_the_cells(cache, log):
    notes = []
    outcome = run_cells(
        squares([3, 1, 2], log), cache=cache, progress=lambda *note: notes.append(note)
    )
    assert [result.cell.name for result in outcome.results] == [("of 3",), ("of 1",), ("of 2",)]
    assert list(outcome.figures.values()) == [
        {"square": n * n, "parity": p} for n, p in ((3, "odd"), (1, "odd"), (2, "even"))
    ]
    assert (outcome.missing, outcome.warnings, outcome.failures) == (0, (), {})
    assert [fraction for fraction, _ in notes] == [
        0,
        pytest.approx(1 / 3),
        pytest.approx(2 / 3),
        1,
    ]
    assert notes[0][1] == "0 of 3 cells"
    assert all(
        note.startswith(f"{n} of 3 cells, about ") and note.endswith(" left")
        for n, (_, note) in enumerate(notes)
        if n
    )


def test_what_is_finished_is_not_done_again(cache, log):
    run_cells(squares([1, 2], log), cache=cache)
    outcome = run_cells(squares([1, 2, 3], log), cache=cache)
    assert said(log) == ["square 1", "square 2", "square 3"]
    assert [result.cached for result in outcome.results] == [True, True, False]
    assert [figures["square"] for figures in outcome.figures.values()] == [1, 4, 9]
    # a changed method runs again, alone
    again = run_cells([*squares([1], log, version="2"), *squares([2, 3], log)], cache=cache)
    assert said(log)[3:] == ["square 1"]
    assert [result.cached for result in again.results] == [False, True, True]


@pytest.mark.parametrize("workers", [1, 2])
def test_each_result_is_told_when_it_is_there_known_ones_first(cache, log, workers):
    run_cells(squares([2], log), cache=cache)
    told = []

    def tell(result):
        kept = len([path for path in cache.iterdir() if path.suffix == ".json"])
        told.append((result.cell.name[0], result.cached, result.finished.figures["square"], kept))

    twin = Cell(("twin",), bench_work.square, {"value": 3, "log": str(log)})
    run_cells([*squares([1, 2, 3], log), twin], cache=cache, workers=workers, finished=tell)
    assert told[0] == ("of 2", True, 4, 1)
    assert {name: figure for name, _, figure, _ in told} == {
        "of 1": 1,
        "of 2": 4,
        "of 3": 9,
        "twin": 9,
    }
    kept = {name: count for name, _, _, count in told}
    assert kept["of 3"] == kept["twin"]
    assert sorted(kept.values()) in ([1, 2, 2, 3], [1, 2, 3, 3])


def test_cells_of_the_same_content_run_once(cache, log):
    first = squares([5], log)[0]
    second = Cell(("another",), bench_work.square, {"value": 5, "log": str(log)})
    outcome = run_cells([first, second], cache=cache)
    assert said(log) == ["square 5"]
    assert [figures["square"] for figures in outcome.figures.values()] == [25, 25]


def test_figures_come_back_as_they_were(cache):
    """Not one bit less, and what JSON cannot say comes back as well."""
    cells = [Cell((what,), bench_work.returns, {"what": what}) for what in ("numpy", "nan", "inf")]
    first, second = (run_cells(cells, cache=cache) for _ in range(2))
    assert [result.cached for result in second.results] == [True] * 3
    assert str(second.figures) == str(first.figures)
    assert second.figures["numpy",] == {"a": float(np.float32(0.1)), "b": 3, "c": True}
    assert np.isnan(second.figures["nan",]["a"])
    assert second.figures["inf",]["a"] == -np.inf
    for path in cache.iterdir():
        json.loads(
            path.read_text(), parse_constant=lambda name: pytest.fail(f"{name} is not JSON")
        )


@pytest.mark.parametrize("workers", [1, 2])
def test_one_that_fails_is_told_and_tried_again(cache, workers):
    for _ in range(2):
        outcome = run_cells(of(bench_work.fails, 5), cache=cache, workers=workers)
        assert outcome.failures == {
            ("0",): "ZeroDivisionError",
            ("1",): "value: must be even, got 1",
            ("3",): "value: must be even, got 3",
        }
        assert list(outcome.figures.values()) == [{}, {}, {"value": 2}, {}, {"value": 4}]
        assert outcome.missing == 0
    assert len(list(cache.iterdir())) == 2
    assert [result.cached for result in outcome.results] == [False, False, True, False, True]


def test_interrupted_it_keeps_what_is_finished(cache):
    outcome = run_cells(of(bench_work.interrupts, 5, at=3), cache=cache)
    assert list(outcome.figures) == [("0",), ("1",), ("2",)]
    assert outcome.missing == 2
    assert len(list(cache.iterdir())) == 3


def test_a_key_press_stops_processes_quietly(cache, log):
    """A terminal sends Ctrl-C to the workers too: no traceback of theirs may appear."""
    code = (
        f"import sys; sys.path[:0] = {[str(ROOT / 'tests/helpers'), str(ROOT)]!r}\n"
        "import bench_work, numpy as np; from lab.jobs.cells import Cell;"
        " from lab.jobs.engine import run_cells\npixels = np.ones((2, 2))\n"
        "cells = [Cell((str(n),), bench_work.total,"
        f" {{'pixels': n * pixels, 'log': {str(log)!r}, 'slow_s': 0.3}}) for n in"
        f" range(200)]\noutcome = run_cells(cells, cache={str(cache)!r},"
        " workers=2)\nprint(len(outcome.results), outcome.missing)"
    )
    with child(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    ) as running:
        deadline = time.monotonic() + 120
        while not cache.is_dir() or not list(cache.glob("[!.]*.json")):
            assert running.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.05)
        os.killpg(running.pid, signal.SIGINT)
        out, err = running.communicate(timeout=60)
    assert err == ""
    finished, missing = map(int, out.split())
    assert finished == len(list(cache.iterdir())) >= 1
    assert missing == 200 - finished


def test_a_full_disk_leaves_what_is_finished(cache, log, monkeypatch, capsys):
    write = Path.write_text
    written = []

    def nearly_full(self, *arguments, **options):
        if len(written) == 2:
            write(self, "half")
            raise OSError(errno.ENOSPC, "No space left on device", str(self))
        written.append(self)
        return write(self, *arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", nearly_full)
        with pytest.raises(OSError, match="No space left") as caught:
            run_cells(squares(range(5), log), cache=cache)
    assert Path(caught.value.filename).parent == cache
    assert explain(caught.value) == FAILURE
    assert capsys.readouterr().err == f"cep: {caught.value.filename}: No space left on device\n"
    assert len(list(cache.iterdir())) == 2
    outcome = run_cells(squares(range(5), log), cache=cache)
    assert [result.cached for result in outcome.results] == [True, True, False, False, False]
    assert [figures["square"] for figures in outcome.figures.values()] == [0, 1, 4, 9, 16]


def test_a_process_that_is_started_anew_is_no_news(monkeypatch):
    def renewed(tasks, _call, **_options):
        warnings.warn(
            "A worker stopped while some jobs were given to the executor. (loky)",
            UserWarning,
            stacklevel=1,
        )
        yield from ((key, bench_work.square) for key in list(tasks))

    monkeypatch.setattr("lab.jobs.executors._spread", renewed)
    before = list(warnings.filters)
    tasks = dict.fromkeys("ab", (bench_work.square, {}))
    assert [key for key, _ in in_processes(tasks, 2)] == ["a", "b"]
    assert list(warnings.filters) == before


def test_a_full_disk_stops_processes(cache, monkeypatch):
    def full(*_arguments, **_options):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(OSError, match="No space left"):
        run_cells(of(bench_work.fails, 9), cache=cache, workers=2)
    assert not cache.exists()


def test_what_is_raised_leaves_no_empty_folder_and_removes_no_other(tmp_path):
    def at_once(_fraction, _note):
        raise RuntimeError("stop")

    def at_the_end(fraction, _note):
        if fraction == 1:
            raise RuntimeError("stop")

    (tmp_path / "own").mkdir()
    for stop, cache in (
        (at_once, "a/b/cells"),
        (at_once, "own/cells"),
        (at_once, "own"),
        (at_the_end, "kept/cells"),
    ):
        with pytest.raises(RuntimeError, match="stop"):
            run_cells(of(bench_work.fails, 3), cache=tmp_path / cache, progress=stop)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["kept", "own"]
    assert list((tmp_path / "own").iterdir()) == []
    assert len(list((tmp_path / "kept/cells").iterdir())) == 1


def every_digit(text):
    """Yield the text with each of its digits changed, one at a time."""
    for index, character in enumerate(text):
        if character.isdigit():
            yield text[:index] + str((int(character) + 1) % 10) + text[index + 1 :]


def test_no_changed_digit_gets_through(cache, log):
    run_cells(squares([7], log), cache=cache)
    (path,) = cache.iterdir()
    whole = path.read_text()
    count = 0
    for changed in every_digit(whole):
        if json.loads(changed) == json.loads(whole):
            continue  # the 17th digit of a time may be one that no number has
        path.write_text(changed)
        outcome = run_cells(squares([7], log), cache=cache)
        assert outcome.figures["of 7",]["square"] == 49
        assert not outcome.results[0].cached
        assert len(outcome.warnings) == 1
        count += 1
    assert count > 64
    assert run_cells(squares([7], log), cache=cache).results[0].cached


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda text: text[: len(text) // 2], "damaged"),
        (lambda _text: "", "damaged"),
        (lambda _text: "[1]", "damaged"),
        (lambda _text: "\x00\xff", "damaged"),
        (lambda text: text.replace('"even"', '"odd"'), "damaged"),
        (
            lambda text: text.replace('"engine": 1', '"engine": 2'),
            "of another version of the engine",
        ),
        (
            lambda text: text.replace("cep.bench-cell/1", "cep.bench-cell/0"),
            "of another version of the engine",
        ),
    ],
)
def test_what_cannot_be_trusted_is_made_again(cache, log, spoil, reason):
    run_cells(squares([2, 4, 3], log), cache=cache)
    spoilt = [path for path in cache.iterdir() if '"even"' in path.read_text()]
    for path in spoilt:
        path.write_text(spoil(path.read_text()))
    outcome = run_cells(squares([2, 4, 3], log), cache=cache)
    assert outcome.warnings == (f"{cache}: 2 finished cells {reason}: made again",)
    assert [result.cached for result in outcome.results] == [False, False, True]
    assert list(outcome.figures.values())[:2] == [
        {"square": 4, "parity": "even"},
        {"square": 16, "parity": "even"},
    ]
    assert run_cells(squares([2, 4, 3], log), cache=cache).warnings == ()


def test_a_file_under_another_name_is_not_believed(cache, log):
    run_cells(squares([2, 3], log), cache=cache)
    one, other = cache.iterdir()
    one.write_text(other.read_text())
    outcome = run_cells(squares([2, 3], log), cache=cache)
    assert [figures["square"] for figures in outcome.figures.values()] == [4, 9]
    assert outcome.warnings == (f"{cache}: 1 finished cell damaged: made again",)


def test_processes_give_the_same(cache, log, tmp_path):
    cells = [
        Cell(
            (str(n),), bench_work.total, {"pixels": np.full((300, 300), float(n)), "log": str(log)}
        )
        for n in range(6)
    ]
    together = run_cells(cells, cache=cache, workers=2)
    alone = run_cells(cells, cache=tmp_path / "alone")
    assert together.figures == alone.figures == {(str(n),): {"total": 9e4 * n} for n in range(6)}
    begun = [line.split() for line in said(log)[:12] if line.startswith("begin")]
    assert sorted(words[2] for words in begun) == list("012345")
    assert str(os.getpid()) not in {words[1] for words in begun}


def test_processes_have_one_inner_thread(cache):
    cells = [Cell((str(seed),), bench_work.inner_threads, {"seed": seed}) for seed in range(2)]
    assert (
        list(run_cells(cells, cache=cache, workers=2).figures.values()) == [{"threads": "1"}] * 2
    )


def test_one_that_kills_its_process_fails_alone(cache):
    outcome = run_cells(of(bench_work.kills_its_process, 10, at=3), cache=cache, workers=2)
    assert list(outcome.failures) == [("3",)]
    assert "its process died" in outcome.failures["3",]
    assert [figures.get("value") for figures in outcome.figures.values()] == [
        0,
        1,
        2,
        None,
        *range(4, 10),
    ]
    assert len(list(cache.iterdir())) == 9


def test_machines_of_cached_cells_are_told(cache, log):
    """Speed must not be told as this machine's where another one measured it."""
    from lab.jobs.cache import Cache
    from lab.jobs.cells import Finished, fingerprints

    cells = squares([1, 2, 3], log)
    elsewhere = {"processor": "another"}
    Cache(cache).keep(
        fingerprints(cells)[1],
        cells[1],
        Finished({"square": 4, "parity": "even"}, "", 1.5, elsewhere),
    )
    outcome = run_cells(cells, cache=cache)
    assert len(outcome.machines) == 2
    assert outcome.machines[1] == elsewhere
    assert outcome.machines[0]["versions"]["numpy"] == np.__version__
    assert outcome.results[1].finished.seconds == 1.5


@pytest.mark.parametrize(
    ("options", "message"),
    [({"workers": 0}, "workers: must be at least 1"), ({"cache": "file"}, "file: is a file")],
)
def test_refusals(tmp_path, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("")
    with pytest.raises(ValueError, match=message):
        run_cells(of(bench_work.fails, 1), **{"cache": "cache", **options})


def test_names_must_differ(cache, log):
    with pytest.raises(ValueError, match="cells: every name must come once, of 2 comes twice"):
        run_cells(squares([1, 2, 2], log), cache=cache)


def test_no_cells_no_results(cache):
    outcome = run_cells([], cache=cache, workers=2)
    assert (outcome.results, outcome.missing, outcome.machines) == ((), 0, [])
