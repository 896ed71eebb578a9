"""``cep export`` and ``cep upload``: a code on its way to the shutter."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cep.commands.console import finish
from cep.commands.options import ChipNs, CodeSource, Force, Json, Seed
from cep.commands.programs import (
    ClockPpm,
    Device,
    LeaseMs,
    Port,
    checked_profile,
    load_program,
    named_port,
    program_figures,
    timed_program,
)


def export(
    code: CodeSource,
    file_format: Annotated[
        str,
        typer.Option("--format", "-f", help="csv json vcd c arduino rp2 pulsepal scpi camera dmd"),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help=(
                "File to write; CODE.SUFFIX when omitted (json: CODE.program.json, rp2:"
                " CODE_rp2.py)."
            ),
        ),
    ] = None,
    chip_ns: ChipNs = None,
    device: Device = None,
    force: Force = False,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Write a code as a timed shutter program, and read it back to prove the edges.

    Chips are rounded to the format's ticks, as 0.5 us of an Uno, where that changes them by half a
    percent at most; a warning says so. The program is checked against the shutter that the code
    was searched for, or --device.

    csv, json, vcd: its edges, for scripts and logic analysers. c: a header for firmware of your
    own. arduino, rp2: a whole program for an Uno, or for a Pico with MicroPython, as its main.py.
    pulsepal, scpi: settings of a Pulse Pal or a waveform generator. camera, dmd: a recipe for a
    multi-exposure camera or a micromirror array.

    Example: cep export code.json --format c -o shutter_code.h
    """
    from cep.codes.sources import code_file
    from cep.shutter.play import on_ticks
    from hw.drivers.report import Trust
    from hw.export import export_program, file_name, find_exporter
    from motdiff.files.outputs import claim, write_text

    tick_ns = find_exporter(file_format).tick_ns
    program, stored = timed_program(code, chip_ns=chip_ns)
    program, warnings = on_ticks(program, tick_ns)
    profile = checked_profile(program, stored, source=code, device=device)
    file = code_file(code)
    target = output or Path(file_name("code" if file is None else file.stem, file_format))
    outputs = claim([target], force=force, inputs=[] if file is None else [file])
    text = export_program(program, file_format, device=profile)
    result = {
        "file": target,
        "format": file_format,
        **program_figures(program, profile),
        "trust": Trust.C.value,
        "warnings": [f"{target}: {warning}" for warning in warnings],
        "seed": seed,
    }
    said = (
        f"{target}: {program.chips} chips of {program.chip_ns} ns, {program.pulses} openings,"
        f" {program.duration_ns / 1e6:.4g} ms; read back, edges identical; trust C:"
        f" {Trust.C.meaning}"
    )
    finish(
        result,
        as_json=as_json,
        show=lambda console: console.print(said),
        outputs=outputs,
        save=lambda made: write_text(made[target], text),
    )


def upload(
    code: CodeSource,
    port: Port,
    chip_ns: ChipNs = None,
    driver: Annotated[
        str,
        typer.Option(
            "--driver",
            help="cxp (our firmware), pulse-pal, or scpi: --port is then a VISA resource.",
        ),
    ] = "cxp",
    arm: Annotated[
        bool,
        typer.Option("--arm", help="Arm when the program is verified: the next trigger plays it."),
    ] = False,
    play: Annotated[
        bool, typer.Option("--play", help="Play it once, now, and wait for its end.")
    ] = False,
    lease_ms: LeaseMs = 10_000,
    device: Device = None,
    clock_ppm: ClockPpm = 0.0,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Also write the report as JSON.")
    ] = None,
    force: Force = False,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Load a code into a shutter controller, read it back where it can be, and arm or play it if
    wanted.

    Only cxp reads back, has a lease and takes --clock-ppm; the others stay armed until the next
    upload.

    Example: cep upload code.json --port /dev/ttyACM0 --arm
    """
    from cep.codes.sources import code_file
    from cep.optics.code import ShutterCode
    from cep.shutter.play import DRIVERS, open_shutter
    from motdiff.files.json_files import json_text
    from motdiff.files.outputs import claim, write_text

    if driver not in DRIVERS:
        raise ValueError(f"--driver: must be one of {', '.join(DRIVERS)}, got {driver[:40]!r}")
    if arm and play:
        raise ValueError("--arm and --play: give one of them, --play arms by itself")
    if clock_ppm and driver != "cxp":
        raise ValueError(f"--clock-ppm: {driver} cannot stretch chips, only cxp does")
    named_port(port)
    program, profile = load_program(code, chip_ns=chip_ns, device=device)
    file = code_file(code)
    outputs = claim([output] if output else [], force=force, inputs=[] if file is None else [file])
    with open_shutter(port, driver=driver) as shutter:
        report = shutter.upload(
            ShutterCode(program.bits, program.chip_ns),
            profile=profile,
            arm=arm,
            play=play,
            lease_ms=lease_ms,
            clock_ppm=clock_ppm,
        )
        result = {
            "port": report.port,
            "driver": driver,
            **program_figures(program, profile),
            "firmware": report.firmware,
            "trust": report.trust.value,
            "read_back": report.read_back,
            "armed": report.armed,
            "played": play,
            "lease_ms": report.lease_ms,
            "clock_ppm": report.clock_ppm,
            "retries": report.retries,
            "seconds": report.seconds,
            "warnings": report.warnings,
            "seed": seed,
        }
        if output:
            with (
                outputs.written() as made
            ):  # in here, since a command that fails must leave nothing armed
                write_text(made[output], json_text(result))
    lease = f" for {report.lease_ms} ms" if report.lease_ms else ""
    armed = f"; armed{lease}" if report.armed else "; armed and triggered already"
    then = "; played once" if play else armed if arm else ""
    trust = f"trust {report.trust}: {report.trust.meaning}"
    finish(
        result,
        as_json=as_json,
        show=lambda console: console.print(
            f"{report.port}: {program.chips} chips of {program.chip_ns} ns loaded, {trust}{then}"
        ),
    )
