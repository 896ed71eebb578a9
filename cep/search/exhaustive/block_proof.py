"""Proof in blocks: which folds each block holds, and the record of a block that was judged.

A record states: of the codes of the block, those listed are all whose |P| is nowhere below the
bound. It stays true when a better code is found later, so every block may have a bound of its own;
none may exceed the best minimum of all. Folds, prefixes and rotations:
:mod:`cep.search.exhaustive.folds`.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import lru_cache
from math import comb
from typing import Any

import numpy as np

from cep.optics.code import ShutterCode
from cep.proofs.certify.minimum import chip_minimum, min_chip
from cep.search.exhaustive.blocks import MARGIN
from cep.search.exhaustive.folds import COUNTS, codes_by_prefix, folding, scan_prefixes
from cep.search.problem import SearchProblem

VERSION = 1
"""Of the method and its blocks: records of another one are of other blocks."""

MOST_CHIPS = 60
_MOST_FOUND = 2**18
_CODES = 2**37  # of a block, about: a second
_FEWEST = 8  # blocks of a proof
_MOST = 1024


@dataclass(frozen=True)
class Block:
    """A range of prefixes, and the number of codes that it accounts for."""

    first: int
    until: int
    codes: int


@dataclass(frozen=True)
class BlockPlan:
    """A problem cut into blocks.

    Attributes
    ----------
    chips : int
        Longest code.
    fewest, most : int
        Open chips.
    ring : int
        Chips of the ring on which codes are folded, a multiple of four.
    prefix : int
        Sums of a fold by which blocks are cut.
    blocks : tuple of Block
        Each code that fits on the ring, closed chips at either end included, belongs to one.
    """

    chips: int
    fewest: int
    most: int
    ring: int
    prefix: int
    blocks: tuple[Block, ...]

    @property
    def codes(self) -> int:
        """All codes of the ring with so many open chips, in closed form."""
        return sum(comb(self.ring, opened) for opened in range(self.fewest, self.most + 1))

    def header(self) -> dict[str, Any]:
        """First line of a proof's file."""
        return {
            "chips": self.chips,
            "fewest_open": self.fewest,
            "most_open": self.most,
            "ring": self.ring,
            "prefix": self.prefix,
            "blocks": len(self.blocks),
            "codes": self.codes,
        }


def plan_blocks(problem: SearchProblem) -> BlockPlan:
    """Cut a problem into blocks of about as many codes each.

    Raises
    ------
    ValueError
        For a problem with a motion along which the shape of a chip counts, with limits on runs or
        single chips, another objective, or too many chips.
    """
    if [name for name, _ in problem.objective_mix] != ["min-mtf"] or problem.rule != "worst":
        raise ValueError(
            'objective: only the largest "min-mtf" in the worst scenario can be proven'
        )
    if problem.scenarios or (problem.response is not None and not problem.response.instant):
        raise ValueError(
            "scenarios: a proof in blocks is for a uniform straight motion; leave --workers out"
        )
    runs = problem.runs
    plain = runs.min_open == runs.min_closed == runs.min_period == 1
    if not plain or runs.max_pulses or runs.max_open or runs.fixed:
        raise ValueError(
            "runs: a proof in blocks has no limits on runs or single chips; leave --workers out"
        )
    if problem.chips > MOST_CHIPS:
        raise ValueError(
            f"chips: at most {MOST_CHIPS} can be proven in blocks, got {problem.chips}"
        )
    low, high = problem.open_limits
    return _planned(problem.chips, max(low, 1), high)


@lru_cache(maxsize=4)
def _planned(chips: int, fewest: int, most: int) -> BlockPlan:
    fold = folding(chips, (fewest, most), 1.0)
    by_prefix = codes_by_prefix(fold.quarter, fold.prefix, fewest, most)
    total = sum(by_prefix.tolist())
    each = total / min(max(total // _CODES, _FEWEST), _MOST)
    blocks = []
    first = 0
    held = 0
    for prefix, codes in enumerate(by_prefix.tolist(), 1):
        held += codes
        if held >= each or prefix == by_prefix.size:
            blocks.append(Block(first, prefix, held))
            first = prefix
            held = 0
    return BlockPlan(chips, fewest, most, 4 * fold.quarter, fold.prefix, tuple(blocks))


def judge_block(
    chips: int, fewest: int, most: int, first: int, until: int, bound: float
) -> dict[str, float | int | str]:
    """Judge the codes of a block: the work of a cell, see :mod:`cep.jobs.engine`.

    Parameters
    ----------
    chips, fewest, most : int
    first, until : int
        Prefixes of the block.
    bound : float
        Smallest |P| of interest.

    Returns
    -------
    dict
        ``first``, ``until``, ``bound``; ``codes`` accounted for;
        :data:`cep.search.exhaustive.folds.COUNTS`; ``survivors``: codes of at most so many chips
        whose minimum is not below the bound, of each mirror pair the larger text, joined by
        spaces; ``minima`` of these, in the same order; ``seconds`` of a core.

    Raises
    ------
    ValueError
        If so many codes reach the bound that it does not serve a proof.
    """
    began = time.thread_time()
    found = np.zeros(_MOST_FOUND, np.uint64)
    counts = np.zeros(len(COUNTS) + 1, np.int64)
    fold = folding(chips, (fewest, most), bound * (1 - MARGIN))
    number = scan_prefixes(first, until, fold, found, counts)
    if number < 0:
        raise ValueError(
            f"bound: more than {_MOST_FOUND} codes reach {bound:.6g}, begin with a better code"
        )
    kept = {}
    for word in sorted(set(found[:number].tolist())):
        bits = core(format(word, "b")[::-1])
        value = min_chip(ShutterCode(bits))
        if value >= bound * (1 - MARGIN):
            kept[bits] = value
    ordered = sorted(kept)
    return {
        "first": first,
        "until": until,
        "bound": bound,
        "codes": int(counts[-1]),
        **{name: int(count) for name, count in zip(COUNTS, counts, strict=False)},
        "survivors": " ".join(ordered),
        "minima": " ".join(f"{kept[bits]:.9f}" for bits in ordered),
        "seconds": round(time.thread_time() - began, 3),
    }


def core(bits: str) -> str:
    """Strip closed chips from a code's ends, and take the larger text of two mirror images."""
    inside = bits.strip("0")
    return max(inside, inside[::-1])


def certified(bits: str) -> float:
    """Bound a code's minimum from below."""
    return chip_minimum(ShutterCode(bits)).lower
