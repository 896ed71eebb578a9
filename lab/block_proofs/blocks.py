"""Blocks of a proof: the folds that each block holds, and the record of a block that was judged.

A record states: of the codes of the block, those listed are all whose |P| is nowhere below the
bound. It stays true when a better code is found later, so every block may have a bound of its own;
none may exceed the best minimum of all. Folds, prefixes and rotations: :mod:`.folds`.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import lru_cache
from math import comb

import numpy as np

from cep.optics.code import ShutterCode
from cep.proofs.certify.minimum import chip_minimum, min_chip
from lab.block_proofs.folds import COUNTS, codes_by_prefix, folding, scan_prefixes

VERSION = 1
"""Of the method and its blocks: records of another version are of other blocks."""

MOST_CHIPS = 60
_MARGIN = 1e-8  # relative: codes with the bound's own minimum stay in spite of rounding
_MOST_SURVIVORS = 2**18
_BLOCK_CODES = 2**37  # about a second of one core
_FEWEST_BLOCKS = 8
_MOST_BLOCKS = 1024


@dataclass(frozen=True)
class Block:
    """A range of prefixes, and the number of codes that it accounts for."""

    first: int
    until: int
    codes: int


@dataclass(frozen=True)
class BlockPlan:
    """All codes of a range of open chips, cut into blocks.

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
        return sum(comb(self.ring, open_chips) for open_chips in range(self.fewest, self.most + 1))

    def header(self) -> dict[str, int]:
        """First line of a proof's file, without its version."""
        return {
            "chips": self.chips,
            "fewest_open": self.fewest,
            "most_open": self.most,
            "ring": self.ring,
            "prefix": self.prefix,
            "blocks": len(self.blocks),
            "codes": self.codes,
        }


@lru_cache(maxsize=4)
def plan_blocks(chips: int, fewest: int, most: int) -> BlockPlan:
    """Cut the codes of at most ``chips`` chips into blocks of about as many codes each.

    Raises
    ------
    ValueError
        If there are too many chips, or the range of open chips is empty.
    """
    if not 1 <= chips <= MOST_CHIPS:
        raise ValueError(f"chips: must lie within 1..{MOST_CHIPS}, got {chips}")
    if not 1 <= fewest <= most <= chips:
        raise ValueError(f"open chips: must lie within 1..{chips}, got {fewest}..{most}")
    fold = folding(chips, (fewest, most), 1.0)
    by_prefix = codes_by_prefix(fold.quarter, fold.prefix, fewest, most).tolist()
    total = sum(by_prefix)
    block_codes = total / min(max(total // _BLOCK_CODES, _FEWEST_BLOCKS), _MOST_BLOCKS)
    blocks = []
    first = 0
    codes = 0
    for until, prefix_codes in enumerate(by_prefix, 1):
        codes += prefix_codes
        if codes >= block_codes or until == len(by_prefix):
            blocks.append(Block(first, until, codes))
            first = until
            codes = 0
    return BlockPlan(chips, fewest, most, 4 * fold.quarter, fold.prefix, tuple(blocks))


def judge_block(
    chips: int, fewest: int, most: int, first: int, until: int, bound: float
) -> dict[str, float | int | str]:
    """Judge the codes of a block.

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
        :data:`lab.block_proofs.folds.COUNTS`; ``survivors``: codes of at most so many chips whose
        minimum is not below the bound, of each mirror pair the larger text, joined by spaces;
        ``minima`` of these, in the same order; ``seconds`` of a core.

    Raises
    ------
    ValueError
        If so many codes reach the bound that it does not serve a proof.
    """
    start_s = time.thread_time()
    words = np.zeros(_MOST_SURVIVORS, np.uint64)
    counts = np.zeros(len(COUNTS) + 1, np.int64)
    fold = folding(chips, (fewest, most), bound * (1 - _MARGIN))
    number = scan_prefixes(first, until, fold, words, counts)
    if number < 0:
        raise ValueError(
            f"bound: more than {_MOST_SURVIVORS} codes reach {bound:.6g}, begin with a better code"
        )
    minima: dict[str, float] = {}
    for word in set(words[:number].tolist()):
        bits = core(format(word, "b")[::-1])
        minimum = min_chip(ShutterCode(bits))
        if minimum >= bound * (1 - _MARGIN):
            minima[bits] = minimum
    survivors = sorted(minima)
    return {
        "first": first,
        "until": until,
        "bound": bound,
        "codes": int(counts[-1]),
        **{name: int(count) for name, count in zip(COUNTS, counts, strict=False)},
        "survivors": " ".join(survivors),
        "minima": " ".join(f"{minima[bits]:.9f}" for bits in survivors),
        "seconds": round(time.thread_time() - start_s, 3),
    }


def core(bits: str) -> str:
    """Strip closed chips from a code's ends, and take the larger text of two mirror images."""
    inside = bits.strip("0")
    return max(inside, inside[::-1])


def certified(bits: str) -> float:
    """Bound a code's minimum from below."""
    return chip_minimum(ShutterCode(bits)).lower
