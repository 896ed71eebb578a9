"""The log of a run: a row per 50 steps and per validation, a plot, and pieces of a run that go on
in one file."""

import math
from dataclasses import replace

import pytest
from matplotlib.figure import Figure

from motdiff.training.log import RunLog, read_log
from motdiff.training.trainer import Losses

LOSSES = Losses(total=1.5, path=1.0, dwell=2.5, gradient=0.75, smoothed=1.25)


def steps(log, numbers, *, seconds_per_step=0.5, losses=LOSSES, batch=16):
    for number in numbers:
        log.step(number, losses, batch=batch, seconds=seconds_per_step * number)


def test_fifty_steps_are_a_row(tmp_path):
    steps(RunLog(tmp_path, steps=1000), range(1, 131))
    rows = read_log(tmp_path / "log.csv")
    assert [row["step"] for row in rows] == [50, 100]
    first = rows[0]
    assert first["samples"] == 50 * 16
    assert (first["path"], first["dwell"], first["gradient"]) == (1.0, 2.5, 0.75)
    assert first["loss"] == 1.25
    assert math.isnan(first["validation_mnc"])


def test_the_rate_counts_only_the_time_of_the_steps(tmp_path):
    """Drawing motions before it, validating in between, or earlier pieces must not look like slow
    training."""
    steps(RunLog(tmp_path, steps=1000), range(1, 51))
    steps(RunLog(tmp_path, steps=1000), range(51, 101), seconds_per_step=2.0)
    rates = [row["samples_per_s"] for row in read_log(tmp_path / "log.csv")]
    assert rates == pytest.approx([16 / 0.5, 16 / 2.0])


def test_a_piece_may_begin_on_a_row(tmp_path):
    steps(RunLog(tmp_path, steps=1000), [50])
    (row,) = read_log(tmp_path / "log.csv")
    assert row["step"] == 50
    assert math.isnan(row["samples_per_s"])


def test_large_counts_stay_exact(tmp_path):
    steps(RunLog(tmp_path, steps=10**7), [1_234_550])
    (row,) = read_log(tmp_path / "log.csv")
    assert row["step"] == 1_234_550
    assert row["samples"] == 1_234_550 * 16


def test_a_validation_is_a_row_a_line_and_a_plot(tmp_path, capsys):
    log = RunLog(tmp_path, steps=100)
    steps(log, range(1, 51))
    log.validated(50, 0.8125, loss=1.25)
    rows = read_log(tmp_path / "log.csv")
    assert [row["validation_mnc"] for row in rows][1] == 0.8125
    assert rows[1]["loss"] == 1.25
    assert math.isnan(rows[1]["samples"])
    assert (tmp_path / "progress.png").read_bytes().startswith(b"\x89PNG")
    told = capsys.readouterr()
    assert told.out == ""
    assert "step 50: validation MNC 0.8125" in told.err
    assert "step 50/100  loss 1.2500" in told.err


def test_a_validation_before_any_step(tmp_path):
    RunLog(tmp_path, steps=100).validated(0, 0.25, loss=math.nan)
    (row,) = read_log(tmp_path / "log.csv")
    assert math.isnan(row["loss"])
    assert (tmp_path / "progress.png").exists()


def test_a_later_piece_goes_on_in_the_same_file(tmp_path):
    for first in (1, 51):
        steps(RunLog(tmp_path, steps=100), range(first, first + 50))
    assert [row["step"] for row in read_log(tmp_path / "log.csv")] == [50, 100]
    assert (tmp_path / "log.csv").read_text().count("step") == 1


def test_steps_done_twice_after_a_kill_are_drawn_once(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_args, **_kwargs: drawn.append(figure))
    steps(RunLog(tmp_path, steps=500), range(1, 201))
    log = RunLog(tmp_path, steps=500)
    steps(log, range(101, 201), losses=replace(LOSSES, smoothed=0.5))
    log.validated(200, 0.5, loss=0.5)
    (line,) = drawn[0].axes[0].lines
    assert line.get_xdata().tolist() == [50, 100, 150, 200]
    assert line.get_ydata().tolist() == [1.25, 1.25, 0.5, 0.5]


def test_the_other_processes_of_a_group_are_silent(tmp_path, capsys):
    log = RunLog(tmp_path, steps=100, enabled=False)
    steps(log, range(1, 101))
    log.say("hello")
    log.validated(100, 0.5, loss=1.0)
    assert not log.resume(0, scheduled=False)
    log.close()
    assert list(tmp_path.iterdir()) == []
    assert capsys.readouterr() == ("", "")


def test_a_row_cut_short_by_a_kill_can_be_read(tmp_path):
    steps(RunLog(tmp_path, steps=100), range(1, 51))
    with (tmp_path / "log.csv").open("a") as file:
        file.write("100,16")
    rows = read_log(tmp_path / "log.csv")
    assert rows[1]["step"] == 100
    assert math.isnan(rows[1]["loss"])


def test_a_resumed_log_holds_nothing_that_will_be_done_again(tmp_path):
    log = RunLog(tmp_path, steps=1000)
    steps(log, range(1, 101))
    log.validated(100, 0.5, loss=1.0)
    steps(log, range(101, 171))
    log.validated(170, 0.6, loss=1.0)  # where the piece ended
    whole = (tmp_path / "log.csv").read_bytes()
    # cut short by a kill, also after its last comma
    for row in ("160,25", "160,2560,0.5,0.5,0.5,1,100,", "160,2560,0.5,0.5,0.5,1,100,\r"):
        with (tmp_path / "log.csv").open("a", newline="") as file:
            file.write(row)
        assert RunLog(tmp_path, steps=1000).resume(170, scheduled=True)
        assert (tmp_path / "log.csv").read_bytes() == whole
    assert not RunLog(tmp_path, steps=1000).resume(170, scheduled=False)
    assert [row["step"] for row in read_log(tmp_path / "log.csv")] == [50, 100, 100, 150]
    assert not RunLog(tmp_path, steps=1000).resume(120, scheduled=False)
    assert [row["step"] for row in read_log(tmp_path / "log.csv")] == [50, 100, 100]
    assert RunLog(tmp_path, steps=1000).resume(100, scheduled=True)
    assert not RunLog(tmp_path, steps=1000).resume(0, scheduled=False)
    assert read_log(tmp_path / "log.csv") == []
    assert not RunLog(tmp_path / "none", steps=1000).resume(0, scheduled=False)


def test_the_line_says_the_minutes_done_and_left(tmp_path, capsys):
    steps(RunLog(tmp_path, steps=250), range(101), seconds_per_step=3.0)
    assert "5 min done, 8 left" in capsys.readouterr().err.splitlines()[-1]
