"""``cep hw``: a shutter controller: its state, clock, trigger and abort."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import typer

from cep.commands.console import Page, Table, finish, print_page, progress
from cep.commands.emulate import emulate
from cep.commands.hardware_options import Driver, Port, named_port, open_controller
from cep.commands.options import Json, command, flag, option
from cep.commands.timing import timing
from cep.commands.verify import verify

if TYPE_CHECKING:
    from hw.cxp.protocol import Hello, Status

_LOOK_S = 0.05  # between two questions for the state
_CRYSTAL_PPM = 200  # a quartz crystal is within 100 ppm, with room for the host's own

hw = typer.Typer(
    help="A shutter controller: its state, clock, trigger and abort.", no_args_is_help=True
)


@dataclass(frozen=True, kw_only=True)
class InfoOptions:
    """Options of ``cep hw info``."""

    port: str | None = option("--port", None, "Controller to ask, as in cep upload.", short="-p")
    ask: bool = flag(
        "--ask", "Greet every port: resets many boards, and foreign devices hear it too."
    )
    watch: float | None = option(
        "--watch", "SECONDS", "Follow the controller's state for so long; Ctrl-C ends it sooner."
    )
    as_json: Json = False


@hw.command("info")
@command(InfoOptions)
def info(options: InfoOptions) -> None:
    """List the serial ports, or with --port show a controller's limits and state.

    Example: cep hw info --ask

    Example: cep hw info --port /dev/ttyACM0
    """
    if options.port is None:
        if options.watch is not None:
            raise ValueError("--watch: needs --port")
        _list_ports(ask=options.ask, as_json=options.as_json)
        return
    if options.ask:
        raise ValueError("--ask: not valid with --port")
    if options.watch is not None:
        _watch(options.port, options.watch, as_json=options.as_json)
        return
    with open_controller(options.port) as controller:
        status = controller.status()
    result = {
        "port": options.port,
        **_hello_figures(controller.announced),
        **_status_figures(status),
        "trust": f"{controller.trust} at most",
    }
    rows = [(name.replace("_", " "), str(value)) for name, value in result.items()]
    finish(result, [Table(options.port, ("", ""), rows)], as_json=options.as_json)


@dataclass(frozen=True, kw_only=True)
class PortOptions:
    """A controller on a port."""

    port: Port
    as_json: Json = False


@hw.command("trigger")
@command(PortOptions)
def trigger(options: PortOptions) -> None:
    """Play what is armed, once, and wait for its end.

    Example: cep hw trigger --port /dev/ttyACM0
    """
    from cep.shutter.play import open_shutter

    with open_shutter(named_port(options.port)) as shutter:
        status = shutter.play()
    finish(
        _confirmed(options.port, status),
        [f"{options.port}: played, 0 edges missed, shutter closed"],
        as_json=options.as_json,
    )


@dataclass(frozen=True, kw_only=True)
class AbortOptions(PortOptions):
    """Options of ``cep hw abort``."""

    driver: Driver = "cxp"


@hw.command("abort")
@command(AbortOptions)
def abort(options: AbortOptions) -> None:
    """Close the shutter and disarm, whatever it is doing.

    Example: cep hw abort --port /dev/ttyACM0
    """
    from cep.shutter.play import open_shutter

    with open_shutter(named_port(options.port), driver=options.driver) as shutter:
        status = shutter.abort()
    words = [f"{options.port}: closed"]
    if status is not None:  # only CXP controllers tell their state
        words.append(_name(status))
    finish(_confirmed(options.port, status), [", ".join(words)], as_json=options.as_json)


@dataclass(frozen=True, kw_only=True)
class CalibrateOptions(PortOptions):
    """Options of ``cep hw calibrate``."""

    seconds: float = option("--seconds", None, "How long to compare the clocks, s.", 10.0)


@hw.command("calibrate")
@command(CalibrateOptions)
def calibrate(options: CalibrateOptions) -> None:
    """Measure a controller's clock against this computer's.

    The figure goes into --clock-ppm of cep upload, which stretches the chips by it.

    Example: cep hw calibrate --port /dev/ttyACM0 --seconds 20
    """
    from hw.drivers.cxp import measure_clock

    if not 0 < options.seconds < 3600:
        raise ValueError(f"--seconds: must be above 0 and below 3600, got {options.seconds:g}")
    with open_controller(options.port) as controller, progress("comparing clocks") as tick:
        fit = measure_clock(controller, seconds=options.seconds, progress=tick)
    warnings = []
    if abs(fit.ppm) > _CRYSTAL_PPM + fit.uncertainty_ppm:
        warnings.append(
            "a crystal is within 100 ppm, so this is a ceramic resonator, which drifts with"
            " temperature: calibrate it warm"
        )
    result = {
        "port": options.port,
        "clock_ppm": fit.ppm,
        "uncertainty_ppm": fit.uncertainty_ppm,
        "seconds": fit.seconds,
        "samples": fit.samples,
        "warnings": warnings,
    }
    finish(
        result,
        [
            f"{options.port}: clock is {abs(fit.ppm):.0f} ppm"
            f" {'fast' if fit.ppm >= 0 else 'slow'} (± {fit.uncertainty_ppm:.0f});"
            f" --clock-ppm {fit.ppm:.0f} takes it out"
        ],
        as_json=options.as_json,
    )


hw.command("timing")(timing)
hw.command("verify")(verify)
hw.command("emulate")(emulate)


def _list_ports(*, ask: bool, as_json: bool) -> None:
    from hw.cxp.link import ask_ports
    from hw.cxp.protocol import Hello
    from hw.port import PortInfo, list_ports

    answers: dict[PortInfo, Hello | str | None] = dict.fromkeys(list_ports())
    if ask:
        answers |= ask_ports()
    ports = []
    rows = []
    for port, answer in answers.items():
        about = {
            "port": port.port,
            "description": port.description,
            "serial_number": port.serial_number,
        }
        firmware = answer.firmware if isinstance(answer, Hello) else None
        reply = {
            "firmware": firmware,
            "controller": None if answer is None else firmware is not None,
            "answer": None if firmware is not None else answer,
        }
        ports.append({**about, **reply})
        rows.append((*about.values(), firmware or answer or "not asked"))
    page: Page = ["no serial ports"]
    if rows:
        heads = ("port", "description", "USB serial number", "controller")
        page = [Table("serial ports", heads, rows)]
    finish({"ports": ports}, page, as_json=as_json)


def _watch(port: str, seconds: float, *, as_json: bool) -> None:
    """Print every change of the state, from now on; the controller is left as it is."""
    if not seconds > 0:
        raise ValueError(f"--watch: must be above 0, got {seconds:g}")
    changes: list[dict[str, object]] = []
    last: tuple[object, ...] | None = None
    looks = 0
    # Ctrl-C is the ordinary end of watching: the controller is left as it is
    with open_controller(port) as controller, suppress(KeyboardInterrupt):
        start_s = time.monotonic()
        while (after_s := time.monotonic() - start_s) < seconds:
            status = controller.status()
            looks += 1
            # not the position and the time, which change at every look
            state = (
                status.state,
                status.runs,
                status.late,
                status.bad_frames,
                status.stored_crc32,
            )
            if state != last:
                changes.append({"after_s": after_s, **_status_figures(status)})
                if not as_json:
                    line = (
                        f"{after_s:9.3f} s  {_name(status):7s} plays {status.runs}  missed edges"
                        f" {status.late}  bad frames {status.bad_frames}  CRC32"
                        f" 0x{status.stored_crc32:08x}"
                    )
                    print_page([line])
            last = state
            time.sleep(min(_LOOK_S, max(0.0, start_s + seconds - time.monotonic())))
    finish(
        {"port": port, "looks": looks, "changes": changes},
        [f"{port}: {looks} looks, {len(changes)} states seen"],
        as_json=as_json,
    )


def _confirmed(port: str, status: Status | None) -> dict[str, object]:
    """Return the JSON of a request that the device acknowledged: trust B."""
    figures: dict[str, object] = {}
    if status is not None:  # drivers other than CXP's have none
        figures = _status_figures(status)
    return {"port": port, **figures, "trust": "B"}


def _hello_figures(hello: Hello) -> dict[str, object]:
    return {
        "firmware": hello.firmware,
        "protocol": f"CXP{hello.version}",
        "max_chips": hello.max_chips,
        "tick_ns": hello.tick_ns,
        "min_chip_ns": hello.min_ticks * hello.tick_ns,
        "max_chip_ns": hello.max_ticks * hello.tick_ns,
        "max_on_ns": hello.max_on_ns,
        "max_duty": hello.max_duty,
        "lead_ns": hello.lead_ns,
        "trigger_input": hello.trigger_input,
        "fractions": hello.fractions,
        "reset_cause": hello.reset_cause.name.lower(),
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
        # 0 where no program is stored
        "stored_crc32": f"0x{status.stored_crc32:08x}" if status.stored_crc32 else None,
    }
