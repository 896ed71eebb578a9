"""Number of chips: the fewest with which the best exposure is as good as with more."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from cep.optics.code import ShutterCode
from cep.optics.path_limits import check_resolved
from cep.search.expected import WORTH_DB
from cep.search.exposures import (
    Exposure,
    ExposureFinder,
    best_possible,
    check_light,
    judged_exposures,
)
from cep.search.problem import SearchProblem

ASSUMED_EXPOSURE_S = 0.05
"""Exposure where none is given and the number of chips is chosen: it must be the same for all."""

COUNTS = (8, 16, 32, 52, 104)
"""Numbers of chips that are tried where none is given."""


@dataclass(frozen=True)
class ChipCount:
    """Number of chips that was chosen.

    Attributes
    ----------
    chips : int
    gains_db : mapping of int to float
        What the best exposure gains with each other number that was tried, dB.
    code : ShutterCode or None
        The best code found with so many chips, within the limits; None where Ctrl-C came before
        any.
    early : {"", "time", "interrupted"}
        What ended the choice before all numbers were tried, if anything.
    """

    chips: int
    gains_db: Mapping[int, float]
    code: ShutterCode | None
    early: str = ""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings, one sentence each."""
        if not self.early:
            return ()
        end = {"time": "the time", "interrupted": "Ctrl-C"}[self.early]
        return (f"{end} ended the choice of the number of chips: fewer numbers were tried",)

    def uninterrupted(self) -> ChipCount:
        """Return this choice; raise KeyboardInterrupt where Ctrl-C ended it."""
        if self.early == "interrupted":
            raise KeyboardInterrupt
        return self


def choose_chips(
    problem_of: Callable[[int], SearchProblem],
    counts: Sequence[int] = COUNTS,
    *,
    path_error_px: float = 0.0,
    seed: int = 0,
    time_s: float = math.inf,
    threads: int | None = None,
    progress: Callable[[float, str], None] = lambda _share, _note: None,
) -> ChipCount:
    """Choose the fewest chips with which the best exposure is within ``WORTH_DB`` of the best.

    Anytime: the time or Ctrl-C ends the choice with the numbers tried so far.

    Parameters
    ----------
    problem_of : callable
        Returns the problem with so many chips. It may raise ValueError for some, which are left
        out, as are those that the motion does not resolve.
    counts : sequence of int
    path_error_px, seed, threads, progress
        As of :func:`cep.search.advise.advise`.
    time_s : float
        Limit, seconds. Of the first number it ends the search alone, so that one is judged.

    Raises
    ------
    ValueError
        If none is left: as for the first of them.
    """
    deadline = time.monotonic() + time_s
    reached: dict[int, Exposure] = {}
    refusal = ValueError("counts: needs at least one number of chips")
    early = ""
    count = 0  # the number that is tried
    try:
        for index, count in enumerate(counts):
            left_s = deadline - time.monotonic()
            if reached and left_s <= 0:
                early = "time"
                break
            progress(index / len(counts), f"{count} chips")
            try:
                problem = problem_of(count)
                check_resolved(problem.scenarios[0].trajectory, count)
                check_light(problem)
            except ValueError as error:
                # more chips fail for the same reason, or for being too many
                if index == 0:
                    refusal = error
                continue
            # whatever the time, the first number is judged
            time_left_s = max(left_s, 1e-3)
            reached[count], stopped = _best_exposure(
                problem, path_error_px, seed, time_left_s, threads
            )
            if stopped in ("time", "interrupted"):
                early = stopped
                break
    except KeyboardInterrupt:
        early = "interrupted"
        if not reached:
            return ChipCount(count, {}, None, early)
    if not reached:
        raise refusal
    psnr_db = {count: exposure.psnr_db for count, exposure in reached.items()}
    chosen = min(count for count in reached if psnr_db[count] > max(psnr_db.values()) - WORTH_DB)
    gains_db = {count: psnr_db[count] - psnr_db[chosen] for count in reached if count != chosen}
    return ChipCount(chosen, gains_db, reached[chosen].code, early)


def in_words_of_chips(gains_db: Mapping[int, float]) -> str:
    """Say what other numbers of chips would gain or lose; empty for none.

    Examples
    --------
    >>> in_words_of_chips({16: -0.52, 104: 0.04})
    '16 chips would lose 0.52 dB, 104 gain 0.04 dB'
    """
    verbs = {True: "gain", False: "lose"}
    clauses = [
        f"{count} {verbs[gain_db > 0]} {abs(gain_db):.2f} dB"
        for count, gain_db in gains_db.items()
    ]
    # the noun stands once: "16 chips would lose 0.52 dB, 104 gain 0.04 dB"
    return ", ".join(clauses).replace(" ", " chips would ", 1)


def _best_exposure(
    problem: SearchProblem, path_error_px: float, seed: int, time_s: float, threads: int | None
) -> tuple[Exposure, str]:
    """Best possible exposure at the camera's light, and what ended the search of a code."""
    finder = ExposureFinder(problem)
    camera = problem.camera
    ordinary = finder.ordinary(camera, every_length=path_error_px > 0)
    searched = finder.search(camera, ordinary, seed=seed, time_s=time_s, threads=threads)
    codes = ordinary
    stopped = ""
    if searched is not None:
        codes = [*ordinary, searched.code]
        stopped = searched.stopped
    # judged with the error of the path, which the search does not count
    (exposures,) = judged_exposures(problem, [camera], codes, path_error_px=path_error_px)
    return best_possible(exposures), stopped
