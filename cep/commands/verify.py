"""``cep hw verify``: what the controller holds, and what the shutter played, against what was
asked for.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cep.commands.console import FAILURE, complain, finish, table
from cep.commands.options import (
    ChipNs,
    CodeSource,
    Force,
    Json,
    Linear,
    TableFile,
    TrajectoryFile,
    load_motion,
    table_files,
)
from cep.commands.programs import ClockPpm, open_port, program_figures, timed_program

if TYPE_CHECKING:
    from hw.program import Program


def verify(
    code: CodeSource,
    port: Annotated[
        str | None, typer.Option("--port", "-p", help="Read it back from the controller there.")
    ] = None,
    capture: Annotated[
        Path | None,
        typer.Option(
            "--capture",
            "--vcd",
            help="Compare a logic analyser's recording: VCD, or a CSV export of Saleae Logic.",
        ),
    ] = None,
    signal: Annotated[
        str | None,
        typer.Option(
            "--signal", help="Shutter's signal in the recording; the busiest one without."
        ),
    ] = None,
    trigger: Annotated[
        str | None, typer.Option("--trigger", help="Trigger's signal in the recording.")
    ] = None,
    trajectory: TrajectoryFile = None,
    linear: Linear = None,
    chip_ns: ChipNs = None,
    clock_ppm: ClockPpm = 0.0,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help="Write the code as played; beside it its PSF, with a trajectory.",
        ),
    ] = None,
    tables: TableFile = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Compare a code with what the controller holds (--port), or with what its shutter really
    played (--capture).

    A recording gives each play's chips, clock error and jitter, and with a motion the PSF as
    achieved, which cep deblur takes. Exit code 1 when anything differs.

    Example: cep hw verify code.json --capture capture.vcd --trajectory trajectory.json -o
    played.json
    """
    if (port is None) == (capture is None):
        raise ValueError("--port PORT or --capture FILE: exactly one of them is needed")
    with_capture = {
        "--signal": signal,
        "--trigger": trigger,
        "--trajectory": trajectory,
        "--linear": linear,
        "-o": output,
        "--table": tables,
    }
    unused = (
        [option for option, value in with_capture.items() if value is not None]
        if port is not None
        else []
    )
    if unused:
        raise ValueError(f"{unused[0]}: not valid with --port, only with --capture")
    if capture is not None and clock_ppm:
        raise ValueError("--clock-ppm: not valid with --capture, only with --port")
    program, stored = timed_program(code, chip_ns=chip_ns)
    if port is not None:
        _held(program, port, clock_ppm=clock_ppm, as_json=as_json)
        return
    assert capture is not None
    from cep.codes.sources import code_file
    from cep.files.files import stored_device
    from cep.shutter.playback import playback_files, read_playback
    from motdiff.files.outputs import Outputs, claim

    motion = (
        None
        if trajectory is None and linear is None
        else load_motion(trajectory, linear).trajectory
    )
    written = [] if output is None else playback_files(output, with_psf=motion is not None)
    read = [file for file in (code_file(code), capture, trajectory) if file]
    claim([*written, *table_files(tables)], force=force, inputs=read)
    outputs = Outputs(tuple(table_files(tables)), force)
    device = None if output is None else stored_device(stored, source=code)
    found = read_playback(capture, program, signal=signal, trigger=trigger)
    result = {
        "file": capture,
        "signal": found.signal,
        **program_figures(program, None),
        **found.to_dict(),
        "files": written,
        "warnings": [f"{capture}: {warning}" for warning in found.warnings],
    }
    rows = [
        (
            f"{index} at {play.start_ns / 1e6:.4f} ms",
            -play.scale_ppm,
            play.jitter_ns,
            play.worst_ns,
            "yes" if play.same_bits else "no",
        )
        for index, play in enumerate(found.plays, start=1)
    ]
    heads = ("play", "clock, ppm", "jitter, ns", "worst edge, ns", "same bits")
    finish(
        result,
        as_json=as_json,
        show=lambda console: console.print(table(f"{capture}, {found.signal}", heads, rows)),
        outputs=outputs,
        tables=tables,
        save=lambda _made: (
            output and found.save(output, motion=motion, device=device, force=force)
        ),
    )
    if found.wrong:
        index, play = next(iter(found.wrong.items()))
        others = (
            f" ({len(found.wrong)} of {len(found.plays)} plays differ)"
            if len(found.plays) > 1
            else ""
        )
        complain(f"play {index}: {play.verdict}{others}")
        raise typer.Exit(FAILURE)


def _held(program: Program, port: str, *, clock_ppm: float, as_json: bool) -> None:
    with open_port(port) as controller:
        controller.verify(program, clock_ppm=clock_ppm)
    firmware = controller.announced.firmware
    trust = controller.trust
    result = {
        "port": port,
        "firmware": firmware,
        **program_figures(program, None),
        "read_back": True,
        "trust": trust.value,
    }
    finish(
        result,
        as_json=as_json,
        show=lambda console: console.print(
            f"{port}: holds this code, {program.chips} chips of {program.chip_ns} ns, bit for bit,"
            f" trust {trust}"
        ),
    )
