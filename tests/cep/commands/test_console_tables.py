"""Tables for people: at any width the rows' names can be read whole, and what is left out is
said."""

import re

import pytest
from console_tables import WIDTHS, check, rendered
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from cep.commands.calibrate import folder_table
from cep.commands.console import Table, finish
from cep.files.tables import Bold

NAMES = st.lists(
    st.lists(st.text("abcdefgh", min_size=1, max_size=20), min_size=1, max_size=5).map(" ".join),
    min_size=1,
    max_size=4,
)


@given(NAMES, st.integers(1, 9), st.integers(1, 12), st.sampled_from(WIDTHS), st.integers(0, 2))
def test_names_are_whole_whatever_the_figures_take(names, columns, digits, width, kept):
    figures = ["1" * digits] * columns
    heads = ["", *(f"{'X' * (1 + index)} Y" for index in range(columns))]
    made = Table("", heads, [(name, *figures) for name in names], last_columns=kept)
    text = rendered(made, width)
    page, _, note = text.partition("left out")
    assert re.sub(r"[^a-h]", "", page) == "".join(names).replace(
        " ", ""
    )  # line by line, nothing cut, nothing mixed
    shown = max(line.count("1" * digits) for line in page.splitlines())
    assert note.count("Y") == columns - shown
    for line in page.splitlines():
        assert len(line) <= width
        assert len(re.findall("1+", line)) in (0, shown)
    if shown > kept:
        assert not any(head in note for head in heads[-kept:] if kept)
    if shown < columns:  # one more would not have fitted, with the narrowest names and heads
        least = min(max(map(len, names)), 16)
        assert least + (shown + 1) * max(digits, columns) + 3 * (shown + 2) - 1 > width


def test_columns_are_not_left_out_where_wrapped_heads_fit():
    rows = [("published: raskar-52", 26, 0.0005, "> 100", -22.2)]
    heads = ("code", "open", "min |P|, chips", "noise gain, dB", "MSE, dB")
    assert "left out" not in rendered(Table("", heads, rows), 60)
    assert "noise gain, dB; MSE, dB" in rendered(Table("", heads, rows), 40)


@pytest.fixture
def shown(cep, monkeypatch):
    """Run a command and return the tables that it prints."""
    made = []
    real = Console.print

    def collecting(self, *objects, **options):
        made.extend(one for one in objects if isinstance(one, Table))
        real(self, *objects, **options)

    monkeypatch.setattr(Console, "print", collecting)

    def run(*arguments):
        cep(*arguments)
        assert cep.code == 0, cep.err
        return made.copy()  # printing them again adds to it

    return run


@pytest.mark.parametrize(
    ("command", "tables"),
    [
        ("optimize --linear 52 --open 26 --steps 500 --force", 1),
        ("optimize --trajectory trajectory.json --chips 12 --steps 500 --force", 1),
        ("audit 101100111000010 --flips 1", 3),
        ("mtf --linear 52 --code raskar-52", 1),
    ],
)
def test_every_commands_tables_at_every_width(shown, workplace, command, tables):
    made = shown(*command.split())
    assert len(made) == tables
    for one in made:
        check(one)


def test_the_table_of_a_folder_says_what_failed_at_every_width():
    row = {
        "photo": "DSC01234567890123456789.ARW",
        **dict.fromkeys(("length_px", "extent_px", "confidence", "seconds"), 1.25),
        "direction": "unknown",
        "failure": "is gone",
    }
    for width in WIDTHS:
        out = rendered(folder_table([row]), width)
        assert " failed" in out
        assert "DSC0123456789012" in out
        assert ("left out" in out) == (width < 80)


def test_brackets_of_names_are_printed_as_they_are(capsys):
    table = Table("c[w].json", ("code", "x"), [(Bold("best"), 1), ("[/]", 2)])
    finish({}, as_json=False, page=["m[b].json: written", table])
    said = capsys.readouterr().out
    assert "m[b].json: written" in said
    assert "c[w].json" in said
    assert "[/]" in said
    assert "Bold" not in said
