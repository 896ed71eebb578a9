"""Fronts: against all codes of a length, interruptible, repeatable; and their figure."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from matplotlib.text import Text

from cep.optics.code import ShutterCode
from cep.plots.canvas import png_bytes
from cep.proofs.certify.minimum import min_chip
from cep.proofs.measure import measure
from cep.search.cost import CodeCost
from cep.search.limits import RunLimits
from cep.search.problem import SearchProblem
from lab.bench.published_codes import chip_noise_db
from lab.fronts.front import Front, FrontPoint, knees, non_dominated
from lab.fronts.plot import pareto_figure
from lab.fronts.search import front_points, pareto_front
from motdiff.trajectory import Trajectory

ZERO = 1e-9
TIES = 3e-4  # dB and chips: figures of mirrored codes and of other quadratures agree no better


def arc():
    angle = np.linspace(0, 2.2, 24) ** 1.4
    return Trajectory.from_samples(
        3 * np.stack([np.cos(angle), np.sin(1.7 * angle)], 1), direction="known"
    )


def all_codes(chips):
    everything = ((np.arange(1, 2**chips)[:, None] >> np.arange(chips)) & 1).astype(np.int8)
    return [ShutterCode(bits) for bits in everything]


def on_the_circle(code):
    """Minimum, noise and light of a code by other routes than the search's."""
    return min_chip(code), chip_noise_db(code) + 20 * np.log10(code.chips), code.open_chips


def beaten(figures, others):
    """Whether any of the others (R, 3) is as good in all of minimum, noise, light, and clearly
    better in one."""
    better = (others - np.asarray(figures)) * [1, -1, 1]
    return bool(((better >= -TIES).all(axis=1) & (better > TIES).any(axis=1)).any())


# -- who beats whom -------------------------------------------------------------------------------


TABLES = st.tuples(st.integers(0, 12), st.integers(1, 4)).flatmap(
    lambda shape: arrays(np.float64, shape, elements=st.integers(-3, 3).map(float))
)


@given(TABLES, st.randoms(use_true_random=False))
def test_non_dominated_is_what_its_definition_says(values, random):
    found = non_dominated(values)
    expected = [
        not any((other >= row).all() and (other > row).any() for other in values) for row in values
    ]
    assert found.tolist() == expected
    order = list(range(len(values)))
    random.shuffle(order)
    np.testing.assert_array_equal(non_dominated(values[order]), found[order])
    twice = non_dominated(np.concatenate([values, values]))
    np.testing.assert_array_equal(twice, np.concatenate([found, found]))


def test_infinities_are_numbers_and_nan_is_none():
    assert non_dominated([[np.inf, -np.inf], [np.inf, 0], [0, np.inf]]).tolist() == [
        False,
        True,
        True,
    ]
    with pytest.raises(ValueError, match=r"^values: "):
        non_dominated([[1.0, np.nan]])
    with pytest.raises(ValueError, match=r"^values: "):
        non_dominated([1.0, 2.0])


# -- fronts ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("chips", [8, 9, 10])
def test_a_count_against_all_its_codes(chips):
    """Every code is on the count's true front, and both ends of that are found."""
    everything = [on_the_circle(code) for code in all_codes(chips)]
    for count in range(3, chips):
        every = np.array([f for f in everything if f[2] == count and f[0] > ZERO])
        problem = SearchProblem(chips=chips, open_range=(count, count))
        front = pareto_front(problem, rng=np.random.default_rng(count), steps=20_000)
        assert front.unit == "chips"
        figures = [on_the_circle(point.code) for point in front.points]
        assert bool(figures) == bool(len(every))
        for point, (minimum, noise_db, light) in zip(front.points, figures, strict=True):
            assert (point.minimum, point.noise_db) == pytest.approx((minimum, noise_db), abs=TIES)
            assert point.open_chips == light == count
            assert not beaten((minimum, noise_db, light), every)
        if figures:
            assert max(f[0] for f in figures) == pytest.approx(every[:, 0].max(), abs=TIES)
            assert min(f[1] for f in figures) == pytest.approx(every[:, 1].min(), abs=TIES)


def test_the_whole_front_against_all_codes():
    every = np.array([f for code in all_codes(10) if (f := on_the_circle(code))[0] > ZERO])
    front = pareto_front(SearchProblem(chips=10), rng=np.random.default_rng(0), steps=60_000)
    found = np.array([(p.minimum, p.noise_db, p.open_chips) for p in front.points])
    expected = every[non_dominated(np.round(every * [1, -1, 1], 6))]
    assert len(np.unique(np.round(expected, 4), axis=0)) == len(found)
    for row in expected:
        assert np.isclose(found, row, atol=TIES).all(axis=1).any()
    assert front.steps >= 60_000
    assert front.stopped == "steps"
    # beaten codes are kept as the curves of their own light
    assert {p.code.bits for p in front.points} < {
        p.code.bits for curve in front.curves.values() for p in curve
    }


def test_annealing_improves_on_the_local_search():
    problem = SearchProblem(chips=30, open_range=(16, 16))
    plain = pareto_front(problem, rng=np.random.default_rng(1), steps=0)
    longer = pareto_front(problem, rng=np.random.default_rng(1), steps=400_000)
    assert max(p.minimum for p in longer.points) > max(p.minimum for p in plain.points) + 0.02
    values = [[p.minimum, -p.noise_db] for p in longer.points]
    assert all(
        not non_dominated([[p.minimum, -p.noise_db], *values])[0] or p in longer.points
        for p in plain.points
    )


def test_along_a_straight_motion_figures_are_those_of_measure():
    motion = Trajectory.straight(13.0)
    front = pareto_front(
        SearchProblem.along(motion, chips=9), rng=np.random.default_rng(0), steps=0
    )
    assert front.unit == "light-true"
    assert not front.sampled
    for point in front.points:
        metrics = measure(motion, point.code)
        expected = (metrics.min_mtf, metrics.noise_gain_db, metrics.mse_db)
        assert (point.minimum, point.noise_db, point.mse_db) == pytest.approx(expected, abs=1e-6)


def test_along_a_curve_the_front_is_over_noise_and_light():
    problem = SearchProblem.along(arc(), chips=8)
    fine = CodeCost(
        SearchProblem.along(arc(), chips=8, objective="noise"), oversampling=64, dtype=np.float64
    )
    codes = np.array([code.array for code in all_codes(8)], dtype=np.int8)
    every = np.column_stack([np.zeros(len(codes)), fine.cost_of(codes), codes.sum(axis=1)])
    front = pareto_front(problem, rng=np.random.default_rng(0), steps=0)
    assert front.sampled
    assert len({point.open_chips for point in front.points}) == len(front.points)
    for point in front.points:
        assert not beaten((0, point.noise_db, point.open_chips), every)
    least = every[every[:, 1].argmin(), 1]
    assert min(point.noise_db for point in front.points) == pytest.approx(least, abs=1e-9)
    assert "best minimum" not in knees(front)


def test_an_unknown_direction_counts_as_the_worse():
    problem = SearchProblem.along(arc(), chips=8, direction="unknown")
    (point,) = front_points(problem, [ShutterCode("11101001")])
    both = [
        measure(path, point.code, budget=0).noise_gain_db for path in (arc(), arc().reversed())
    ]
    assert point.noise_db == pytest.approx(max(both), abs=1e-9)


def test_a_zero_has_no_finite_noise():
    """Samples of 1/|H|^2 may miss a zero, and be finite; the mean over the circle is not."""
    (point,) = front_points(
        SearchProblem(chips=31), [ShutterCode("1111101110100110101101110001111")]
    )
    assert point.minimum == 0
    assert point.noise_db == np.inf


@settings(max_examples=8, deadline=None)
@given(
    st.integers(1, 3),
    st.integers(1, 3),
    st.integers(2, 4),
    st.none() | st.integers(4, 6),
    st.integers(1, 6),
    st.integers(0, 2**32),
)
def test_limits_are_kept(min_open, min_closed, max_pulses, max_open, min_period, seed):
    problem = SearchProblem(
        chips=12,
        open_range=(6, 9),
        runs=RunLimits(
            max_open=max_open,
            min_period=min_period,
            min_open=min_open,
            min_closed=min_closed,
            max_pulses=max_pulses,
        ),
    )
    front = pareto_front(problem, rng=np.random.default_rng(seed), steps=0)
    codes = np.array([p.code.array for curve in front.curves.values() for p in curve]).reshape(
        -1, 12
    )
    assert problem.satisfied(codes.astype(np.int8)).all()


def test_the_same_seed_gives_the_same_front():
    problem = SearchProblem(chips=16, open_range=(7, 11))
    first, second = (
        pareto_front(problem, rng=np.random.default_rng(5), steps=20_000, threads=threads)
        for threads in (1, 2)
    )
    assert first.points == second.points
    assert first.steps == second.steps


@pytest.mark.parametrize("calls", [1, 4, 30])
def test_an_interrupt_gives_the_front_so_far(calls):
    told = []

    def progress(fraction, note):
        told.append(fraction)
        assert "open" in note
        if len(told) == calls:
            raise KeyboardInterrupt

    front = pareto_front(SearchProblem(chips=20), rng=np.random.default_rng(0), progress=progress)
    assert front.stopped == "interrupted"
    assert len(told) == calls
    assert front.points
    assert all(0 <= fraction <= 1 for fraction in told)


def test_a_time_limit_gives_the_front_so_far():
    front = pareto_front(SearchProblem(chips=24), rng=np.random.default_rng(0), time_s=1e-6)
    assert front.points
    assert front.stopped == "time"
    assert (
        pareto_front(
            SearchProblem(chips=24), rng=np.random.default_rng(0), time_s=1e-6, steps=10
        ).stopped
        == "time"
    )


def test_counts_may_be_chosen():
    front = pareto_front(
        SearchProblem(chips=12), rng=np.random.default_rng(0), counts=(8, 6, 8), steps=0
    )
    assert list(front.curves) == [6, 8]


def test_a_code_that_leaves_no_choice():
    front = pareto_front(
        SearchProblem(chips=1),
        rng=np.random.default_rng(0),
        steps=100,
    )
    assert [point.code.bits for point in front.points] == ["1"]


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("counts", {"counts": (3, 99)}),
        ("counts", {"counts": ()}),
        ("shares", {"shares": (0.5, 1.5)}),
        ("shares", {"shares": ()}),
        ("steps", {"steps": -1}),
        ("time_s", {"time_s": 0.0}),
    ],
)
def test_bad_arguments_are_named(name, options):
    with pytest.raises(ValueError, match=rf"^{name}: "):
        pareto_front(SearchProblem(chips=8), rng=np.random.default_rng(0), **options)


def test_a_mean_over_scenarios_is_refused():
    with pytest.raises(ValueError, match=r"^rule: "):
        pareto_front(SearchProblem(chips=8, rule="mean"), rng=np.random.default_rng(0))


# -- what is made of them -------------------------------------------------------------------------


def handmade(unit="chips"):
    points = tuple(
        FrontPoint(ShutterCode("1" * count + "0" * (8 - count)), minimum, noise_db, count, -20.0)
        for count, minimum, noise_db in (
            (3, 1.0, 12.0),
            (4, 0.9, 11.0),
            (5, 0.85, 11.05),
            (7, 0.1, 20.0),
        )
    )
    curves = {point.open_chips: (point,) for point in points}
    return Front(points, curves, unit, SearchProblem(chips=8), 1.0, 0, False)


def test_knees():
    found = {name: point.open_chips for name, point in knees(handmade()).items()}
    assert found == {"best minimum": 3, "least noise": 4, "compromise": 5, "most light": 7}
    sampled = {
        name: point.open_chips for name, point in knees(handmade("light-true, sampled")).items()
    }
    assert sampled == {"least noise": 4, "compromise": 5, "most light": 7}


@pytest.mark.parametrize("unit", ["chips", "light-true", "light-true, sampled"])
def test_the_figure_shows_the_front(unit):
    front = handmade(unit)
    hidden = FrontPoint(ShutterCode("11110000"), 0.0, np.inf, 4, -5.0)
    shown = FrontPoint(ShutterCode("11110000"), 0.88, 11.1, 4, -5.0)
    figure = pareto_figure(front, {"theirs": shown, "hopeless": hidden})
    axes, bar = figure.axes
    dots = np.concatenate([np.asarray(c.get_offsets()) for c in axes.collections])
    heights = [p.open_chips if front.sampled else p.minimum for p in (*front.points, shown)]
    np.testing.assert_allclose(dots, np.column_stack([[12.0, 11.0, 11.05, 20.0, 11.1], heights]))
    assert "dB" in axes.get_xlabel()
    assert "light-true" in axes.get_ylabel() + bar.get_ylabel() or unit == "chips"
    written = " ".join(text.get_text() for text in axes.texts)
    assert all(name in written for name in (*knees(front), "theirs", "hopeless (has a zero)"))
    assert png_bytes(figure) == png_bytes(
        pareto_figure(front, {"theirs": shown, "hopeless": hidden})
    )


def test_labels_do_not_cover_one_another():
    crowd = {
        f"a code with a name {i}": FrontPoint(ShutterCode("1110"), 0.9 + i / 500, 11.0, 3, -5.0)
        for i in range(6)
    }
    figure = pareto_figure(handmade(), crowd)
    figure.draw_without_rendering()
    texts = [text for text in figure.axes[0].texts if text.get_text()]
    boxes = [Text.get_window_extent(text) for text in texts]  # without their leader lines
    assert len(boxes) == 10
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])


def test_an_empty_front_is_not_drawn():
    with pytest.raises(ValueError, match=r"^front: "):
        pareto_figure(Front((), {}, "chips", SearchProblem(chips=8), 0.0, 0, False))
