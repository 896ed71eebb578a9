"""Goldens: what counts as a difference between two records, and what is no record at all."""

import json
import sys

import pytest

from lab.studies.goldens.__main__ import main
from lab.studies.goldens.cases import CASES, PREPARATION, Case
from lab.studies.goldens.comparison import compare, near_numbers
from lab.studies.goldens.placeholders import normalised
from lab.studies.goldens.recording import PreparationError, Recorder

CODE = "1010000111000001010000110011110111010111001001100111"
RECORD = {"stdout": "", "stderr": "", "exit": "0\n"}


def write_record(folder, name="version", **streams):
    case = folder / name
    case.mkdir(parents=True)
    for stream, text in {**RECORD, **streams}.items():
        (case / stream).write_text(text, encoding="utf-8")
    (case / "files.json").write_text("{}", encoding="utf-8")
    (folder / "seconds.json").write_text("{}", encoding="utf-8")
    return folder


@pytest.fixture
def recorder(tmp_path):
    """A recorder of a checkout whose only program is Python."""
    programs = tmp_path / "root" / ".venv" / "bin"
    programs.mkdir(parents=True)
    (programs / "python").symlink_to(sys.executable)
    for name in ("record", "scratch", "work"):
        (tmp_path / name).mkdir()
    return Recorder(tmp_path / "root", tmp_path / "record", tmp_path / "scratch")


# -- numbers ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("before", "after", "count"),
    [
        ("noise 3.1415926535 dB", "noise 3.1415926536 dB", 1),
        ("[-0.1, 2.5e-9]", "[-0.10000000001, 2.50000000001e-9]", 2),
        ("1e6 and 12px", "1.0000000001e6 and 12px", 1),
        ("0.5", "0.5001", None),
        ("3.25 dB", "3.25 px", None),
        ("same", "same", 0),
    ],
)
def test_nearly_equal_numbers_are_counted(before, after, count):
    assert near_numbers(before, after) == count


@pytest.mark.parametrize("frame", ["{}", '"bits": "{}",', "The code is {}.", "{}.json", "x={}"])
def test_a_flipped_chip_is_a_difference(frame):
    flips = [CODE[:i] + "10"[int(bit)] + CODE[i + 1 :] for i, bit in enumerate(CODE)]
    counts = {near_numbers(frame.format(CODE), frame.format(code)) for code in flips}
    assert counts == {None}


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("1234567890123456", "1234567890123457"),  # hashes of digits alone, and with letters
        ("91e1234567890123a", "91e1234567890123b"),
        ("a1000000000000e2", "a1000000000001e2"),
        ("chip_ns 100000001", "chip_ns 100000002"),
    ],
)
def test_whole_numbers_and_hashes_are_equal_or_differ(before, after):
    assert near_numbers(before, after) is None


# -- records ----------------------------------------------------------------------------------


def test_equal_records_do_not_differ(tmp_path, capsys):
    folders = [str(write_record(tmp_path / name, stdout=CODE)) for name in ("before", "after")]
    assert main(["compare", *folders]) == 0
    assert "1 cases, 0 differ" in capsys.readouterr().out


def test_another_code_in_a_record_is_shown(tmp_path, capsys):
    before = write_record(tmp_path / "before", stdout=f"code {CODE}\n")
    after = write_record(tmp_path / "after", stdout=f"code {CODE[:-1]}0\n")
    assert main(["compare", str(before), str(after)]) == 1
    assert "1 cases, 1 differ" in capsys.readouterr().out


def test_a_case_that_a_record_lacks_differs(tmp_path, capsys):
    before = write_record(write_record(tmp_path / "before"), "mtf-pdf")
    after = write_record(tmp_path / "after")
    (after / "mtf-pdf").mkdir()  # a record that was ended within the case
    assert not compare(before, after, most_lines=9)
    assert "is not in" in capsys.readouterr().out


@pytest.mark.parametrize("mistyped", [0, 1])
def test_a_folder_that_is_no_record_is_refused(tmp_path, capsys, mistyped):
    folders = [write_record(tmp_path / "record"), write_record(tmp_path / "other")]
    folders[mistyped] = tmp_path / "recrod"
    with pytest.raises(SystemExit) as exit_status:
        main(["compare", *map(str, folders)])
    assert exit_status.value.code == 2
    assert "recrod: is no record" in capsys.readouterr().err


def test_a_record_that_did_not_come_to_its_end_is_refused(tmp_path):
    folders = [write_record(tmp_path / name) for name in ("before", "after")]
    for folder in folders:  # both ended where the inputs could not be made
        (folder / "seconds.json").unlink()
    with pytest.raises(SystemExit) as exit_status:
        main(["compare", *map(str, folders)])
    assert exit_status.value.code == 2


@pytest.mark.parametrize(
    ("option", "reason"), [("--root", "is no checkout"), ("--inputs", "there is no folder")]
)
def test_a_record_of_nothing_is_refused(tmp_path, capsys, recorder, option, reason):
    del recorder  # of it the checkout alone
    (tmp_path / "root/.venv/bin/cep").symlink_to(sys.executable)
    paths = {"--root": tmp_path / "root", "-o": tmp_path / "new", option: tmp_path / "missing"}
    with pytest.raises(SystemExit) as exit_status:
        main(["record", *(str(word) for pair in paths.items() for word in pair)])
    assert exit_status.value.code == 2
    assert reason in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_names_of_cases_are_unique():
    names = [case.name for case in (*PREPARATION, *CASES)]
    assert len(set(names)) == len(names)


# -- recording --------------------------------------------------------------------------------


def test_a_case_is_recorded_with_what_it_writes(tmp_path, recorder):
    script = "print(2.5); open('new.txt', 'w').write('text'); raise SystemExit(3)"
    recorder._record(Case("writes", f'python -c "{script}"'), tmp_path / "work")
    case = tmp_path / "record" / "writes"
    assert (case / "exit").read_text() == "3\n"  # a case may fail: that is recorded
    assert (case / "stdout").read_text() == "2.5\n"
    assert list(json.loads((case / "files.json").read_text())) == ["new.txt"]


def test_a_failed_first_command_is_no_record(tmp_path, recorder):
    first = "python -c \"raise SystemExit('no port')\""
    with pytest.raises(PreparationError, match="second: its preparation: exit 1: no port"):
        recorder._record(Case("second", "python -c pass", first=first), tmp_path / "work")
    assert not (tmp_path / "record" / "second").exists()


def test_failed_inputs_are_no_record(tmp_path, recorder, monkeypatch):
    failing = [Case("input-coded", "python -c 'raise SystemExit(2)'")]
    monkeypatch.setattr("lab.studies.goldens.recording.PREPARATION", failing)
    monkeypatch.setattr("lab.studies.goldens.recording.drawn_inputs", dict)
    with pytest.raises(PreparationError, match="input-coded: its preparation: exit 2"):
        recorder.prepare(tmp_path / "work")


# -- placeholders -----------------------------------------------------------------------------


@pytest.mark.parametrize("above", ["", "\n", "Title\n\n"])
def test_costs_of_a_drawn_table_are_replaced_wherever_it_begins(above):
    table = (
        " code      noise, dB   seconds \n ───────────────────────────────\n a         {}   {} \n"
    )
    texts = [
        normalised(above + table.format("     3.25", seconds), "stdout", {})
        for seconds in ("   1.25", "   9.75")
    ]
    assert texts[0] == texts[1]
    assert "3.25" in texts[0]
    assert "<cost>" in texts[0]
