"""Neighbours of a code, against brute force; zeros where theory puts them."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cep.audit import better_neighbours, minimum_along, null_threshold
from cep.code import ShutterCode
from cep.exposure import coded_otf
from cep.minimum import min_chip
from motdiff.trajectory import Trajectory

BENT = Trajectory.from_samples([[0, 0], [6, 1], [9, 5]])


def flipped(bits, places):
    return "".join(str(1 - int(bit)) if k in places else bit for k, bit in enumerate(bits))


@settings(max_examples=15, deadline=None)
@given(st.text("01", min_size=6, max_size=10).filter(lambda bits: "1" in bits))
def test_the_best_neighbours_are_found(bits):
    code = ShutterCode(bits)
    found = {len(n.flips): n for n in better_neighbours(code, flips=2)}
    for flips in (1, 2):
        others = [flipped(bits, places) for places in combinations(range(len(bits)), flips)]
        best = max(min_chip(ShutterCode(other)) for other in others if "1" in other)
        if best > 1.01 * min_chip(code) + 1e-9:
            assert found[flips].minimum == pytest.approx(best, rel=1e-6)
        if flips in found:
            assert found[flips].code.bits == flipped(bits, [k - 1 for k in found[flips].flips])
            assert found[flips].minimum > min_chip(code)


def test_the_best_code_has_no_better_neighbour():
    best = max((ShutterCode(f"{n:09b}") for n in range(1, 2**9)), key=min_chip)
    assert better_neighbours(best, flips=3) == ()


def test_an_open_shutter_has_zeros_at_multiples_of_one_over_its_length():
    found = minimum_along(ShutterCode("1" * 8), None)
    assert found.upper < null_threshold(ShutterCode("1" * 8), None)
    assert found.at[0] * 8 == pytest.approx(round(found.at[0] * 8), abs=1e-6)


@pytest.mark.parametrize("direction", ["known", "unknown"])
def test_the_minimum_along_a_path_counts_the_worse_direction(direction):
    path = Trajectory(BENT.t, BENT.xy, direction)
    code = ShutterCode("110100")
    found = minimum_along(code, path)
    line = np.linspace(-0.5, 0.5, 201)
    fx, fy = np.meshgrid(line, line)
    paths = [path] if direction == "known" else [path, path.reversed()]
    dense = min(float(np.abs(coded_otf(p, code, fx, fy)).min()) for p in paths)
    # a curved path's zeros are isolated points: both searches come close to one
    assert found.lower <= found.upper <= dense + 1e-4


def test_neighbours_along_a_path_are_better_there():
    known = Trajectory(BENT.t, BENT.xy, "known")
    code = ShutterCode("111111")
    for neighbour in better_neighbours(code, known, flips=2):
        assert neighbour.minimum > minimum_along(code, known).upper
