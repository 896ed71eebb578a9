"""Names that others chose, in every output: they are shown, and nothing in them is obeyed."""

import csv
import io
import json
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from hostile_names import HOSTILE
from hypothesis import given
from hypothesis import strategies as st

from cep.commands.console import Table, announce, print_page, progress
from cep.files.code_files import StoredCode, write_code
from cep.files.foreign_text import (
    csv_text,
    latex_text,
    markdown_text,
    plot_text,
    terminal_line,
)
from cep.files.tables import Bold, Sheet, latex, markdown, write_sheets
from cep.optics.code import ShutterCode
from cep.plots.canvas import save
from cep.plots.codes import code_strips
from cep.plots.photos import psf_figure
from motdiff.files.inputs import printable
from motdiff.files.json_files import json_text


@pytest.fixture
def printed(monkeypatch):
    """What the page for people prints of lines and tables."""

    def run(*items):
        stream = io.StringIO()
        monkeypatch.setattr(sys, "stdout", stream)
        print_page(items)
        return stream.getvalue()

    return run


@pytest.mark.parametrize("name", HOSTILE, ids=ascii)
def test_a_terminal_obeys_no_name(printed, capsys, name):
    shown = printed(f"{name}: written", Table(name, ("", name), [(name, Bold(name))]))
    announce(f"{name}: is no photo")
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    for text in (shown.replace("\n", ""), told.replace("\n", "")):
        assert text.isprintable()
    if name.isprintable():
        assert f"{name}: written" in shown
        assert f"cep: {name}: is no photo" in told


@pytest.mark.parametrize("name", HOSTILE, ids=ascii)
def test_the_bar_takes_no_markup(monkeypatch, name):
    stream = io.StringIO()
    stream.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", stream)
    with progress(f"estimating ({name})") as tick:
        tick(0.5, name)
    assert "\x1b]0" not in stream.getvalue()
    assert "\x9b" not in stream.getvalue()


@given(st.text(max_size=20))
def test_any_text_is_one_printable_line(text):
    for made in (terminal_line, csv_text, latex_text, markdown_text, plot_text):
        shown = made(text)
        assert shown.isprintable()
        shown.encode("utf-8")


@given(st.text(st.sampled_from("=+-@ \t\r\n'\"1x,"), max_size=6))
def test_no_cell_of_a_spreadsheet_is_a_formula(text):
    shown = csv_text(text)
    assert not shown.strip().startswith(("=", "+", "-", "@")) or re.fullmatch("[-+]1+", shown)


def test_numbers_stay_numbers(tmp_path):
    write_sheets(
        [Sheet("", ("name", "a", "b"), [("=x", -0.25, "-1.5"), ("-", None, "+3e-07")])],
        tmp_path / "t.csv",
    )
    with open(tmp_path / "t.csv", newline="") as stream:
        assert list(csv.reader(stream))[1:] == [["'=x", "-0.25", "-1.5"], ["'-", "", "+3e-07"]]


@pytest.mark.parametrize("name", HOSTILE, ids=ascii)
def test_markdown_and_latex_keep_their_lines(tmp_path, name):
    sheet = Sheet(name, ("a", name), [(name, Bold(name)), ("second", 1)])
    text = markdown([sheet])
    rows = [
        re.split(r"(?<!\\)(?:\\\\)*\|", line) for line in text.splitlines() if line.startswith("|")
    ]
    assert [len(row) for row in rows] == [4, 4, 4, 4]
    assert not re.search(r"(?<!\\)(\\\\)*(<|!\[|`|\$)", text.replace("\\`", ""))
    typeset = latex([sheet])
    assert len(typeset.splitlines()) == 13
    assert not re.search(r"\\(input|frac)", typeset)
    for row in re.findall(r"^ {4}(.*) \\\\$", typeset, re.MULTILINE):
        assert not row.startswith(("[", "*"))  # an option of the row before
    for suffix in (".md", ".tex", ".csv"):
        write_sheets([sheet], tmp_path / f"t{suffix}")


@pytest.mark.parametrize("name", HOSTILE, ids=ascii)
def test_a_figure_shows_the_name(tmp_path, name):
    save(code_strips({name: ShutterCode("101")}), tmp_path / "f.svg")
    drawn = ElementTree.parse(tmp_path / "f.svg").iter("{http://www.w3.org/2000/svg}text")
    texts = [one.text or "" for one in drawn]
    assert printable(name).strip() in [one.strip() for one in texts]
    for suffix in (".png", ".pdf"):
        save(psf_figure({name: [[1.0]]}), tmp_path / f"f{suffix}")


def test_json_has_the_name_itself():
    for name in HOSTILE:
        for ascii_only in (False, True):
            text = json_text({name: name}, ascii_only=ascii_only)
            text.encode("ascii" if ascii_only else "utf-8")
            assert json.loads(text) == {name: name}


# -- commands -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "stem", ["[bold]", "a\n=b", "$x", "\x1b[31m", "_x", "\udcff", "=1", "\u202ex"], ids=ascii
)
def test_files_of_any_name_are_read_and_written(cep, tmp_path, monkeypatch, stem):
    monkeypatch.chdir(tmp_path)
    code = f"{stem}.json"
    picture = f"{stem}.svg"
    write_code(code, StoredCode(ShutterCode("1011")))
    for suffix in (".md", ".csv", ".tex"):
        found = cep.succeeds(
            "mtf",
            "--linear",
            "9",
            "--code",
            code,
            "-o",
            picture,
            "--table",
            f"{stem}{suffix}",
            "--force",
        )
        assert found["image"] == picture
        assert cep("mtf", "--linear", "9", "--code", code, "-o", picture, "--force").code == 0, (
            cep.err
        )
        assert cep.out.replace("\n", "").isprintable()
    ElementTree.parse(os.fsencode(picture))
    line = cep.refuses("audit", f"{stem}.txt.json")
    assert line.rstrip("\n").isprintable()


@pytest.mark.parametrize("encoding", ["latin-1", "ascii", "cp850", "cp932", "utf-8"])
@pytest.mark.parametrize(
    "arguments", ["camera list", "optimize --help", "camera list --json", "--help"]
)
def test_an_output_that_is_not_utf_8(encoding, arguments):
    run = [sys.executable, "-c", "from cep.commands.main import run; run()", *arguments.split()]
    done = subprocess.run(
        run, env={**os.environ, "PYTHONIOENCODING": encoding}, capture_output=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, b"")
    text = done.stdout.decode(encoding)
    if "--json" in arguments:
        assert len(json.loads(text)["cameras"]) > 5
    elif arguments == "camera list":
        assert "sony-imx250" in text


def test_a_plain_locale(tmp_path):
    """Files of any name, as the system's encoding is ASCII."""
    Path(tmp_path, "größe.json").write_text(
        json_text({"schema": "cep.code/1", "bits": "1011", "chip_ns": 1000})
    )
    environment = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    command = [
        sys.executable,
        "-c",
        "from cep.commands.main import run; run()",
        "mtf",
        "--linear",
        "9",
    ]
    arguments = ["--code", "größe.json", "-o", "größe.png", "--table", "größe.md"]
    done = subprocess.run(
        [*command, *arguments], env=environment, cwd=tmp_path, capture_output=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, b"")
    assert Path(tmp_path, "größe.png").is_file()
    assert Path(tmp_path, "größe.md").is_file()
