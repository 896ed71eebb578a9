"""Table by which the studio's model is corrected: `python -m lab.photo_gains.table`."""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterator
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np

import cep
from cep.optics.camera import Camera
from cep.optics.straight_motion import straight_axis
from cep.search.measured import GAINS_TABLE
from cep.search.problem import SearchProblem
from cep.search.verdict import Verdict
from motdiff.motions import boracchi_foi, quadratic
from motdiff.trajectory import Trajectory

PHOTONS = (500.0, 5_000.0, 50_000.0)
READ_NOISE_E = (2.0, 20.0, 100.0)
MOST_CHIPS = 40
ABOUT = """For each motion, read noise and light: the gain of the best single exposure and of the
best code over the open shutter, as the model of photographs expects it and as the twelve bundled
photographs show it, dB. The studio shifts its model by their differences, each case by those
nearest to it. Cases that the file has already are left; more motions or light in this file make
the table finer."""


@dataclass(frozen=True, kw_only=True)
class MeasuredGain:
    """A case of the table.

    Attributes
    ----------
    motion : str
    extent_px : float
    straight : int
        1 where the path is straight.
    photons : float
        At full scale.
    read_noise_e : float
    snapshot_model_db, code_model_db : float
        Gain over the open shutter of the best single exposure and of the best code, by the model.
    snapshot_measured_db, code_measured_db : float
        The mean over photographs.
    """

    motion: str
    extent_px: float
    straight: int
    photons: float
    read_noise_e: float
    snapshot_model_db: float
    code_model_db: float
    snapshot_measured_db: float
    code_measured_db: float


def main() -> None:
    """Write the table."""
    parser = argparse.ArgumentParser(prog="python -m lab.photo_gains.table", description=ABOUT)
    parser.add_argument("-o", "--output", type=Path, default=GAINS_TABLE)
    arguments = parser.parse_args()
    output: Path = arguments.output
    columns = [field.name for field in fields(MeasuredGain)]
    present: set[tuple[str, ...]] = set()
    if output.exists():
        with output.open(encoding="utf-8", newline="") as stream:
            present = {_case(row) for row in csv.DictReader(stream)}
    else:
        output.write_text(",".join(columns) + "\n", encoding="utf-8")
    for row in measured_gains(present):
        with output.open("a", encoding="utf-8", newline="") as stream:
            csv.writer(stream, lineterminator="\n").writerow(astuple(row))
        print(*astuple(row), flush=True)


def motions() -> dict[str, Trajectory]:
    """Return the motions of the table."""
    arcs = {
        f"arc {px:.0f} px": quadratic(
            np.random.default_rng(12), min_length_px=px, max_length_px=px + 1, max_bend=1.5
        )
        for px in (10.0, 26.0)
    }
    walks = {
        f"walk {px:.0f} px": boracchi_foi(np.random.default_rng(3), max_length_px=px)
        for px in (30.0, 60.0)
    }
    straight = {f"straight {px:.0f} px": Trajectory.straight(px) for px in (8.0, 20.0, 50.0)}
    return straight | arcs | walks


def measured_gains(present: set[tuple[str, ...]]) -> Iterator[MeasuredGain]:
    """Measure the cases that are not present."""
    for name, path in motions().items():
        chips = int(min(max(round(path.length_px), 8), MOST_CHIPS))
        for read_noise_e in READ_NOISE_E:
            for photons in PHOTONS:
                if (name, f"{read_noise_e:g}", f"{photons:g}") in present:
                    continue
                camera = Camera(photons_full_scale=photons, read_noise_e=read_noise_e, bits=16)
                problem = SearchProblem.along(path, chips=chips, camera=camera)
                model = cep.advise(problem, levels=(), photographs=()).here
                measured = cep.advise(problem, levels=()).here
                yield MeasuredGain(
                    motion=name,
                    extent_px=round(path.extent_px, 1),
                    straight=int(straight_axis(path) is not None),
                    photons=photons,
                    read_noise_e=read_noise_e,
                    **_gains(model, "model"),
                    **_gains(measured, "measured"),
                )


def _gains(verdict: Verdict, name: str) -> dict[str, float]:
    """Gains of the best single exposure and the best code, by the names of the columns."""
    gains_db = verdict.gains_db
    return {
        f"{kind}_{name}_db": round(gains_db.get(kind, np.nan), 2) for kind in ("snapshot", "code")
    }


def _case(row: dict[str, str]) -> tuple[str, ...]:
    return row["motion"], *(f"{float(row[name]):g}" for name in ("read_noise_e", "photons"))


if __name__ == "__main__":
    main()
