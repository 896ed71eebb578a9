"""What the README promises is run; the tour has every command."""

import re
from pathlib import Path

import pytest
from documented_commands import command_line, commands_in

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


TOUR = (ROOT / "docs" / "tour.md").read_text(encoding="utf-8")


def blocks(page, language):
    return re.findall(rf"^```{language}\n(.*?)^```", page, re.DOTALL | re.MULTILINE)


def test_the_python_example_runs(capsys):
    (example,) = blocks(README, "python")
    assert len([line for line in example.splitlines() if line.strip()]) <= 10
    exec(compile(example, "README.md", "exec"), {})
    sentence, code, *_ = capsys.readouterr().out.splitlines()
    assert sentence.startswith(
        ("Code this exposure", "Coding does not pay here", "Pulse", "Leave the shutter open")
    )
    bits = code.partition(":")[0]
    assert len(bits) == 20
    assert set(bits) == {"0", "1"}


def test_the_tour_shows_every_command():
    tour = [
        words
        for block in blocks(TOUR, "sh")
        for line in block.splitlines()
        for words in commands_in(line)
    ]
    assert {words[1] for words in tour if words[0] == "cep"} == set(command_line().commands) - {
        "demo"
    }  # it has its own place


@pytest.mark.parametrize(
    "target", ["demo", "test", "test-slow", "test-all", "test-lab", "lint", "bench"]
)
def test_make_targets_exist(target):
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert re.search(rf"^{target}: \$\(READY\)$", makefile, re.MULTILINE)


def test_continuous_integration_leaves_no_test_out():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    chosen = dict(re.findall(r"^(test[\w-]*): .*\n\t\$\(PYTEST\)(.*)$", makefile, re.MULTILINE))
    assert chosen == {
        "test": ' -m "not slow"',
        "test-slow": " -m slow",
        "test-all": "",
        "test-lab": " tests/lab lab",
    }
    run = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert set(re.findall(r"^make (test[\w-]*)", run, re.MULTILINE)) == {"test-all", "test-lab"}
