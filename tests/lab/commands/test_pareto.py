"""``python -m lab pareto``: its files, what it says, its exit codes."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from cep.codes.published import for_chips
from cep.optics.code import ShutterCode
from cep.proofs.certify.minimum import min_chip
from lab.fronts.search import pareto_front


def test_both_files_are_written(lab, workplace):
    options = (
        "--chips",
        "13",
        "--open",
        "6:10",
        "--steps",
        "2000",
        "--seed",
        "2",
        "--exposure",
        "65us",
    )
    found = lab.succeeds("pareto", *options, "-o", "f.json", "--plot", "f.svg")
    assert Path("f.svg").read_text().startswith("<?xml")
    stored = json.loads(Path("f.json").read_text())
    assert stored["schema"] == "cep.front/1"
    assert stored["chip_ns"] == 5000
    assert stored["unit"] == found["unit"] == "chips"
    assert stored["points"] == found["points"]
    assert set(stored["knees"]) == {"best minimum", "least noise", "compromise", "most light"}
    assert set(stored["published"]) == {entry.name for entry in for_chips(13)} != set()
    for point in found["points"]:
        code = ShutterCode(point["bits"])
        assert point["minimum"] == pytest.approx(min_chip(code), abs=1e-9)
        assert point["open"] == code.open_chips
        assert 6 <= code.open_chips <= 10
        assert point["dnf_db"] == pytest.approx(point["noise_gain_db"] + 20 * np.log10(code.duty))
    assert {"seconds", "steps", "stopped", "interrupted", "seed", "warnings"} <= set(found)
    assert stored["problem"]["seed"] == 2


def test_for_people_it_prints_the_knees(lab, workplace):
    assert (
        lab("pareto", "--chips", "8", "--linear", "10", "--open", "40%:80%", "--steps", "0").code
        == 0
    )
    for text in (
        "best minimum",
        "least noise",
        "compromise",
        "most light",
        "noise gain, dB",
        "front.json, front.png",
    ):
        assert text in lab.out
    assert Path("front.png").read_bytes().startswith(b"\x89PNG")
    best = json.loads(Path("front.json").read_text())["knees"]["best minimum"]
    assert f"best minimum: {best['bits']}" in lab.out


def test_a_curve_says_that_its_minimum_is_sampled(lab, workplace):
    found = lab.succeeds(
        "pareto", "--trajectory", "trajectory.json", "--chips", "8", "--steps", "0"
    )
    assert found["unit"] == "light-true, sampled"
    assert "samples" in found["warnings"][0]
    lights = [point["open"] for point in found["points"]]
    assert lights == sorted(set(lights))


def test_an_interrupt_keeps_the_front(lab, workplace, monkeypatch):
    def interrupted_soon(problem, *, progress, **options):
        def stop(_fraction, _note):
            raise KeyboardInterrupt

        return real(problem, progress=stop, **options)

    real = pareto_front
    monkeypatch.setattr("lab.fronts.comparison.pareto_front", interrupted_soon)
    found = lab.succeeds("pareto", "--chips", "20", "-o", "f.json")
    assert found["interrupted"]
    assert found["stopped"] == "interrupted"
    assert "early" in found["warnings"][0]
    assert json.loads(Path("f.json").read_text())["points"] == found["points"]
    assert Path("f.png").exists()


def test_runs_and_periods_are_limited(lab, workplace):
    Path("strobe.toml").write_text(
        'schema = "hw.device/1"\nname = "strobe"\nmax_on_ns = 2500000\nmax_rate_hz = 400.0\n'
    )
    options = ("--chips", "12", "--device", "strobe.toml", "--steps", "1000", "-o", "a.json")
    lab.succeeds("pareto", *options)
    front = json.loads(Path("a.json").read_text())
    assert (front["problem"]["max_open"], front["problem"]["min_period"]) == (2, 3)
    assert front["points"]
    for point in front["points"]:
        # runs of at most two, and no start two chips after another
        assert "111" not in point["bits"]
        assert "0101" not in "0" + point["bits"]


def test_repeatable(lab, workplace):
    options = ("pareto", "--chips", "12", "--steps", "1000", "--seed", "4")
    lab.succeeds(*options, "-o", "a.json")
    lab.succeeds(*options, "-o", "b.json")
    assert Path("a.json").read_bytes() == Path("b.json").read_bytes()
    assert Path("a.png").read_bytes() == Path("b.png").read_bytes()


@pytest.mark.parametrize(
    ("says", "options"),
    [
        ("--open", ("--open", "5:2")),
        ("--open", ("--open", "some")),
        ("--open", ("--open", "3:99")),
        ("--open", ("--open", "90%:20%")),
        ("--trajectory", ("--linear", "20", "--trajectory", "trajectory.json")),
        ("--linear", ("--linear", "-3")),
        ("chips", ("--linear", "1")),
        ("--plot", ("--plot", "front.gif")),
        ("--plot", ("-o", "a.png", "--plot", "a.png")),
        ("--min-open", ("--min-open", "12", "--open", "3")),
        ("--time", ("--time", "0")),
        ("zero", ("--open", "16", "--steps", "0")),
        ("no folder", ("-o", "nowhere/front.json")),
        ("sharp.png", ("--plot", "sharp.png")),
        ("--help", ("--chips", "1")),
    ],
)
def test_bad_options_write_nothing(lab, workplace, says, options):
    before = {item: item.read_bytes() for item in sorted(workplace.iterdir())}
    assert says in lab.refuses("pareto", "--chips", "16", *options)
    assert {item: item.read_bytes() for item in sorted(workplace.iterdir())} == before


def test_existing_files_need_force(lab, workplace):
    options = ("pareto", "--chips", "8", "--open", "4:6", "--steps", "0")
    lab.succeeds(*options)
    assert "--force" in lab.refuses(*options)
    lab.succeeds(*options, "--force")


def test_help_has_an_example_and_says_what_is_judged(lab):
    lab("pareto", "--help")
    shown = " ".join(lab.out.split())
    for text in (
        "Example: python -m lab pareto",
        "--json",
        "--seed",
        "--force",
        "--output",
        "any speed",
        "curved",
    ):
        assert text in shown


def test_the_front_says_what_ended_it(lab, workplace):
    quick = ("pareto", "--chips", "12", "--open", "6", "--force")
    for given, stopped in (
        (("--steps", "900"), "steps"),
        (("--time", "0.2"), "time"),
        (("--steps", "1000000000", "--time", "0.2"), "time"),
    ):
        found = lab.succeeds(*quick, *given)
        assert (found["stopped"], found["interrupted"]) == (stopped, False)
        assert bool(found["warnings"]) == (len(given) == 4)


def test_the_fronts_time_rules_unless_moves_are_given(lab, workplace, monkeypatch):
    seen = []
    real = pareto_front

    def hasty(problem, *, steps, time_s, **options):
        seen.append((steps, time_s))
        return real(problem, **options, steps=100, time_s=60.0)

    monkeypatch.setattr("lab.fronts.comparison.pareto_front", hasty)
    for given in ((), ("--time", "7"), ("--steps", "90"), ("--steps", "90", "--time", "7")):
        lab.succeeds("pareto", "--chips", "12", "--open", "6", "--force", *given)
    assert seen == [(None, 60.0), (None, 7.0), (90, math.inf), (90, 7.0)]
