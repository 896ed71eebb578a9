"""The transcript in docs/hardware.md, run from the shell as it stands there, against the emulated Uno."""

import json
import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest

if not hasattr(signal, "SIGALRM"):
    pytest.skip("no pseudo-terminals on this system", allow_module_level=True)

from emulators.tools import require_simavr

ROOT = Path(__file__).resolve().parents[3]
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")


def transcript():
    text = (ROOT / "docs" / "hardware.md").read_text(encoding="utf-8")
    return text.split("<!-- This transcript is run by the tests")[1].split("```console\n")[1].split("```")[0]


def test_from_the_search_to_the_shutters_edges(tmp_path):
    require_simavr()
    lines = transcript().splitlines()
    python = f"{shlex.quote(sys.executable)} -c 'from cep.cli.main import run; run()'"
    script = ["set -eu", *(line[2:] for line in lines if line.startswith("$ "))]
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "cep").write_text(f'#!/bin/sh\nexec {python} "$@"\n')
    (tmp_path / "bin" / "cep").chmod(0o755)
    environment = {
        **os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "100", "PATH": f"{tmp_path}/bin:{os.environ['PATH']}",
    }  # fmt: skip
    done = subprocess.run(
        ["bash", "-c", "\n".join(script)], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, (tmp_path / "emulator.txt").read_text() + done.stdout + done.stderr
    assert _said(done.stdout.splitlines()) == _said(line for line in lines if not line.startswith("$ "))
    sent = json.loads((tmp_path / "code.json").read_text())
    played = json.loads((tmp_path / "played.json").read_text())
    assert played["bits"] == sent["bits"]
    # an emulated pin changes between two instructions: some 200 ns over 20 chips
    assert abs(played["chip_ns"] - sent["chip_ns"]) <= 20


def _said(lines):
    """What lines say apart from their figures, the width of columns, and rules between them."""
    words = (" ".join(NUMBER.sub("N", line).replace("─", "").split()) for line in lines)
    return [line for line in words if line]
