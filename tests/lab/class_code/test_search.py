"""One code for a class of motions: mean decibels against brute force, invariances, what is
refused."""

import time
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from cep.commands.code_options import openings
from cep.files.code_files import read_code
from cep.optics.band import band_samples
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.exposure import mtf
from cep.search.annealing import anneal
from cep.search.code_search import SearchOptions
from cep.search.cost import CodeCost
from cep.search.problem import OBJECTIVES, SearchProblem
from lab.class_code.motions import MOST_SCENARIOS, class_scenarios, draw_motions
from lab.class_code.search import check_class, optimize_class, per_motion_db
from motdiff.trajectory import Trajectory

AVERAGED = " or ".join(name for name, known in OBJECTIVES.items() if known.averages)
CHIPS = 10
OPEN = 4
EVERY = [
    ShutterCode("".join("01"[k in on] for k in range(CHIPS)))
    for on in combinations(range(CHIPS), OPEN)
]
PROBLEM = SearchProblem.along(chips=CHIPS, open_range=(OPEN, OPEN), objective="noise")
WALKS = draw_motions(3, length_px=15.0, rng=np.random.default_rng(1))


def noise_db(path, code):
    samples = band_samples(path)
    return 10 * np.log10(
        samples.weight @ (1 / np.array(mtf(path, code, samples.fx, samples.fy)) ** 2)
    )


def test_the_mean_of_the_decibels_is_best_of_all_codes():
    mean_db = {code.bits: np.mean([noise_db(path, code) for path in WALKS]) for code in EVERY}
    best = optimize_class(WALKS, PROBLEM, SearchOptions(steps=20_000), threads=1)
    assert best.rows[0].mean_db == pytest.approx(mean_db[best.code.bits], abs=1e-3)
    assert best.rows[0].mean_db == pytest.approx(min(mean_db.values()), abs=1e-3)
    # the decibels of the mean, which one bad motion rules, would choose another
    rivals = {
        code.bits: np.mean([10 ** (noise_db(path, code) / 10) for path in WALKS]) for code in EVERY
    }
    assert min(rivals, key=rivals.get) != best.code.bits


def test_unknown_directions_count_both_ways_in_the_mean():
    unknown = [replace(path, direction="unknown") for path in WALKS]
    (both,) = per_motion_db(PROBLEM, unknown[:1], EVERY[:5])
    ways = [
        [noise_db(path, code) for code in EVERY[:5]] for path in (WALKS[0], WALKS[0].reversed())
    ]
    np.testing.assert_allclose(both, np.mean(ways, axis=0), atol=1e-3)
    assert sum(one.weight for one in class_scenarios(unknown)) == len(unknown)
    assert len(class_scenarios([Trajectory.straight(9.0)])) == 1  # its own mirror image


def test_order_and_orientation_of_the_motions_do_not_matter():
    costs = per_motion_db(PROBLEM, WALKS, EVERY)
    turned = [
        Trajectory.from_samples(path.xy @ [[0, 1], [-1, 0]], t=path.t, direction="known")
        for path in WALKS
    ]
    np.testing.assert_allclose(per_motion_db(PROBLEM, turned[::-1], EVERY)[::-1], costs, atol=1e-6)
    # against time, a code is worth what its mirror image is worth along it
    back = per_motion_db(
        PROBLEM,
        [path.reversed() for path in WALKS],
        [ShutterCode(one.bits[::-1]) for one in EVERY],
    )
    np.testing.assert_allclose(back, costs, atol=1e-6)


def test_rows_are_judged_on_motions_that_the_search_has_not_seen(tmp_path):
    unseen = draw_motions(4, length_px=15.0, rng=np.random.default_rng(2))
    best = optimize_class(WALKS, PROBLEM, SearchOptions(steps=2000), held_out=unseen, threads=1)
    assert (
        best.outcome.code
        == optimize_class(WALKS, PROBLEM, SearchOptions(steps=2000), threads=2).outcome.code
    )
    own, *others = best.rows
    assert (own.behind_db, own.behind_error_db) == (0, 0)
    for row in others:
        if row.code.chips != CHIPS:  # a published one
            assert not row.within_limits
            continue
        costs = per_motion_db(PROBLEM, unseen, [row.code, best.code])
        assert row.others_db == pytest.approx(costs[:, 0].mean())
        assert row.behind_db == pytest.approx((costs[:, 0] - costs[:, 1]).mean())
        assert not row.within_limits or row.behind_db >= 0
    assert any("3 motions are few" in line for line in best.warnings)
    best.save(tmp_path / "code.json")
    stored = read_code(tmp_path / "code.json")
    assert (stored.code, stored.problem["rule"], stored.problem["motions"]) == (
        best.code,
        "mean",
        3,
    )


def test_the_verdict_recommends_nothing_that_loses_to_its_own_table():
    unseen = draw_motions(20, length_px=15.0, rng=np.random.default_rng(2))
    # 30 photo-electrons at full scale beside 5 electrons of read noise: light is all that counts,
    # up to some blur
    dim = replace(PROBLEM, objective="mse", camera=Camera(photons_full_scale=30.0))
    dark = optimize_class(
        WALKS,
        replace(dim, open_range=(1, 2)),
        SearchOptions(steps=500),
        held_out=unseen,
        threads=1,
    )
    better = min(dark.rows, key=lambda row: row.behind_db)
    assert better.behind_db < 0
    assert not better.within_limits
    assert better.code.open_chips > 2
    assert dark.verdict.startswith(f"Use the {better.name} (open for {better.code.open_chips} of")
    free = optimize_class(
        WALKS, replace(dim, open_range=None), SearchOptions(steps=500), held_out=unseen, threads=1
    )
    assert min(row.behind_db for row in free.rows) == 0
    assert free.code.pulses == 1
    assert free.verdict.startswith("A short exposure is best, one opening (open for ")
    noise = optimize_class(
        WALKS,
        replace(PROBLEM, open_range=None),
        SearchOptions(steps=3000),
        held_out=unseen,
        threads=1,
    )
    assert noise.to_dict()["verdict"] == noise.verdict
    snapshot = next(row for row in noise.rows if row.name == "best snapshot")
    assert f"{snapshot.behind_db:.2f} dB" in noise.verdict
    assert "published code raskar-52" in noise.verdict


def test_a_search_whose_samples_take_longer_than_its_time_makes_moves(monkeypatch):
    class SlowCost(CodeCost):
        def __init__(self, *given, **options):
            time.sleep(0.5)
            super().__init__(*given, **options)

    monkeypatch.setattr(anneal, "CodeCost", SlowCost)
    best = optimize_class(WALKS, PROBLEM, SearchOptions(time_s=0.4), threads=1)
    assert best.outcome.stopped == "time"
    assert best.outcome.steps > 0
    assert not best.unsearched
    assert "Nothing was searched" not in best.verdict


@pytest.mark.parametrize(
    ("stopped", "said"), [("time", "7 s passed"), ("interrupted", "Ctrl-C ended it")]
)
def test_where_no_move_was_made_the_verdict_recommends_nothing(stopped, said):
    best = optimize_class(WALKS, PROBLEM, SearchOptions(steps=500), threads=1)
    none = replace(
        best,
        how=SearchOptions(time_s=7.0),
        outcome=replace(best.outcome, steps=0, stopped=stopped),
    )
    assert none.verdict.startswith(f"Nothing was searched: {said} before the first move.")
    assert "--time" in none.verdict
    # where there is one code only, nothing needs a search
    assert (
        "Nothing" not in replace(none, outcome=replace(none.outcome, stopped="complete")).verdict
    )


def test_one_opening_is_not_called_openings():
    assert [openings(ShutterCode(bits)) for bits in ("0110", "0101")] == [
        "1 opening",
        "2 openings",
    ]


@pytest.mark.parametrize(
    ("motions", "changes", "message"),
    [
        ([], {}, "motions: a class needs at least one"),
        (
            WALKS,
            {"objective": "min-mtf"},
            f"objective: a class is searched by {AVERAGED} alone, got min-mtf",
        ),
        (
            WALKS,
            {"objective": (("noise", 1.0), ("flatness", 1.0))},
            f"{AVERAGED} alone, got flatness",
        ),
        ([Trajectory.straight(1.0)], {}, "chips: 10 chips are too many for a path of 1.0 px"),
        ([Trajectory.straight(9.0)] * (MOST_SCENARIOS + 1), {}, "scenarios: 257 are too many"),
    ],
)
def test_a_class_without_a_mean_is_refused(motions, changes, message):
    with pytest.raises(ValueError, match=message):
        check_class(replace(PROBLEM, **changes, scenarios=class_scenarios(motions)))
