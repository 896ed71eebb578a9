"""Search of a code by a method, within its moves and time, and the description of it in files."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from cep.optics.code import ShutterCode
from cep.search.annealing.anneal import standard_moves
from cep.search.problem import SearchProblem
from cep.search.recipe import Found, prove_code, search_code

STANDARD_TIME_S = 60.0
"""Limit of an annealing that is given neither moves nor a time, seconds."""

NO_TIME_S = 1e-9
"""Time limit that ends an annealing at its start: the best of its starting codes is returned."""


@dataclass(frozen=True, kw_only=True)
class Search:
    """How a code is searched.

    Attributes
    ----------
    method : {"anneal", "exact"}
    steps : int, optional
        Moves of an annealing. The same seed and moves give the same code, unless the time ends the
        search.
    time_s : float, optional
        Limit of an annealing, seconds; a proof runs to its end. With a time alone the annealing
        goes on for it, however many moves that are; without moves or a time it makes as many as
        suit the problem, for :data:`STANDARD_TIME_S` at most.
    seed : int

    Raises
    ------
    ValueError
        If the method is another, the time is not above 0, or moves or a time are
        given for a proof.
    """

    method: Literal["anneal", "exact"] = "anneal"
    steps: int | None = None
    time_s: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if self.method not in ("anneal", "exact"):
            raise ValueError(f"method: must be anneal or exact, got {self.method!r}")
        if self.time_s is not None and not self.time_s > 0:
            raise ValueError(f"time_s: must be above 0 seconds, got {self.time_s}")
        for name in ("steps", "time_s"):
            if self.method == "exact" and getattr(self, name) is not None:
                raise ValueError(
                    f"{name}: not valid with method='exact', which judges every code there is"
                )

    @property
    def limit_s(self) -> float:
        """Limit of an annealing, seconds; infinite where only its moves are given."""
        if self.time_s is not None:
            return self.time_s
        if self.steps is None:
            return STANDARD_TIME_S
        return math.inf

    def moves(self, problem: SearchProblem) -> int | None:
        """Say how many moves an annealing makes; None where the time alone ends it."""
        if self.steps is None and self.time_s is None:
            return standard_moves(problem)
        return self.steps


def searched_problem(problem: SearchProblem) -> SearchProblem:
    """Reduce to the unit circle a problem where only the code's polynomial matters."""
    # |H| = |sinc| |P|: the largest min |P| holds for any speed, and has exact proofs
    if problem.on_circle and problem.objective == "min-mtf":
        return replace(problem, scenarios=())
    return problem


def search(
    problem: SearchProblem,
    how: Search,
    *,
    start: Sequence[ShutterCode] = (),
    length_px: float | None = None,
    threads: int | None = None,
    progress: Callable[[float, ShutterCode], None] | None = None,
) -> Found:
    """Search a code, or count all codes for the best.

    Parameters
    ----------
    problem : SearchProblem
    how : Search
    start : sequence of ShutterCode
        Codes to start an annealing from.
    length_px : float, optional
        Of the path, for the length-only code among the baselines; of the problem's when omitted.
    threads : int, optional
        As many as there are cores when omitted; the code does not depend on it.
    progress : callable, optional
        Called with the fraction done and the best code so far.

    Returns
    -------
    Found
        No baseline within the limits has a lower cost. Along a path a proof is over the band's
        samples, though: it stands, whatever a baseline is worth between them.

    Raises
    ------
    ValueError
        If the problem is not one that the method solves.
    """
    rng = np.random.default_rng(how.seed)
    if how.method == "exact":
        return prove_code(
            problem,
            rng=rng,
            time_s=how.limit_s,
            length_px=length_px,
            progress=progress,
            threads=threads,
        )
    return search_code(
        problem,
        rng=rng,
        steps=how.moves(problem),
        time_s=how.limit_s,
        start=start,
        length_px=length_px,
        progress=progress,
        threads=threads,
    )


def described_search(
    problem: SearchProblem, how: Search, *, steps: int, stopped: str
) -> dict[str, Any]:
    """Describe a problem, how it was searched and how that ended, as a code file does."""
    return {
        "chips": problem.chips,
        **asdict(problem.runs),
        "open_range": problem.open_limits,
        "objective": problem.objective,
        "direction": problem.direction,
        "rule": problem.rule,
        "camera": problem.camera.to_dict(),
        "scene": asdict(problem.scene),
        "device": problem.device and problem.device.to_dict(),
        "method": how.method,
        "seed": how.seed,
        "steps": steps,
        "stopped": stopped,
    }


def ended_early(how: Search, stopped: str, moves: int | None) -> list[str]:
    """Warn of a search that Ctrl-C or the time ended before its ``moves``."""
    if stopped == "interrupted":
        run = {"anneal": "search", "exact": "proof"}[how.method]
        return [f"the {run} was stopped early, this is the best code so far"]
    # an annealing that is given a time alone always ends by it
    if stopped == "time" and moves is not None:
        return [
            f"the limit of {how.limit_s:g} s ended the search before its {moves:,} moves: another"
            " run may give another code"
        ]
    return []
