"""Designs of the coded table: what each is told, and what it minimises."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from coded_table import BENT, GUESS, TINY, chosen

from cep.codes.published import published
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.proofs.measure import measure
from cep.search import code_search
from lab.bench.coded.designs import DESIGNS, MotionPrior, design_code
from lab.bench.coded.protocol import (
    class_motions,
    drawn_motions,
)
from lab.trainings.dce.shipped_code import DCE_CODE
from motdiff.trajectory import Trajectory


@pytest.mark.parametrize("design", DESIGNS)
def test_codes_keep_the_limits_that_are_theirs(design):
    code = chosen(design)
    if design == "open":
        assert code.bits == "1" * 16
    elif design in ("snapshot", "class-snapshot"):
        assert code.pulses == 1
    elif design == "strobe":
        assert code.pulses >= 2
        assert len(set(code.bits.strip("0").rstrip("1").split("1")) - {""}) <= 1  # gaps all alike
    elif design == "raskar-52":
        assert code == published("raskar-52").code
    elif design == "dce":
        assert code == DCE_CODE
    else:
        assert (code.chips, 6 <= code.open_chips <= 8) == (16, True)


def test_an_unknown_design():
    with pytest.raises(ValueError, match=r"design: must be one of open, .*, got 'theirs'"):
        chosen("theirs", MotionPrior())


def test_each_design_minimises_what_it_should():
    """Brute force over all codes of four chips out of eight: the worst of both directions, or the
    given one alone."""
    codes = [
        ShutterCode("".join("01"[k in on] for k in range(8))) for on in combinations(range(8), 4)
    ]

    def gain(path, code):
        return measure(path, code, budget=0).noise_gain_db

    along = {code.bits: (gain(BENT, code), gain(BENT.reversed(), code)) for code in codes}
    limits = {"chips": 8, "open_range": (4, 4), "steps": 2000}
    known = MotionPrior((BENT,), (1.0,))
    ordered = MotionPrior((replace(BENT, direction="known"),), (1.0,))
    for design, prior in [
        ("one-way", known),
        ("oracle", known),
        ("parametric-oracle", known),
        ("calibrated-4", ordered),
        ("calibrated-point", ordered),
    ]:
        assert along[chosen(design, prior, **limits).bits][0] == pytest.approx(
            min(a for a, _ in along.values()), abs=0.05
        )
    for design in (
        "both-ways",
        "parametric",
        "calibrated-point",
    ):  # the direction of this path is not known
        found = along[chosen(design, known, **limits).bits]
        assert max(found) == pytest.approx(min(map(max, along.values())), abs=0.05)
    # a posterior weighs its paths: of a sure one nothing else is left
    sure = MotionPrior((BENT, GUESS), (1.0, 0.0))
    assert chosen("posterior", sure, **limits) == chosen("both-ways", sure, **limits)
    torn = chosen("posterior", MotionPrior((BENT, GUESS), (0.1, 0.9)), **limits)
    means = {code.bits: 0.1 * max(along[code.bits]) + 0.9 * gain(GUESS, code) for code in codes}
    assert means[torn.bits] == pytest.approx(min(means.values()), abs=0.05)
    # DNF sees a straight path only
    straight = {code.bits: gain(Trajectory.straight(20.0), code) for code in codes}
    assert straight[chosen("dnf", **limits).bits] == pytest.approx(
        min(straight.values()), abs=0.05
    )


def test_searches_use_one_thread_and_the_same_budget(monkeypatch):
    real = code_search.anneal
    seen = []

    def watched(problem, **options):
        seen.append(options)
        return real(problem, **options)

    monkeypatch.setattr(code_search, "anneal", watched)
    for design in ("dnf", "oracle", "posterior"):
        chosen(design)
    assert [(options["threads"], options["steps"]) for options in seen] == [(1, 800)] * 3


@pytest.mark.parametrize("design", ["dnf", "oracle"])
def test_an_interrupted_search_is_not_taken_for_a_finished_one(monkeypatch, design):
    """The search itself returns its best so far after Ctrl-C; kept as a cell it would stand for
    the whole budget."""
    real = code_search.anneal

    def stop(_fraction, _best):
        raise KeyboardInterrupt

    monkeypatch.setattr(
        code_search,
        "anneal",
        lambda problem, **options: real(problem, **options | {"progress": stop}),
    )
    with pytest.raises(KeyboardInterrupt):
        chosen(design, steps=10**6)


@pytest.mark.parametrize("design", ["one-way", "both-ways", "oracle"])
def test_a_search_is_never_worse_than_a_snapshot_that_keeps_its_limits(design):
    known = MotionPrior((BENT,), (1.0,))
    limits = {"open_range": (1, 16), "objective": "mse"}
    dark = Camera(photons_full_scale=300.0, read_noise_e=5.0)
    codes = [
        design_code(
            name,
            known,
            chips=16,
            camera=dark,
            steps=40_000,
            rng=np.random.default_rng(0),
            **limits,
        )
        for name in (design, "snapshot")
    ]
    ways = (BENT,) if design in ("one-way", "oracle") else (BENT, BENT.reversed())
    ours, short = (
        max(measure(way, code, camera=dark, budget=0).mse_db for way in ways) for code in codes
    )
    assert ours <= short + 1e-6


def test_the_class_is_of_the_protocols_kind_and_none_of_its_motions():
    walks = replace(TINY, shakes="boracchi-foi")
    shown = drawn_motions(walks)
    others = class_motions(walks)
    assert len(others) == 60
    assert all(path.length_px == pytest.approx(60, abs=1) for path in others)  # thinned
    assert not any(np.allclose(path.xy[-1], one.xy[-1]) for path in others for one in shown)


def test_all_photos_have_the_same_class_code():
    """Brute force over all codes of four chips out of eight, by the mean of the decibels."""
    codes = [
        ShutterCode("".join("01"[k in on] for k in range(8))) for on in combinations(range(8), 4)
    ]
    paths = class_motions(TINY)[:2]
    gains = {
        code.bits: np.mean([measure(path, code, budget=0).noise_gain_db for path in paths])
        for code in codes
    }
    found = chosen("class", MotionPrior(paths, (0.5, 0.5)), chips=8, open_range=(4, 4), steps=2000)
    assert gains[found.bits] == pytest.approx(min(gains.values()), abs=0.05)
