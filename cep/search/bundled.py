"""Proven codes that come with the package, as answers or starts of searches."""

from __future__ import annotations

import time

from cep.codes.optima import OPTIMA, ProvenCode
from cep.optics.band import straight_axis
from cep.optics.code import ShutterCode
from cep.proofs.certify.minimum import chip_minimum
from cep.search.exhaustive.proof import BundledLog, ExactResult
from cep.search.problem import SearchProblem


def proven_optimum(problem: SearchProblem) -> ExactResult | None:
    """Return the best code of a problem that a bundled proof covers; None where none does.

    Parameters
    ----------
    problem : SearchProblem
        Only the smallest |P| of the unit circle is proven: objective "min-mtf" alone, without
        scenarios.

    Returns
    -------
    ExactResult or None

    Notes
    -----
    The best of all codes is also the best of any part of them that it belongs to. So a proof
    covers every problem with no more chips, and no other numbers of open chips, than its own, if
    some shift of the code or of its mirror image keeps the limits.

    Examples
    --------
    >>> found = proven_optimum(SearchProblem.along(chips=14, open_range=(9, 9)))
    >>> found.code.bits, found.proof.file
    ('11111001101010', 'docs/optima.md')
    """
    if problem.scenarios or [name for name, _ in problem.objective_mix] != ["min-mtf"]:
        return None
    started = time.monotonic()
    low, high = problem.open_limits
    for entry in OPTIMA:
        covers = (
            problem.chips <= entry.chips and entry.fewest_open <= low and high <= entry.most_open
        )
        if not covers:
            continue
        code = _within_limits(problem, entry)
        if code is None:  # shifts and mirror image break the limits: another code may be the best
            continue
        minimum = chip_minimum(code)
        log = BundledLog(
            chips=entry.chips,
            limits={"fewest_open": entry.fewest_open, "most_open": entry.most_open},
            domain="the unit circle",
            file=entry.proof,
            bits=code.bits,
            lower=minimum.lower,
            upper=minimum.upper,
        )
        return ExactResult(code, minimum, log, time.monotonic() - started, True)
    return None


def proven_starts(problem: SearchProblem) -> list[ShutterCode]:
    """Return the proven codes within the limits of a "min-mtf" search along straight motion.

    Examples
    --------
    >>> [code.bits for code in proven_starts(SearchProblem.along(chips=5, open_range=(2, 4)))]
    ['11010', '11101']
    """
    straight = all(
        straight_axis(scenario.trajectory) is not None for scenario in problem.scenarios
    )
    if not straight or "min-mtf" not in dict(problem.objective_mix):
        return []
    codes = (_within_limits(problem, entry) for entry in OPTIMA)
    return [code for code in codes if code is not None]


def _within_limits(problem: SearchProblem, entry: ProvenCode) -> ShutterCode | None:
    """Place a proven code or its mirror image at the first chip where it keeps the limits."""
    room = problem.chips - len(entry.bits)
    # shifts and the mirror image have the same |P|
    for bits in (entry.bits, entry.bits[::-1]):
        for first in range(room + 1):
            code = ShutterCode("0" * first + bits + "0" * (room - first))
            if problem.allows(code):
                return code
    return None
