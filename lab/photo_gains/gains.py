"""Gains of codes on other photographs than those by which they are stated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cep.optics.code import ShutterCode
from cep.photographs.trial import PhotoTrial
from cep.search.exposures import gain_range_db
from cep.search.problem import SearchProblem
from cep.search.verdict import Verdict
from motdiff.motions import boracchi_foi, quadratic
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

CHIPS = 40
LENGTHS = (1, 2, 3, 4, 5, 6, 8, 12)  # of the single exposures, chips
SIDE_PX = 300
JUDGED_PX = 128


@dataclass(frozen=True)
class Gain:
    """A gain that was stated, and what other photographs show.

    Attributes
    ----------
    stated_db, low_db, high_db : float
        With its range.
    measured_db, over_best_db : float
        Of the same two ways; and over the single exposure that is best on these photographs.
    spread_db : float
        Standard deviation of ``measured_db`` from photograph to photograph.
    best_chips, stated_chips : int
        Length of that single exposure, and of the one stated.
    """

    stated_db: float
    low_db: float
    high_db: float
    measured_db: float
    over_best_db: float
    spread_db: float
    best_chips: int
    stated_chips: int

    @property
    def covered(self) -> bool:
        """Whether the measured mean lies in the stated range."""
        return self.low_db <= self.measured_db <= self.high_db

    @property
    def cells(self) -> str:
        """Cells of a table."""
        return (
            f"{self.stated_db:+.2f} ({self.low_db:+.1f} to {self.high_db:+.1f}) |"
            f" {self.measured_db:+.2f} | {'yes' if self.covered else 'no'} | {self.spread_db:.2f}"
            f" | {self.over_best_db:+.2f} | {self.best_chips} ({self.stated_chips})"
        )


def motions() -> dict[str, Trajectory]:
    """Return the motions of the table."""
    arc = quadratic(np.random.default_rng(12), min_length_px=24, max_length_px=30, max_bend=1.5)
    walk = boracchi_foi(np.random.default_rng(3), max_length_px=40)
    return {
        "straight 40 px": Trajectory.straight(40.0),
        "arc": arc,
        "shake": replace(walk, direction="known"),
    }


def trial_of(problem: SearchProblem, scenes: Sequence[FloatArray]) -> PhotoTrial:
    """Return photos of scenes along a problem's motions."""
    return PhotoTrial(problem.directed_paths(), scenes, camera=problem.camera, judged_px=JUDGED_PX)


def measured_gain(verdict: Verdict, trial: PhotoTrial) -> Gain | None:
    """Measure a verdict's gain of the best code over the best single exposure; None without."""
    code = verdict.best("code")
    single = verdict.best("snapshot")
    if code is None or single is None:
        return None
    low_db, high_db = gain_range_db(code, single) or (np.nan, np.nan)
    singles = [centred(CHIPS, length) for length in LENGTHS]
    levels = trial.psnr_db([code.code, single.code, *singles])
    means = levels[1:].mean(axis=1)
    best = int(means.argmax())
    gains = levels[0] - levels[1]
    return Gain(
        stated_db=code.psnr_db - single.psnr_db,
        low_db=low_db,
        high_db=high_db,
        measured_db=float(gains.mean()),
        over_best_db=float((levels[0] - levels[1 + best]).mean()),
        spread_db=float(gains.std(ddof=1)),
        best_chips=[single.code, *singles][best].open_chips,
        stated_chips=single.code.open_chips,
    )


def centred(chips: int, length: int) -> ShutterCode:
    """Return a single opening of so many of the chips, in the middle of the exposure."""
    before = (chips - length) // 2
    return ShutterCode("0" * before + "1" * length + "0" * (chips - length - before))
