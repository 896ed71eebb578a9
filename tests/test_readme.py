"""What the README promises is run."""

import re
from pathlib import Path

import pytest

from cep.cli.main import app

README = (Path(__file__).resolve().parent.parent / "README.md").read_text(encoding="utf-8")


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", README, re.DOTALL | re.MULTILINE)


def test_the_python_example_runs(capsys):
    (example,) = blocks("python")
    assert len([line for line in example.splitlines() if line.strip()]) <= 10
    exec(compile(example, "README.md", "exec"), {})
    sentence, code, *_ = capsys.readouterr().out.splitlines()
    assert sentence.startswith(("Code this exposure", "Coding does not pay here", "Pulse", "Leave the shutter open"))
    bits = code.partition(":")[0]
    assert len(bits) == 20
    assert set(bits) == {"0", "1"}


def test_every_command_of_the_tour_exists_with_its_options():
    import typer

    commands = typer.main.get_command(app).commands
    lines = [
        line.split("#")[0].split() for block in blocks("sh") for line in block.splitlines() if line.startswith("cep ")
    ]
    assert len(lines) >= 10
    for line in lines:
        command = commands[line[1]]
        command = getattr(command, "commands", {}).get(line[2] if len(line) > 2 else "", command)  # of a group
        offered = {option for parameter in command.params for option in parameter.opts}
        assert {word for word in line if word.startswith("-")} <= offered, line
    shown = {line[1] for line in lines}
    assert shown == set(commands) - {"demo"}  # the demo has its own place


@pytest.mark.parametrize("target", ["demo", "test", "lint", "bench"])
def test_make_targets_exist(target):
    makefile = (Path(__file__).resolve().parent.parent / "Makefile").read_text(encoding="utf-8")
    assert re.search(rf"^{target}: \$\(READY\)$", makefile, re.MULTILINE)
