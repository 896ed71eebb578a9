"""DNF's code: the least noise that exhaustive search finds for its length, within the limits, and
never by luck."""

import itertools

import numpy as np
import pytest

from cep.optics.code import ShutterCode
from cep.proofs.measure import measure
from cep.search.annealing.anneal import anneal
from cep.search.baselines import dnf_problem
from cep.search.limits import RunLimits
from lab.bench.published_codes import chip_noise_db
from motdiff.trajectory import Trajectory


def dnf_code(length_px, chips, *, rng, steps=1_000_000, **limits):
    return anneal(dnf_problem(length_px, chips, **limits), rng=rng, steps=steps).code


def noise_db(bits, length_px):
    return measure(Trajectory.straight(length_px), ShutterCode(bits), budget=0).noise_gain_db


@pytest.mark.parametrize("length_px", [6.0, 15.5])
def test_no_code_of_the_same_light_has_less_noise(length_px):
    n = 11
    k = 5
    found = dnf_code(length_px, n, rng=np.random.default_rng(0), steps=20_000, open_range=(k, k))
    every = [
        "".join("1" if i in chosen else "0" for i in range(n))
        for chosen in itertools.combinations(range(n), k)
    ]
    assert found.open_chips == k
    assert noise_db(found.bits, length_px) == pytest.approx(
        min(noise_db(bits, length_px) for bits in every), abs=1e-6
    )


def test_it_beats_every_random_code_on_a_straight_blur():
    rng = np.random.default_rng(1)
    found = dnf_code(30.0, 32, rng=rng, steps=100_000, open_range=(16, 16))
    drawn = dnf_problem(30.0, 32, open_range=(16, 16)).random_codes(50, rng=rng)
    gains = [noise_db(ShutterCode(bits).bits, 30.0) for bits in drawn]
    assert noise_db(found.bits, 30.0) < min(gains) - 1


def test_the_factor_itself_would_ask_for_a_single_chip():
    """Why codes of different light are compared by noise: relative to its own light, one chip
    cannot be beaten."""
    rng = np.random.default_rng(2)
    codes = [
        ShutterCode("0010"),
        *(ShutterCode(bits) for bits in rng.integers(0, 2, (30, 9)) if bits.any()),
    ]
    factors_db = [chip_noise_db(code) + 20 * np.log10(code.open_chips) for code in codes]
    assert factors_db[0] == pytest.approx(0, abs=1e-9)
    assert min(factors_db) >= -1e-9
    # and yet its noise is far from the least
    assert dnf_code(9.0, 9, rng=rng, steps=5_000).open_chips > 2


def test_the_limits_are_kept():
    code = dnf_code(
        20.0,
        24,
        rng=np.random.default_rng(3),
        steps=5000,
        open_range=(8, 12),
        runs=RunLimits(min_open=2, max_pulses=4),
    )
    assert 8 <= code.open_chips <= 12
    assert code.pulses <= 4
    assert min(length for bit, length in code.runs if bit) >= 2


def test_a_path_without_length_is_designed_for_like_one_of_a_pixel():
    codes = [
        dnf_code(length_px, 8, rng=np.random.default_rng(4), steps=2_000)
        for length_px in (0.0, 1.0)
    ]
    assert codes[0] == codes[1]
