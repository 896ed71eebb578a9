"""``python -m lab bench codes``: the comparison, its files, and its refusals."""

import csv
import json
from pathlib import Path

import pytest
from cep_tables import read_tables

from cep.commands.console import FAILURE, INTERRUPTED
from cep.optics.code import ShutterCode
from lab.bench.published_codes import chip_noise_db, code_cells, code_rows


def untouchable(*_arguments, **_options):
    pytest.fail("a finished search was made again")


def test_codes_are_compared_at_equal_light_and_found_again(lab, workplace, monkeypatch):
    names = ("bdinr-8", "barker-13")
    command = ("bench", "codes", *names, "--time", "0.3", "--workers", "1", "-o", "codes")
    found = lab.succeeds(*command)
    rows = {row["name"]: row for row in found["tables"]["codes"]}
    assert set(rows) == set(names)
    for row in rows.values():
        assert len(row["bits"]) == row["chips"]
        assert row["bits"].count("1") == row["open"]
    # the largest minimum of eight chips, five of them open, is this code's own: docs/optima.md
    assert rows["bdinr-8"]["min_chip"]["published"] == pytest.approx(0.9128, abs=1e-4)
    assert rows["bdinr-8"]["min_chip"]["ours"] <= 0.9128 + 1e-4
    assert not rows["bdinr-8"]["better"]
    assert [Path(file).name for file in found["files"]] == [
        "codes.md",
        "codes.tex",
        "codes.csv",
        "codes.json",
    ]
    text = Path("codes/codes.md").read_text()
    assert text.count("| bdinr-8 |") == text.count("| barker-13 |") == 1
    assert "`python -m lab bench codes bdinr-8 barker-13 --time 0.3`" in text
    ((_, _, head, lines),) = read_tables(Path("codes/codes.tex").read_text())
    assert [line[0] for line in lines] == list(rows)
    assert {len(head)} == {len(line) for line in lines}
    kept = json.loads(Path("codes/codes.json").read_text())
    assert kept["codes"] == found["tables"]["codes"]
    assert kept["machines"][0]["versions"]["numpy"]
    with open("codes/codes.csv", newline="", encoding="utf-8") as stream:
        assert [line["our_bits"] for line in csv.DictReader(stream)] == [
            row["bits"] for row in rows.values()
        ]

    assert "exists already" in lab.refuses(*command)
    monkeypatch.setattr("lab.jobs.engine.worked", untouchable)
    assert lab.succeeds(*command, "--force")["tables"] == found["tables"]
    # what one code gives does not depend on which others are asked for
    alone = lab.succeeds(
        "bench", "codes", "barker-13", "--time", "0.3", "--cache", "codes/cells", "-o", "alone"
    )
    assert alone["tables"]["codes"] == [rows["barker-13"]]


def test_a_code_of_ones_own_is_searched_against(lab, workplace):
    options = ("--code", "mine=11101", "--time", "0.1", "--workers", "1")
    alone = lab.succeeds("bench", "codes", *options, "-o", "alone")
    assert [(row["name"], row["chips"], row["open"]) for row in alone["tables"]["codes"]] == [
        ("mine", 5, 4)
    ]
    both = lab.succeeds("bench", "codes", "bdinr-8", *options, "-o", "both")
    assert [row["name"] for row in both["tables"]["codes"]] == ["bdinr-8", "mine"]
    command = json.loads(Path("both/codes.json").read_text())["command"]
    assert command == "python -m lab bench codes bdinr-8 --code mine=11101 --time 0.1"


def test_people_see_the_comparison(lab, workplace):
    lab("bench", "codes", "bdinr-8", "--time", "0.1", "-o", "codes")
    assert lab.code == 0, lab.err
    assert "better on both: 0 of 1" in lab.out
    assert "codes: codes.md, codes.tex, codes.csv, codes.json" in lab.out


def test_interrupted_it_keeps_the_rows(monkeypatch):
    real = code_rows.__globals__["anneal"]

    def stopping(problem, **options):
        if problem.chips == 10:
            raise KeyboardInterrupt
        return real(problem, **options)

    monkeypatch.setattr("lab.bench.published_codes.anneal", stopping)
    codes = [("first", ShutterCode("110100101")), ("second", ShutterCode("1101001011"))]
    assert [row.name for row in code_rows(codes, time_s=0.2)] == ["first"]


def test_half_a_search_is_not_kept(lab, workplace, monkeypatch):
    real = code_rows.__globals__["anneal"]

    def interrupted(problem, **options):
        def stop(_fraction, _best):
            raise KeyboardInterrupt

        return real(problem, **options, progress=stop)

    command = ("bench", "codes", "bdinr-8", "--time", "0.1", "-o", "codes")
    monkeypatch.setattr("lab.bench.published_codes.anneal", interrupted)
    lab(*command, "--json")
    assert (lab.code, lab.err) == (INTERRUPTED, "lab: interrupted\n")
    assert (lab.json["missing"], lab.json["tables"]) == (1, {"codes": []})
    assert any("--force goes on" in warning for warning in lab.json["warnings"])
    assert Path("codes/codes.md").is_file()
    assert list(Path("codes/cells").iterdir()) == []
    monkeypatch.setattr("lab.bench.published_codes.anneal", real)
    assert len(lab.succeeds(*command, "--force")["tables"]["codes"]) == 1


def test_a_search_that_fails_is_told_beside_the_others(lab, workplace, monkeypatch):
    real = code_rows.__globals__["anneal"]

    def anneal(problem, **options):
        if problem.chips == 13:
            raise ValueError("code: too short")
        return real(problem, **options)

    monkeypatch.setattr("lab.bench.published_codes.anneal", anneal)
    lab(
        "bench",
        "codes",
        "bdinr-8",
        "barker-13",
        "--time",
        "0.1",
        "--workers",
        "1",
        "-o",
        "codes",
        "--json",
    )
    assert lab.code == FAILURE
    assert lab.json["failures"] == {"barker-13": "code: too short"}
    assert [row["name"] for row in json.loads(Path("codes/codes.json").read_text())["codes"]] == [
        "bdinr-8"
    ]


def test_another_budget_is_another_cell():
    code = [("a", ShutterCode("1101"))]
    ((one,), (other,)) = (code_cells(code, time_s=time_s, seed=0) for time_s in (1.0, 2.0))
    assert one.version == other.version
    assert one.arguments != other.arguments


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("nothing-7",), "nothing-7"),
        (("bdinr-8", "--time", "0"), "--time"),
        (("bdinr-8", "--code", "bdinr-8=1011"), "--code: bdinr-8 is the name of a published code"),
        (("--code", "mine=1012"), "--code: mine: "),
        (("bdinr-8", "-o", "sharp.png"), "sharp.png: is a file, a folder name is needed"),
        (("bdinr-8", "--cache", "sharp.png"), "sharp.png: is a file"),
    ],
)
def test_refusals(lab, workplace, options, message):
    assert message in lab.refuses("bench", "codes", *options)


def test_chip_noise_of_one_chip_is_nought():
    assert chip_noise_db(ShutterCode("0100")) == pytest.approx(0, abs=1e-12)
