"""Codes proven to have the largest minimum of |P| on the unit circle, see docs/optima.md: answers
of the searches that their proofs cover, starts of others.
"""

from __future__ import annotations

import math
import time
from functools import cache
from typing import NamedTuple

from cep.optics.code import ShutterCode
from cep.proofs.certify.minimum import chip_minimum
from cep.search.exhaustive.exact import BundledLog, ExactResult
from cep.search.problem import SearchProblem

_TABLE = "docs/optima.md"
# Codes with their numbers of chips: the best of up to so many, whatever is open. A longer code is
# listed only where it beats all shorter ones, which may be padded with closed chips.
_ANY_LIGHT = (
    ("1", 9),
    ("1110001001", 12),
    ("1111100110101", 20),
    ("110000011011110110101", 21),
    ("1100000111011101101001", 23),
    ("110100110010000101111101", 25),
    ("10111101001011101000110001", 28),
    ("11101011100001001100100001001", 35),
    ("111110111110010010011100100001010101", 37),
    ("11111101000111100011010011010100010001", 38),
    ("100100100100111010000111001110111010001", 39),
    ("1101001001110000000111011111100111010101", 41),
    ("111111100101011010011000011001000100010001", 42),
    ("1111111110001110001010110010100100010010001", 43),
    ("11111111000101100101110101001010001100110001", 47),
    ("111111101111010001110110101000110100110001010101", 48),
)
_BY_OPEN_CHIPS = (
    "1101",
    "11101",
    "1110001001",
    "1000001001100000010000001",
    "10010001101000001000001",
    "1001000001010100110001",
    "1111000001001000000100010001",
    "11001000111000100000100101",
    "1011010100010011000011000001",
    "1110000001001110101100101",
    "100111011100101001101000001",
    "10111101001011101000110001",
    "110100100001110101110110011",
    "1111011110010011101000010101",
    "1111111001110011011010101",
    "1111110101011100100111100011",
    "1111111110011101101011101",
    "1110100111011101011011111101",
    "1111111111110001110101011011",
    "1111100111011101111111101101",
    "1111001101111111111111110101",
    "1111111101111111101111010111",
    "1111111111101111011111011111",
    "111111111111111011111111111",
    "1111111111111101111111111111",
    "1111111111111111111111111111",
)
_MOST_BY_OPEN_CHIPS = 28  # chips to which each number of open chips is proven
_IN_BLOCKS = 42  # chips from which each number has a proof of its own


class ProvenCode(NamedTuple):
    """The code of largest minimum |P| among all of a range of lengths and open chips.

    Attributes
    ----------
    bits : str
        From the first open chip to the last.
    chips : int
        Most chips of the codes that the proof covers.
    fewest_open, most_open : int
        Their fewest and most open chips.
    proof : str
        File of the proof, or else the page with its table, in the documentation.
    """

    bits: str
    chips: int
    fewest_open: int
    most_open: int
    proof: str


OPTIMA = (
    *(
        ProvenCode(
            bits, chips, 1, chips, f"docs/proofs/{chips}.jsonl" if chips >= _IN_BLOCKS else _TABLE
        )
        for bits, chips in _ANY_LIGHT
    ),
    *(
        ProvenCode(bits, _MOST_BY_OPEN_CHIPS, bits.count("1"), bits.count("1"), _TABLE)
        for bits in _BY_OPEN_CHIPS
    ),
    ProvenCode(
        "1110110001101111010111101000101000011010011010001", 52, 26, 26, "docs/proofs/52-26.jsonl"
    ),
)
"""Of any number of open chips, shortest first; of three to 28 open chips; and of 26 open chips of
52."""


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
    the code or its mirror image keeps the limits.

    Examples
    --------
    >>> found = proven_optimum(SearchProblem.along(chips=14, open_range=(9, 9)))
    >>> found.code.bits, found.proof.file
    ('11111001101010', 'docs/optima.md')
    """
    if (
        problem.frames == 2
        or problem.scenarios
        or [name for name, _ in problem.objective_mix] != ["min-mtf"]
    ):
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
        if code is None:  # it breaks the limits, and its mirror image: another may be the best
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
    if not problem.straight or "min-mtf" not in dict(problem.objective_mix):
        return []
    codes = (_within_limits(problem, entry) for entry in OPTIMA)
    return [code for code in codes if code is not None]


def proven_ceiling(chips: int, open_chips: int) -> float:
    """Return what no code of so many chips and open chips can exceed in its smallest |P|, chips.

    Infinite where no proof covers them.
    """
    covering = (
        entry
        for entry in OPTIMA
        if chips <= entry.chips and entry.fewest_open <= open_chips <= entry.most_open
    )
    return min((_proven_minimum(entry.bits) for entry in covering), default=math.inf)


@cache
def _proven_minimum(bits: str) -> float:
    return chip_minimum(ShutterCode(bits)).upper


def _within_limits(problem: SearchProblem, entry: ProvenCode) -> ShutterCode | None:
    """Return a proven code or its mirror image, of the same |P|, whichever keeps the limits."""
    if len(entry.bits) > problem.chips:
        return None
    # where it stands does not count: limits are on runs, and the shutter rests closed around it
    for bits in (entry.bits, entry.bits[::-1]):
        code = ShutterCode(bits.ljust(problem.chips, "0"))
        if problem.allows(code):
            return code
    return None
