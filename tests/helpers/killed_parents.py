"""A Python program for tests that is killed while its own processes work: which of them outlive
it."""

import os
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
_START_S = 120.0
_END_S = 30.0


def outliving(program: str, *, busy: Path, least: int = 1) -> list[str]:
    """Run a program, kill it when ``busy`` exists, and return the command lines of its processes
    that do not end.

    Parameters
    ----------
    program : str
        Python source, which starts processes and makes the file ``busy`` while they work.
    busy : Path
    least : int
        Processes that the program must have had at that moment.
    """
    paths = f"import sys; sys.path[:0] = {[str(ROOT / 'tests/helpers'), str(ROOT)]!r}\n"
    parent = subprocess.Popen([sys.executable, "-c", paths + program], start_new_session=True)
    family = []
    try:
        _wait(lambda: busy.exists() or parent.poll() is not None, _START_S)
        assert parent.poll() is None, "the program ended before it was busy"
        family = _descendants(parent.pid)
        assert len(family) >= least, family
        os.kill(parent.pid, signal.SIGKILL)
        parent.wait(timeout=_END_S)
        _wait(lambda: not any(map(_lives, family)), _END_S)
        return [_command(pid) for pid in family if _lives(pid)]
    finally:
        for pid in [parent.pid, *family]:
            if pid != parent.pid or parent.poll() is None:
                _kill(pid)
        parent.wait(timeout=_END_S)


def _wait(reached, longest_s):
    deadline = time.monotonic() + longest_s
    while not reached() and time.monotonic() < deadline:
        time.sleep(0.05)


def _descendants(pid):
    children = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = re.fullmatch(r"(\d+) \(.*\) \S (\d+) .*", stat.read_text(), re.DOTALL)
        except OSError:  # it has just ended
            continue
        children.setdefault(int(fields[2]), []).append(int(fields[1]))
    found = children.get(pid, [])
    return found + [inner for child in found for inner in _descendants(child)]


def _lives(pid):
    """Whether a process is there, and is not only kept for its parent's sake."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def _command(pid):
    return (
        Path(f"/proc/{pid}/cmdline")
        .read_bytes()
        .replace(b"\0", b" ")
        .decode(errors="replace")[:200]
    )


def _kill(pid):
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
