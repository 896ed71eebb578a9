"""A serial port that plays a transcript, and what a fresh interpreter has imported."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


class ScriptedPort:
    """Expects exactly the bytes written, hands out the replies, in order; each exchange is (sent,
    reply) in hex."""

    def __init__(self, *exchanges):
        self.exchanges = [(bytes.fromhex(sent), bytes.fromhex(reply)) for sent, reply in exchanges]
        self.waiting = b""
        self.closed = False

    @property
    def in_waiting(self):
        return len(self.waiting)

    def read(self, size):
        data = self.waiting[:size]
        self.waiting = self.waiting[size:]
        return data

    def write(self, data):
        assert self.exchanges, f"not in the transcript: {data.hex(' ')}"
        sent, reply = self.exchanges.pop(0)
        assert data.hex(" ") == sent.hex(" ")
        self.waiting += reply

    def close(self):
        self.closed = True

    def all_consumed(self):
        return not self.exchanges and not self.waiting and self.closed


def imported_with(modules: str, wanted: set[str]) -> set[str]:
    """Which of ``wanted`` a fresh interpreter has loaded after ``import MODULES``."""
    code = f"import sys, {modules}; print(*({wanted!r} & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=Path(__file__).parents[2],
        timeout=60,
        capture_output=True,
        text=True,
        check=True,
    )
    return set(done.stdout.split())
