"""Report of the coded-exposure table: Markdown, CSV and JSON tables, the figures of every photo,
and a picture.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import mean, median
from typing import TYPE_CHECKING

from cep.files.foreign_text import in_code_span, markdown_text
from cep.jobs.cells import Figure as Measured
from lab.bench.coded.designs import DESIGNS
from lab.bench.coded.picture import coded_figure
from lab.bench.coded.protocol import CodedProtocol
from lab.bench.coded.run import ESTIMATORS, CodedTable
from lab.bench.coded.tables import harmed, shots_csv
from lab.bench.table_io import (
    means_in_words,
    report_files,
    tables_markdown,
    write_figure,
    write_report_files,
)
from lab.bench.tables import Table
from motdiff.files.outputs import new_folder

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NAME = "cep"
_PHOTOS = "-photos.csv"
OUTPUTS = report_files(_NAME, _PHOTOS)
"""Files of the table."""

_RESTORED_BY = {
    "psf": " with the true coded PSF.",
    "path": (
        ", which knows the true path but has to find in which direction the camera ran along it"
        " (with the oracles' codes it knows that too)."
    ),
    "estimate": (
        ", which knows the path that the code was made for, but not in which direction the camera"
        " ran along it (the oracle's: the truth; codes made for none: our estimate)."
    ),
    "blind": " with the kernel that the search of PMP finds in that photo alone.",
}
_RIGHT_PX = 1.0
_MNC = "kernel_mnc"
_PICTURED = ("calibrated-4", "both-ways", "parametric", "dce", "dnf", "snapshot", "open")


def write_coded_report(
    folder: Path,
    tables: Sequence[Table],
    measured: CodedTable,
    *,
    command: str,
    warnings: Sequence[str],
    force: bool = False,
) -> dict[str, Path]:
    """Write :data:`OUTPUTS`, all or nothing; the picture where anything was measured.

    Parameters
    ----------
    folder : Path, made where it is missing
    tables : sequence of Table
    measured : CodedTable
    command : str
        Command that reproduces them.
    warnings : sequence of str
    force : bool
        Whether existing files may be replaced.

    Returns
    -------
    dict from a file's name to its path
    """
    with new_folder(folder, OUTPUTS, force=force) as made:
        text = _introduction(measured, tables, command, warnings) + tables_markdown(tables)
        if measured.shots:
            write_figure(_figure(measured), made, _NAME)
            text += "\n![photo, coded photo with code and PSF, restored photo, MTF](cep.png)\n"
        names = write_report_files(
            made,
            _NAME,
            tables,
            text=text,
            cells=(_PHOTOS, shots_csv(measured)),
            command=command,
            seed=measured.protocol.seed,
            machines=measured.machines,
            warnings=warnings,
        )
    return {name: folder / name for name in names}


def _figure(measured: CodedTable) -> Figure:
    # after Ctrl-C there may be none at the calibration photo's level
    taken = dict.fromkeys(shot.photons for shot in measured.shots)
    level = min(taken, key=lambda one: abs((one or 0) - measured.protocol.calibration_photons))
    at = [shot for shot in measured.shots if shot.photons == level]
    photo = at[0].photo
    motion = at[0].motion
    shown = {shot.design: shot for shot in at if (shot.photo, shot.motion) == (photo, motion)}
    wanted = (*_PICTURED, *(name for name in shown if name not in DESIGNS))
    picked = {name: shown[name] for name in wanted if name in shown} or shown
    return coded_figure(
        {name: shot.arguments for name, shot in picked.items()},
        {name: f"{float(shot.figures['psnr_db'] or 0):.2f} dB" for name, shot in picked.items()},
        linear=bool(measured.protocol.photons),
    )


def _light(protocol: CodedProtocol) -> str:
    if not protocol.photons:
        return ""
    said = f", motions estimated at {protocol.calibration_photons:,.0f} photo-electrons"
    return said + (", codes searched for each light level" if protocol.objective == "mse" else "")


def _found(measured: CodedTable) -> list[str]:
    """How good the estimates and calibrations are, a line for each kind."""
    by_kind: dict[str, dict[tuple[str, int], Mapping[str, Measured]]] = {}
    for (kind, photo, index), figures in measured.estimates.items():
        if figures:  # a calibration is the same for all photos
            by_kind.setdefault(kind, {})["" if "error_px" in figures else photo, index] = figures
    lines = []
    for kind, found in by_kind.items():
        mncs, cpu_s = (
            [float(one[name] or 0) for one in found.values()] for name in ("mnc", "cpu_s")
        )
        line = (
            f"{len(found)} of mean MNC {mean(mncs):.3f}, {median(cpu_s):.1f} CPU-s each in the"
            " median"
        )
        if kind in ESTIMATORS:
            lines.append(f"\nPaths estimated from an open photo by {ESTIMATORS[kind]}: {line}.")
        else:
            errors_px = [float(one["error_px"] or 0) for one in found.values()]
            right = sum(error_px <= _RIGHT_PX for error_px in errors_px)
            lines.append(
                f"\nCalibrations, {kind}: {line}; {right} within {_RIGHT_PX:g} px of the truth at"
                f" equal times, error {median(errors_px):.2f} px in the median."
            )
    for name in dict.fromkeys(shot.design for shot in measured.shots):
        if mncs := [
            float(mnc)
            for shot in measured.shots
            if shot.design == name and (mnc := shot.figures.get(_MNC))
        ]:
            lines.append(
                f"\nKernels found in the photos themselves, {markdown_text(name)}: {len(mncs)} of"
                f" mean MNC {mean(mncs):.3f}."
            )
    left_out = [name for name, design in DESIGNS.items() if design.only_named]
    if not {shot.design for shot in measured.shots} & set(left_out):
        lines.append(f"\nMeasured only where `--designs` names them: {', '.join(left_out)}.")
    return lines


def _introduction(
    measured: CodedTable, tables: Sequence[Table], command: str, warnings: Sequence[str]
) -> str:
    protocol = measured.protocol
    photos = len({shot.photo for shot in measured.shots})
    own = list(dict.fromkeys(shot.design for shot in measured.shots if shot.design not in DESIGNS))
    counts = {name: harmed(measured, name) for name in ("both-ways", "one-way", *own)}
    machines = "; ".join(
        f"{m['processor']}, {m['cores']} cores, Python {m['python']}" for m in measured.machines
    )
    head = [
        "# The coded-exposure table",
        "",
        (
            f"Made by {in_code_span(command)}, protocol {in_code_span(protocol.name)}, seed"
            f" {protocol.seed}, on {machines or 'no machine'}."
        ),
        (
            f"{photos} photos, {protocol.motions} motions each{_light(protocol)}. {protocol.chips}"
            f" chips (DCE: 32); searches keep {protocol.open_range[0]} to {protocol.open_range[1]}"
            f" of them open and have {protocol.steps:,} moves each for `{protocol.objective}`"
            " (DNF: always `noise`, of a straight blur); snapshots, strobes and published codes"
            " are as they are, and so are codes that were given. Restored by"
            f" `{protocol.restoration}`{_RESTORED_BY[protocol.restored_by]}"
        ),
        (
            ""
            if protocol.photons
            else (
                "Every photo has the light of the open shutter, as if coding cost none: snapshots"
                " and strobes, which shut out the most, are shown apart."
            )
        ),
        (
            f"{means_in_words(tables)} PSNR and SSIM up to shift, 32 px of border left out. A"
            " noise gain is infinite where the MTF has a zero on a line, as an open shutter's has"
            " on straight motion."
        ),
        *(f"\n- {markdown_text(warning)}" for warning in warnings),
        *_found(measured),
        *(
            f"\n{markdown_text(name)}: noise gain in the worse direction above the open shutter's"
            f" in {bad} of {count} photos."
            for name, (bad, count) in counts.items()
            if count
        ),
        "",
        "",
    ]
    return "\n".join(head)
