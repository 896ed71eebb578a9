"""What the commands say of their options: on the help pages, and where a value is wrong."""

import inspect
import re
import typing
from pathlib import Path

import pytest
import typer

from cep.commands import camera, controller
from cep.commands.main import app

GYRO = [
    "--method",
    "gyro",
    "--gyro",
    "gyro.csv",
    "--focal",
    "900",
    "--start",
    "0.1",
    "--exposure",
    "0.05",
]
FINE = {
    "calibrate": ["blurred.png", *GYRO],
    "calibration-set": ["--photos", "2", "--chips", "8"],
    "advise": ["--linear", "12", "--chips", "12"],
    "optimize": ["--linear", "12", "--chips", "12", "--steps", "1000"],
    "audit": ["1011", "--linear", "9"],
    "mtf": ["--linear", "9"],
    "simulate": ["sharp.png", "--linear", "9"],
    "deblur": ["blurred.png", "--trajectory", "trajectory.json"],
    "export": ["1011", "--format", "csv"],
    "camera list": [],
    "camera estimate": ["sharp.png", "blurred.png"],
    "studio": ["--no-browser"],
    "demo": [],
}
"""Commands that do not talk with a device, with arguments that they take."""


def functions():
    """Each command's name and function."""
    named = {info.name: info.callback for info in app.registered_commands}
    named |= {f"camera {info.name}": info.callback for info in camera.camera.registered_commands}
    named |= {f"hw {info.name}": info.callback for info in controller.hw.registered_commands}
    return named


def declared(function):
    """Each option's long name with its Python type; arguments are left out."""
    hints = typing.get_type_hints(function, include_extras=True)
    for name in inspect.signature(function).parameters:
        kind, *about = (
            typing.get_args(hints[name])
            if typing.get_origin(hints[name]) is typing.Annotated
            else (None,)
        )
        if about and isinstance(about[0], typer.models.OptionInfo):
            names = (
                about[0].default,
                *about[0].param_decls,
            )  # in an Annotated the first name stands for the default
            yield max(names, key=len), kind


def numeric():
    """Every option with a number, of every command."""
    for command in FINE:
        for option, kind in declared(functions()[command]):
            types = {kind, *typing.get_args(kind)} & {int, float}
            if types:
                yield command, option, types.pop()


@pytest.fixture
def refused(cep, workplace):
    """Run a command that must be refused and write nothing; return the line it printed."""
    times = [step / 100 for step in range(40)]
    Path("gyro.csv").write_text("t_s,wx,wy,wz\n" + "".join(f"{t},0.1,0.2,0.01\n" for t in times))
    before = sorted(Path().rglob("*"))

    def run(command, *arguments):
        line = cep.refuses(*command.split(), *FINE[command], *arguments)
        assert sorted(Path().rglob("*")) == before
        return line

    return run


# -- a wrong value --------------------------------------------------------------------------------


def test_all_commands_are_walked():
    assert {name for name in functions() if not name.startswith("hw ")} - {
        "shoot",
        "upload",
    } == set(FINE)
    assert {"--steps", "--photons", "--focal", "--flips", "--workers"} <= {
        name for _, name, _ in numeric()
    }


@pytest.mark.parametrize(("command", "option", "kind"), list(numeric()))
def test_a_bad_number_is_refused_by_the_options_name(refused, command, option, kind):
    for value in ("-1", "x", "nan" if kind is float else "1.5"):
        line = refused(command, option, value)
        assert re.search(rf"(?<![\w-]){option}(?![\w-])", line), line
        assert not re.search(r"(?<![\w-])[a-z]+_[a-z_]+: ", line), line


EXPOSED = [command for command in FINE if "--exposure" in dict(declared(functions()[command]))]


@pytest.mark.parametrize("command", EXPOSED)
def test_an_exposure_is_the_same_text_in_every_command(refused, command):
    assert {
        "advise",
        "calibrate",
        "demo",
        "optimize",
    } == set(EXPOSED)
    for value in ("1/0", "-0.05", "soon", "20 minutes"):
        line = refused(command, "--exposure", value)
        assert (
            line.strip()
            == "cep: --exposure: must be a time above 0 as 1/30, 0.02, 20ms or 500us, got"
            f" {value!r}"
        )


@pytest.mark.parametrize(
    ("command", "given", "option"),
    [
        *(
            ("optimize", ["--open", value], "--open")
            for value in ("0", "9:3", "1:13", "x", "nan", "")
        ),
        *(
            ("optimize", ["--open", value], "--open")
            for value in ("200%:300%", "nan%", "90%:10%", "x%", "30.1%:30.2%", "40%:6", "6:50%")
        ),
        *(("optimize", ["--speed", value], "--speed") for value in ("0:1", "nan", "2:1", "x")),
        *(
            ("optimize", ["--objective", value], "--objective")
            for value in ("min-mtf:nan", "noise:0", "x", ",")
        ),
        ("optimize", ["--method", "x"], "--method"),
        ("optimize", ["--chips", "49"], "--chips"),
        ("optimize", ["--min-open", "13"], "--min-open"),
        ("optimize", ["--min-open", "5", "--open", "2:4"], "--min-open"),
        ("optimize", ["--min-open", "5", "--open", "2:4"], "--open"),
        ("optimize", ["--device", "flc", "--exposure", "84ns"], "--exposure"),
        ("audit", ["--linear", "0.1"], "CODE"),
        ("mtf", ["--code", "10112"], "--code"),
        ("mtf", ["--code", "1011", "--linear", "0.1"], "--code"),
        ("deblur", ["--code", "0000"], "--code"),
        ("deblur", ["--method", "tv", "--photons", "9"], "--photons: not valid with --method tv"),
        ("deblur", ["--method", "x"], "--method"),
        ("simulate", ["--code", "10x"], "--code"),
        *(
            (command, ["--gamma", "nan"], "--gamma")
            for command in ("calibrate", "deblur", "simulate", "demo")
        ),
        ("calibrate", ["--method", "x"], "--method"),
        ("calibrate", ["--method", "pmp"], "--exposure: not valid with --method pmp"),
        ("calibrate", ["--method", "reference"], "--sharp: needed with --method reference"),
        ("calibrate", ["--start", "9"], "--start"),
    ],
)
def test_a_bad_value_is_refused_by_the_options_name(refused, command, given, option):
    assert option in refused(command, *given)


def test_a_wrong_code_given_as_an_argument_is_named(cep, workplace):
    assert cep.refuses("audit", "10112").startswith("cep: CODE: only 0 and 1")
    assert cep.refuses("export", "0000", "--format", "csv").startswith(
        "cep: CODE: all chips are closed"
    )


def test_what_is_wrong_in_a_file_keeps_the_files_name_and_field(cep, workplace):
    Path("camera.json").write_text('{"photons_full_scale": -3}')
    line = cep.refuses("audit", "1011", "--camera", "camera.json", "--photons", "100")
    assert "camera.json: photons_full_scale: must" in line


# -- help pages -----------------------------------------------------------------------------------


@pytest.fixture(params=[60, 80, 120])
def width(request, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(request.param))
    return request.param


@pytest.mark.parametrize("command", functions())
def test_a_help_page_shows_every_option_whole_and_ends_with_examples(cep, width, command):
    cep(*command.split(), "--help")
    assert cep.code == 0
    assert "<bool>" not in cep.out
    for option, _ in declared(functions()[command]):
        assert option in cep.out.split()
    page, last = re.split(r"^ Examples?:", cep.out, flags=re.MULTILINE)
    assert max(map(len, page.splitlines())) <= width
    assert last.split()[0] == "cep"
    assert "╭" not in last
    commands = " ".join(last.replace("\\\n", " ").split())
    assert commands.startswith(f"cep {command} ")


@pytest.mark.parametrize("command", ["optimize", "calibrate"])
def test_a_long_page_is_in_panels_and_the_common_options_come_last(cep, monkeypatch, command):
    monkeypatch.setenv("COLUMNS", "80")
    cep(command, "--help")
    panels = re.split(r"^╭─ (.*?) ─*╮$", cep.out, flags=re.MULTILINE)[1:]
    titles = panels[::2]
    bodies = panels[1::2]
    assert titles[-1] == "Common options"
    assert "--help" in bodies[-1]
    assert max(len(re.findall(r"^│ \*? *-", body, flags=re.MULTILINE)) for body in bodies) <= 10


def test_an_example_can_be_copied_as_it_stands(cep, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    cep("optimize", "--help")
    examples = cep.out.split("Examples:")[1].replace("\\\n", " ")
    lines = [" ".join(line.split()) for line in examples.splitlines() if line.strip()]
    assert all(line.startswith("cep optimize ") for line in lines)
    assert (
        "cep optimize --trajectory motion/trajectory.json --chips 40 --open 40%:60% -o code.json"
        in lines
    )
