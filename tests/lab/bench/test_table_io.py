"""Figures of the benchmarks as files."""

import numpy as np

from cep.plots.canvas import new_figure, show_photo
from lab.bench.table_io import FIGURE_SUFFIXES, tables_latex, tables_markdown, write_figure
from lab.bench.tables import Column, tabulate


def drawn(level=0.5):
    figure = new_figure(2.0, 2.0)
    axes = figure.subplots()
    show_photo(axes, np.full((8, 8), level))
    axes.set_title("a photo")
    return figure


def test_the_same_figure_gives_the_same_files_at_any_time(tmp_path, monkeypatch):
    for name, moment in (("first", "1000000000"), ("second", "1700000000")):
        monkeypatch.setenv("SOURCE_DATE_EPOCH", moment)  # what matplotlib takes for now
        (tmp_path / name).mkdir()
        write_figure(drawn(), tmp_path / name, "f")
    for suffix in FIGURE_SUFFIXES:
        first, second = (
            (tmp_path / name / f"f{suffix}").read_bytes() for name in ("first", "second")
        )
        assert first == second
    assert b"CreationDate" not in (tmp_path / "first/f.pdf").read_bytes()
    assert {path.name for path in (tmp_path / "first").iterdir()} == {"f.png", "f.pdf", "f.svg"}
    write_figure(drawn(0.6), tmp_path / "second", "f")
    assert (tmp_path / "first/f.pdf").read_bytes() != (tmp_path / "second/f.pdf").read_bytes()


def test_brackets_in_the_name_of_a_row_stay():
    name = "motdiff@runs[w]/a.safetensors"
    figures = {(row, photo, 0): {"mnc": float(photo)} for row in (name, "pmp") for photo in (0, 1)}
    table = tabulate(
        "t",
        figures,
        [Column("mnc", "MNC", "high")],
        rng=np.random.default_rng(0),
        cluster=(1, 2),
    )
    assert r"| motdiff@runs\[w\]/a.safetensors |" in tables_markdown([table])
    assert "motdiff@runs{[}w]/a.safetensors &" in tables_latex([table])
