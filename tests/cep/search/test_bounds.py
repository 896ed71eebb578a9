"""Bounds: above (or below) every code by brute force."""

import numpy as np
import pytest
from bounded_problems import PROBLEMS, accelerated, all_codes, best_of_all
from hypothesis import given, settings
from hypothesis import strategies as st

from cep.optics.code import ShutterCode
from cep.optics.response import ShutterResponse
from cep.proofs.certify.minimum import min_chip
from cep.search.bounds import bound, chip_ceilings, circle_average
from cep.search.problem import SearchProblem
from motdiff.trajectory import Trajectory


@pytest.mark.parametrize("name", PROBLEMS)
def test_no_code_passes_a_bound(name):
    problem = PROBLEMS[name]
    lowest, noise = best_of_all(problem)
    limits = bound(problem)
    assert lowest <= limits.min_mtf * (1 + 1e-9) + 1e-12
    assert noise >= limits.noise
    assert limits.min_mtf <= 1.5 * problem.open_limits[1] / problem.chips
    assert set(limits.method) == {"min_mtf", "min_chip", "noise"}


@given(
    st.integers(2, 40).flatmap(lambda n: st.tuples(st.just(n), st.integers(1, n))),
    st.integers(0, 99),
)
@settings(deadline=None)  # the proven minima are computed at the first use
def test_closed_forms_hold_for_random_codes(size, seed):
    chips, k = size
    bits = np.zeros(chips)
    bits[np.random.default_rng(seed).permutation(chips)[:k]] = 1
    reached = min_chip(ShutterCode(bits))
    for values in chip_ceilings(chips, np.array([k])).values():
        assert reached <= values[0] + 1e-9


def test_known_minima_and_theorem():
    """Barker-13 (k = 9) has 1.362373; the first code above 2 has 39 chips, so 38 are bounded by 2
    and 39 are not (Hare and Jankauskas, arXiv 1910.13994)."""
    barker = SearchProblem(chips=13, open_range=(9, 9))
    assert bound(barker).min_chip == pytest.approx(1.362373, abs=1e-5)
    assert bound(SearchProblem(chips=38)).min_chip <= 2
    assert bound(SearchProblem(chips=38)).method["min_chip"] == "proven"
    assert bound(SearchProblem(chips=39)).min_chip > 2.018
    assert bound(SearchProblem(chips=52, open_range=(26, 26))).min_chip == pytest.approx(
        2.242270, abs=2e-6
    )
    assert bound(SearchProblem(chips=60, open_range=(30, 30))).min_chip == pytest.approx(
        np.sqrt(30 * 30 / 59)
    )
    assert bound(SearchProblem(chips=1)).min_chip == 1


def test_circle_average_keeps_what_a_finer_grid_sees():
    n = 7
    size = 64
    kept = circle_average(np.abs(np.sin(np.arange(size // 2 + 1))), n)
    lags = np.fft.irfft(kept)
    assert kept.min() >= 0
    assert np.abs(lags[(size - n) // 2 : size // 2]).max() < 1e-12


def test_a_shutter_with_ramps_is_bounded_by_its_light():
    slow = ShutterResponse(chip_ns=1000, rise_ns=600, fall_ns=900)
    problem = SearchProblem.along(
        accelerated(), chips=7, open_range=(3, 3), direction="forward", response=slow
    )
    metrics = [problem.measure(ShutterCode(code), budget=0) for code in all_codes(7, [3])]
    limits = bound(problem)
    assert max(m.min_mtf for m in metrics) <= limits.min_mtf
    assert min(m.noise_gain_db for m in metrics) >= limits.noise
    assert limits.method["min_mtf"] == limits.method["noise"] == "light"


@pytest.mark.parametrize("opened", [1, 3, 6, 7])
def test_every_pulse_has_one_tail(opened):
    lingering = ShutterResponse(chip_ns=1000, on_bias_ns=300, fall_ns=400)
    problem = SearchProblem.along(
        Trajectory.straight(3.0),
        chips=7,
        open_range=(opened, opened),
        response=lingering,
        objective="noise",
    )
    most = lingering.open_time(all_codes(7, [opened])).max()
    assert bound(problem).noise == pytest.approx(-20 * np.log10(most), abs=1e-9)
