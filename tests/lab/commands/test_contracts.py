"""What holds for the product's commands holds for the laboratory's: help, refusals, outputs."""

import importlib
import re
from pathlib import Path

import pytest
import typer
from named_pipes import empty_pipe

from lab.commands.main import app

FOLDERS = {
    "bench": (("bench", "--quick", "-o", "OUT"), "README.md"),
    "bench, its last table": (("bench", "--quick", "-o", "OUT"), "cep-ours/cep.csv"),
    "bench blind": (("bench", "blind", "--quick", "-o", "OUT"), "blind.csv"),
    "bench speed": (("bench", "speed", "--quick", "-o", "OUT"), "speed.csv"),
    "bench cep": (("bench", "cep", "--quick", "-o", "OUT"), "cep.csv"),
    "bench codes": (("bench", "codes", "raskar-52", "-o", "OUT"), "codes.csv"),
}
"""Commands that write a folder, and a file in it."""

COMMANDS = ("pareto", "prove", "design-class", "frames", "bench")
TABLES = ("blind", "cep", "speed", "codes")


@pytest.fixture
def idle(workplace, monkeypatch):
    """A folder of inputs, in a process in which nothing can be measured."""

    def work(*_arguments, **_options):
        raise AssertionError("the work has begun")

    importlib.import_module("lab.bench.blind.plan")
    for name in ("lab.jobs.engine.run_cells", "lab.bench.coded.job.measure_coded"):
        module, _, attribute = name.rpartition(".")
        if hasattr(importlib.import_module(module), attribute):
            monkeypatch.setattr(name, work)
    return workplace


def put(arguments, place):
    return [part.replace("OUT", place) for part in arguments]


@pytest.mark.parametrize("name", FOLDERS)
def test_a_file_in_place_of_the_folder_is_refused(lab, idle, name):
    Path("file").write_text("precious")
    assert "is a file" in lab.refuses(*put(FOLDERS[name][0], "file"))
    assert "file" in lab.refuses(*put(FOLDERS[name][0], "file/out"))
    assert Path("file").read_text() == "precious"


@pytest.mark.parametrize("name", FOLDERS)
def test_an_output_that_exists_is_refused(lab, idle, name):
    arguments, inside = FOLDERS[name]
    written = Path("out", inside)
    written.parent.mkdir(parents=True)
    written.write_text("precious")
    line = lab.refuses(*put(arguments, "out"))
    assert f"{written}: exists already, use --force to replace it" in line


@pytest.mark.parametrize(
    ("arguments", "option"),
    [
        (("bench", "codes", "no-such-code"), "NAME"),
        (("bench", "blind", "--methods", "x"), "--methods"),
        (("bench", "blind", "--protocol", "x"), "--protocol"),
        (("bench", "cep", "--designs", "x"), "--designs"),
        (("bench", "--workers", "x"), "--workers"),
        (("bench", "codes", "--time", "-1"), "--time"),
        (("bench", "codes", "--seed", "1.5"), "--seed"),
        (("pareto", "--steps", "-1"), "--steps"),
        (("prove", "--chips", "x"), "--chips"),
    ],
)
def test_a_bad_value_is_refused_by_the_options_name(lab, workplace, arguments, option):
    assert option in lab.refuses(*arguments)


@pytest.mark.parametrize(
    "arguments",
    [
        ("cep", "--protocol", "PIPE.toml"),
        ("blind", "--protocol", "PIPE.toml"),
        ("blind", "--protocol", "ours", "--gyro", "PIPE.txt"),
    ],
    ids=" ".join,
)
def test_a_pipe_is_no_input(lab, workplace, arguments):
    name = next(part for part in arguments if part.startswith("PIPE"))
    with empty_pipe(name):
        line = lab.refuses("bench", *arguments, "-o", "bench")
    assert name in line
    assert "regular file" in line


@pytest.mark.parametrize("command", [*COMMANDS, *(f"bench {name}" for name in TABLES)])
def test_a_help_page_ends_with_examples(lab, command):
    lab(*command.split(), "--help")
    assert lab.code == 0
    page, last = re.split(r"^ Examples?:", lab.out, flags=re.MULTILINE)
    assert "--json" in page
    assert " ".join(last.split()).startswith(f"python -m lab {command} ")


def test_the_commands_are_those_that_the_help_lists(lab):
    assert {*typer.main.get_command(app).commands} == set(COMMANDS)
    assert all(name in lab("--help").out for name in COMMANDS)
