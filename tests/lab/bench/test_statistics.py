"""Statistics of benchmarks: closed forms, an independent bootstrap, and intervals that hold what
they promise."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from lab.bench.statistics import crossed_interval, mean_interval, summarized


def rng(seed=0):
    return np.random.default_rng(seed)


def test_summaries_of_a_known_row():
    found = summarized(range(1, 22))
    assert (found.n, found.mean, found.median, found.q05, found.q95) == (21, 11, 11, 2, 20)
    assert found.sd == pytest.approx(math.sqrt(21 * 22 / 12), rel=1e-12)  # of 1..n: n (n + 1) / 12


def test_summaries_of_little():
    assert summarized([]).n == 0
    assert math.isnan(summarized([]).mean)
    one = summarized([3])
    assert (one.n, one.mean, one.median, one.q05, one.q95) == (1, 3, 3, 3, 3)
    assert math.isnan(one.sd)
    assert summarized([1, math.inf]).mean == math.inf
    assert summarized([math.inf, 20, 22.5]).median == 22.5
    assert summarized([math.inf, math.inf, 20]).median == math.inf
    values = np.random.default_rng(0).normal(size=38)
    found = summarized(values)
    assert (found.q05, found.median, found.q95) == pytest.approx(
        np.quantile(values, (0.05, 0.5, 0.95)), rel=1e-12
    )


@given(st.integers(-(10**6), 10**6), st.integers(3, 30), st.integers(1, 5))
def test_a_constant_difference_has_no_width(constant, count, size):
    second = (
        rng(1).integers(-1000, 1000, count * size) / 8
    )  # sums and differences without rounding
    clusters = [index // size for index in range(count * size)]
    found = mean_interval(
        (second + constant / 8) - second, rng=rng(), clusters=clusters, resamples=1000
    )
    assert found.low == found.mean == found.high == constant / 8
    assert (found.n, found.clusters) == (count * size, count)
    assert found.excludes_zero == (constant != 0)


def test_one_cluster_says_nothing_of_others():
    found = mean_interval([1.0, 2.0, 3.0], rng=rng(), clusters=["a"] * 3)
    assert (found.mean, found.low, found.high) == (2, -math.inf, math.inf)
    assert not found.excludes_zero


def test_two_clusters_say_hardly_more():
    """Half of all draws are one cluster twice, without spread: no end can be given."""
    found = mean_interval([1.0, 1.1], rng=rng())
    assert (found.low, found.high) == (-math.inf, math.inf)


def slow_interval(values, clusters, seed, resamples=4000):
    """Bootstrap cluster by cluster, with the error of each draw worked out from its own
    clusters."""
    labels = sorted(set(clusters))
    groups = [
        np.array([v for v, c in zip(values, clusters, strict=True) if c == label])
        for label in labels
    ]

    def mean_and_error(drawn):
        size = sum(len(group) for group in drawn)
        mean = sum(group.sum() for group in drawn) / size
        squares = sum((group.sum() - mean * len(group)) ** 2 for group in drawn)
        return mean, math.sqrt(squares * len(drawn) / (len(drawn) - 1)) / size

    mean, error = mean_and_error(groups)
    draw = np.random.default_rng(seed)
    pivots = []
    for _ in range(resamples):
        one, own = mean_and_error(
            [groups[index] for index in draw.integers(0, len(groups), len(groups))]
        )
        pivots.append((one - mean) / own)
    return (
        mean,
        mean - np.quantile(pivots, 0.975) * error,
        mean - np.quantile(pivots, 0.025) * error,
    )


def test_intervals_are_those_of_an_independent_bootstrap():
    draw = rng(3)
    clusters = draw.integers(0, 15, 60).tolist()
    values = draw.exponential(size=60) + np.array(clusters) / 10
    mean, low, high = slow_interval(values, clusters, seed=4)
    found = mean_interval(values, rng=rng(5), clusters=clusters, resamples=40_000)
    assert found.mean == pytest.approx(mean, rel=1e-12)
    assert found.low == pytest.approx(low, abs=0.05 * (high - low))
    assert found.high == pytest.approx(high, abs=0.05 * (high - low))


def test_many_normal_values_have_the_interval_of_student():
    values = rng(6).normal(3, 2, 200)
    found = mean_interval(values, rng=rng(7), resamples=20_000)
    low, high = stats.t.interval(0.95, 199, values.mean(), stats.sem(values))
    assert found.low == pytest.approx(low, abs=0.06 * (high - low))
    assert found.high == pytest.approx(high, abs=0.06 * (high - low))


def coverage(make, trials=800, level=0.95):
    """Return the share of intervals that hold zero, the true mean, and three standard errors of
    the share."""
    draw = rng(12)
    held = 0
    for _ in range(trials):
        values, clusters = make(draw)
        found = mean_interval(values, rng=draw, clusters=clusters, level=level, resamples=1000)
        held += found.low <= 0 <= found.high
    return held / trials, 3 * math.sqrt(level * (1 - level) / trials)


@pytest.mark.parametrize(("count", "level"), [(10, 0.95), (30, 0.95), (10, 0.8)])
def test_intervals_hold_what_they_promise(count, level):
    share, error = coverage(lambda draw: (draw.normal(size=count), None), level=level)
    assert share == pytest.approx(level, abs=error)


def of_photos(draw):
    """Ten photos of six motions each: what is the photo's own is most of the difference."""
    photos = np.repeat(np.arange(10), 6)
    return draw.normal(size=10)[photos] + 0.3 * draw.normal(size=60), photos.tolist()


def test_values_of_one_photo_are_no_independent_evidence():
    share, error = coverage(of_photos)
    assert share == pytest.approx(0.95, abs=error)
    share, _ = coverage(lambda draw: (of_photos(draw)[0], None), trials=200)
    assert share < 0.7


@given(st.floats(-100, 100), st.sampled_from([0.25, 2.0, 8.0]))
def test_intervals_move_and_grow_with_the_values(shift, scale):
    values = rng(9).normal(size=12)
    one = mean_interval(values, rng=rng(), resamples=1000)
    other = mean_interval(scale * values + shift, rng=rng(), resamples=1000)
    assert other.low == pytest.approx(scale * one.low + shift, abs=1e-9)
    assert other.high == pytest.approx(scale * one.high + shift, abs=1e-9)


def test_the_same_seed_gives_the_same():
    values = rng(10).normal(size=20)
    assert mean_interval(values, rng=rng(1)) == mean_interval(values, rng=rng(1))
    assert mean_interval(values, rng=rng(1)) != mean_interval(values, rng=rng(2))


def crossed(photos, motions, generator, *, photo_sd=0.3, motion_sd=2.0):
    """Values of every photo with every motion, their photos and their motions; the true mean is
    0."""
    of_photo = generator.normal(0, photo_sd, photos)
    of_motion = generator.normal(0, motion_sd, motions)
    values = of_photo[:, None] + of_motion + generator.normal(0, 1, (photos, motions))
    return (
        values.ravel(),
        np.repeat(np.arange(photos), motions).tolist(),
        np.tile(np.arange(motions), photos).tolist(),
    )


@pytest.mark.parametrize(("photos", "motions"), [(10, 10), (10, 40)])
def test_crossed_intervals_hold_the_mean_as_often_as_they_say(photos, motions):
    """By photo alone, though photos are as scarce, they would hold it in half of the trials."""
    generator = rng(5)
    found = []
    alone = []
    for _ in range(400):
        values, by_photo, by_motion = crossed(photos, motions, generator)
        found.append(crossed_interval(values, by_photo, by_motion))
        sums = np.bincount(by_photo, weights=values) / motions
        alone.append(abs(sums.mean()) < 2.26 * sums.std(ddof=1) / math.sqrt(photos))
    assert 0.92 < np.mean([one.low <= 0 <= one.high for one in found]) < 0.99
    assert np.mean(alone) < 0.7


def test_crossed_clusters_that_are_one_are_plain_clusters():
    """Each value a cluster of its own, twice: Student's interval."""
    values = rng(6).normal(size=12)
    found = crossed_interval(values, list(range(12)), list("abcdefghijkl"))
    half = stats.t.ppf(0.975, 11) * values.std(ddof=1) / math.sqrt(12)
    assert (found.low, found.high) == pytest.approx((values.mean() - half, values.mean() + half))
    assert (found.n, found.clusters) == (12, 12)


def test_crossed_with_one_photo_says_nothing_of_others():
    found = crossed_interval([1.0, 2.0, 3.0], ["a"] * 3, [0, 1, 2])
    assert (found.mean, found.low, found.high, found.clusters) == (2, -math.inf, math.inf, 1)


@pytest.mark.parametrize(
    ("values", "options", "message"),
    [
        ([], {}, "values: must be finite numbers in one row"),
        ([1.0, math.nan], {}, "values: "),
        ([1.0, math.inf], {}, "values: "),
        ([[1.0]], {}, "values: "),
        ([1.0, 2.0], {"clusters": ["a"]}, "clusters: must be one label per value, got 1 for 2"),
        ([1.0, 2.0], {"level": 1.0}, "level: "),
        ([1.0, 2.0], {"resamples": 999}, "resamples: must be at least 1000"),
    ],
)
def test_refusals(values, options, message):
    with pytest.raises(ValueError, match=message):
        mean_interval(values, rng=rng(), **options)


def test_crossed_needs_labels_of_both_kinds():
    with pytest.raises(ValueError, match="clusters: must be one label per value, got 1 for 2"):
        crossed_interval([1.0, 2.0], ["a", "b"], ["a"])
