"""What the hardware commands share: options, the controller on a port, and a code as a timed
program.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from cep.files.files import StoredCode
    from hw.device import DeviceProfile
    from hw.drivers.cxp import Controller
    from hw.program import Program

Port = Annotated[
    str,
    typer.Option(
        "--port",
        "-p",
        help=(
            "Serial port of the controller, as /dev/ttyACM0 or COM3; its USB serial number; or"
            " auto."
        ),
    ),
]
LeaseMs = Annotated[
    int,
    typer.Option(
        "--lease-ms", min=1, max=65535, help="An armed controller disarms itself after this, ms."
    ),
]
ClockPpm = Annotated[
    float,
    typer.Option(
        "--clock-ppm",
        min=-100_000,
        max=100_000,
        help="The controller's clock is this fast, as cep hw calibrate found.",
    ),
]
Device = Annotated[
    str | None,
    typer.Option(
        "--device",
        metavar="NAME|FILE",
        help=(
            "Check against this profile: a built-in name or a .toml file. When omitted the one"
            " that the code was searched for; generic has no limits."
        ),
    ),
]


def timed_program(source: str, *, chip_ns: int | None) -> tuple[Program, StoredCode]:
    """Return the program of a code, for whatever shutter, and what its file says of it.

    Raises
    ------
    ValueError
        If it is no code, or its chip time is out of range.
    """
    from cep.codes.sources import find_code
    from hw.program import MAX_CHIP_NS, Program

    stored = find_code(source, chip_ns=chip_ns)
    code = stored.code
    if code.chip_ns > MAX_CHIP_NS:
        where = f"{source}: chip time" if chip_ns is None else "--chip-ns:"
        raise ValueError(f"{where} must be below 2^63 ns, got {code.chip_ns:.6g}")
    return Program.from_bits(code.bits, chip_ns=code.chip_ns), stored


def load_program(
    source: str, *, chip_ns: int | None, device: str | None
) -> tuple[Program, DeviceProfile | None]:
    """Return the program of a code, and the profile of ``--device`` or else the one that the code
    was searched for.

    Raises
    ------
    ValueError
        If the chip time is out of range, or the device cannot play the program: the line lists
        every limit it breaks.
    """
    program, stored = timed_program(source, chip_ns=chip_ns)
    return program, checked_profile(program, stored, source=source, device=device)


def checked_profile(
    program: Program, stored: StoredCode, *, source: str, device: str | None
) -> DeviceProfile | None:
    """Return the profile that :func:`load_program` returns with a program, checked as there."""
    from cep.files.files import stored_device
    from hw.device import load_profile

    profile = stored_device(stored, source=source) if device is None else load_profile(device)
    if profile is not None and (problems := profile.check(program)):
        whose = (
            f"; {source} was searched for {profile.name}, --device says which other shutter it"
            " is for"
        )
        raise ValueError(
            f"the program cannot be played: {'; '.join(problems)}{'' if device else whose}"
        )
    return profile


def open_port(port: str) -> Controller:
    """Open the controller of ``--port``.

    Raises
    ------
    ValueError
        If it names nothing, or what cannot be opened.
    """
    from hw.drivers.finding import open_controller

    return open_controller(named_port(port))


def named_port(port: str) -> str:
    """Return the name that ``--port`` gives, which must not be blank."""
    if not port.strip():
        raise ValueError(
            "--port: must name a port, as /dev/ttyACM0 or COM3, a USB serial number or auto"
        )
    return port


def program_figures(program: Program, profile: DeviceProfile | None) -> dict[str, object]:
    """Return what every hardware command's JSON says of a program that was checked."""
    return {
        "chips": program.chips,
        "chip_ns": program.chip_ns,
        "runs": program.runs,
        "edges": program.edges,
        "duration_ns": program.duration_ns,
        "checks": {"device": profile.name if profile else None, "problems": []},
        "code_crc32": f"0x{program.code_crc32:08x}",
    }
