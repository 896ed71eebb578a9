"""``cep hw verify``: a code compared with the controller's program, or with a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import typer

from cep.commands.console import FAILURE, Table, announce, finish
from cep.commands.hardware_options import ClockPpm, TimedCode, open_controller, program_figures
from cep.commands.options import (
    Force,
    Json,
    MotionOptions,
    TableFile,
    command,
    option,
    output_option,
    table_files,
)


@dataclass(frozen=True, kw_only=True)
class VerifyOptions(TimedCode, MotionOptions):
    """Options of ``cep hw verify``."""

    port: str | None = option(
        "--port", None, "Read it back from the controller there.", short="-p"
    )
    capture: Path | None = option(
        "--capture",
        None,
        "Compare a logic analyser's recording: VCD, or a CSV export of Saleae Logic.",
        short="--vcd",
    )
    signal: str | None = option(
        "--signal", None, "Shutter's signal in the recording; the busiest one without."
    )
    trigger: str | None = option("--trigger", None, "Trigger's signal in the recording.")
    clock_ppm: ClockPpm = 0.0
    output: Path | None = output_option(
        "Write the code as played; beside it its PSF, with a trajectory."
    )
    table: TableFile = None
    force: Force = False
    as_json: Json = False


@command(VerifyOptions)
def verify(options: VerifyOptions) -> None:
    """Compare a code with what a controller holds (--port) or its shutter played (--capture).

    A recording gives each play's chips, clock error and jitter, and with a motion the PSF as
    achieved, which cep deblur takes. Exit code 1 when anything differs.

    Example: cep hw verify code.json --capture capture.vcd --trajectory trajectory.json -o
    played.json
    """
    if (options.port is None) == (options.capture is None):
        raise ValueError("--port PORT or --capture FILE: exactly one of them is needed")
    if options.capture is None:
        _verify_stored(options)
    else:
        _verify_recording(options, options.capture)


def _verify_stored(options: VerifyOptions) -> None:
    with_capture = {
        "--signal": options.signal,
        "--trigger": options.trigger,
        "--trajectory": options.trajectory,
        "--linear": options.linear,
        "-o": options.output,
        "--table": options.table,
    }
    for name, value in with_capture.items():
        if value is not None:
            raise ValueError(f"{name}: not valid with --port, only with --capture")
    program, _ = options.timed_program()
    port = options.port or ""
    with open_controller(port) as controller:
        controller.verify(program, clock_ppm=options.clock_ppm)
    trust = controller.trust
    result = {
        "port": port,
        "firmware": controller.announced.firmware,
        **program_figures(program, None),
        "read_back": True,
        "trust": trust.value,
    }
    finish(
        result,
        [
            f"{port}: holds this code, {program.chips} chips of {program.chip_ns} ns, bit for bit,"
            f" trust {trust}"
        ],
        as_json=options.as_json,
    )


def _verify_recording(options: VerifyOptions, capture: Path) -> None:
    from cep.codes.sources import code_file
    from cep.files.code_files import stored_device
    from cep.shutter.playback import playback_files, read_playback
    from motdiff.files.outputs import Outputs, claim

    if options.clock_ppm:
        raise ValueError("--clock-ppm: not valid with --capture, only with --port")
    output = options.output
    force = options.force
    program, stored = options.timed_program()
    motion = None
    if options.has_motion:
        motion = options.load_motion().trajectory
    files: Sequence[Path] = ()
    device = None
    if output is not None:
        files = playback_files(output, with_psf=motion is not None)
    tables = table_files(options.table)
    inputs = filter(None, [code_file(options.code), capture, options.trajectory])
    claim([*files, *tables], force=force, inputs=inputs)
    if output is not None:
        device = stored_device(stored, source=options.code)
    playback = read_playback(capture, program, signal=options.signal, trigger=options.trigger)
    result = {
        "file": capture,
        "signal": playback.signal,
        **program_figures(program, None),
        **playback.to_dict(),
        "files": files,
        "warnings": [f"{capture}: {warning}" for warning in playback.warnings],
    }
    rows = [
        (
            f"{index} at {play.start_ns / 1e6:.4f} ms",
            -play.scale_ppm,  # a play that lasts longer is of a slow clock
            play.jitter_ns,
            play.worst_ns,
            "yes" if play.same_bits else "no",
        )
        for index, play in enumerate(playback.plays, start=1)
    ]
    heads = ("play", "clock, ppm", "jitter, ns", "worst edge, ns", "same bits")
    finish(
        result,
        [Table(f"{capture}, {playback.signal}", heads, rows)],
        as_json=options.as_json,
        outputs=Outputs(tuple(tables), force),
        tables=options.table,
        save=lambda _staged: (
            output and playback.save(output, motion=motion, device=device, force=force)
        ),
    )
    if playback.wrong:
        index, play = next(iter(playback.wrong.items()))
        line = f"play {index}: {play.verdict}"
        if len(playback.plays) > 1:
            line += f" ({len(playback.wrong)} of {len(playback.plays)} plays differ)"
        announce(line)
        raise typer.Exit(FAILURE)
