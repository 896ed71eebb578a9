"""Tests that interrupt work as well where SIGINT is ignored, as in the background jobs of a
script."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SLEEPER = """
import signal, subprocess, sys
from children import child

def test_an_interrupt_ends_a_child():
    code = "print('ready', flush=True); import time; time.sleep(100)"
    command = [sys.executable, "-c", code]
    with child(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert process.stdout.readline() == "ready\\n"
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=30) != 0
"""


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_children_of_a_background_job_can_be_interrupted(tmp_path):
    (tmp_path / "test_sleeper.py").write_text(SLEEPER)
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        ran = subprocess.run(
            [
                sys.executable,
                "-m",
                "pytest",
                "-p",
                "conftest",
                "-p",
                "no:cacheprovider",
                "--rootdir",
                ".",
                ".",
            ],
            cwd=tmp_path,
            env=os.environ
            | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests/helpers")])},
            capture_output=True,
            text=True,
            timeout=120,
        )
    finally:
        signal.signal(signal.SIGINT, before)
    assert "1 passed" in ran.stdout, ran.stdout + ran.stderr
