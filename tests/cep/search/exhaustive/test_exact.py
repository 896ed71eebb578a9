"""The proof: against plain brute force, on known values, within every limit, and whatever it
starts from."""

from functools import cache
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cep.optics.band import band_samples
from cep.optics.code import ShutterCode
from cep.optics.exposure import chip_basis
from cep.optics.response import ShutterResponse
from cep.proofs.certify.minimum import min_chip
from cep.search.annealing.proposals import LoopLimits, keeps_runs
from cep.search.exhaustive.exact import BestCode, codes_to_count, exact
from cep.search.exhaustive.scan import INNER, all_patterns, possible
from cep.search.exhaustive.scan_tables import LimitTables
from cep.search.limits import RunLimits
from cep.search.problem import Scenario, SearchProblem
from motdiff.trajectory import Trajectory


def arc(length_px=4.0):
    angle = np.linspace(0, 2.2, 24) ** 1.4
    return Trajectory.from_samples(
        length_px / 3 * np.stack([np.cos(angle), np.sin(1.7 * angle)], 1)
    )


@cache
def everything(chips):
    """All codes with the first chip open, and their smallest |P| on a grid."""
    codes = (2 * np.arange(2 ** (chips - 1))[:, None] + 1 >> np.arange(chips) & 1).astype(np.int8)
    blocks = [
        np.abs(np.fft.rfft(part, 128)).min(axis=1)
        for part in np.array_split(codes, max(1, len(codes) // 2**15))
    ]
    return codes, np.concatenate(blocks)


def brute_force(problem):
    """Largest minimum of any code: the grid orders the codes, and the continuum only lowers its
    figures."""
    codes, sampled = everything(problem.chips)
    kept = np.flatnonzero(problem.satisfied(codes))
    best = -1.0
    for index in kept[np.argsort(-sampled[kept])]:
        if sampled[index] <= best:
            break
        best = max(best, min_chip(ShutterCode(codes[index])))
    return best


def sampled_minimum(codes, basis):
    return np.hypot(codes @ basis.real, codes @ basis.imag).min(axis=1)


def recheck(proof):
    """Repeat a proof on the unit circle by brute force."""
    limits = proof.limits
    problem = SearchProblem(
        chips=proof.chips,
        open_range=(limits["fewest_open"], limits["most_open"]),
        runs=RunLimits(
            min_open=limits["min_open"],
            min_closed=limits["min_closed"],
            max_pulses=limits["max_pulses"],
            max_open=limits["max_open"],
            min_period=limits["min_period"],
        ),
    )
    best = brute_force(problem)
    return proof.complete and proof.lower - 1e-9 <= best <= proof.upper + 1e-9


@pytest.mark.parametrize("chips", [1, 2, 5, 8, 11, 12, 13, 16])
def test_free_optimum_is_that_of_brute_force(chips):
    found = exact(SearchProblem(chips=chips), threads=1)
    assert found.proven
    assert recheck(found.proof)
    assert found.minimum.lower <= min_chip(found.code) <= found.minimum.upper + 1e-9
    assert found.proof.upper - found.proof.lower <= 2e-6 * found.proof.upper
    # every code is a shift of one that starts open
    assert sum(entry.codes for entry in found.proof.lengths) == 2 ** (chips - 1)
    assert all(entry.codes / 2 <= entry.judged <= entry.codes for entry in found.proof.lengths)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"open_range": (11, 11)},
        {"runs": RunLimits(min_open=2, min_closed=2, max_pulses=4)},
        {"runs": RunLimits(max_open=2)},
        {"runs": RunLimits(max_open=5, min_period=5)},
    ],
)
def test_bit_tables_lose_no_code(options):
    problem = SearchProblem(chips=20, **options)
    found = exact(problem, threads=1)
    assert found.proven
    assert recheck(found.proof)
    assert problem.satisfied(found.code.array[None])[0]


@pytest.mark.slow  # brute force
@given(
    st.integers(8, 13),
    st.integers(1, 3),
    st.integers(1, 3),
    st.one_of(st.none(), st.integers(1, 4)),
    st.integers(1, 5),
    st.integers(0, 8),
    st.one_of(st.none(), st.integers(1, 6)),
    st.integers(1, 7),
)
@settings(max_examples=40, deadline=None)
def test_limits_are_those_of_brute_force(
    chips, min_open, min_closed, max_pulses, fewest, more, max_open, min_period
):
    most = min(chips, max(fewest, min_open) + more)
    try:
        problem = SearchProblem(
            chips=chips,
            open_range=(fewest, most),
            runs=RunLimits(
                min_open=min_open,
                min_closed=min_closed,
                max_pulses=max_pulses,
                max_open=max_open,
                min_period=min_period,
            ),
        )
    except ValueError:
        return  # no code keeps such limits
    found = exact(problem, threads=1)
    assert problem.satisfied(found.code.array[None])[0]
    assert recheck(found.proof)


def test_a_period_is_not_kept_by_mirror_images():
    """Starts of pulses turn into ends: both codes of a mirror pair must be counted, and only one
    may be named."""
    forward = SearchProblem(
        chips=13, open_range=(5, 5), runs=RunLimits(max_pulses=2, min_period=6)
    )
    assert not forward.mirrors
    found = exact(forward, threads=1)
    assert recheck(found.proof)
    codes = all_patterns(13)
    kept = codes[forward.satisfied(codes)]
    assert not forward.satisfied(kept[:, ::-1]).all()
    # every code with both ends open of every length, and the mirror image of each
    assert all(
        entry.judged >= entry.codes / 2
        for entry in found.proof.lengths
        if entry.length < INNER + 2
    )
    assert codes_to_count(forward) == 2 * codes_to_count(
        SearchProblem(chips=13, open_range=(5, 5))
    )


@pytest.mark.slow  # brute force
@given(
    st.text("01", min_size=1, max_size=24),
    st.integers(1, 3),
    st.integers(1, 3),
    st.integers(1, 6),
    st.integers(1, 6),
    st.integers(1, 8),
)
@settings(max_examples=300, deadline=None)
def test_runs_are_kept_by_codes_and_their_parts(
    bits, min_open, min_closed, max_pulses, max_open, min_period
):
    bits = f"1{bits}1"
    code = np.array([[int(bit) for bit in bits]], dtype=np.int8)
    problem = SearchProblem(
        chips=len(bits),
        runs=RunLimits(
            min_open=min(min_open, len(bits)),
            min_closed=min_closed,
            max_pulses=max_pulses,
            max_open=max(max_open, min_open),
            min_period=min_period,
        ),
    )
    limits = LoopLimits.of(problem)
    kept = bool(problem.satisfied(code)[0])
    assert keeps_runs(code[0], limits) == kept
    for first in range(len(bits)):
        for last in range(first + 1, len(bits) + 1):
            fits = possible(code[:, first:last], limits, (first == 0, last == len(bits)))[0]
            assert fits or not kept


@pytest.mark.parametrize(
    ("opened", "chips", "value"),
    [
        (3, 12, 0.607346),
        (4, 14, 0.752394),
        (5, 14, 1.0),
        (6, 25, 1.065286),
        (7, 24, 1.101883),
        (8, 24, 1.311101),
    ],
)
def test_published_values_by_number_of_ones(opened, chips, value):
    # published for codes of any length; these lengths reach them
    found = exact(SearchProblem(chips=chips, open_range=(opened, opened)), threads=1)
    assert found.code.open_chips == opened
    assert found.proof.lower == pytest.approx(value, abs=2e-6)


@pytest.mark.slow  # brute force
@pytest.mark.parametrize("chips", [9, 12])
@pytest.mark.parametrize("direction", ["forward", "unknown"])
def test_along_a_path_it_is_the_best_of_all_codes_at_the_samples(chips, direction):
    scenarios = (
        Scenario(arc()),
        Scenario(Trajectory.straight(3.0)),
    )
    problem = SearchProblem(
        chips=chips, scenarios=scenarios, direction=direction, open_range=(2, chips - 3)
    )
    found = exact(problem, threads=1)
    codes = all_patterns(chips)
    codes = codes[problem.satisfied(codes)].astype(float)
    lowest = np.full(len(codes), np.inf)
    for scenario in scenarios:
        for path in (scenario.trajectory, scenario.trajectory.reversed())[
            : 1 + (direction == "unknown")
        ]:
            samples = band_samples(path)
            basis = chip_basis(path, chips, samples.fx, samples.fy)
            lowest = np.minimum(lowest, sampled_minimum(codes, basis))
    assert found.proven
    assert found.proof.lower == pytest.approx(lowest.max(), rel=1e-9)
    assert found.minimum.upper <= found.proof.lower + 1e-9


def test_along_a_path_with_bit_tables():
    problem = SearchProblem.along(arc(5.0), chips=20, open_range=(3, 5), direction="forward")
    found = exact(problem, threads=1)
    samples = band_samples(arc(5.0))
    basis = chip_basis(arc(5.0), 20, samples.fx, samples.fy)
    chosen = [list(chips) for opened in (3, 4, 5) for chips in combinations(range(20), opened)]
    codes = np.zeros((len(chosen), 20))
    for row, chips in zip(codes, chosen, strict=True):
        row[chips] = 1
    likely = codes[np.argsort(-sampled_minimum(codes, basis[:, ::50]))[:2000]]
    assert found.proof.lower == pytest.approx(sampled_minimum(likely, basis).max(), rel=1e-9)
    assert sampled_minimum(likely[-1:], basis[:, ::50]) < found.proof.lower


def test_outcome_depends_neither_on_threads_nor_on_the_start(monkeypatch):
    problem = SearchProblem(chips=21)
    plain = exact(problem, threads=1)
    other = exact(problem, threads=3)
    monkeypatch.setattr(BestCode, "anneal", lambda self: None)
    cold = exact(problem, threads=1)
    assert plain.code == other.code == cold.code
    assert plain.minimum == other.minimum == cold.minimum
    codes = [
        [(entry.length, entry.judged) for entry in one.proof.lengths]
        for one in (plain, other, cold)
    ]
    assert codes[0] == codes[1] == codes[2]


def test_of_equal_minima_the_brighter_code_wins():
    found = exact(SearchProblem(chips=10), threads=1)
    # a single open chip reaches 1 as well, and so do darker codes
    assert min_chip(found.code) == pytest.approx(1.0, abs=1e-9)
    assert found.code.open_chips == 5


def test_interrupted_it_returns_the_best_so_far():
    problem = SearchProblem(chips=22)
    seen = []

    def progress(fraction, best):
        seen.append((fraction, min_chip(best)))
        if fraction > 0.3:
            raise KeyboardInterrupt

    part = exact(problem, threads=2, progress=progress)
    assert not part.proven
    assert not part.proof.complete
    assert part.proof.lower < part.proof.upper
    assert [fraction for fraction, _ in seen] == sorted(fraction for fraction, _ in seen)
    assert min_chip(part.code) >= seen[-1][1] - 1e-9


@given(st.integers(0, 99), st.floats(0.5, 2.5))
@settings(max_examples=10, deadline=None)
def test_what_a_cell_discards_is_below_the_limit_wherever_the_point_lies(seed, limit):
    rng = np.random.default_rng(seed)
    chips = 20
    basis = np.exp(-2j * np.pi * np.outer(np.arange(chips), rng.random(8) / 2))
    tables = LimitTables(basis, LoopLimits.of(SearchProblem(chips=chips)), limit)
    inner = all_patterns(INNER) @ tables.used[tables.inner_at : tables.inner_at + INNER]
    rows = tables.cells.reshape(-1, tables.grid, tables.grid, 16)
    discarded = 0
    for _ in range(200):
        frequency, y, x = rng.integers(tables.used.shape[1]), *rng.integers(tables.grid, size=2)
        left = np.unpackbits(rows[frequency, y, x].view(np.uint8), bitorder="little").astype(bool)
        # corners and a point inside
        for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1), rng.random(2)):
            point = tables.corner[frequency] + tables.step * (x + dx + 1j * (y + dy))
            assert (np.abs(point + inner[~left, frequency]) < limit).all()
        discarded += int((~left).sum())
    assert discarded > 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"chips": 10, "objective": "noise"}, "objective: only"),
        ({"chips": 10, "objective": (("min-mtf", 1.0), ("noise", 1.0))}, "objective: only"),
        ({"chips": 49}, "chips: at most 48"),
        (
            {"chips": 10, "scenarios": (Scenario(Trajectory.straight(40.0)),)},
            "scenarios: at some frequency no code",
        ),
        ({"chips": 10, "scenarios": (Scenario(arc()),), "rule": "mean"}, "objective: only"),
        (
            {
                "chips": 10,
                "scenarios": (Scenario(arc()),),
                "response": ShutterResponse(chip_ns=1e6, rise_ns=3e5),
            },
            "response: a proof needs",
        ),
    ],
)
def test_what_cannot_be_proven_is_named(options, message):
    with pytest.raises(ValueError, match=message) as caught:
        exact(SearchProblem(**options))
    assert "\n" not in str(caught.value)


def test_codes_to_count():
    assert codes_to_count(SearchProblem(chips=20)) == 2**18
    assert codes_to_count(SearchProblem.along(arc(), chips=10)) == 2**10
