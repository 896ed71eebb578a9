"""``cep upload``: a code loaded into a shutter controller."""

from __future__ import annotations

from dataclasses import dataclass

from cep.commands.console import finish
from cep.commands.hardware_options import (
    ClockPpm,
    Driver,
    PlayableCode,
    Port,
    named_port,
    program_figures,
)
from cep.commands.options import Json, command, flag


@dataclass(frozen=True, kw_only=True)
class UploadOptions(PlayableCode):
    """Options of ``cep upload``."""

    port: Port
    driver: Driver = "cxp"
    arm: bool = flag("--arm", "Arm when the program is verified: the next trigger plays it.")
    play: bool = flag("--play", "Play it once, now, and wait for its end.")
    clock_ppm: ClockPpm = 0.0
    as_json: Json = False


@command(UploadOptions)
def upload(options: UploadOptions) -> None:
    """Load a code into a shutter controller, read it back where it can be, and arm or play it.

    Only cxp reads back, disarms itself after 10 s and takes --clock-ppm; the others stay armed
    until the next upload, or cep hw abort.

    Example: cep upload code.json --port /dev/ttyACM0 --arm
    """
    from cep.shutter.play import open_shutter
    from hw.drivers import DRIVERS

    driver = options.driver
    if driver not in DRIVERS:
        raise ValueError(f"--driver: must be one of {', '.join(DRIVERS)}, got {driver[:40]!r}")
    if options.arm and options.play:
        raise ValueError("--arm and --play: give one of them, --play arms by itself")
    if options.clock_ppm and not DRIVERS[driver].stretches_chips:
        raise ValueError(f"--clock-ppm: {driver} cannot stretch chips, only cxp does")
    named_port(options.port)
    program, stored = options.timed_program()
    profile = options.checked_profile(program, stored)
    with open_shutter(options.port, driver=driver) as shutter:
        report = shutter.upload(
            program,
            profile=profile,
            arm=options.arm,
            play=options.play,
            clock_ppm=options.clock_ppm,
        )
    result = {
        "port": report.port,
        "driver": driver,
        **program_figures(program, profile),
        "firmware": report.firmware,
        "trust": report.trust.value,
        "read_back": report.read_back,
        "armed": report.armed,
        "played": options.play,
        "lease_ms": report.lease_ms,
        "clock_ppm": report.clock_ppm,
        "retries": report.retries,
        "seconds": report.seconds,
        "warnings": report.warnings,
    }
    state = ""
    if options.play:
        state = "; played once"
    elif options.arm and not report.armed:
        state = "; armed and triggered already"
    elif options.arm:
        state = "; armed"
        if report.lease_ms:  # a CXP controller disarms itself
            state += f" for {report.lease_ms} ms"
    finish(
        result,
        [
            f"{report.port}: {program.chips} chips of {program.chip_ns} ns loaded, trust"
            f" {report.trust}: {report.trust.meaning}{state}"
        ],
        as_json=options.as_json,
    )
