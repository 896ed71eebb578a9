"""Folded scan against brute force, closed counts, and the other exact search."""

from math import comb

import numpy as np
import pytest

from cep.optics.code import ShutterCode
from cep.proofs.certify.minimum import min_chip
from cep.search.exhaustive.exact import exact
from cep.search.problem import SearchProblem
from lab.block_proofs.blocks import core, judge_block, plan_blocks
from lab.block_proofs.folds import codes_by_prefix, folding


def records(bound, chips, open_range=None):
    plan = plan_blocks(chips, *(open_range or (1, chips)))
    return plan, [
        judge_block(plan.chips, plan.fewest, plan.most, block.first, block.until, bound)
        for block in plan.blocks
    ]


def survivors(found):
    return [bits for record in found for bits in record["survivors"].split()]


@pytest.mark.parametrize(
    ("chips", "opened", "bound"),
    [
        (7, (1, 7), 0.9),
        (12, (1, 12), 0.8),
        (13, (1, 13), 0.7),
        (15, (4, 9), 0.9),
        (16, (1, 16), 1.0),
        (14, (7, 7), 0.3),
    ],
)
def test_survivors_are_those_of_brute_force(chips, opened, bound):
    _, found = records(bound, chips, opened)
    codes = (np.arange(1, 2**chips, 2)[:, None] >> np.arange(chips)) & 1
    codes = codes[(codes.sum(axis=1) >= opened[0]) & (codes.sum(axis=1) <= opened[1])]
    likely = codes[np.abs(np.fft.rfft(codes, 16 * chips, axis=1)).min(axis=1) >= bound - 1e-9]
    cores = {core("".join(map(str, code))) for code in likely.tolist()}
    wanted = {bits for bits in cores if min_chip(ShutterCode(bits)) >= bound * (1 - 1e-8)}
    assert wanted
    # sorted: none is listed twice
    assert sorted(survivors(found)) == sorted(wanted)


@pytest.mark.parametrize(
    ("chips", "opened"), [(12, (1, 12)), (18, (1, 18)), (20, (9, 11)), (24, (12, 12))]
)
def test_blocks_hold_every_code_of_the_ring_once(chips, opened):
    plan, found = records(1.5, chips, opened)
    assert plan.codes == sum(comb(plan.ring, k) for k in range(opened[0], opened[1] + 1))
    assert (
        sum(record["codes"] for record in found)
        == sum(block.codes for block in plan.blocks)
        == plan.codes
    )
    assert [block.first for block in plan.blocks] == [
        0,
        *(block.until for block in plan.blocks[:-1]),
    ]
    assert plan.blocks[-1].until == 5**plan.prefix


@pytest.mark.parametrize(
    ("chips", "opened"), [(21, None), (22, (9, 9)), (26, None), (28, (14, 14))]
)
def test_the_best_is_that_of_the_scan_with_bit_tables(chips, opened):
    problem = SearchProblem(chips=chips, open_range=opened)
    other = exact(problem, threads=1)
    _, found = records(other.proof.lower, chips, opened)
    assert core(other.code.bits) in survivors(found)
    best = max(float(text) for record in found for text in record["minima"].split())
    assert best == pytest.approx(other.proof.upper, abs=2e-6)


def test_a_lower_bound_leaves_the_same_codes_and_more():
    _, low = records(1.2, 20)
    _, high = records(1.3, 20)
    assert set(survivors(high)) < set(survivors(low))
    minima = {
        bits: float(text)
        for record in low
        for bits, text in zip(record["survivors"].split(), record["minima"].split(), strict=True)
    }
    assert set(survivors(high)) == {bits for bits, value in minima.items() if value >= 1.3}


def test_counts_by_prefix_are_those_of_all_folds():
    fold = folding(12, (1, 12), 1.0)
    total = np.zeros(5**fold.prefix, dtype=int)
    for word in range(1, 2**12):
        sums = [sum((word >> (i + 3 * j)) & 1 for j in range(4)) for i in range(3)]
        largest = max(way[k:] + way[:k] for way in (sums, sums[::-1]) for k in range(3))
        total[int("".join(map(str, largest[: fold.prefix])), 5)] += 1
    assert codes_by_prefix(3, fold.prefix, 1, 12).tolist() == total.tolist()


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ((61, 1, 61), "chips: must lie within 1..60"),
        ((20, 0, 4), "open chips: must lie within 1..20"),
        ((20, 5, 4), "open chips: must lie within 1..20"),
    ],
)
def test_limits_that_no_plan_has_are_refused(limits, message):
    with pytest.raises(ValueError, match=message):
        plan_blocks(*limits)


def test_a_bound_that_all_codes_reach_is_refused(monkeypatch):
    monkeypatch.setattr("lab.block_proofs.blocks._MOST_SURVIVORS", 4)
    with pytest.raises(ValueError, match="bound: more than 4 codes reach"):
        judge_block(16, 1, 16, 0, 625, 0.3)
