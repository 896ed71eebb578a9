"""Proven codes: those of the tables in the documentation, whose proofs are there; answers wherever
these cover the problem, starts elsewhere, and never outside the limits.
"""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cep.optics.code import ShutterCode
from cep.optics.response import ShutterResponse
from cep.proofs.certify.minimum import chip_minimum, min_chip
from cep.search.code_search import SearchOptions, search_code
from cep.search.exhaustive.exact import exact
from cep.search.limits import RunLimits
from cep.search.optima import OPTIMA, proven_ceiling, proven_optimum, proven_starts
from cep.search.problem import Scenario, SearchProblem
from motdiff.trajectory import Trajectory

ROOT = Path(__file__).parents[3]
TABLE = (ROOT / "docs" / "optima.md").read_text()
ROW = r"^\| (\d+) \| (\d\.\d{6}) \| (\d+) \| (\d+) \| `([01]+)` \|"
SINGLE = r"^\| (52) \| (26) \| (\d\.\d{6}) \| (\d+) \| `([01]+)` \|"
STRAIGHT = Trajectory.straight(30.0)
LIMITED = {
    "any light": SearchProblem(chips=17),
    "a range of light": SearchProblem(chips=15, open_range=(6, 10)),
    "fixed light": SearchProblem(chips=14, open_range=(5, 5)),
    "few pulses": SearchProblem(chips=16, runs=RunLimits(max_pulses=5, max_open=5)),
    "period": SearchProblem(chips=15, runs=RunLimits(min_period=2)),
    "one chip": SearchProblem(chips=1),
}


def rows():
    """Return most chips, minimum, open chips, length and bits of each row with any number of open
    chips."""
    found = re.findall(ROW, TABLE, re.MULTILINE)
    return [
        (int(n), float(least), int(opened), int(length), bits)
        for n, least, opened, length, bits in found
    ]


def by_open_chips():
    """Return the last row of the table by open chips, as open chips -> minimum, and open chips ->
    bits."""
    chips, *cells = re.findall(r"^\| (\d+) \| (\d\.\d{4}) \|(.*)\|$", TABLE, re.MULTILINE)[-1]
    minima = [float(cell) for cell in " | ".join(cells).split(" | ")]
    codes = re.findall(r"^\| (\d+) \| `([01]+)` \|$", TABLE, re.MULTILINE)
    return int(chips), dict(enumerate(minima, 3)), {int(opened): bits for opened, bits in codes}


def test_the_table_has_the_bundled_codes_and_no_others():
    single = [bits for *_, bits in re.findall(SINGLE, TABLE, re.MULTILINE)]
    listed = [*dict.fromkeys(bits for *_, bits in rows()), *by_open_chips()[2].values(), *single]
    assert listed == [entry.bits for entry in OPTIMA]


def test_each_code_is_proven_for_the_chips_of_its_last_row():
    last = {bits: chips for chips, *_, bits in rows()}
    free = [entry for entry in OPTIMA if entry.fewest_open < entry.most_open]
    assert last == {entry.bits: entry.chips for entry in free}
    assert all((entry.fewest_open, entry.most_open) == (1, entry.chips) for entry in free)
    chips, _, codes = by_open_chips()
    fixed = {entry.bits: (entry.chips, entry.most_open) for entry in OPTIMA if entry not in free}
    assert fixed == {bits: (chips, opened) for opened, bits in codes.items()} | {
        OPTIMA[-1].bits: (52, 26)
    }


@pytest.mark.parametrize(
    "entry", OPTIMA, ids=lambda entry: f"{entry.chips}-{entry.bits.count('1')}"
)
def test_its_proof_is_a_page_or_a_file_of_the_documentation(entry):
    text = (ROOT / entry.proof).read_text()
    assert entry.bits in text


def test_each_row_states_what_its_code_has():
    for _, minimum, opened, length, bits in {row[-1]: row for row in rows()}.values():
        assert (bits.count("1"), len(bits)) == (opened, length)
        assert chip_minimum(ShutterCode(bits)).lower == pytest.approx(minimum, rel=2e-6)
    ((_, opened, minimum, length, bits),) = re.findall(SINGLE, TABLE, re.MULTILINE)
    assert (bits.count("1"), len(bits)) == (int(opened), int(length))
    assert chip_minimum(ShutterCode(bits)).lower == pytest.approx(float(minimum), rel=2e-6)


def test_the_codes_by_open_chips_have_the_minima_of_the_last_row():
    _, minima, codes = by_open_chips()
    assert minima.keys() == codes.keys()
    for opened, bits in codes.items():
        assert bits.count("1") == opened
        assert chip_minimum(ShutterCode(bits)).upper == pytest.approx(minima[opened], abs=6e-5)


@pytest.mark.parametrize("name", LIMITED)
def test_a_covered_problem_has_the_optimum_of_a_count_of_all_codes(name):
    problem = LIMITED[name]
    found = proven_optimum(problem)
    assert found is not None
    assert problem.allows(found.code)
    assert found.proven
    assert found.minimum.upper == pytest.approx(exact(problem).minimum.upper, rel=1e-6)


@pytest.mark.parametrize(
    "problem",
    [
        SearchProblem(chips=13, open_range=(10, 12)),  # the light excludes the best code
        SearchProblem(chips=13, runs=RunLimits(max_open=4)),
        SearchProblem(chips=13, runs=RunLimits(min_open=2)),
        SearchProblem(chips=49),  # no proof reaches so far
        SearchProblem(chips=50, open_range=(28, 28)),  # 48 chips were proven, not 50
        SearchProblem(chips=52, open_range=(25, 26)),
        SearchProblem(chips=13, objective="noise"),
        SearchProblem(chips=13, objective=(("min-mtf", 1.0), ("noise", 0.1))),
        SearchProblem(chips=13, scenarios=(Scenario(STRAIGHT),)),  # the chip's roll-off counts
    ],
)
def test_other_problems_are_not_covered(problem):
    assert proven_optimum(problem) is None


def test_starts_are_for_the_minimum_of_straight_motions_within_the_limits():
    ramps = ShutterResponse(chip_ns=1000, rise_ns=500, fall_ns=300)
    slowing = Trajectory.from_samples([[0, 0], [9, 0], [30, 0]], direction="unknown")
    for problem in (
        SearchProblem(chips=60),
        SearchProblem.along(STRAIGHT, chips=52, open_range=(20, 26), response=ramps),
        SearchProblem.along(slowing, chips=44, direction="unknown", runs=RunLimits(max_open=7)),
        SearchProblem(chips=60, open_range=(24, 24)),
    ):
        starts = proven_starts(problem)
        assert starts
        assert all(problem.allows(code) for code in starts)
    bent = Trajectory.from_samples([[0, 0], [6, 1], [9, 5], [10, 11]])
    assert proven_starts(SearchProblem.along(bent, chips=40)) == []
    assert proven_starts(SearchProblem(chips=40, objective="noise")) == []
    assert proven_starts(SearchProblem(chips=40, open_range=(30, 40))) == []


@pytest.mark.parametrize(
    ("chips", "light", "least"),
    [(50, None, 2.244272), (60, (26, 26), 2.242268), (64, None, 2.244272)],
)
def test_a_search_never_returns_less_than_what_is_proven_for_fewer_chips(chips, light, least):
    problem = SearchProblem(chips=chips, open_range=light)
    found = search_code(problem, SearchOptions(steps=100))
    assert found.stopped != "proven"
    assert min_chip(found.code) >= least


def test_a_covered_search_makes_no_move_and_names_its_proof():
    problem = SearchProblem(chips=52, open_range=(26, 26))
    found = search_code(problem, SearchOptions(steps=1000))
    assert (found.stopped, found.steps, found.proof["file"]) == (
        "proven",
        0,
        "docs/proofs/52-26.jsonl",
    )
    assert min_chip(found.code) == pytest.approx(2.242270, abs=2e-6)
    assert "published: raskar-52" in {row.name for row in found.baselines}
    assert all(row.cost_db >= found.objective for row in found.baselines if row.within_limits)
    # where a device, as one of long openings, excludes the code, it is not used
    slower = replace(problem, runs=RunLimits(min_open=2))
    other = search_code(slower, SearchOptions(steps=1000))
    assert other.stopped == "steps"
    assert slower.allows(other.code)


def test_no_code_exceeds_the_ceiling_of_its_chips_and_light():
    chips = 9
    codes = np.array(list(np.ndindex(*[2] * chips)))
    # on a grid a minimum is no smaller than the true one: a slack of its step is left
    least = np.abs(np.fft.fft(codes, 720, axis=1)).min(axis=1)
    opened = codes.sum(axis=1)
    for count in range(3, chips + 1):
        assert least[opened == count].max() <= proven_ceiling(chips, count) + 0.05 < count
    best = max(proven_ceiling(chips, count) for count in range(1, chips + 1))
    assert least.max() == pytest.approx(best, abs=0.05)
    assert proven_ceiling(200, 100) == math.inf
