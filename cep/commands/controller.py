"""``cep hw``: a shutter controller, step by step."""

from __future__ import annotations

import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cep.commands.console import finish, page, progress, table
from cep.commands.emulate import emulate
from cep.commands.options import ChipNs, CodeSource, Json, Seed
from cep.commands.programs import (
    ClockPpm,
    Device,
    LeaseMs,
    Port,
    load_program,
    open_port,
    program_figures,
)
from cep.commands.verify import verify

if TYPE_CHECKING:
    from collections.abc import Iterator

    from hw.cxp.protocol import Hello, Status

hw = typer.Typer(help="A shutter controller, step by step.", no_args_is_help=True)

_ACKNOWLEDGED = "B"  # of hw.drivers.report.Trust


@hw.command("list")
def list_(
    ask: Annotated[
        bool,
        typer.Option(
            "--ask", help="Greet every port: resets many boards, and foreign devices hear it too."
        ),
    ] = False,
    as_json: Json = False,
) -> None:
    """List the serial ports, with --ask also which of them is a shutter controller.

    Example: cep hw list --ask
    """
    from hw.cxp.protocol import Hello
    from hw.drivers.finding import ask_ports
    from hw.port import list_ports

    answers = dict(ask_ports()) if ask else {}
    rows: list[dict[str, Any]] = []
    for info in answers or list_ports():
        answer = answers.get(info)
        controller = isinstance(answer, Hello)
        rows.append(
            {
                "port": info.port,
                "description": info.description,
                "serial_number": info.serial_number,
                "firmware": answer.firmware if isinstance(answer, Hello) else None,
                "controller": controller if ask else None,
                "answer": answer if isinstance(answer, str) else None,
            }
        )
    cells = [
        (
            row["port"],
            row["description"],
            row["serial_number"],
            row["firmware"] or row["answer"] or "not asked",
        )
        for row in rows
    ]
    finish(
        {"ports": rows},
        as_json=as_json,
        show=lambda console: console.print(
            table(
                "serial ports", ("port", "description", "USB serial number", "controller"), cells
            )
            if rows
            else "no serial ports"
        ),
    )


@hw.command("info")
def info(port: Port, as_json: Json = False) -> None:
    """Show what a controller says of itself and how it stands.

    Example: cep hw info --port /dev/ttyACM0
    """
    with open_port(port) as controller:
        status = controller.status()
    told = controller.announced
    trust = controller.trust
    result = {
        "port": port,
        **_hello_figures(told),
        **_status_figures(status),
        "trust": f"{trust} at most",
    }
    rows = [(name.replace("_", " "), str(value)) for name, value in result.items()]
    finish(
        result, as_json=as_json, show=lambda console: console.print(table(port, ("", ""), rows))
    )


@hw.command("load")
def load(
    code: CodeSource,
    port: Port,
    chip_ns: ChipNs = None,
    device: Device = None,
    clock_ppm: ClockPpm = 0.0,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Load a code; the controller confirms its CRC-32. Nothing is read back or armed: see cep
    upload.

    Example: cep hw load code.json --port /dev/ttyACM0
    """
    from hw.device import refusal
    from hw.drivers.report import Trust

    program, profile = load_program(code, chip_ns=chip_ns, device=device)
    with open_port(port) as controller:
        problems = controller.check(program, profile=profile)
        if problems:
            raise ValueError(refusal(problems, controller.limits))
        stored = controller.load(program, clock_ppm=clock_ppm)
    result = {
        "port": port,
        **program_figures(program, profile),
        "trust": Trust.B.value,
        "chip_ticks": float(stored.chip_ticks),
        "stored_crc32": f"0x{stored.crc32:08x}",
        "seed": seed,
    }
    finish(
        result,
        as_json=as_json,
        show=lambda console: console.print(
            f"{port}: {program.chips} chips of {program.chip_ns} ns loaded, trust B: acknowledged"
            " only"
        ),
    )


@hw.command("arm")
def arm(port: Port, lease_ms: LeaseMs = 10_000, as_json: Json = False) -> None:
    """Arm what is loaded: the next trigger plays it, until the lease is over.

    Example: cep hw arm --port /dev/ttyACM0 --lease-ms 60000
    """
    from hw.cxp.protocol import State

    with open_port(port) as controller:
        status = controller.arm(lease_ms=lease_ms)
        told = controller.announced
    armed = status.state is State.ARMED
    result = {
        "port": port,
        "armed": armed,
        "lease_ms": lease_ms,
        **_status_figures(status),
        "trust": _ACKNOWLEDGED,
    }
    where = "its trigger input or cep hw trigger" if told.trigger_input else "cep hw trigger"
    then = (
        f"armed for {lease_ms} ms; {where} plays it"
        if armed
        else f"armed and triggered already, {_name(status)}"
    )
    finish(
        result,
        as_json=as_json,
        show=lambda console: console.print(
            f"{port}: {then} (trust {_ACKNOWLEDGED}: acknowledged only)"
        ),
    )


@hw.command("trigger")
def trigger(
    port: Port,
    wait_s: Annotated[
        float, typer.Option("--wait", min=0.0, help="Wait this long, s, for the end of the play.")
    ] = 60.0,
    as_json: Json = False,
) -> None:
    """Play what is armed, once, and wait for its end.

    Example: cep hw trigger --port /dev/ttyACM0
    """
    with open_port(port) as controller:
        status = controller.play(timeout_s=wait_s)
    result = {"port": port, **_status_figures(status), "trust": _ACKNOWLEDGED}
    finish(
        result,
        as_json=as_json,
        show=lambda console: console.print(f"{port}: played, 0 edges missed, shutter closed"),
    )


@hw.command("abort")
def abort(port: Port, as_json: Json = False) -> None:
    """Close the shutter and disarm, whatever it is doing.

    Example: cep hw abort --port /dev/ttyACM0
    """
    with open_port(port) as controller:
        status = controller.abort()
    result = {"port": port, **_status_figures(status), "trust": _ACKNOWLEDGED}
    finish(
        result,
        as_json=as_json,
        show=lambda console: console.print(f"{port}: closed, {_name(status)}"),
    )


@hw.command("calibrate")
def calibrate(
    port: Port,
    seconds: Annotated[
        float, typer.Option("--seconds", help="How long to compare the clocks, s.")
    ] = 10.0,
    as_json: Json = False,
) -> None:
    """Measure a controller's clock against this computer's.

    The figure goes into --clock-ppm of cep upload and cep hw load, which stretch the chips by it.

    Example: cep hw calibrate --port /dev/ttyACM0 --seconds 20
    """
    from hw.cxp.clock import measure_clock

    if not 0 < seconds < 3600:
        raise ValueError(f"--seconds: must be above 0 and below 3600, got {seconds:g}")
    with open_port(port) as controller, progress("comparing clocks") as tick:
        fit = measure_clock(controller, seconds=seconds, progress=tick)
    drifts = (
        "a crystal is within 100 ppm, so this is a ceramic resonator, which drifts with"
        " temperature: calibrate it warm"
    )
    warnings = [drifts] if abs(fit.ppm) > 200 + fit.uncertainty_ppm else []
    result = {
        "port": port,
        "clock_ppm": fit.ppm,
        "uncertainty_ppm": fit.uncertainty_ppm,
        "seconds": fit.seconds,
        "samples": fit.samples,
        "warnings": warnings,
    }
    finish(
        result,
        as_json=as_json,
        show=lambda console: console.print(
            f"{port}: clock is {abs(fit.ppm):.0f} ppm {'fast' if fit.ppm >= 0 else 'slow'} (±"
            f" {fit.uncertainty_ppm:.0f}); --clock-ppm {fit.ppm:.0f} takes it out"
        ),
    )


@hw.command("monitor")
def monitor(
    port: Port,
    seconds: Annotated[
        float | None, typer.Option("--seconds", help="Stop after this, s; else at Ctrl-C.")
    ] = None,
    every_s: Annotated[
        float, typer.Option("--every", min=0.001, max=3600, help="Time between two looks, s.")
    ] = 0.05,
    as_json: Json = False,
) -> None:
    """Watch a controller: a line whenever its state, plays or errors change.

    Example: cep hw monitor --port /dev/ttyACM0 --seconds 30
    """
    if seconds is not None and not seconds > 0:
        raise ValueError(f"--seconds: must be above 0, got {seconds:g}")
    console = page()
    changes: list[dict[str, object]] = []
    last: tuple[object, ...] | None = None
    looks = 0
    with open_port(port) as controller, _until_interrupted():
        start = time.monotonic()
        while seconds is None or time.monotonic() - start < seconds:
            status = controller.status()
            looks += 1
            shown = (
                status.state,
                status.runs,
                status.late,
                status.bad_frames,
                status.stored_crc32,
            )
            if shown != last:
                change = {"after_s": time.monotonic() - start, **_status_figures(status)}
                changes.append(change)
                if not as_json:
                    console.print(
                        f"{change['after_s']:9.3f} s  {_name(status):7s} plays {status.runs} "
                        f" missed edges {status.late}  bad frames {status.bad_frames}  CRC32"
                        f" 0x{status.stored_crc32:08x}"
                    )
            last = shown
            time.sleep(
                every_s
                if seconds is None
                else min(every_s, max(0.0, start + seconds - time.monotonic()))
            )
    finish(
        {"port": port, "looks": looks, "changes": changes},
        as_json=as_json,
        show=lambda console: console.print(f"{port}: {looks} looks, {len(changes)} states seen"),
    )


hw.command("verify")(verify)
hw.command("emulate")(emulate)


@contextmanager
def _until_interrupted() -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt:
        return  # the ordinary end of watching: the controller is left as it is


def _hello_figures(told: Hello) -> dict[str, object]:
    return {
        "firmware": told.firmware,
        "protocol": f"CXP{told.version}",
        "max_chips": told.max_chips,
        "tick_ns": told.tick_ns,
        "min_chip_ns": told.min_ticks * told.tick_ns,
        "max_chip_ns": told.max_ticks * told.tick_ns,
        "max_on_ns": None if told.max_on_ticks is None else told.max_on_ticks * told.tick_ns,
        "max_duty": told.max_duty,
        "lead_ns": told.lead_ns,
        "trigger_input": told.trigger_input,
        "fractions": told.fractions,
        "reset_cause": told.reset_cause.name.lower(),
    }


def _name(status: Status) -> str:
    return status.state.name.lower()


def _status_figures(status: Status) -> dict[str, object]:
    return {
        "state": _name(status),
        "position": status.pos,
        "plays": status.runs,
        "missed_edges": status.late,
        "bad_frames": status.bad_frames,
        "uptime_s": status.uptime_us * 1e-6,
        "stored_crc32": f"0x{status.stored_crc32:08x}" if status.stored_crc32 else None,
    }
