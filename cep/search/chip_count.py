"""Number of chips of a code where none is asked for."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cep.search.problem import SearchProblem

STANDARD_CHIPS = 52
"""Chips where their number is open, as many as Raskar's code of 2006 has: more are no better on
photographs, fewer are worse (``python -m lab.studies.chip_count``)."""

STANDARD_EXPOSURE_S = 0.052
"""Exposure of ``cep advise`` where none is given, and of ``cep optimize`` where neither it nor the
number of chips is: 52 chips of 1 ms."""

_COUNTS = (STANDARD_CHIPS, 32, 16, 8, 4, 2)


def problem_of_standard_chips(problem_of: Callable[[int], SearchProblem]) -> SearchProblem:
    """Return the problem of 52 chips, or the most of 32, 16, 8, 4 and 2 that are possible.

    A chip covers a quarter of a pixel at least, and the shutter can play it.

    Parameters
    ----------
    problem_of : callable
        Returns the problem with so many chips, or raises ValueError.

    Raises
    ------
    ValueError
        As for the most chips that are refused for another reason than the motion, where not even
        two are possible; else as for 52.
    """
    # every command reads the constants as it starts: no array library until then
    from cep.optics.path_limits import check_resolved

    refusals = []
    unresolved = []
    for count in _COUNTS:
        try:
            problem = problem_of(count)
        except ValueError as error:
            refusals.append(error)
            continue
        try:
            check_resolved(problem.scenarios[0].trajectory, count)
        except ValueError as error:
            unresolved.append(error)
        else:
            return problem
    # a limit that fewer chips break is the user's, the count of chips is not
    raise (refusals or unresolved)[0]
