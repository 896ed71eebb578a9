"""``--table``: the tables that commands print, in a file by its suffix."""

import csv
from pathlib import Path

import pytest

from cep.files.code_files import StoredCode, write_code
from cep.optics.code import ShutterCode


def test_csv_has_the_figures_in_full(cep, tmp_path):
    table = tmp_path / "audit.csv"
    found = cep.succeeds("audit", "raskar-52", "--flips", "0", "--table", table)
    first = table.read_text(encoding="utf-8").split("\n\n")[0].splitlines()
    rows = dict(csv.reader(first[2:]))
    assert float(rows["min_chip"]) == found["min_chip"]


@pytest.mark.parametrize(
    ("command", "heads"),
    [
        (("camera", "list"), {"name", "read noise"}),
        (("mtf", "--linear", "9", "--code", "1011"), {"code", "min MTF"}),
        (("advise", "--linear", "8", "--chips", "8"), {"at equal light, dB", "advised"}),
    ],
)
def test_every_table_of_a_page_is_written(cep, tmp_path, monkeypatch, command, heads):
    monkeypatch.chdir(tmp_path)
    assert cep(*command, "--table", "page.md").code == 0, cep.err
    assert cep.out.endswith("page.md: the tables\n")
    text = Path("page.md").read_text(encoding="utf-8")
    assert all(f"| {head} |" in text for head in heads)
    assert "use --force" in cep.refuses(*command, "--table", "page.md", *_elsewhere(command))


def _elsewhere(command):
    """Another output, so that only the table is in the way."""
    return {"mtf": ("-o", "b.png"), "advise": ("-o", "b.png")}.get(command[0], ())


def test_brackets_in_the_names_of_files_stay(cep, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_code("c[w].json", StoredCode(ShutterCode("1011")))
    cep("mtf", "--linear", "9", "--code", "c[w].json", "-o", "m[b].png", "--table", "t.md")
    text = Path("t.md").read_text(encoding="utf-8")
    for part in ("m[b].png", "c[w]"):
        assert part in cep.out
        assert part.replace("[", "\\[").replace("]", "\\]") in text


def test_another_suffix_is_refused_before_any_work(cep, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for command in (("audit", "1011"), ("advise", "--linear", "9")):
        line = cep.refuses(*command, "--table", "t.xlsx")
        assert line == "cep: --table: t.xlsx: tables are written as .tex, .csv or .md\n"
    assert not list(tmp_path.iterdir())
