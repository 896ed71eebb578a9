"""Tables of benchmarks: bold needs a paired test, what is missing is told, and files say how they
were made."""

import csv
import io
import json
import math

import numpy as np
import pytest
from rich.console import Console

from cep.commands.console import Table as ConsoleTable
from lab.bench.harness import in_code_span
from lab.bench.statistics import mean_interval, summarized
from lab.bench.table_io import (
    TABLES_SCHEMA,
    Provenance,
    tables_csv,
    tables_json,
    tables_latex,
    tables_markdown,
)
from lab.bench.tables import Column, differences, tabulate
from lab.commands.tables import table_page
from lab.jobs.machine import machine

PSNR = Column("psnr_db", "PSNR, dB", better="high")
PHOTOS = 10
MOTIONS = 4


def measured(**methods):
    """Return figures of every method on photos that differ far more than the methods; motions add
    a little."""
    rng = np.random.default_rng(0)
    base = rng.normal(25, 5, (PHOTOS, 1)) + rng.normal(0, 1, (PHOTOS, MOTIONS))
    return {
        (method, f"photo {p}", f"motion {m}"): {"psnr_db": float(base[p, m] + gain[p, m])}
        for method, gain in methods.items()
        for p in range(PHOTOS)
        for m in range(MOTIONS)
    }


def gain(mean, spread=0.3, seed=1):
    return np.random.default_rng(seed).normal(mean, spread, (PHOTOS, MOTIONS))


def made(figures, *columns, **options):
    return tabulate(
        "one table", figures, columns or (PSNR,), rng=np.random.default_rng(5), **options
    )


def bold(table):
    return [label for label, entries in table.rows.items() if any(entry.bold for entry in entries)]


def test_bold_follows_the_paired_test():
    """Half a decibel is surely there although the photos differ by ten times as much."""
    table = made(measured(plain=gain(0), ours=gain(0.5, seed=2), snapshot=gain(-2)))
    ours = table.rows["ours"][0]
    plain = table.rows["plain"][0]
    assert bold(table) == ["ours"]
    assert ours.interval.low < plain.interval.high  # unpaired intervals overlap
    assert ours.runner_up == "plain"
    assert 0 < ours.lead.low < ours.lead.mean < ours.lead.high
    assert ours.lead.mean == pytest.approx(ours.summary.mean - plain.summary.mean, rel=1e-9)
    assert ours.lead.clusters == PHOTOS


def test_a_larger_mean_alone_is_not_bold():
    table = made(measured(plain=gain(0), ours=gain(0.02, spread=1, seed=2)))
    ours = table.rows["ours"][0]
    assert ours.summary.mean > table.rows["plain"][0].summary.mean
    assert ours.lead.low < 0 < ours.lead.high
    assert bold(table) == []


@pytest.mark.parametrize("cluster", [1, (1, 2)])
@pytest.mark.parametrize(("photos", "shown"), [(1, False), (2, False), (PHOTOS, True)])
def test_the_interval_of_one_or_two_photos_is_not_printed(cluster, photos, shown):
    """However alike they are: two photos show their spread by one difference."""
    some = {
        name: own
        for name, own in measured(ours=gain(2)).items()
        if int(name[1].split()[1]) < photos
    }
    constant = {name: {"psnr_db": 25.0} for name in some}
    for figures in (some, constant):
        table = made(figures, cluster=cluster)
        assert ("(" in table.lines()[0][1]) == shown
        assert ("(" in tables_latex([table]).split("ours", 1)[1]) == shown
        assert (table.rows["ours"][0].finite_interval is not None) == shown


def test_one_photo_is_no_evidence():
    """Forty motions of one photo are one witness; counted by motion they are many."""
    figures = {
        (name[0], "photo 0", "/".join(name[1:])): own
        for name, own in measured(plain=gain(0), ours=gain(2)).items()
    }
    assert bold(made(figures)) == []
    assert bold(made(figures, cluster=2)) == ["ours"]


def test_low_may_be_better():
    figures = measured(plain=gain(0), ours=gain(-1, seed=2))
    assert bold(made(figures, Column("psnr_db", "noise, dB", better="low"))) == ["ours"]
    assert bold(made(figures)) == ["plain"]
    assert bold(made(figures, Column("psnr_db", "PSNR, dB"))) == []


def test_equal_rows_are_not_bold():
    assert bold(made(measured(plain=gain(0), same=gain(0)))) == []


def test_who_failed_where_the_next_did_not_is_not_bold():
    figures = measured(plain=gain(0), ours=gain(3, seed=2))
    figures["ours", "photo 1", "motion 1"] = {}
    figures["ours", "photo 2", "motion 1"] = {"psnr_db": math.nan}
    table = made(figures)
    assert bold(table) == []
    assert (table.rows["ours"][0].lead.n, table.rows["ours"][0].summary.n) == (38, 38)
    assert table.lines()[1][1].endswith(", 38 of 40")
    assert table.lines()[0][1].count(" of ") == 0
    # where both failed nothing speaks against it
    for photo in ("photo 1", "photo 2"):
        figures["plain", photo, "motion 1"] = {}
    assert bold(made(figures)) == ["ours"]


def test_what_was_never_measured_is_a_dash():
    figures = {
        ("oracle", "photo 0"): {},
        ("ours", "photo 0"): {"psnr_db": 20.0},
        ("ours", "photo 1"): {"psnr_db": 21.0},
    }
    table = made(figures)
    assert table.lines() == [
        ("oracle", "–", "1"),
        ("ours", "20.50", "2"),
    ]  # two photos give no interval
    assert bold(table) == []


def test_an_infinite_figure_is_shown_and_never_bold():
    figures = measured(plain=gain(0), ours=gain(2))
    figures["ours", "photo 0", "motion 0"] = {"psnr_db": math.inf}
    table = made(figures)
    assert table.lines()[1][1] == "inf"
    assert table.rows["ours"][0].interval is None
    assert bold(table) == []


def test_differences_are_taken_pair_by_pair():
    figures = measured(plain=gain(0), ours=gain(1, seed=2), snapshot=gain(-2))
    del figures["plain", "photo 3", "motion 0"]
    figures["snapshot", "photo 0", "motion 0"] = {"psnr_db": None, "note": "dark"}
    found = differences(figures, "ours")
    assert {name[0] for name in found} == {"plain", "snapshot"}
    assert found["snapshot", "photo 0", "motion 0"] == {"psnr_db": None, "note": None}
    assert len(found) == 2 * PHOTOS * MOTIONS - 1
    table = made(found, Column("psnr_db", "ours less, dB"))
    names = [name for name in found if name[0] == "plain"]
    ours = [figures["ours", *name[1:]]["psnr_db"] for name in names]
    plain = [figures[name]["psnr_db"] for name in names]
    entry = table.rows["plain"][0]
    assert entry.summary.mean == pytest.approx(np.mean(ours) - np.mean(plain), rel=1e-9)
    assert entry.interval == mean_interval(
        np.subtract(ours, plain),
        rng=np.random.default_rng(5),
        clusters=[name[1] for name in names],
    )
    with pytest.raises(ValueError, match="reference: must be one of the rows, got 'theirs'"):
        differences(figures, "theirs")


def test_markdown_marks_and_escapes():
    figures = {
        (name[0].replace("plain", "min |P|"), *name[1:]): own
        for name, own in measured(plain=gain(0), ours=gain(1, seed=2)).items()
    }
    table = made(figures)
    head, rule, first, second = tables_markdown([table]).splitlines()[2:]
    assert head == "|  | PSNR, dB | n |"
    assert rule == "| --- | ---: | ---: |"
    assert first.startswith("| min \\|P\\| | ")
    entry = table.rows["ours"][0]
    ends = f"{entry.interval.low:.2f}..{entry.interval.high:.2f}"
    assert second == f"| ours | **{entry.summary.mean:.2f}** ({ends}) | 40 |"


def test_csv_has_every_number():
    figures = measured(plain=gain(0), ours=gain(1, seed=2))
    figures["plain", "photo 0", "motion 0"] = {"psnr_db": math.inf}
    table = made(figures)
    rows = list(csv.DictReader(io.StringIO(tables_csv([table, table]))))
    assert len(rows) == 4
    assert [row["bold"] for row in rows] == ["no", "no"] * 2
    values = [own["psnr_db"] for name, own in figures.items() if name[0] == "ours"]
    summary = summarized(values)
    for name in ("mean", "median", "sd", "q05", "q95"):
        assert float(rows[1][name]) == pytest.approx(getattr(summary, name), rel=1e-5)
    assert (rows[0]["mean"], rows[0]["low"], rows[0]["sd"]) == ("inf", "", "")


def test_json_says_how_it_was_made():
    table = made(measured(plain=gain(0), ours=gain(1, seed=2)))
    about = Provenance("python -m lab bench cep --quick", 3, [machine()], ["one"])
    text = tables_json([table], about)
    document = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert (document["schema"], document["seed"], document["warnings"]) == (
        TABLES_SCHEMA,
        3,
        ["one"],
    )
    assert document["machines"][0]["versions"]["numpy"] == np.__version__
    (shown,) = document["tables"]
    entry = shown["rows"][1]["entries"][0]
    assert entry["bold"] is True
    assert entry["lead"]["low"] == table.rows["ours"][0].lead.low
    assert entry["interval"]["clusters"] == PHOTOS


def test_people_see_it_on_a_console():
    table = made(measured(plain=gain(0), ours=gain(1, seed=2)))
    console = Console(file=io.StringIO(), width=100, force_terminal=True, color_system="standard")
    console.print(ConsoleTable(table.title, table.head, table.lines()))
    shown = console.file.getvalue()
    mean = f"{table.rows['ours'][0].summary.mean:.2f}"
    assert f"\x1b[1m{mean}\x1b[0m (" in shown


def test_people_see_the_median_where_that_is_shown():
    """The mean of an infinite figure is infinite, whatever the others are."""
    figures = {
        ("open", f"photo {p}", "motion 0"): {"gain_db": gain_db}
        for p, gain_db in enumerate((math.inf, 20.0, 22.5))
    }
    tables = [
        made(figures, Column("gain_db", "gain, dB", middle=middle, digits=1))
        for middle in ("median", "mean")
    ]
    console = Console(file=io.StringIO(), width=60)
    for one in table_page(tables):
        console.print(one)
    assert [
        line.split()[1] for line in console.file.getvalue().splitlines() if "open" in line
    ] == ["22.5", "inf"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"cluster": 0}, "figures: label 0 is wanted of every name"),
        ({"cluster": 3}, "figures: label 3 is wanted of every name"),
        ({"cluster": -1}, "figures: label -1 is wanted of every name"),
    ],
)
def test_refusals(options, message):
    with pytest.raises(ValueError, match=message):
        made(measured(plain=gain(0)), **options)
    with pytest.raises(ValueError, match="columns: psnr_db is no number, got 'dark'"):
        made({("a", "b"): {"psnr_db": "dark"}})


def test_code_in_markdown_ends_where_it_ends():
    assert in_code_span("a `b` ``c``") == "``` a `b` ``c`` ```"
    assert in_code_span("\x1b[2J").isprintable()
