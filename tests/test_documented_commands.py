"""Commands that the documents show exist, with their options and values; pages with transcripts
run as they stand."""

import pytest
from documented_commands import Shown, commands_in, fault, pages, shown
from emulators.tools import require_simavr
from shell_transcripts import ROOT, run_transcript, transcript_of

RUN_ELSEWHERE = {"docs/hardware.md"}
"""tests/cep/commands/test_hardware_transcript.py runs it."""

GONE = {
    "motdiff/weights/README.md: python -m motdiff eval": (
        "its figures were measured by the former command"
    ),
}

TRANSCRIPTS = [
    page for page, _ in pages() if page not in RUN_ELSEWHERE and transcript_of(ROOT / page)
]


def test_every_command_that_is_shown_is_accepted():
    commands = list(dict.fromkeys(shown()))
    assert len(commands) > 250
    assert {"README.md", "docs/howto/robot.md", "notebooks/quickstart.py"} <= {
        command.page for command in commands
    }
    faults = {str(command): text for command in commands if (text := fault(command))}
    assert {name: text for name, text in faults.items() if name not in GONE} == {}
    assert faults.keys() == GONE.keys(), "a command that is back needs no exception"


@pytest.mark.parametrize(
    ("line", "part"),
    [
        ("cep optimise --linear 40", "optimise"),
        ("cep optimize --linear 40 --chip 12", "--chip"),
        ("cep optimize --linear forty", "--linear"),
        ("cep advise --linear 40 --photons", "--photons"),
        ("cep simulate", "SHARP"),
        ("cep hw trigger --port uno board", "board"),
        ("python -m motdiff train run.toml", "--out"),
    ],
)
def test_a_command_that_no_user_could_run_is_found(line, part):
    (words,) = commands_in(line)
    assert part in (fault(Shown("page", words, whole=True)) or "")


@pytest.mark.slow(reason="calibrates, searches and restores as a user would")
@pytest.mark.parametrize("page", TRANSCRIPTS)
def test_a_page_runs_from_top_to_bottom(page, tmp_path):
    lines = transcript_of(ROOT / page)
    if any("hw emulate" in line for line in lines):
        require_simavr()
    run_transcript(lines, tmp_path)
