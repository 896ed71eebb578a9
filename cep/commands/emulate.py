"""``cep hw emulate``: a controller for those without a board."""

from __future__ import annotations

import signal
import sys
import time
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cep.commands.console import finish
from cep.commands.options import Force, Json, argument, command, option

if TYPE_CHECKING:
    from collections.abc import Iterator

    from hw.emulation.uno import EmulatedUno

_BOARDS = ("uno",)
_LOOK_S = 0.05  # at its pins' record and the keyboard: a hand does not notice the delay


@dataclass(frozen=True, kw_only=True)
class EmulateOptions:
    """Options of ``cep hw emulate``."""

    board: str = argument("BOARD", "uno: an ATmega328P with the shipped firmware.")
    link: Path | None = option(
        "--link", None, "Symbolic link to make to its port, for a name that stays."
    )
    vcd: Path | None = option(
        "--vcd", None, "At the end, write what its pins did: shutter, busy, trigger."
    )
    seconds: float | None = option("--seconds", None, "End after this, s; else at Ctrl-C.")
    force: Force = False
    as_json: Json = False


@command(EmulateOptions)
def emulate(options: EmulateOptions) -> None:
    """Run an emulated controller on a pseudo-terminal, in real time, until Ctrl-C.

    Needs gcc and Debian's libsimavr-dev and libelf-dev, or what your system calls them. On a
    terminal, t and Enter give a pulse on its trigger input.

    Example: cep hw emulate uno --link uno --vcd played.vcd
    """
    from cep.files.foreign_text import terminal_line
    from hw.emulation.uno import EmulatedUno, EmulationError
    from motdiff.files.outputs import Outputs, claim

    board = options.board
    link = options.link
    vcd = options.vcd
    if board not in _BOARDS:
        raise ValueError(f"BOARD: must be one of {', '.join(_BOARDS)}, got {board[:40]!r}")
    if options.seconds is not None and not 0 < options.seconds < 1e9:
        raise ValueError(f"--seconds: must be above 0, got {options.seconds:g}")
    claim(filter(None, [link, vcd]), force=options.force)
    uno = EmulatedUno()
    try:
        uno.start()
    except EmulationError as error:
        raise ValueError(str(error)) from None  # what is missing can be installed
    port = uno.port
    try:
        with _linked(link, port):
            print(  # noqa: T201
                terminal_line(f"{board} is at {link or port}; Ctrl-C ends it"),
                file=sys.stderr,
                flush=True,
            )
            _run(uno, options.seconds)
    finally:
        uno.stop()
    if vcd is not None:
        with Outputs((vcd,), options.force).written() as staged:
            uno.write_vcd(staged[vcd])
    edges = uno.edges()
    result = {
        "board": board,
        "port": port,
        "edges": len(edges),
        "open": bool(edges and edges[-1][1]),
        "vcd": vcd,
    }
    line = f"{board}: {len(edges)} edges of the shutter"
    if vcd is not None:
        line += f", in {vcd}"
    finish(result, [line], as_json=options.as_json)


def _run(uno: EmulatedUno, seconds: float | None) -> None:
    import select

    deadline = time.monotonic() + (seconds or float("inf"))
    keys = [stream for stream in (sys.stdin,) if stream is not None and stream.isatty()]
    signals: list[int] = []
    # The ordinary end must not come as an exception: it could break off a word with the emulator.
    handlers = {
        number: signal.signal(number, lambda signum, _: signals.append(signum))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        while not signals and time.monotonic() < deadline:
            uno.check()
            ready, _, _ = select.select(keys, [], [], _LOOK_S)
            if ready and sys.stdin.readline().strip() == "t":
                uno.trigger()
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


@contextmanager
def _linked(link: Path | None, port: str) -> Iterator[None]:
    if link is None:
        yield
        return
    link.unlink(missing_ok=True)  # claim has seen to --force
    link.symlink_to(port)
    try:
        yield
    finally:
        link.unlink(missing_ok=True)
