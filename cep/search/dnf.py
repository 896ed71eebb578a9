"""DNF: the code of least deconvolution noise for a straight blur of the path's length.

The deconvolution noise factor of a code is ``sqrt(mean(max|H|^2 / |H|^2))``; since |H| is largest
at frequency 0, it is the noise of the inverse filter relative to the light that came through. A
single open chip has the least there is, 1, whatever the light it loses: among codes of different
light the noise itself is compared, which for codes of equal light is the same.
"""

from __future__ import annotations

import numpy as np

from cep.search.annealing.anneal import SearchResult, anneal
from cep.search.limits import RunLimits
from cep.search.problem import SearchProblem
from motdiff.trajectory import Trajectory

SHORTEST_PX = 1.0
"""Paths that are shorter, px, are designed for as if they had this length: less hardly blurs."""


def dnf_problem(
    length_px: float,
    chips: int,
    *,
    open_range: tuple[int, int] | None = None,
    runs: RunLimits | None = None,
) -> SearchProblem:
    """Search problem of DNF; parameters as of :func:`dnf_search`."""
    if not (np.isfinite(length_px) and length_px >= 0):
        raise ValueError(f"length_px: must be 0 or more, got {length_px}")
    straight = Trajectory.straight(max(SHORTEST_PX, float(length_px)))
    # the noise gain, not the DNF: among codes of equal light they rank alike, and only the gain
    # counts the light that a code loses
    return SearchProblem.along(
        straight, chips=chips, open_range=open_range, objective="noise", runs=runs or RunLimits()
    )


def dnf_search(
    length_px: float,
    chips: int,
    *,
    rng: np.random.Generator,
    steps: int | None = 1_000_000,
    time_s: float = 60.0,
    open_range: tuple[int, int] | None = None,
    runs: RunLimits | None = None,
    threads: int | None = None,
) -> SearchResult:
    """Search DNF's code with the project's search, for a straight motion of the given length.

    Parameters
    ----------
    length_px : float, px
        Arc length of the path.
    chips : int
    rng : numpy Generator
    steps, time_s, threads
        As :func:`cep.search.annealing.anneal.anneal` takes them.
    open_range : (int, int), optional
        Fewest and most open chips; any number when omitted.
    runs : RunLimits, optional
        Limits on runs and pulses; none when omitted.

    Raises
    ------
    ValueError
        If the length is negative or not finite, or the problem or the budget is malformed.

    References
    ----------
    Agrawal and Raskar, "Optimal single image capture for motion deblurring", CVPR 2009.
    """
    problem = dnf_problem(length_px, chips, open_range=open_range, runs=runs)
    return anneal(problem, rng=rng, steps=steps, time_s=time_s, threads=threads)
