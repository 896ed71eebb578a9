"""``cep export`` and ``cep upload``: a code on its way to the shutter."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cep.cli.console import finish
from cep.cli.options import ChipNs, CodeSource, Force, Json, Seed, load_code

if TYPE_CHECKING:
    from hw.device import DeviceProfile
    from hw.program import Program

__all__ = ["export", "upload"]

Device = Annotated[
    str | None, typer.Option("--device", help="Check against this profile: a built-in name or a .toml file.")
]


def export(
    code: CodeSource,
    file_format: Annotated[str, typer.Option("--format", "-f", help="c, csv or json.")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="File to write; CODE.SUFFIX when omitted.")
    ] = None,
    chip_ns: ChipNs = None,
    device: Device = None,
    force: Force = False,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Write a code as a timed shutter program, and read it back to prove the edges.

    Example: cep export code.json --format c -o shutter_code.h
    """
    from cep.outputs import claim, write_text
    from hw.drivers.report import Trust
    from hw.export import exporter

    chosen = exporter(file_format)
    program = _program(code, chip_ns)
    checks = _checks(program, device)
    target = output or Path(f"{Path(code).stem if code.endswith('.json') else 'code'}{chosen.suffix}")
    claim([target], force=force)
    text = chosen.export(program)
    if chosen.parse_back(text) != program:
        raise RuntimeError(f"{target}: reading the {file_format} text back gave other edges, nothing was written")
    write_text(target, text)
    result = {
        "file": target,
        "format": file_format,
        **_program_figures(program, checks),
        "trust": Trust.FILE_ONLY.value,
        "seed": seed,
    }
    finish(result, as_json=as_json, show=lambda console: console.print(
        f"{target}: {program.chips} chips of {program.chip_ns} ns, {program.pulses} openings, "
        f"{program.duration_ns / 1e6:.4g} ms; read back, edges identical"
    ))  # fmt: skip


def upload(
    code: CodeSource,
    port: Annotated[str, typer.Option("--port", "-p", help="Serial port of the controller, as /dev/ttyACM0 or COM3.")],
    chip_ns: ChipNs = None,
    arm: Annotated[
        bool, typer.Option("--arm", help="Arm when the program is verified: the next trigger plays it.")
    ] = False,
    lease_ms: Annotated[
        int, typer.Option("--lease-ms", min=1, help="An armed controller disarms itself after this.")
    ] = 10_000,
    device: Device = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Also write the report as JSON.")] = None,
    force: Force = False,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Load a code into a CXP1 shutter controller, read it back, and arm it if wanted.

    Example: cep upload code.json --port /dev/ttyACM0 --arm
    """
    from cep.files import json_text
    from cep.outputs import claim, write_text
    from hw.device import load_profile
    from hw.drivers.cxp import Controller

    program = _program(code, chip_ns)
    profile = None if device is None else load_profile(device)
    checks = _checks(program, device)
    claim([output] if output else [], force=force)
    with Controller.open(port) as controller:
        report = controller.upload(program, profile=profile, arm=arm, lease_ms=lease_ms)
    result = {
        "port": port,
        **_program_figures(program, checks),
        "trust": report.trust.value,
        "armed": report.armed,
        "lease_ms": report.lease_ms,
        "code_crc32": f"0x{report.code_crc32:08x}",
        "retries": report.retries,
        "seconds": report.seconds,
        "seed": seed,
    }
    if output:
        write_text(output, json_text(result))
    armed = f"; armed for {report.lease_ms} ms" if report.armed else ""
    finish(result, as_json=as_json, show=lambda console: console.print(
        f"{port}: {program.chips} chips of {program.chip_ns} ns loaded, {report.trust.value}{armed}"
    ))  # fmt: skip


def _program(source: str, chip_ns: int | None) -> Program:
    from hw.program import Program

    code = load_code(source, chip_ns=chip_ns).code
    return Program.from_bits(code.bits, chip_ns=code.chip_ns)


def _checks(program: Program, device: str | None) -> dict[str, object]:
    """Check against a profile; what breaks a limit is refused, all of it in one line."""
    if device is None:
        return {"device": None, "problems": []}
    from hw.device import load_profile

    profile: DeviceProfile = load_profile(device)
    problems = profile.check(program)
    if problems:
        raise ValueError("the program cannot be played: " + "; ".join(problems))
    return {"device": profile.name, "problems": []}


def _program_figures(program: Program, checks: dict[str, object]) -> dict[str, object]:
    return {
        "chips": program.chips,
        "chip_ns": program.chip_ns,
        "runs": program.runs,
        "edges": program.edges,
        "duration_ns": program.duration_ns,
        "checks": checks,
    }
