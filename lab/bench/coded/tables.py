"""Tables of coded exposure: quality of the photos, noise gain, and the share of photos that coding
harms.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from cep.files.tables import csv_lines
from cep.jobs.cells import Figure
from lab.bench.coded.designs import design_of
from lab.bench.coded.run import CodedTable, Shot
from lab.bench.tables import Column, Table, differences, tabulate

Name = tuple[str, ...]
_QUALITY = (
    Column("psnr_db", "PSNR, dB", better="high"),
    Column("ssim", "SSIM", better="high", digits=3),
)
_PLAIN = tuple(Column(column.figure, column.head, digits=column.digits) for column in _QUALITY)
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
        designs = list(
            dict.fromkeys(shot.design for shot in shots)
        )  # after Ctrl-C not the same at every level
        if not shots:
            continue
        figures = _figures(shots)
        light = "" if level is None else f", {level:,.0f} photo-electrons"
        title = f"Coded exposure, {measured.protocol.name}{light}"
        apart = {design_of(name).label for name in designs if beyond_comparison(measured, name)}
        rivals = {name: own for name, own in figures.items() if name[0] not in apart}
        limits = {name: own for name, own in figures.items() if name[0] in apart}
        if rivals:
            tables.append(_table(title, rivals, _QUALITY, measured))
        if limits:
            tables.append(_table(f"{title}: rows beyond comparison", limits, _PLAIN, measured))
        for label in (
            design_of(name).label
            for name in designs
            if design_of(name).compared and len(designs) > 1
        ):
            less = differences(figures, label)
            tables.append(_table(f"{label} less each other row{light}", less, _PLAIN, measured))
        gains = (*_GAIN, _ZEROS) if any(own["zero"] for own in figures.values()) else _GAIN
        tables.append(
            _table(
                f"Noise gain of the codes along the true motion{light}", figures, gains, measured
            )
        )
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
        numbers = (shot.figures.get(name) for name in names)
        rows.append(
            (
                shot.design,
                shot.photo,
                shot.motion,
                "" if shot.photons is None else f"{shot.photons:g}",
                *("" if number is None else f"{float(number):.6g}" for number in numbers),
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
    return tabulate(
        title, figures, columns, rng=rng, row=0, cluster=(1, 2), counted={"motions": 2}
    )


def _worse(figures: Mapping[str, Figure]) -> float:
    gains = [figures.get(name) for name in ("noise_gain_db", "reversed_noise_gain_db")]
    return max((float(gain) for gain in gains if gain is not None), default=math.nan)
