"""Options of the commands that play codes: the port, and a code as a timed program."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer

from cep.commands.options import ChipNs, CodeSource, option

if TYPE_CHECKING:
    from cep.files.code_files import StoredCode
    from hw.device import DeviceProfile
    from hw.drivers.cxp import Controller
    from hw.program import Program

Port = Annotated[
    str,
    typer.Option(
        "--port",
        "-p",
        help="Serial port of the controller, as /dev/ttyACM0 or COM3; its USB serial number; or"
        " auto.",
    ),
]
Driver = Annotated[
    str,
    typer.Option(
        "--driver", help="cxp (our firmware), pulse-pal, or scpi: --port is then a VISA resource."
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


@dataclass(frozen=True, kw_only=True)
class TimedCode:
    """A code with its chip time."""

    code: CodeSource
    chip_ns: ChipNs = None

    def timed_program(self) -> tuple[Program, StoredCode]:
        """Return the program of the code, for whatever shutter, and the content of its file."""
        from cep.codes.sources import find_code
        from hw.program import MAX_CHIP_NS, Program

        stored = find_code(self.code, chip_ns=self.chip_ns)
        code = stored.code
        if code.chip_ns > MAX_CHIP_NS:  # JSON has integers of any size
            place = "--chip-ns:"
            if self.chip_ns is None:
                place = f"{self.code}: chip time"
            raise ValueError(f"{place} must be below 2^63 ns, got {code.chip_ns:.6g}")
        return Program(code.bits, chip_ns=code.chip_ns), stored


@dataclass(frozen=True, kw_only=True)
class PlayableCode(TimedCode):
    """A code with its chip time and the shutter that is to play it."""

    device: str | None = option(
        "--device",
        "NAME|FILE",
        "Check against this profile: a built-in name or a .toml file. When omitted the"
        " one that the code was searched for; generic has no limits.",
    )

    def checked_profile(self, program: Program, stored: StoredCode) -> DeviceProfile | None:
        """Return the profile of ``--device``, or else the one the code was searched for.

        A ValueError lists every limit of it that the program breaks.
        """
        from cep.files.code_files import stored_device
        from hw.device import load_profile

        if self.device is None:
            profile = stored_device(stored, source=self.code)
        else:
            profile = load_profile(self.device)
        if profile is not None and (problems := profile.check(program)):
            line = f"the program cannot be played: {'; '.join(problems)}"
            if self.device is None:
                line += (
                    f"; {self.code} was searched for {profile.name}, --device says which other"
                    " shutter it is for"
                )
            raise ValueError(line)
        return profile


def open_controller(port: str) -> Controller:
    """Open the controller of ``--port``."""
    from hw.drivers.cxp import Controller

    return Controller.open(named_port(port))


def named_port(port: str) -> str:
    """Return the name that ``--port`` gives, which must not be blank."""
    if not port.strip():
        raise ValueError(
            "--port: must name a port, as /dev/ttyACM0 or COM3, a USB serial number or auto"
        )
    return port


def program_figures(program: Program, profile: DeviceProfile | None) -> dict[str, object]:
    """Return the fields of a checked program in every hardware command's JSON."""
    return {
        "chips": program.chips,
        "chip_ns": program.chip_ns,
        "runs": program.runs,
        "edges": program.edges,
        "duration_ns": program.duration_ns,
        "checks": {"device": profile and profile.name, "problems": []},
        "code_crc32": f"0x{program.code_crc32:08x}",
    }
