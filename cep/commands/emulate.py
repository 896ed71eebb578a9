"""``cep hw emulate``: a controller for those without a board."""

from __future__ import annotations

import signal
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cep.commands.console import finish
from cep.commands.options import Force, Json

if TYPE_CHECKING:
    from collections.abc import Iterator

    from hw.emulation.uno import EmulatedUno

_BOARDS = ("uno",)
_LOOK_S = 0.05


def emulate(
    board: Annotated[
        str, typer.Argument(metavar="BOARD", help="uno: an ATmega328P with the shipped firmware.")
    ],
    link: Annotated[
        Path | None,
        typer.Option("--link", help="Symbolic link to make to its port, for a name that stays."),
    ] = None,
    vcd: Annotated[
        Path | None,
        typer.Option("--vcd", help="At the end, write what its pins did: shutter, busy, trigger."),
    ] = None,
    firmware: Annotated[
        Path | None, typer.Option("--firmware", help="Another Intel hex file to run.")
    ] = None,
    clock_ppm: Annotated[
        float,
        typer.Option(
            "--clock-ppm", min=-100_000, max=100_000, help="Its clock is this much fast."
        ),
    ] = 0.0,
    seconds: Annotated[
        float | None, typer.Option("--seconds", help="End after this, s; else at Ctrl-C.")
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Run an emulated controller on a pseudo-terminal, in real time, until Ctrl-C.

    Needs gcc and Debian's libsimavr-dev and libelf-dev, or what your system calls them. On a
    terminal, t and Enter give a pulse on its trigger input.

    Example: cep hw emulate uno --link uno --vcd played.vcd
    """
    from cep.files.foreign_text import terminal_line
    from hw.emulation.build import EmulationError
    from hw.emulation.uno import EmulatedUno
    from motdiff.files.outputs import Outputs, claim

    if board not in _BOARDS:
        raise ValueError(f"BOARD: must be one of {', '.join(_BOARDS)}, got {board[:40]!r}")
    if seconds is not None and not 0 < seconds < 1e9:
        raise ValueError(f"--seconds: must be above 0, got {seconds:g}")
    if firmware is not None and not firmware.is_file():
        raise ValueError(f"--firmware: {firmware} is no file, an Intel hex file is needed")
    claim(
        [path for path in (link, vcd) if path], force=force, inputs=[firmware] if firmware else []
    )
    uno = EmulatedUno(firmware, clock_ppm=clock_ppm)
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
            _run(uno, seconds)
    finally:
        uno.stop()
    if vcd is not None:
        with Outputs((vcd,), force).written() as made:
            uno.write_vcd(made[vcd])
    edges = uno.edges()
    result = {
        "board": board,
        "port": port,
        "edges": len(edges),
        "open": bool(edges and edges[-1][1]),
        "vcd": vcd,
    }
    finish(
        result,
        as_json=as_json,
        show=lambda console: console.print(
            f"{board}: {len(edges)} edges of the shutter" + (f", in {vcd}" if vcd else "")
        ),
    )


def _run(uno: EmulatedUno, seconds: float | None) -> None:
    import select

    end = None if seconds is None else time.monotonic() + seconds
    keys = [sys.stdin] if sys.stdin is not None and sys.stdin.isatty() else []
    ended: list[int] = []
    # The ordinary end must not come as an exception: it could break off a word with the emulator.
    before = {
        number: signal.signal(number, lambda sent, _: ended.append(sent))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        while not ended and (end is None or time.monotonic() < end):
            uno.check()
            ready, _, _ = select.select(keys, [], [], _LOOK_S)
            if ready and sys.stdin.readline().strip() == "t":
                uno.trigger()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _linked(link: Path | None, port: str) -> Iterator[None]:
    if link is None:
        yield
        return
    link.unlink(missing_ok=True)
    link.symlink_to(port)
    try:
        yield
    finally:
        link.unlink(missing_ok=True)
