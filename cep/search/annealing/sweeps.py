"""Annealing of the smallest |P| at a constant temperature, by sweeps over all partners of a chip.

For one chip the swaps with every other chip, and its flip, are judged side by side, at the dips of
|P| alone. A move that deepens a dip beyond what is accepted is refused there. So a move costs a
few cycles of the processor, and the cost in full is summed for few of them. The temperature is low
and does not fall: the number of good codes met grows with the number of moves, however they are
divided into chains (docs/decisions/search.md).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cep.compiled import compiled, inlined
from cep.search.annealing.proposals import uniform
from cep.search.cost import CodeCost
from cep.search.problem import SearchProblem

Codes = NDArray[np.int8]
Floats = NDArray[np.float32]
_MOST_CHIPS = 64  # of a code: its moves are as many lanes of vector instructions
_FREQUENCIES = 64  # at which the cost is summed
_LANES = 16  # float32 numbers of the widest vector registers
_CHAIN = 2**21  # moves from one random code, and until the OTF is summed anew
_SLICE = 2**17  # moves between looks at Ctrl-C: a millisecond
_DIPS = 16  # frequencies at most at which moves are refused
_SHALLOW = 3.0  # times the smallest |P|^2: dips above it refuse few moves
_KEPT = 8  # last and best codes of a run, which are offered: an exact objective ranks them
_TINY = np.float32(1e-9)  # of |H|^2: its fourth power must not overflow


class SweepTables(NamedTuple):
    """Tables of a problem for the compiled loop; F coarse frequencies, G fine ones.

    Attributes
    ----------
    by_chip : (n, 2, F) float32
        Change of the OTF, in chips, when a chip opens: real and imaginary parts.
    by_frequency : (F, 2, lanes) float32
        The same, with zeros after the last chip.
    fine : (n, 2, G) float32
    low, high : int
        Fewest and most open chips.
    """

    by_chip: Floats
    by_frequency: Floats
    fine: Floats
    low: int
    high: int


def can_sweep(problem: SearchProblem) -> bool:
    """Whether sweeps search a problem: the smallest |H| of few chips, one way along a line."""
    if problem.chips > _MOST_CHIPS or problem.limits_runs or problem.response is not None:
        return False
    if problem.frames == 2:  # its dips are not those of |P|
        return False
    if [name for name, _ in problem.objective_mix] != ["min-mtf"]:
        return False
    if len(problem.directed_paths()) > 1:
        return False
    return problem.straight


def sweep_tables(code_cost: CodeCost, judge: CodeCost) -> SweepTables:
    """Lay out some samples of an objective of one part, and all of a finer one.

    The finer ones have to be so many that |P| has no dip between them: of a code with a zero, 8
    per 1 / chips may show a smallest |P| of 2 chips.
    """
    problem = code_cost.problem
    rows = problem.chips * code_cost.rows[:, 0]
    count = min(_FREQUENCIES, rows.shape[-1])
    columns = np.linspace(0, rows.shape[-1] - 1, count).round().astype(int)
    coarse = rows[:, :, columns].astype(np.float32)
    fine = (problem.chips * judge.rows[:, 0]).astype(np.float32)
    lanes = -(-problem.chips // _LANES) * _LANES
    by_frequency = np.zeros((count, 2, lanes), np.float32)
    by_frequency[:, :, : problem.chips] = coarse.transpose(2, 1, 0)
    low, high = problem.open_limits
    return SweepTables(
        np.ascontiguousarray(coarse), by_frequency, np.ascontiguousarray(fine), low, high
    )


def sweep_chain(
    problem: SearchProblem, tables: SweepTables, *, moves: int, temperature_db: float, seed: int
) -> Iterator[tuple[int, Codes]]:
    """Yield the moves made and the (R, n) best codes after every slice of moves.

    Chains follow one another, each from a random code.
    """
    rng = np.random.default_rng(seed)
    random = np.array([int(rng.integers(1, 2**62)) | 1], dtype=np.uint64)
    deepest = np.zeros(1)
    elites = np.empty((0, problem.chips), np.int8)
    total = 0
    while total < moves:
        code = problem.random_codes(1, rng=rng)[0].astype(np.int8)
        until = min(moves, total + _CHAIN)
        while total < until:
            best = np.empty((_KEPT, problem.chips), np.int8)
            count = np.zeros(1, np.int64)
            slice_moves = min(_SLICE, until - total)
            moves_made = sweep_loop(
                tables, code, random, temperature_db, slice_moves, deepest, best, count
            )
            total += moves_made
            elites = np.concatenate([elites, best[: count[0]]])[-_KEPT:]
            yield moves_made, elites


@inlined
def _term_sum(
    by_chip: Floats, otf: Floats, a: int, b: int, s: np.float32, t: np.float32
) -> np.float32:
    """Sum of 1 / |P|^8 after chips ``a`` and ``b`` have opened (1), closed (-1) or stayed (0)."""
    # the eighth power nearly is the minimum, yet tells where to go: docs/decisions/search.md
    unit = np.float32(1)
    total = np.float32(0)
    for f in range(otf.shape[1]):
        x = otf[0, f] + s * by_chip[a, 0, f] + t * by_chip[b, 0, f]
        y = otf[1, f] + s * by_chip[a, 1, f] + t * by_chip[b, 1, f]
        term = unit / (x * x + y * y + _TINY)
        square = term * term
        total += square * square
    return total


@inlined
def _find_dips(otf: Floats, power: Floats, dips: NDArray[np.int64]) -> int:
    """Find frequencies of the deepest local minima of |P|^2; returns their number."""
    size = otf.shape[1]
    lowest = np.float32(np.inf)
    for f in range(size):
        power[f] = otf[0, f] * otf[0, f] + otf[1, f] * otf[1, f]
    for f in range(size):
        lowest = min(lowest, power[f])
    limit = np.float32(_SHALLOW) * lowest + _TINY
    count = 0
    for f in range(size):
        if power[f] < limit and count < _DIPS:
            # |P| is even about both ends of the half circle
            before = power[f - 1] if f > 0 else power[1]
            after = power[f + 1] if f < size - 1 else power[size - 2]
            if power[f] <= before and power[f] < after:
                dips[count] = f
                count += 1
    return count


@inlined
def _fine_power(fine: Floats, code: Codes, otf: Floats) -> np.float32:
    """Smallest |P|^2 of a code on the fine samples; ``otf`` (2, G) is work space."""
    otf[:] = 0
    for j in range(len(code)):
        if code[j]:
            for g in range(otf.shape[1]):
                otf[0, g] += fine[j, 0, g]
                otf[1, g] += fine[j, 1, g]
    lowest = np.float32(np.inf)
    for g in range(otf.shape[1]):
        lowest = min(lowest, otf[0, g] * otf[0, g] + otf[1, g] * otf[1, g])
    return lowest


@inlined
def _refuse_partners(
    tables: Any,
    otf: Floats,
    dips: NDArray[np.int64],
    dip_count: int,
    chip: int,
    signs: Floats,
    floor: np.float32,
    refused: NDArray[np.int32],
) -> None:
    """Count for each partner of a chip the dips where |P|^2 after the move is below the floor."""
    by_chip = tables.by_chip
    lanes = signs.size
    sign = signs[chip]
    signs[chip] = 0  # its lane is the flip alone
    for j in range(lanes):
        refused[j] = 0
    for d in range(dip_count):
        f = dips[d]
        x0 = otf[0, f] + sign * by_chip[chip, 0, f]
        y0 = otf[1, f] + sign * by_chip[chip, 1, f]
        real = tables.by_frequency[f, 0]
        imaginary = tables.by_frequency[f, 1]
        for j in range(lanes):
            x = x0 + signs[j] * real[j]
            y = y0 + signs[j] * imaginary[j]
            refused[j] += x * x + y * y < floor
    signs[chip] = sign


@inlined
def _offer(
    fine: Floats,
    code: Codes,
    precise: Floats,
    deepest: NDArray[np.float64],
    best: Codes,
    best_count: NDArray[np.int64],
) -> None:
    """Append a code to the best if its smallest |P|^2 on the fine samples is the largest yet."""
    lowest = _fine_power(fine, code, precise)
    if lowest <= deepest[0]:
        return
    if best_count[0] == best.shape[0]:
        for r in range(1, best.shape[0]):
            best[r - 1] = best[r]
        best_count[0] -= 1
    best[best_count[0]] = code
    best_count[0] += 1
    deepest[0] = lowest


@compiled
def sweep_loop(
    tables: Any,
    code: Codes,
    random: NDArray[np.uint64],
    temperature: float,
    moves: int,
    deepest: NDArray[np.float64],
    best: Codes,
    best_count: NDArray[np.int64],
) -> int:
    """Judge ``moves`` moves or some more, at a constant temperature; returns their number.

    Parameters
    ----------
    tables : SweepTables
    code : (n,) int8
        Changed in place.
    random : (1,) uint64
        State of the random numbers, not 0.
    temperature : float, dB
    deepest : (1,) float64
        Largest smallest |P|^2 on the fine samples yet; changed in place.
    best : (R, n) int8
        Filled with the last codes that raised it.
    best_count : (1,) int64
        How many codes were filled in.
    """
    by_chip = tables.by_chip
    chips = by_chip.shape[0]
    size = by_chip.shape[2]
    lanes = tables.by_frequency.shape[2]
    otf = np.zeros((2, size), np.float32)
    power = np.empty(size, np.float32)
    signs = np.zeros(lanes, np.float32)
    refused = np.empty(lanes, np.int32)
    dips = np.zeros(_DIPS, np.int64)
    precise = np.empty((2, tables.fine.shape[2]), np.float32)
    open_chips = 0
    for chip in range(chips):
        signs[chip] = 1 - 2 * code[chip]
        open_chips += code[chip]
        if code[chip]:
            for f in range(size):
                otf[0, f] += by_chip[chip, 0, f]
                otf[1, f] += by_chip[chip, 1, f]
    zero = np.float32(0)
    cost = _term_sum(by_chip, otf, 0, 0, zero, zero)
    dip_count = _find_dips(otf, power, dips)
    heat = temperature * np.log(10.0) / 2.5  # from dB of the sum's fourth root to its exponent
    judged_moves = 0
    while judged_moves < moves:
        judged_moves += chips
        chip = int(uniform(random) * chips)
        limit = np.float32(cost * (1.0 - uniform(random)) ** -heat)
        # partners from a random one on: the first that passes is taken
        start = int(uniform(random) * chips)
        # one term alone exceeds the limit where |P|^2 is below this
        floor = np.float32(1.0 / np.sqrt(np.sqrt(limit)))
        _refuse_partners(tables, otf, dips, dip_count, chip, signs, floor, refused)
        sign = signs[chip]
        once = tables.low <= open_chips + int(sign) <= tables.high
        twice = tables.low <= open_chips + 2 * int(sign) <= tables.high
        for step in range(chips):
            partner = start + step
            if partner >= chips:
                partner -= chips
            if refused[partner] > 0:
                continue
            partner_sign = zero
            if partner != chip:
                partner_sign = signs[partner]
            if partner_sign == zero:
                if not once:
                    continue
            elif partner_sign == sign and not twice:
                continue
            changed = _term_sum(by_chip, otf, chip, partner, sign, partner_sign)
            if changed > limit:
                continue
            cost = changed
            for f in range(size):
                otf[0, f] += sign * by_chip[chip, 0, f] + partner_sign * by_chip[partner, 0, f]
                otf[1, f] += sign * by_chip[chip, 1, f] + partner_sign * by_chip[partner, 1, f]
            code[chip] = 1 - code[chip]
            signs[chip] = -sign
            open_chips += int(sign) + int(partner_sign)
            if partner != chip:
                code[partner] = 1 - code[partner]
                signs[partner] = -partner_sign
            dip_count = _find_dips(otf, power, dips)
            lowest = np.float32(np.inf)
            for d in range(dip_count):
                lowest = min(lowest, power[dips[d]])
            # what is deepest on the coarse samples need not be so between them
            if lowest > deepest[0]:
                _offer(tables.fine, code, precise, deepest, best, best_count)
            break
    return judged_moves
