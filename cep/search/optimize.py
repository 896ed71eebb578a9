"""Best shutter code for a motion: searched, and judged on photographs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from cep.files.code_files import StoredCode
from cep.optics.camera import LIGHT_RANGE
from cep.optics.code import ShutterCode
from cep.optics.path_limits import check_frame, check_resolved
from cep.search.baselines import mean_length_px
from cep.search.code_search import (
    SearchOptions,
    search_code,
    searched_problem,
)
from cep.search.cost import CodeCost
from cep.search.exhaustive.exact import codes_to_count
from cep.search.exposures import PLAIN, ExposureFinder, check_light, kind_of
from cep.search.frame_error import codes_of_a_frame, is_framed
from cep.search.measured import is_measured
from cep.search.optimized_code import OptimizedCode, described, stored_code
from cep.search.playable import unplayable
from cep.search.problem import SearchProblem
from cep.search.search_result import SearchResult
from cep.search.verdict import verdict
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

_SEARCH_SHARE = 0.4  # of the time: then rivals are searched
_RIVALS_SHARE = 0.6  # of the time: then it is measured
_MEASURED_SHARE = 0.95  # of the time: comparing and certifying take the rest
_LESS_LIGHT = (3, 10)  # factors of the light that rivals of the code are searched for
Progress = Callable[[float, str], None]


def optimize(
    problem: SearchProblem,
    *,
    method: Literal["anneal", "exact"] = "anneal",
    steps: int | None = None,
    time_s: float | None = None,
    seed: int = 0,
    along: Trajectory | None = None,
    path_error_px: float = 0.0,
    photographs: Sequence[FloatArray] | None = None,
    threads: int | None = None,
    announce: Callable[[str], None] = lambda _text: None,
    progress: Progress = lambda _share, _note: None,
    on_found: Callable[[StoredCode], None] = lambda _stored: None,
    on_best: Callable[[ShutterCode], None] = lambda _code: None,
) -> OptimizedCode:
    """Search the best code along a problem's motions, certify it, and compare it with others.

    No code of the comparison that keeps the problem's limits is better by its objective. Between
    the code and a single exposure photographs decide, see :class:`cep.search.verdict.Verdict`: one
    that is better by the objective is returned where they advise no code.

    Parameters
    ----------
    problem : SearchProblem
        Of two frames the code is one of a pair of cameras, whose other plays its complement: it
        has no certificate and no bound, and what it gains is what both gain together.
    method, steps, time_s, seed
        As of :class:`SearchOptions`.
    along : Trajectory, optional
        What the certificate is for; the first scenario's path when omitted. Where the code's
        polynomial alone decides, it is for the unit circle.
    path_error_px : float
        Rms error of the path where it is an estimate: the verdict counts it, the search does not.
    photographs : sequence of (H, W) float ndarrays, linear light, optional
        On which the verdict is measured, as of :func:`cep.search.advise.advise`. With the
        objective "mse" the code of one camera is the best on them: along a narrow path of several
        searches, by the error in a photo with borders
        (:class:`cep.search.frame_error.FrameError`); else, or where the path has an error, of
        those for its light, a third and a tenth of it. Not where a limit or Ctrl-C ended the
        search.
    threads : int, optional
        As many as there are cores when omitted; the code does not depend on it.
    announce : callable, optional
        As of :func:`cep.search.advise.advise`.
    progress : callable, optional
        Called with the finished share, 0..1, and a note.
    on_found : callable, optional
        Called with the code before it is compared and certified, which may take seconds.
    on_best : callable, optional
        Called with the best code so far while the search goes on, as often as ``progress``.

    Raises
    ------
    ValueError
        If the problem has no motion, its paths cannot be measured or are too short for so many
        chips, even the shortest opening saturates at its light, the method does not solve it, or
        its device cannot play the code.
    KeyboardInterrupt
        After Ctrl-C while the code is compared, measured or certified; ``on_found`` has had it.
        Ctrl-C before ends the search: the best so far is compared and certified.

    Examples
    --------
    >>> problem = SearchProblem.along(Trajectory.straight(16.0), chips=16, open_range=(8, 8))
    >>> best = optimize(problem, method="exact")
    >>> best.code.bits, best.search.stopped
    ('1010111100100100', 'proven')
    """
    how = SearchOptions(method=method, steps=steps, time_s=time_s, seed=seed)
    motion = checked_motion(problem, along)
    search = _searched(
        problem,
        how,
        threads=threads,
        on_best=on_best,
        progress=_part(progress, 0.0, _SEARCH_SHARE),
    )
    on_found(stored_code(problem, how, search))  # what follows takes seconds
    rivalling = _part(progress, _SEARCH_SHARE, _RIVALS_SHARE)
    measuring = _part(progress, _RIVALS_SHARE, _MEASURED_SHARE)
    costs_db: dict[ShutterCode, float] = {}
    if problem.objective == "mse" and search.stopped == "steps" and problem.frames == 1:
        rivalling(0.0, "searching rivals")
        codes = []
        framed = is_framed(problem) and is_measured(problem, photographs)
        if framed:
            codes = codes_of_a_frame(
                problem,
                [search.code],
                seed=seed,
                threads=threads,
                progress=lambda share: rivalling(share, "searching for photos with borders"),
            )
        # the error in a photo with borders is that along the path as it is given
        if not framed or path_error_px > 0:
            codes += _for_less_light(problem, search.code, seed=seed, threads=threads)
        costs_db = _within(problem, search, codes)
    judgement = verdict(
        problem,
        search.code,
        rivals=[*costs_db],
        path_error_px=path_error_px,
        photographs=photographs,
        announce=announce,
        progress=lambda share: measuring(share, "measuring on photographs"),
    )
    best = judgement.user_code
    if best is not None and best.code != search.code:
        search = replace(search, code=best.code, objective=costs_db[best.code])
        on_found(stored_code(problem, how, search))
    progress(_MEASURED_SHARE, "comparing with other codes")
    optimized = described(problem, how, search, judgement, motion=motion)
    progress(1.0, "")
    return optimized


def _searched(
    problem: SearchProblem,
    how: SearchOptions,
    *,
    threads: int | None,
    on_best: Callable[[ShutterCode], None],
    progress: Progress,
) -> SearchResult:
    """Search the code, report the best so far, and give it the times of the problem's chips."""
    searched = searched_problem(problem)
    progress(0.0, f"{codes_to_count(searched):.2g} codes" if how.method == "exact" else "")

    def report(share: float, best: ShutterCode) -> None:
        on_best(best)
        progress(share, f"{best.open_chips} open")

    search = search_code(
        searched,
        how,
        length_px=mean_length_px(problem),
        threads=threads,
        progress=report,
    )
    code = replace(search.code, chip_ns=problem.chip_ns)
    # the limits already keep to the device: its own check has the last word
    played = [code, code.complement()] if problem.frames == 2 else [code]
    for camera_code in played:
        if reason := unplayable(camera_code.bits, problem.device, code.chip_ns):
            raise ValueError(reason)
    return replace(search, code=code)


def _part(progress: Progress, first: float, last: float) -> Progress:
    """Report a part of the work, from one share of the whole to another."""
    return lambda share, note: progress(first + (last - first) * share, note)


def _for_less_light(
    problem: SearchProblem, code: ShutterCode, *, seed: int, threads: int | None
) -> list[ShutterCode]:
    """Search codes for less light, which stand more noise, and what is unknown beyond borders."""
    finder = ExposureFinder(problem)
    camera = problem.camera
    starts = [code]
    # each search starts from the codes for more light: they are near
    for factor in _LESS_LIGHT:
        darker = camera.at(max(camera.photons_full_scale / factor, LIGHT_RANGE[0]))
        starts += finder.codes(darker, starts, seed=seed, threads=threads)
    return starts[1:]


def _within(
    problem: SearchProblem, search: SearchResult, codes: Sequence[ShutterCode]
) -> dict[ShutterCode, float]:
    """Return the codes within the limits that no other code beats, with their cost, dB.

    Whether a single exposure is better than they are, photographs tell.
    """
    rivals = [replace(code, chip_ns=problem.chip_ns) for code in dict.fromkeys(codes)]
    if not rivals:
        return {}
    highest_db = min(
        (
            baseline.cost_db
            for baseline in search.baselines
            if baseline.within_limits and kind_of(baseline.code) not in PLAIN
        ),
        default=math.inf,
    )
    costs_db = CodeCost.fine(problem).cost_of(np.array([code.array for code in rivals]))
    return {
        code: cost_db
        for code, cost_db in zip(rivals, costs_db.tolist(), strict=True)
        if cost_db <= highest_db
        and problem.allows(code)
        and not unplayable(code.bits, problem.device, problem.chip_ns)
    }


def checked_motion(problem: SearchProblem, along: Trajectory | None = None) -> Trajectory:
    """Return the path that a code is certified along.

    Parameters
    ----------
    problem : SearchProblem
    along : Trajectory, optional
        The first scenario's path when omitted.

    Raises
    ------
    ValueError
        If the problem has no motion, its path cannot be measured or is too short for so many
        chips, or even the shortest opening saturates at its light.
    """
    if not problem.scenarios:
        raise ValueError("scenarios: need a motion to compare and certify codes along")
    motion = along or problem.scenarios[0].trajectory
    check_frame(motion)
    check_resolved(motion, problem.chips)
    check_light(problem)
    return motion
