"""The shipped `main.py` on an emulated RP2040, its console a pseudo-terminal: ``run_board.py
FOLDER``.

Prints the terminal's name, then answers each line of its input, a method of `Chip` and its
arguments as a JSON array, by a line of JSON; ``["log"]`` gives what `machine` was told. Ends with
its input.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
import tty
from types import SimpleNamespace

from emulators.rp2040js.board import Chip, modules

# one look at the clock: 0.1 ms, as long as the interpreter needs for its loop
PASS_CYCLES = 12_500


class Console:
    """`sys.stdin` and `sys.stdout` of a board."""

    def __init__(self, terminal: int) -> None:
        self.terminal = terminal
        self.buffer = SimpleNamespace(
            read=lambda size: os.read(terminal, size), write=lambda data: os.write(terminal, data)
        )

    def fileno(self) -> int:
        return self.terminal


def answer_control(chip: Chip, log: list[str], lines, output) -> None:
    for line in lines:
        name, *values = json.loads(line)
        found = list(log) if name == "log" else getattr(chip, name)(*values)
        output.write(json.dumps(found) + "\n")
        output.flush()
    os._exit(0)


def main() -> None:
    sys.path.insert(0, sys.argv[1])
    master, slave = os.openpty()
    tty.setraw(slave)
    with Chip() as chip:
        board = modules(chip)
        sys.modules.update(board)
        time.ticks_us = lambda: chip.run(PASS_CYCLES) // 125 % 2**30
        time.ticks_diff = lambda later, earlier: (later - earlier + 2**29) % 2**30 - 2**29
        log = board["machine"].log
        control = threading.Thread(target=answer_control, args=(chip, log, sys.stdin, sys.stdout))
        sys.stdout.write(os.ttyname(slave) + "\n")
        sys.stdout.flush()
        control.start()
        sys.stdin = sys.stdout = Console(master)
        import main as firmware  # the shipped one: its folder is first in the path

        try:
            firmware.run()
            log.append("returned")
        except Exception as error:
            log.append(f"raised {error!r}")
        control.join()


if __name__ == "__main__":
    main()
