"""Result of a search: the code, what ended the search, and what the code was compared with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from cep.optics.code import ShutterCode

Stopped = Literal["steps", "time", "interrupted", "complete", "proven"]
"""What ended a search: all its moves made, the time limit, Ctrl-C, that no other code keeps the
limits, or a proof."""


@dataclass(frozen=True)
class ComparedCode:
    """A code in a comparison.

    Attributes
    ----------
    name : str
        "this code", the one that the others are compared with; "open shutter", "best snapshot",
        "best strobe", "published: NAME", "length-only code" or "random code, median"; "best
        snapshot within the limits" and "best strobe within the limits" where the best ones break
        them.
    code : ShutterCode
    within_limits : bool
        Whether the code keeps the problem's limits: others could not be returned, however good
        they are.
    stopped_early : bool
        Whether the time limit or Ctrl-C ended the search of this code: another run may give
        another.
    """

    name: str
    code: ShutterCode
    within_limits: bool
    stopped_early: bool = False

    @property
    def label(self) -> str:
        """The name, and whether the code breaks the limits, for tables."""
        if self.within_limits:
            return self.name
        return f"{self.name} (outside the limits)"


@dataclass(frozen=True, kw_only=True)
class Baseline(ComparedCode):
    """A code that would be used instead of a searched one.

    Attributes
    ----------
    cost_db : float
        By the problem's objective, with its minima over the continuum; lower is better.
    """

    cost_db: float


@dataclass(frozen=True)
class SearchResult:
    """Result of a search, or of a proof.

    Attributes
    ----------
    code : ShutterCode
    objective : float
        Cost in dB, lower is better, with minima over the continuum; see
        :mod:`cep.search.cost`.
    seconds : float
        With the baselines, where there are any.
    steps : int
        Moves tried, or codes counted.
    stopped : {"steps", "time", "interrupted", "complete", "proven"}
        The time limit makes the outcome depend on the machine.
    baselines : tuple of Baseline
        What the code was compared with: none of them that keeps the limits has a lower cost, but
        for a single exposure in whose place :func:`cep.search.optimize.optimize` put a code that
        photographs prefer.
        Ctrl-C may have cut them short; of an annealing alone there are none.
    proof : dict or None
        Log of the proof; ``file`` names that of a bundled proof.
    """

    code: ShutterCode
    objective: float
    seconds: float
    steps: int
    stopped: Stopped
    baselines: tuple[Baseline, ...] = ()
    proof: dict[str, Any] | None = None
