"""Run of an evaluation, case by case; rows are saved at once, so that Ctrl-C loses nothing."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from motdiff.crops import CROP_PX
from motdiff.estimators.base import Estimator
from motdiff.evaluation.floors import ceilings, floors, mean_kernel
from motdiff.evaluation.measure import Measured, Row, measure_estimator, measure_psf
from motdiff.evaluation.sets import RECIPES, Case, levin, load_scenes, simulated
from motdiff.evaluation.tables import csv_line
from motdiff.simulate import border_px

__all__ = ["CaseSet", "Outcome", "evaluate", "levin_set", "simulated_sets"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class CaseSet:
    """Cases to measure on.

    Attributes
    ----------
    name : str
    cases : iterator of Case
        Made when they are asked for.
    count : int
        How many there are.
    mean : (S, S) float, optional
        Mean kernel of other motions of the kind, where the kind is known.
    """

    name: str
    cases: Iterator[Case]
    count: int
    mean: FloatArray | None = None


@dataclass
class Outcome:
    """Results measured so far.

    Attributes
    ----------
    rows : list of Row
    shown : dict from set to cases
        The first cases of each set, for its contact sheet.
    kernels : dict from set to method to case name to PSF
        Of the shown cases.
    stopped : bool
        Ctrl-C came before the end.
    """

    rows: list[Row] = field(default_factory=list)
    shown: dict[str, list[Case]] = field(default_factory=dict)
    kernels: dict[str, dict[str, dict[str, FloatArray]]] = field(default_factory=dict)
    stopped: bool = False


def simulated_sets(
    names: Sequence[str],
    photos: Path | str,
    *,
    count: int,
    seed: int,
    sigma: float | None = None,
    gyro_trace: Path | str | None = None,
    grey: bool = False,
) -> list[CaseSet]:
    """Prepare simulated sets; all of them use the same photos, in the same order.

    Parameters
    ----------
    names : sequence of the names in :data:`motdiff.evaluation.sets.RECIPES`
    photos : folder of sharp photos, or a pack
    count, seed : int
    sigma : float, optional
        Noise, instead of each recipe's own.
    gyro_trace : path, optional
        Recording, needed by "gyro".
    grey : bool
        Photos of one channel.

    Raises
    ------
    ValueError
        If a set is unknown, or an input that it needs is missing.
    """
    if unknown := [name for name in names if name not in RECIPES]:
        raise ValueError(f"set: must be one of {', '.join(RECIPES)}, got {unknown[0]!r}")
    if count < 1:
        raise ValueError(f"count: must be at least 1, got {count}")
    mixes = {name: RECIPES[name].mix(gyro_trace) for name in names}
    scenes = load_scenes(photos, least_px=CROP_PX + border_px("real"), grey=grey)
    return [
        CaseSet(
            name,
            simulated(
                scenes,
                count=count,
                seed=seed,
                mix=mix,
                sigma=RECIPES[name].sigma if sigma is None else sigma,
                borders=RECIPES[name].borders,
            ),
            count,
            mean_kernel(mix, seed=seed),
        )
        for name, mix in mixes.items()
    ]


def levin_set(folder: Path | str) -> CaseSet:
    """Prepare Levin's photos, all of the folder."""
    return CaseSet("levin", levin(folder), len(list(Path(folder).glob("*.mat"))))


def evaluate(
    sets: Sequence[CaseSet],
    estimators: Mapping[str, Estimator],
    out: Path,
    *,
    restore: bool = True,
    shown: int = 8,
    report: Callable[[str], None] = lambda _line: None,
) -> Outcome:
    """Measure floors, estimators and ceilings on every case; each row goes to ``out/rows.csv`` at once.

    Parameters
    ----------
    sets : sequence of CaseSet
    estimators : mapping from the name in the tables to Estimator
    out : folder, made where it is missing
    restore : bool
        Whether photos are restored to measure PSNR and SSIM (0.9 CPU-s per row).
    shown : int
        Cases kept for each contact sheet.
    report : callable
        Called with a line of progress.

    Returns
    -------
    Outcome; after Ctrl-C the cases until then, with ``stopped``
    """
    out.mkdir(parents=True, exist_ok=True)
    outcome = Outcome()
    began_s, done, total = time.monotonic(), 0, sum(case_set.count for case_set in sets)
    with (out / "rows.csv").open("w", encoding="utf-8", buffering=1) as table:
        table.write(csv_line(f.name for f in fields(Row)))
        try:
            for case_set in sets:
                seen = outcome.shown.setdefault(case_set.name, [])
                for number, case in enumerate(case_set.cases, 1):
                    if len(seen) < shown:
                        seen.append(case)
                    for measured in _measured(case_set, case, estimators, restore):
                        row = measured.row
                        table.write(csv_line(getattr(row, f.name) for f in fields(Row)))
                        outcome.rows.append(row)
                        if measured.psf is not None and any(shown_case is case for shown_case in seen):
                            by_method = outcome.kernels.setdefault(case_set.name, {})
                            by_method.setdefault(row.method, {})[case.name] = measured.psf
                        if row.method in estimators:
                            report(f"{case_set.name} {number}/{case_set.count}  {row.method}  {_in_short(row)}")
                    done += 1
                    left_min = (total - done) * (time.monotonic() - began_s) / done / 60
                    report(f"{case_set.name} {number}/{case_set.count} done, {left_min:.1f} min left")
        except KeyboardInterrupt:
            outcome.stopped = True
    return outcome


def _measured(case_set: CaseSet, case: Case, estimators: Mapping[str, Estimator], restore: bool) -> Iterator[Measured]:
    for name, psf in floors(case_set.mean).items():
        yield measure_psf(case_set.name, case, name, psf, restore=restore)
    for name, estimator in estimators.items():
        yield measure_estimator(case_set.name, case, name, estimator, restore=restore)
    for name, psf in ceilings(case).items():
        yield measure_psf(case_set.name, case, name, psf, restore=restore)


def _in_short(row: Row) -> str:
    if row.failure:
        return f"failed: {row.failure}"
    return (
        f"MNC {row.mnc:.3f}  sub-pixel {row.mnc_subpixel:.3f}  path {row.path_mnc:.3f}  "
        f"conf {row.confidence:.2f}  {row.cpu_s:.1f} CPU-s"
    )
