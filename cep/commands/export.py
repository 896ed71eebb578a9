"""``cep export``: a code as a timed program for a shutter."""

from __future__ import annotations

from dataclasses import MISSING, dataclass
from pathlib import Path

from cep.commands.console import finish
from cep.commands.hardware_options import PlayableCode, program_figures
from cep.commands.options import Force, Json, command, option, output_option
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
