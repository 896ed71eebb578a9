"""Transcripts in documents, run from the shell as they stand: ``$ command``, ``> more of it``, and
the output below."""

import difflib
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

PROMPTS = ("$ ", "> ")
ROOT = Path(__file__).resolve().parents[2]
NUMBER = re.compile(r"-?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?")
SIGNED = re.compile(
    r"\b(gain|lose) N dB"
)  # of nearly nothing: the sign hangs on the processor's last bits
SMALL_SEARCH = """
import sys
if sys.argv[1:2] == ["optimize"]:
    from cep.photographs import scenes
    from cep.search import code_search
    code_search.standard_moves = lambda _problem: 100_000
    few = scenes.photographs()[:5]
    scenes.photographs = lambda: few
from cep.commands.main import run
run()
"""
"""The program `cep`, but for the moves of a search for which none are named, and with five of the
twelve photographs that gains are measured on: the usual 4 million moves and the restorations take
longer than all else on a page, whose figures are not compared."""


def transcript_of(page):
    """Return the lines of all transcripts of a page, in order."""
    fences = re.findall(
        r"^```console\n(.*?)^```$", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
    )
    return "".join(fences).splitlines()


def run_transcript(lines, folder):
    """Run the commands of a transcript in a folder, and compare their output with the one shown,
    but for figures."""
    python = shlex.quote(sys.executable)
    script = ["set -eu", *(line[2:] for line in lines if line.startswith(PROMPTS))]
    programs = folder / "bin"
    programs.mkdir()
    for name, arguments in {
        "cep": f"-c {shlex.quote(SMALL_SEARCH)}",
        "python": "",
    }.items():
        (programs / name).write_text(f'#!/bin/sh\nexec {python} {arguments} "$@"\n')
        (programs / name).chmod(0o755)
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "COLUMNS": "100",
        "PATH": f"{programs}:{os.environ['PATH']}",
    }
    done = subprocess.run(
        ["bash", "-c", "\n".join(script)],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=1800,
        check=False,
    )
    kept = "".join(path.read_text() for path in folder.glob("emulator*.txt"))
    assert done.returncode == 0, kept + done.stdout + done.stderr
    shown = _words(line for line in lines if not line.startswith(PROMPTS))
    printed = _words(done.stdout.splitlines())
    assert printed == shown, "\n".join(
        difflib.unified_diff(shown, printed, "shown", "printed", lineterm="")
    )


def _words(lines):
    """Lines without their figures and the signs of these, the width of columns, and rules between
    them."""
    figures = (NUMBER.sub("N", line).replace("─", "") for line in lines)
    words = (" ".join(SIGNED.sub("gain N dB", line).split()) for line in figures)
    return [line for line in words if line]
