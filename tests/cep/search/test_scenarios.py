"""What may happen instead: speeds, drift, jitter, alternatives; their physics and their books."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cep.optics.code import ShutterCode
from cep.optics.exposure import chip_basis, coded_otf
from cep.optics.response import ShutterResponse
from cep.optics.timeline import extended
from cep.search.scenarios import (
    MOST_SCENARIOS,
    Scenario,
    alternatives,
    drifted,
    jittered,
    scenario_rows,
    speed_range,
)
from motdiff.files.trajectories import StoredMotion
from motdiff.trajectory import Trajectory

CODE = ShutterCode("1011000101")
BENT = Trajectory.from_samples([[0, 0], [6, 1], [9, 5], [10, 11]], t=[0, 0.3, 0.5, 1])
F = np.linspace(0, 0.5, 60)
FX, FY = np.random.default_rng(2).uniform(-0.5, 0.5, (2, 30))


def otf(scenario, fx=F, fy=0.0):
    return coded_otf(scenario.trajectory, CODE, fx, fy, edges=scenario.edges)


@given(st.floats(0.3, 1), st.floats(1, 3), st.integers(2, 5))
def test_another_speed_stretches_the_frequencies(low, high, count):
    path = Trajectory.straight(14.0)
    for scenario, factor in zip(
        speed_range(path, low, high, count), np.linspace(low, high, count), strict=True
    ):
        assert scenario.weight == pytest.approx(1 / count)
        assert np.abs(otf(scenario) - coded_otf(path, CODE, factor * F, 0.0)).max() < 1e-12


@given(st.floats(-0.3, 0.3))
def test_drift_on_a_uniform_straight_motion_is_another_speed(amount):
    path = Trajectory.straight(14.0)
    (scenario,) = drifted(path, CODE.chips, amount)
    (scaled,) = speed_range(path, 1 + amount, 1 + amount, 1)
    # a slow code is open for longer as well: more light
    assert np.abs(np.abs(otf(scenario)) - (1 + amount) * np.abs(otf(scaled))).max() < 1e-12


def test_drift_covers_another_part_of_the_path():
    fast, on_time, slow = drifted(BENT, 10, [-0.2, 0.0, 0.2])
    assert [s.edges[-1] for s in (fast, on_time, slow)] == pytest.approx([0.8, 1.0, 1.2])
    assert np.abs(otf(on_time, FX, FY) - coded_otf(BENT, CODE, FX, FY)).max() < 1e-12
    # a fast code is a code of finer chips that ends early: 10 chips of 0.08 are 20 of 0.04, five
    # more are unused
    early = ShutterCode("".join(2 * bit for bit in CODE.bits) + "00000")
    assert np.abs(otf(fast, FX, FY) - coded_otf(BENT, early, FX, FY)).max() < 1e-12
    # the last chip of a slow one sees what the turned copy of the path's end draws
    t, xy = extended(BENT)
    tail = Trajectory.from_samples(
        np.stack([np.interp([1.08, 1.2], t, xy[:, i]) for i in (0, 1)], axis=1)
    )
    last = chip_basis(BENT, 10, FX, FY, edges=slow.edges)[-1]
    assert np.abs(last) == pytest.approx(0.12 * np.abs(tail.otf(FX, FY)))


@given(st.integers(0, 10_000))
@settings(max_examples=20)
def test_a_path_goes_on_smoothly_both_ways(seed):
    rng = np.random.default_rng(seed)
    path = Trajectory.from_samples(np.cumsum(rng.normal(size=(9, 2)), axis=0))
    t, xy = extended(path)
    assert (np.diff(t) > 0).all()
    assert (t[0], t[-1]) == (-1, 2)
    velocity = np.diff(xy, axis=0) / np.diff(t)[:, None]
    assert velocity == pytest.approx(
        np.concatenate([f := velocity[8:16], f, f])[
            [*range(7, -1, -1), *range(8, 16), *range(23, 15, -1)]
        ]
    )
    straight_t, straight_xy = extended(Trajectory.straight(5.0))
    assert straight_xy[:, 0] == pytest.approx(5 * (straight_t - 0.5))


def test_jitter_is_independent_monotone_and_as_large_as_said():
    chips = 50
    sigma = 0.1
    count = 200
    scenarios = jittered(BENT, chips, sigma, count, rng=np.random.default_rng(0))
    edges = np.array([s.edges for s in scenarios])
    assert (np.diff(edges, axis=1) > 0).all()
    shifts = (edges - np.linspace(0, 1, chips + 1)) * chips
    assert shifts.std() == pytest.approx(sigma, rel=0.03)
    assert abs(shifts.mean()) < 4 * sigma / np.sqrt(shifts.size)
    assert abs(np.corrcoef(shifts[:, 10], shifts[:, 11])[0, 1]) < 0.3
    assert sum(s.weight for s in scenarios) == pytest.approx(1)
    again = jittered(BENT, chips, sigma, 1, rng=np.random.default_rng(0))[0]
    assert again.edges == pytest.approx(edges[0])
    still = jittered(BENT, chips, 0.0, 1, rng=np.random.default_rng(0))[0]
    assert still.edges == pytest.approx(np.linspace(0, 1, chips + 1))


def test_alternatives_keep_their_probabilities():
    other = BENT.scaled(2)
    found = alternatives(StoredMotion(BENT, 0.6, ((0.3, other), (0.0, BENT))))
    assert [(s.trajectory, s.weight) for s in found] == [(BENT, 0.6), (other, 0.3)]
    assert alternatives(StoredMotion(BENT, 0.0))[0].weight == 1.0


def test_variations_cross_and_share_the_weight_out():
    motion = StoredMotion(BENT, 0.75, ((0.25, BENT.scaled(2)),))
    crossed = jittered(
        drifted(speed_range(alternatives(motion), 0.9, 1.1, 3), 10, [0.0, 0.01]),
        10,
        0.05,
        4,
        rng=np.random.default_rng(1),
    )
    assert len(crossed) == 2 * 3 * 2 * 4
    assert sum(s.weight for s in crossed) == pytest.approx(1)
    assert sum(s.weight for s in crossed[:24]) == pytest.approx(0.75)
    ends = np.array([s.edges[-1] for s in crossed]).reshape(6, 2, 4).mean(axis=(0, 2))
    assert ends == pytest.approx([1.0, 1.01], abs=0.005)  # jitter adds to the drift
    assert drifted(Scenario(BENT, 2.0), 10, 0.1)[0].weight == 2.0
    with pytest.raises(ValueError, match=f"{48 * 6} are too many, at most {MOST_SCENARIOS}"):
        speed_range(crossed, 0.9, 1.1, 6)
    with pytest.raises(ValueError, match="300 are too many"):
        alternatives(StoredMotion(BENT, 0.5, ((0.1, BENT),) * 299))


@pytest.mark.parametrize(
    "response", [None, ShutterResponse(chip_ns=10, rise_ns=4, fall_ns=5, on_bias_ns=2)]
)
@pytest.mark.parametrize("edges", [None, np.linspace(0, 1.05, 11) + 0.004 * np.sin(np.arange(11))])
def test_the_reversed_path_plays_the_code_in_its_own_order(response, edges):
    scenario = Scenario(BENT, edges=edges)
    for turned, path in ((False, BENT), (True, BENT.reversed())):
        rows = scenario_rows(scenario, 10, FX, FY, response=response, reversed_path=turned)
        assert rows.shape == (10, 2, 2, FX.size)
        bits = [0, *CODE.array.astype(int), 0]
        total = sum(
            rows[k, bits[k], 0] for k in range(10) if bits[k + 1]
        )  # from the first: the right one is closed yet
        assert (
            np.abs(total - coded_otf(path, CODE, FX, FY, response=response, edges=edges)).max()
            < 1e-12
        )
    mirrored = scenario_rows(scenario, 10, FX, FY, response=response)[::-1].transpose(0, 2, 1, 3)
    assert (np.abs(rows - mirrored).max() < 1e-12) == (response is None and edges is None)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: speed_range(BENT, 0.0, 1.0, 2), "factors must be above 0"),
        (lambda: speed_range(BENT, 2.0, 1.0, 2), "in order"),
        (lambda: speed_range(BENT, 1.0, 2.0, 1), "at least 2"),
        (lambda: drifted(BENT, 5, 0.6), "amounts: must lie within -0.5..0.5, got 0.6"),
        (lambda: drifted(BENT, 5, []), "got none"),
        (
            lambda: jittered(BENT, 5, 0.2, 2, rng=np.random.default_rng(0)),
            "sigma_chips: must lie within 0..0.15",
        ),
        (
            lambda: jittered(BENT, 5, 0.1, 0, rng=np.random.default_rng(0)),
            "count: must be at least 1",
        ),
        (
            lambda: drifted(Scenario(BENT, edges=np.linspace(0, 1, 4)), 5, 0.1),
            "5 chips need 6 edges",
        ),
        (lambda: Scenario(BENT, edges=[0, 0.7, 0.6]), "increasing"),
        (lambda: Scenario(BENT, edges=[0, 0.7, 3]), "within -0.5..1.5"),
    ],
)
def test_bad_scenarios_are_named(make, words):
    with pytest.raises(ValueError, match=words) as caught:
        make()
    assert "\n" not in str(caught.value)


def test_edges_cannot_be_changed_afterwards():
    edges = np.linspace(0, 1, 4)
    scenario = Scenario(BENT, edges=edges)
    edges[1] = 0.9
    assert scenario.edges == pytest.approx([0, 1 / 3, 2 / 3, 1])
    with pytest.raises(ValueError, match="read-only"):
        scenario.edges[0] = 0.5
