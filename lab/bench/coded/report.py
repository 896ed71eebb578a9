"""Report of the coded-exposure table: Markdown, CSV and JSON tables, the figures of every photo,
and a picture.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import mean, median
from typing import TYPE_CHECKING

from cep.files.foreign_text import markdown_text
from lab.bench.coded.designs import DESIGNS
from lab.bench.coded.estimates import ESTIMATORS
from lab.bench.coded.picture import coded_figure
from lab.bench.coded.protocol import CodedProtocol
from lab.bench.coded.run import CodedTable
from lab.bench.coded.tables import coded_tables, harmed, shots_csv
from lab.bench.harness import Report, file_names, in_code_span, report_of_means, warning_lines
from lab.bench.table_io import Provenance, means_in_words
from lab.bench.tables import Table
from lab.jobs.cells import Figure as Measured

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PHOTOS = "-photos.csv"
OUTPUTS = file_names("cep", _PHOTOS)
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
_PICTURED = ("calibrated-4", "both-ways", "parametric", "dce", "dnf", "snapshot", "open")


def coded_report(measured: CodedTable, provenance: Provenance) -> Report:
    """Lay out the table, with a picture where anything was measured."""
    tables = coded_tables(measured)
    figure = None
    below = ""
    if measured.shots:
        figure = _figure(measured)
        below = "\n![photo, coded photo with code and PSF, restored photo, MTF](cep.png)\n"
    return report_of_means(
        f"Coded exposure, {measured.protocol.name}",
        tables,
        provenance=provenance,
        outcome=measured.outcome,
        introduction=_introduction(measured, tables, provenance),
        below=below,
        cells=(_PHOTOS, shots_csv(measured)),
        figure=figure,
    )


def _figure(measured: CodedTable) -> Figure:
    # after Ctrl-C there may be none at the calibration photo's level
    levels = dict.fromkeys(shot.photons for shot in measured.shots)
    nearest = min(
        levels, key=lambda level: abs((level or 0) - measured.protocol.calibration_photons)
    )
    first = next(shot for shot in measured.shots if shot.photons == nearest)
    place = (first.photo, first.motion, nearest)
    shots = {
        shot.design: shot
        for shot in measured.shots
        if (shot.photo, shot.motion, shot.photons) == place
    }
    designs = (*_PICTURED, *(name for name in shots if name not in DESIGNS))
    columns = {name: shots[name] for name in designs if name in shots} or shots
    return coded_figure(
        {name: shot.arguments for name, shot in columns.items()},
        {name: f"{float(shot.figures['psnr_db'] or 0):.2f} dB" for name, shot in columns.items()},
        linear=bool(measured.protocol.photons),
    )


def _light(protocol: CodedProtocol) -> str:
    if not protocol.photons:
        return ""
    text = f", motions estimated at {protocol.calibration_photons:,.0f} photo-electrons"
    if protocol.objective == "mse":
        text += ", codes searched for each light level"
    return text


def _estimate_quality(measured: CodedTable) -> list[str]:
    """Quality of the estimates and calibrations, a line for each kind."""
    by_kind: dict[str, dict[tuple[str, int], Mapping[str, Measured]]] = {}
    for (kind, photo, index), figures in measured.estimates.items():
        if figures:  # a calibration is the same for all photos
            by_kind.setdefault(kind, {})["" if "error_px" in figures else photo, index] = figures
    lines = []
    for kind, estimates in by_kind.items():
        mncs = [float(figures["mnc"] or 0) for figures in estimates.values()]
        cpu_s = [float(figures["cpu_s"] or 0) for figures in estimates.values()]
        line = (
            f"{len(estimates)} of mean MNC {mean(mncs):.3f}, {median(cpu_s):.1f} CPU-s each in the"
            " median"
        )
        if kind in ESTIMATORS:
            lines.append(f"\nPaths estimated from an open photo by {ESTIMATORS[kind]}: {line}.")
            continue
        errors_px = [float(figures["error_px"] or 0) for figures in estimates.values()]
        right = sum(error_px <= _RIGHT_PX for error_px in errors_px)
        lines.append(
            f"\nCalibrations, {kind}: {line}; {right} within {_RIGHT_PX:g} px of the truth at"
            f" equal times, error {median(errors_px):.2f} px in the median."
        )
    kernel_mncs: dict[str, list[float]] = {}
    for shot in measured.shots:
        if mnc := shot.figures.get("kernel_mnc"):
            kernel_mncs.setdefault(shot.design, []).append(float(mnc))
    lines += [
        f"\nKernels found in the photos themselves, {markdown_text(name)}: {len(mncs)} of"
        f" mean MNC {mean(mncs):.3f}."
        for name, mncs in kernel_mncs.items()
    ]
    left_out = [name for name, design in DESIGNS.items() if design.only_named]
    if not {shot.design for shot in measured.shots} & set(left_out):
        lines.append(f"\nMeasured only where `--designs` names them: {', '.join(left_out)}.")
    return lines


def _introduction(
    measured: CodedTable, tables: Sequence[Table], provenance: Provenance
) -> list[str]:
    protocol = measured.protocol
    photos = len({shot.photo for shot in measured.shots})
    user_codes = dict.fromkeys(
        shot.design for shot in measured.shots if shot.design not in DESIGNS
    )
    counts = {name: harmed(measured, name) for name in ("both-ways", "one-way", *user_codes)}
    machines = "; ".join(
        f"{machine['processor']}, {machine['cores']} cores, Python {machine['python']}"
        for machine in provenance.machines
    )
    lent = ""
    if not protocol.photons:
        lent = (
            "Every photo has the light of the open shutter, as if coding cost none: snapshots and"
            " strobes, which shut out the most, are shown apart."
        )
    return [
        "# The coded-exposure table",
        "",
        (
            f"Made by {in_code_span(provenance.command)},"
            f" protocol {in_code_span(protocol.name)}, seed {protocol.seed},"
            f" on {machines or 'no machine'}."
        ),
        (
            f"{photos} photos, {protocol.motions} motions each{_light(protocol)}. {protocol.chips}"
            f" chips (DCE: 32); searches keep {protocol.open_range[0]} to {protocol.open_range[1]}"
            f" of them open and have {protocol.steps:,} moves each for `{protocol.objective}`"
            " (DNF: always `noise`, of a straight blur); snapshots, strobes and published codes"
            " are as they are, and so are codes that were given. Restored by"
            f" `{protocol.restoration}`{_RESTORED_BY[protocol.restored_by]}"
        ),
        lent,
        (
            f"{means_in_words(tables)} PSNR and SSIM up to shift, 32 px of border left out. A"
            " noise gain is infinite where the MTF has a zero on a line, as an open shutter's has"
            " on straight motion."
        ),
        *warning_lines(provenance.warnings),
        *_estimate_quality(measured),
        *(
            f"\n{markdown_text(name)}: noise gain in the worse direction above the open shutter's"
            f" in {bad} of {count} photos."
            for name, (bad, count) in counts.items()
            if count
        ),
    ]
