"""Tables as LaTeX, CSV and Markdown: each is read back to the cells it was made of."""

import csv
import io
import re

import pytest
from cep_tables import read_tables
from hypothesis import given
from hypothesis import strategies as st

from cep.files.tables import (
    Bold,
    Sheet,
    cell_text,
    check_table_name,
    latex,
    markdown,
    write_sheets,
)

NASTY = r"""R&D 50% $x_1 #2 {a} ~b ^c \d |P| <1> "q" – ± × ² µ ≤ ≥ → …"""
SHEET = Sheet(
    "What a_code costs, 5 %",
    ("code", "MTF", "remark"),
    [
        ("raskar-52", 0.05090123456789, NASTY),
        (Bold("ours"), 1234.56789, None),
        ("third", 7, Bold("2.0", " (1.5..2.5)")),
    ],
)


def test_latex_is_read_back():
    (found,) = read_tables(latex([SHEET]))
    assert found == (
        SHEET.title,
        "lrl",
        ["code", "MTF", "remark"],
        [
            ["raskar-52", "0.0509", NASTY],
            ["*ours*", "1234.6", "–"],
            ["third", "7", "*2.0* (1.5..2.5)"],
        ],
    )


TEXTS = st.text(st.sampled_from('ab 0.1&%$#_{}~^\\|<>"–±×²µ≤≥→…'), min_size=1, max_size=12).filter(
    lambda text: "[" not in text and text.strip() == text and "--" not in text
)


@given(rows=st.lists(st.tuples(TEXTS, TEXTS), min_size=1, max_size=4))
def test_no_character_is_lost_or_typeset_as_another(rows):
    (found,) = read_tables(latex([Sheet("", ("a", "b"), rows)]))
    assert found[3] == [list(row) for row in rows]


def test_several_tables_have_a_caption_each():
    found = read_tables(latex([SHEET, Sheet("", ("a",), [(1,)])]))
    assert [caption for caption, *_ in found] == [SHEET.title, ""]
    assert latex([SHEET]).startswith("% \\usepackage{booktabs}\n")


def test_csv_has_numbers_in_full_and_nothing_where_nothing_is(tmp_path):
    write_sheets([SHEET], tmp_path / "one.csv")
    with open(tmp_path / "one.csv", newline="", encoding="utf-8") as stream:
        rows = list(csv.reader(stream))
    assert rows[0] == list(SHEET.columns)
    assert rows[1] == ["raskar-52", "0.05090123456789", NASTY]
    assert rows[2:] == [["ours", "1234.56789", ""], ["third", "7", "2.0 (1.5..2.5)"]]


def test_csv_of_several_tables_has_blocks_below_titles(tmp_path):
    write_sheets([SHEET, Sheet("other", ("a",), [(1,)])], tmp_path / "two.csv")
    blocks = (tmp_path / "two.csv").read_text(encoding="utf-8").split("\n\n")
    first, second = (list(csv.reader(io.StringIO(block))) for block in blocks)
    assert first[:2] == [[SHEET.title], list(SHEET.columns)]
    assert second == [["other"], ["a"], ["1"]]


def test_markdown_keeps_bars_within_cells(tmp_path):
    write_sheets([SHEET], tmp_path / "one.md")
    lines = (tmp_path / "one.md").read_text(encoding="utf-8").splitlines()
    assert lines[0].replace("\\", "") == f"**{SHEET.title}**"
    rows = [
        [
            re.sub(r"\\([\\`*_\[\]<|~$&#])", r"\1", cell.strip())
            for cell in re.split(r"(?<!\\)(?:\\\\)*\|", line)[1:-1]
        ]
        for line in lines
        if line.startswith("|")
    ]
    assert rows[0] == list(SHEET.columns)
    assert rows[1] == ["---", "---:", "---:"]
    assert rows[2] == ["raskar-52", "0.0509", NASTY]
    assert rows[3] == ["**ours**", "1234.6", "–"]
    assert markdown([]) == ""


def test_cells_are_written_for_people():
    assert [cell_text(value) for value in (None, 0.123456, 12345.67, 3, "x")] == [
        "–",
        "0.1235",
        "12345.7",
        "3",
        "x",
    ]


@pytest.mark.parametrize("name", ["table.txt", "table", "table.xlsx"])
def test_other_suffixes_are_refused(name, tmp_path):
    with pytest.raises(ValueError, match=r"tables are written as \.tex, \.csv or \.md"):
        check_table_name(name)
    with pytest.raises(ValueError, match=r"\.tex"):
        write_sheets([SHEET], tmp_path / name)
    assert not list(tmp_path.iterdir())
