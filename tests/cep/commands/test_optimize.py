"""``cep optimize`` from the shell: proofs, motions that may differ, a shutter's
ramps."""

import errno
import importlib
import json
import math
import re
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from cep.commands.optimize import OptimizeOptions
from cep.files.code_files import read_code
from cep.optics.code import ShutterCode
from cep.search.annealing.anneal import standard_moves
from cep.search.problem import SearchProblem
from hw.device import load_profile
from hw.program import Program
from motdiff.trajectory import Trajectory


def test_exact_proves_the_best_and_audit_confirms_it(cep, workplace):
    found = cep.succeeds(
        "optimize", "--linear", "13", "--chips", "13", "--method", "exact", "-o", "best.json"
    )
    assert found["proven"]
    assert found["bits"] == "1111100110101"  # the Barker-13 code: docs/optima.md
    assert found["min_chip"] == pytest.approx(1.362373, abs=1e-5)
    # light-true, as that of the annealing
    assert found["objective"] == pytest.approx(-20 * np.log10(found["min_chip"] / 13), abs=1e-5)
    stored = read_code("best.json")
    assert stored.problem["proof"]["bits"]
    audited = cep.succeeds("audit", "best.json")
    assert audited["verified"]["holds"]


@pytest.mark.parametrize("length_px", ["13", "5.5", "40"])
def test_what_is_proven_already_is_returned_with_its_proof(cep, workplace, length_px):
    asked = (
        "optimize",
        "--linear",
        length_px,
        "--chips",
        "13",
        "--objective",
        "min-mtf",
    )
    found = cep.succeeds(*asked, "--time", "2", "-o", "best.json")
    assert (found["bits"], found["open"], found["stopped"], found["steps"]) == (
        "1111100110101",
        9,
        "proven",
        0,
    )
    assert (found["proven"], found["proof"], found["warnings"]) == (True, "docs/optima.md", [])
    assert found["bound"] == pytest.approx(1.362373, abs=1e-5)
    assert found["gap"] == pytest.approx(0, abs=1e-5)
    assert found["certificate"]["unit"] == "chips"
    assert read_code("best.json").problem["proof"]["file"] == "docs/optima.md"
    assert cep.succeeds("audit", "best.json")["verified"]["holds"]
    said = cep(*asked, "--force", "-o", "best.json").out
    assert "proven (docs/optima.md): no code within the limits is better" in " ".join(said.split())
    # a limit that excludes the code: it is searched
    other = cep.succeeds(*asked, "--min-open", "2", "--steps", "500", "-o", "other.json")
    assert (other["proven"], other["proof"]) == (False, None)


def test_a_bound_of_zero_has_no_gap(cep, workplace):
    # P(-1) = 0 with both of two chips open
    asked = (
        "--linear",
        "4",
        "--chips",
        "2",
        "--open",
        "2",
        "--objective",
        "min-mtf",
        "--steps",
        "100",
    )
    found = cep.succeeds("optimize", *asked, "-o", "two.json")
    assert (found["bits"], found["min_chip"], found["bound"], found["gap"]) == (
        "11",
        0.0,
        0.0,
        0.0,
    )


def test_a_proof_says_over_which_frequencies(cep, workplace):
    options = (
        "optimize",
        "--linear",
        "12",
        "--chips",
        "10",
        "--method",
        "exact",
        "--force",
        "-o",
        "new.json",
    )
    assert "better on the unit circle" in cep(*options).out
    # along several motions only the samples are counted out: the continuum may rank the codes
    # otherwise
    assert "band samples" in cep(*options, "--speed", "0.9:1.1").out


def test_a_forged_certificate_is_found_out(cep, workplace):
    cep.succeeds(
        "optimize", "--linear", "13", "--chips", "13", "--steps", "2000", "-o", "new.json"
    )
    document = json.loads(Path("new.json").read_text())
    document["certificate"]["lower"] *= 1.01
    document["certificate"]["upper"] *= 1.01
    Path("forged.json").write_text(json.dumps(document))
    audited = cep.succeeds("audit", "forged.json")
    assert not audited["verified"]["holds"]


def test_a_certificate_of_one_way_does_not_cover_both(cep, workplace):
    motion = json.loads(Path("trajectory.json").read_text())
    Path("one_way.json").write_text(json.dumps({**motion, "direction": "known"}))
    options = ("--trajectory", "one_way.json", "--chips", "8", "--steps", "500")
    cep.succeeds("optimize", *options, "-o", "new.json")
    audited = cep.succeeds("audit", "new.json", "--trajectory", "trajectory.json")
    assert audited["verified"]["holds"]
    assert any(
        "does not cover this motion, forward and backward" in line for line in audited["warnings"]
    )


def test_other_speeds_count(cep, workplace):
    options = (
        "optimize",
        "--linear",
        "12",
        "--chips",
        "12",
        "--objective",
        "noise",
        "--steps",
        "3000",
        "--force",
    )
    plain = cep.succeeds(*options, "-o", "plain.json")
    wider = cep.succeeds(*options, "--speed", "0.8:1.2", "-o", "wider.json")
    # its figures are the worst over all of them
    assert wider["noise_gain_db"] > plain["noise_gain_db"]
    assert any("on time" in warning for warning in wider["warnings"])
    assert wider["gap"] is not None
    assert wider["noise_gain_db"] >= wider["bound"]


def test_a_slow_shutter_is_designed_for(cep, workplace):
    options = (
        "optimize",
        "--linear",
        "20",
        "--chips",
        "16",
        "--objective",
        "noise",
        "--steps",
        "3000",
        "--force",
    )
    quick = cep.succeeds(*options, "--device", "flc", "--exposure", "16ms", "-o", "quick.json")
    slow = cep.succeeds(*options, "--device", "flc", "--exposure", "0.8ms", "-o", "slow.json")
    assert slow["noise_gain_db"] > quick["noise_gain_db"]
    assert ShutterCode(slow["bits"]).chips == 16


def test_only_what_a_strobe_can_play_is_proposed(cep, lab, workplace):
    Path("strobe.toml").write_text(
        'schema = "hw.device/1"\nname = "strobe"\nmax_on_ns = 2500000\nmax_rate_hz ='
        " 300.0\nmax_duty = 0.5\n"
    )
    options = ("--linear", "16", "--chips", "16", "--device", "strobe.toml", "--force")
    for command in (
        ("optimize", "--steps", "3000"),
        ("optimize", "--method", "exact"),
        ("frames", "--steps", "3000"),
    ):
        run = lab if command[0] == "frames" else cep
        found = run.succeeds(*command, *options, "-o", "new.json")
        stored = read_code(found["file"] if "file" in found else found["files"][0])
        assert {
            name: stored.problem[name] for name in ("max_open", "min_period", "open_range")
        } == {
            "max_open": 2,
            "min_period": 4,
            "open_range": [1, 8],
        }
        for bits in [found["bits"]] if isinstance(found["bits"], str) else found["bits"]:
            program = Program(bits, chip_ns=1_000_000)
            assert load_profile("strobe.toml").check(program) == ()
    # limits of the device and of an option count together
    found = cep.succeeds("optimize", *options, "--steps", "3000", "--min-open", "2")
    assert read_code("code.json").problem["min_open"] == 2
    code = ShutterCode(found["bits"])
    assert code.open_chips == 2 * code.pulses  # the device opens for two chips at most


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--method", "guess"), "--method: must be anneal or exact"),
        (("--method", "exact", "--objective", "noise"), "min-mtf"),
        (("--speed", "fast"), "--speed: must be LOW:HIGH"),
        (("--speed", "-1:1"), "above 0"),
        (("--objective", "noise:much"), "--objective: must be a name or a mix"),
        (("--objective", "noise:1,noise:2"), "twice"),
        (("--method", "exact", "--steps", "9"), "--steps"),
        (
            ("--device", "dark.toml"),
            "--exposure: dark opens for 10 ns at most, a chip must not last longer",
        ),
    ],
)
def test_bad_wishes_are_one_line(cep, workplace, options, message):
    Path("dark.toml").write_text('schema = "hw.device/1"\nname = "dark"\nmax_on_ns = 10\n')
    line = cep.refuses("optimize", "--linear", "12", "--chips", "12", "-o", "never.json", *options)
    assert message in line
    assert not Path("never.json").exists()


def test_a_mix_is_searched(cep, workplace):
    options = (
        "optimize",
        "--linear",
        "12",
        "--chips",
        "12",
        "--open",
        "6",
        "--steps",
        "30000",
        "--force",
    )
    both = cep.succeeds(*options, "--objective", "min-mtf:0.5,noise:1", "-o", "both.json")
    assert (both["bound"], both["gap"]) == (None, None)
    noise = cep.succeeds(*options, "--objective", "noise", "-o", "noise.json")
    assert both["noise_gain_db"] >= noise["noise_gain_db"] - 1e-9
    assert read_code("both.json").problem["objective"] == [["min-mtf", 0.5], ["noise", 1.0]]


def test_nothing_to_choose_takes_no_time(cep, workplace):
    found = cep.succeeds(
        "optimize", "--linear", "6", "--chips", "6", "--open", "6", "-o", "all.json"
    )
    assert (found["bits"], found["steps"], found["stopped"]) == ("111111", 0, "complete")
    cep("optimize", "--linear", "6", "--chips", "6", "--open", "6", "--time", "60", "--force")
    assert "no other code keeps the limits" in cep.out


def test_a_comparison_that_the_time_ended_is_told(cep, workplace, monkeypatch):
    """Long codes: their baselines may take a quarter of the time."""
    limits = []

    def cut_short(problem, *, time_s, **_options):
        limits.append(time_s)
        return SimpleNamespace(code=ShutterCode("1" * problem.chips), stopped="time")

    monkeypatch.setattr("cep.search.baselines.anneal", cut_short)
    searched = ["optimize", "--linear", "12", "--chips", "12", "--steps", "500", "--time", "9"]
    found = cep.succeeds(*searched, "--force")
    assert limits == [2.25]
    assert found["baselines"]["length-only code"]["stopped_early"]
    assert found["stopped"] == "steps"
    (warning,) = found["warnings"]
    assert "the search of the length-only code was stopped early" in warning
    cep(*searched, "--force")
    assert cep.err == f"cep: warning: {warning}\n"


# -- what ends a search ---------------------------------------------------------------------------

QUICK = ("optimize", "--linear", "12", "--chips", "12", "--force")
STANDARD = standard_moves(
    SearchProblem.along(Trajectory.straight(12.0), chips=12, objective="mse")
)


@pytest.fixture
def budgets(monkeypatch):
    """Collect the budget of every search of a command, and make it end at once."""
    seen = []

    def hasty(real):
        def search(problem, *arguments, steps, time_s, **options):
            seen.append((steps, time_s))
            return real(problem, *arguments, **options, steps=500, time_s=60.0)

        return search

    for name in ("cep.search.code_search.anneal", "lab.frames.optimum.anneal_frames"):
        module, function = name.rsplit(".", 1)
        monkeypatch.setattr(name, hasty(getattr(importlib.import_module(module), function)))
    return seen


@pytest.mark.parametrize(
    ("given", "budget"),
    [
        ((), (STANDARD, 60.0)),
        (("--time", "7"), (None, 7.0)),
        (("--steps", "900"), (900, math.inf)),
        (("--steps", "900", "--time", "7"), (900, 7.0)),
    ],
)
def test_the_time_rules_unless_moves_are_given(cep, lab, workplace, budgets, given, budget):
    cep.succeeds(*QUICK, *given)
    steps, time_s = budget
    ((moves, left_s),) = budgets
    assert moves == steps
    assert time_s / 2 <= left_s <= time_s  # what the baselines took is off
    del budgets[:]
    lab.succeeds("frames", *QUICK[1:], *given)
    single, joint = budgets
    assert single[0] == joint[0] == steps
    assert time_s / 4 <= single[1] <= time_s / 2 <= joint[1] <= time_s


@pytest.mark.parametrize("command", ["optimize", "frames"])
def test_the_result_says_what_ended_the_search(cep, lab, workplace, command):
    run = lab if command == "frames" else cep
    for given, stopped, words in (
        (("--steps", "900"), "steps", "moves made"),
        (("--time", "0.2"), "time", "stopped by the time"),
        (("--steps", "1000000000", "--time", "0.2"), "time", "stopped by the time"),
    ):
        found = run.succeeds(command, *QUICK[1:], *given)
        assert (found["stopped"], found["interrupted"]) == (stopped, False)
        assert found["steps"] >= (900 if stopped == "steps" else 1)
        assert bool(found["warnings"]) == (len(given) == 4)
        if len(given) == 4:
            assert "ended the search before its 1,000,000,000 moves" in found["warnings"][0]
        file = found["files"][0] if command == "frames" else found["file"]
        assert read_code(file).problem["stopped"] == stopped
        run(command, *QUICK[1:], *given)
        assert words in run.out


def test_a_proof_says_so_and_takes_no_budget(cep, workplace):
    assert cep.succeeds(*QUICK, "--method", "exact")["stopped"] == "proven"
    for option in ("--steps", "--time"):
        line = cep.refuses(*QUICK, "--method", "exact", option, "9")
        assert f"{option}: not valid with --method exact" in line


def test_a_full_disk_loses_no_code_and_names_the_file(cep, lab, workplace, monkeypatch):
    asked = ("optimize", "--linear", "14", "--chips", "14", "--method", "exact")

    def full(*_arguments, **_options):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as disk:
        disk.setattr(Path, "write_text", full)
        told = cep.fails(*asked, "-o", "best.json")
        two = lab.fails(
            "frames", "--linear", "14", "--chips", "6", "--steps", "200", "-o", "two.json"
        )
    assert told == "cep: best.json: No space left on device; found: 11111001101010\n"
    assert re.search(r"two_1.json: No space left on device; found: [01]{6}, [01]{6}\n$", two)
    assert not Path("best.json").exists()


@pytest.mark.parametrize(
    ("option", "place"),
    [
        ("--class", "python -m lab design-class"),
        ("--chip-ns", "is --exposure"),
        ("--workers", "python -m lab prove"),
    ],
)
def test_an_option_that_went_says_where(cep, workplace, option, place):
    line = cep.refuses("optimize", "--linear", "9", option, "5")
    assert line.startswith(f"cep: {option.partition('=')[0]} ")
    assert place in line


def test_a_pair_of_cameras_from_the_search_to_both_codes(cep, workplace):
    asked = ("optimize", "--linear", "14", "--chips", "10", "--frames", "2", "--scene", "text")
    # a scene of no photographs: the gains are a model's, and it says so
    best = cep.succeeds(*asked, "--steps", "3000", "--read-noise", "50", "-o", "pair.json")
    code = ShutterCode(best["bits"])
    assert best["complement"] == code.complement().bits
    assert (best["certificate"], best["bound"], best["proven"]) == (None, None, False)
    assert "model of text" in best["verdict"]
    assert {"two open shutters", "two best single exposures"} < set(best["baselines"])
    stored = read_code("pair.json")
    assert stored.problem["frames"] == 2
    assert stored.problem["pair"]["mse_db"] == pytest.approx(best["mse_db"])
    page = " ".join(cep(*asked, "--steps", "3000", "--force", "-o", "pair.json").out.split())
    assert "cep deblur a.png b.png --code pair.json --code complement:pair.json" in page
    assert "certified" not in page
    assert "no code with so many" not in page
    for name in ("pair.json", "complement:pair.json"):
        cep.succeeds("export", name, "--format", "json")
    cep.succeeds("audit", "pair.json")


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (("--frames", "3"), "cep: --frames: must be 1, or 2 for .* python -m lab frames"),
        (("--frames", "0"), "cep: --frames: must be 1, or 2"),
        (("--frames", "2", "--method", "exact"), "cep: --frames: not valid with --method exact"),
        (("--frames", "2", "--open", "2:3"), "cep: --open, --min-open and --frames: conflict: "),
        (
            ("--frames", "2", "--device", "mechanical"),
            "cep: ",
        ),
    ],
)
def test_a_pair_that_cannot_be_is_refused_in_a_line(cep, workplace, options, line):
    asked = ("optimize", "--linear", "9", "--chips", "9", "-o", "pair.json")
    assert re.match(line, cep.refuses(*asked, *options))
    assert not Path("pair.json").exists()


def test_it_has_at_most_24_options():
    assert len(fields(OptimizeOptions)) <= 24
