"""An Uno on avr8js, the simulator that shares nothing with simavr, in the shape of
`hw.emulation.uno.EmulatedUno`."""

from __future__ import annotations

import os
import subprocess
import tempfile
from pathlib import Path
from typing import Self

_SCRIPT = Path(__file__).with_name("uno.mjs")


class Avr8jsUno:
    """Runs `firmware`, as fast as it can (about real time); `port` is its serial port."""

    def __init__(self, firmware: Path) -> None:
        self.firmware = firmware

    def __enter__(self) -> Self:
        import tty  # there is none on Windows

        self._folder = tempfile.TemporaryDirectory()
        self._events = Path(self._folder.name) / "events"
        self._events.touch()
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self._node = subprocess.Popen(
            ["node", str(_SCRIPT), str(self.firmware), str(self._events), str(self._master)],
            stdin=subprocess.PIPE,
            pass_fds=[self._master],
        )
        return self

    def __exit__(self, *_: object) -> None:
        self._node.kill()
        with self._node:
            pass
        os.close(self._master)
        os.close(self._slave)
        self._folder.cleanup()

    def trigger(self, *, pulses: int = 1, hertz: float = 5000.0) -> None:
        assert self._node.stdin is not None
        self._node.stdin.write(f"trigger {pulses} {round(16e6 / hertz)}\n".encode())
        self._node.stdin.flush()

    def edges(self, signal: str = "shutter") -> tuple[tuple[int, int], ...]:
        complete, _, _unfinished = self._events.read_text().rpartition(
            "\n"
        )  # Node may be in the middle of a line
        words = [line.split() for line in complete.splitlines()]
        return tuple((int(cycle), int(level)) for cycle, name, level in words if name == signal)
