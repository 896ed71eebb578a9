"""MicroPython 1.27, compiled to WebAssembly, under node."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

HERE = Path(__file__).parent
NODE = HERE.parent / "node"


class MicroPython:
    """A running interpreter; a context manager. `files` can be imported by it."""

    def __init__(self, *files: Path) -> None:
        command = ["node", str(HERE / "server.mjs"), str(NODE), *map(str, files)]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def __enter__(self) -> MicroPython:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.stdin.close()
        self._process.wait(timeout=10)
        self._process.stdout.close()

    def run(self, source: str) -> str:
        """Run statements and return what they print; an exception in them is raised as
        RuntimeError."""
        self._process.stdin.write(json.dumps(source) + "\n")
        self._process.stdin.flush()
        printed, error = json.loads(self._process.stdout.readline())
        if error:
            raise RuntimeError(error)
        return printed
