"""``cep export`` and ``cep upload``: a code on its way to the shutter."""

from __future__ import annotations

from dataclasses import MISSING, dataclass
from pathlib import Path

from cep.commands.console import finish
from cep.commands.options import Force, Json, command, flag, option, output_option
from cep.commands.programs import ClockPpm, Driver, PlayableCode, Port, named_port, program_figures
from hw.export import EXPORTERS

_FORMATS = "\n\n".join(f"{name}: {exporter.summary}" for name, exporter in EXPORTERS.items())


@dataclass(frozen=True, kw_only=True)
class ExportOptions(PlayableCode):
    """Options of ``cep export``."""

    file_format: str = option("--format", None, _FORMATS, default=MISSING, short="-f")
    output: Path | None = output_option(
        "File to write; CODE.SUFFIX when omitted (json: CODE.program.json, rp2: CODE_rp2.py)."
    )
    force: Force = False
    as_json: Json = False


@command(ExportOptions)
def export(options: ExportOptions) -> None:
    """Write a code as a timed shutter program, and read it back to prove the edges.

    Chips are rounded to the format's ticks, as 0.5 us of an Uno, where that changes them by half a
    percent at most; a warning says so. The program is checked against the shutter that the code
    was searched for, or --device.

    Example: cep export code.json --format c -o shutter_code.h
    """
    from cep.codes.sources import COMPLEMENT, code_file
    from cep.shutter.play import on_ticks
    from hw.drivers import Trust
    from hw.export import export_program, find_exporter
    from motdiff.files.outputs import claim, write_text

    exporter = find_exporter(options.file_format)
    program, stored = options.timed_program()
    # chips last whole ticks of the format's clock, which may round them
    program, warnings = on_ticks(program, exporter.tick_ns)
    profile = options.checked_profile(program, stored)
    file = code_file(options.code)
    stem = Path(file or "code").stem
    if options.code.startswith(COMPLEMENT):
        stem += "_complement"  # beside the file of the first shutter
    target = options.output or Path(exporter.file_name(stem))
    outputs = claim([target], force=options.force, inputs=filter(None, [file]))
    text = export_program(program, options.file_format, device=profile)
    result = {
        "file": target,
        "format": options.file_format,
        **program_figures(program, profile),
        "trust": Trust.C.value,
        "warnings": [f"{target}: {warning}" for warning in warnings],
    }
    line = (
        f"{target}: {program.chips} chips of {program.chip_ns} ns, {program.pulses} openings,"
        f" {program.duration_ns / 1e6:.4g} ms; read back, edges identical; trust C:"
        f" {Trust.C.meaning}"
    )
    finish(
        result,
        [line],
        as_json=options.as_json,
        outputs=outputs,
        save=lambda staged: write_text(staged[target], text),
    )


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
    if options.clock_ppm and not DRIVERS[driver].capabilities.stretches_chips:
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
