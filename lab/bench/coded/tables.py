"""Tables of coded exposure: quality of the photos, noise gain, and the share of photos that coding
harms.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from cep.files.tables import csv_lines
from lab.bench.coded.designs import design_of
from lab.bench.coded.run import CodedTable, Shot
from lab.bench.table_io import number_text
from lab.bench.tables import Column, Table, differences, tabulate, unranked
from lab.jobs.cells import Figure

Name = tuple[str, ...]
_QUALITY = (
    Column("psnr_db", "PSNR, dB", better="high"),
    Column("ssim", "SSIM", better="high", digits=3),
)
_GAIN = (  # infinite where an open shutter meets a straight motion
    Column("noise_gain_db", "noise gain, dB, median", middle="median"),
    Column("worse_noise_gain_db", "worse direction, dB, median", middle="median"),
)
_ZEROS = Column("zero", "zeros, share", middle="share")
_FREE_LIGHT = ("snapshot", "class-snapshot", "strobe")


def coded_tables(measured: CodedTable) -> list[Table]:
    """Lay out the tables: per light level the quality, each compared row less every other one, and
    the noise gains.

    Compared are ours and codes of the user's own: :attr:`lab.bench.coded.designs.Design.compared`.
    """
    tables = []
    for level in measured.protocol.levels:
        shots = [shot for shot in measured.shots if shot.photons == level]
        if not shots:
            continue
        designs = list(dict.fromkeys(shot.design for shot in shots))
        figures = _figures(shots)
        light = "" if level is None else f", {level:,.0f} photo-electrons"
        title = f"Coded exposure, {measured.protocol.name}{light}"
        apart = {design_of(name).label for name in designs if beyond_comparison(measured, name)}
        rivals = {name: cell for name, cell in figures.items() if name[0] not in apart}
        limits = {name: cell for name, cell in figures.items() if name[0] in apart}
        if rivals:
            tables.append(_table(title, rivals, _QUALITY, measured))
        if limits:
            head = f"{title}: rows beyond comparison"
            tables.append(_table(head, limits, unranked(_QUALITY), measured))
        for design in map(design_of, designs):
            if design.compared and len(designs) > 1:
                less = differences(figures, design.label)
                head = f"{design.label} less each other row{light}"
                tables.append(_table(head, less, unranked(_QUALITY), measured))
        gains = (*_GAIN, _ZEROS) if any(cell["zero"] for cell in figures.values()) else _GAIN
        head = f"Noise gain of the codes along the true motion{light}"
        tables.append(_table(head, figures, gains, measured))
    return tables


def beyond_comparison(measured: CodedTable, design: str) -> bool:
    """Whether a row is no rival of the others: its prior is the truth, or the light it blocks
    costs it nothing.

    Where coding costs no light, the shorter an exposure the better, and a snapshot is no code.
    """
    free = not measured.protocol.photons and design in _FREE_LIGHT
    return free or design_of(design).uses_truth


def harmed(measured: CodedTable, design: str) -> tuple[int, int]:
    """Count photos where a design's noise gain, in its worse direction, is above the open
    shutter's.

    Returns
    -------
    (int, int)
        Harmed, and compared.
    """
    worse = {
        (shot.design, shot.photo, shot.motion, shot.photons): _worse(shot.figures)
        for shot in measured.shots
    }
    pairs = [
        (gain, worse["open", photo, motion, level])
        for (name, photo, motion, level), gain in worse.items()
        if name == design and ("open", photo, motion, level) in worse
    ]
    return sum(coded > plain for coded, plain in pairs), len(pairs)


def shots_csv(measured: CodedTable) -> str:
    """Lay out every photo as CSV."""
    names = ("psnr_db", "ssim", "noise_gain_db", "reversed_noise_gain_db", "min_mtf", "kernel_mnc")
    rows: list[tuple[object, ...]] = [("design", "photo", "motion", "photons", *names, "bits")]
    for shot in measured.shots:
        figures = (shot.figures.get(name) for name in names)
        rows.append(
            (
                shot.design,
                shot.photo,
                shot.motion,
                "" if shot.photons is None else f"{shot.photons:g}",
                *(number_text(None if figure is None else float(figure)) for figure in figures),
                shot.bits,
            )
        )
    return csv_lines(rows)


def _figures(shots: Sequence[Shot]) -> dict[Name, Mapping[str, Figure]]:
    return {
        (design_of(shot.design).label, shot.photo, str(shot.motion)): {
            **shot.figures,
            "worse_noise_gain_db": _worse(shot.figures),
            "zero": float(math.isinf(_worse(shot.figures))),
        }
        for shot in shots
    }


def _table(
    title: str,
    figures: Mapping[Name, Mapping[str, Figure]],
    columns: Sequence[Column],
    measured: CodedTable,
) -> Table:
    rng = np.random.default_rng([measured.protocol.seed, 4])
    # every photo is taken with the same motions: cluster by both
    return tabulate(title, figures, columns, rng=rng, cluster=(1, 2), counted={"motions": 2})


def _worse(figures: Mapping[str, Figure]) -> float:
    gains = [figures.get(name) for name in ("noise_gain_db", "reversed_noise_gain_db")]
    return max((float(gain) for gain in gains if gain is not None), default=math.nan)
