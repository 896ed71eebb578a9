"""``python -m lab frames``: its table and its files."""

from pathlib import Path

import pytest
from cep_tables import read_tables


def test_the_comparison_is_written_as_latex(lab, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = lab.succeeds(
        "frames", "--linear", "12", "--chips", "12", "--steps", "2000", "--table", "compared.tex"
    )
    ((caption, _, head, rows),) = read_tables(Path("compared.tex").read_text(encoding="utf-8"))
    assert caption.startswith("on this motion")
    assert head[:2] == ["frames", "open"]
    assert [row[1] for row in rows[:2]] == [str(count) for count in found["open"]]
    assert float(rows[2][2]) == pytest.approx(found["min_chip"], rel=1e-3)


def test_a_file_in_the_way_is_refused(lab, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("pair_2.json").write_text("mine")
    line = lab.refuses("frames", "--linear", "12", "--chips", "12", "-o", "pair.json")
    assert "pair_2.json: exists already, use --force" in line
    assert Path("pair_2.json").read_text() == "mine"
