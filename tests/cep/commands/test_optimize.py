"""``cep optimize`` from the shell: proofs, forced chips, motions that may differ, a shutter's
ramps."""

import errno
import importlib
import json
import math
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from cep.files.files import read_code
from cep.optics.code import ShutterCode
from cep.search.annealing.anneal import standard_moves
from cep.search.problem import SearchProblem
from hw.device import load_profile
from hw.program import Program
from lab.fronts import pareto
from motdiff.files.trajectories import StoredMotion, write_motion
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


@pytest.mark.parametrize(
    ("length_px", "direction"), [("13", "forward"), ("5.5", "unknown"), ("40", "unknown")]
)
def test_what_is_proven_already_is_returned_with_its_proof(cep, workplace, length_px, direction):
    asked = (
        "optimize",
        "--linear",
        length_px,
        "--chips",
        "13",
        "--objective",
        "min-mtf",
        "--direction",
        direction,
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
    other = cep.succeeds(*asked, "--max-pulses", "3", "--steps", "500", "-o", "other.json")
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
    options = (
        "--trajectory",
        "trajectory.json",
        "--chips",
        "8",
        "--steps",
        "500",
        "--direction",
        "forward",
    )
    cep.succeeds("optimize", *options, "-o", "new.json")
    audited = cep.succeeds("audit", "new.json", "--trajectory", "trajectory.json")
    assert audited["verified"]["holds"]
    assert any(
        "does not cover this motion, forward and backward" in line for line in audited["warnings"]
    )


def test_forced_chips_are_kept(cep, workplace):
    options = ("optimize", "--linear", "12", "--chips", "12", "--steps", "3000", "-o", "new.json")
    found = cep.succeeds(*options, "--fixed", "??0???0?????", "--first-open", "--last-open")
    assert found["bits"][0] == found["bits"][-1] == "1"
    assert found["bits"][2] == found["bits"][6] == "0"


def test_other_speeds_and_clocks_count(cep, workplace):
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
    wider = cep.succeeds(
        *options, "--speed", "0.8:1.2", "--drift", "0.02", "--jitter", "0.05", "-o", "wider.json"
    )
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
    quick = cep.succeeds(*options, "--device", "flc", "--chip-ns", "1000000", "-o", "quick.json")
    slow = cep.succeeds(*options, "--device", "flc", "--chip-ns", "50000", "-o", "slow.json")
    assert slow["noise_gain_db"] > quick["noise_gain_db"]
    assert ShutterCode(slow["bits"]).chips == 16


def test_only_what_a_strobe_can_play_is_proposed(cep, workplace):
    Path("strobe.toml").write_text(
        'schema = "hw.device/1"\nname = "strobe"\nmax_on_ns = 2500000\nmax_rate_hz ='
        " 300.0\nmax_duty = 0.5\n"
    )
    options = (
        "optimize",
        "--linear",
        "16",
        "--chips",
        "16",
        "--device",
        "strobe.toml",
        "--force",
        "-o",
        "new.json",
    )
    for method in (
        ("--steps", "3000"),
        ("--method", "exact"),
        ("--frames", "2", "--steps", "3000"),
    ):
        found = cep.succeeds(*options, *method)
        stored = read_code(found["file"] if "file" in found else found["files"][0])
        assert {
            name: stored.problem[name] for name in ("max_open", "min_period", "open_range")
        } == {
            "max_open": 2,
            "min_period": 4,
            "open_range": [1, 8],
        }
        for bits in [found["bits"]] if isinstance(found["bits"], str) else found["bits"]:
            program = Program.from_bits(bits, chip_ns=1_000_000)
            assert load_profile("strobe.toml").check(program) == ()
    # the stricter one of device and wish counts
    found = cep.succeeds(*options, "--steps", "3000", "--max-open", "1", "--min-period", "3")
    assert {name: read_code("new.json").problem[name] for name in ("max_open", "min_period")} == {
        "max_open": 1,
        "min_period": 4,
    }
    assert set(found["bits"].split("0")) <= {"", "1"}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--method", "guess"), "--method: must be anneal or exact"),
        (("--method", "exact", "--objective", "noise"), "min-mtf"),
        (("--bound", "loose"), "--bound: must be quick or sdp"),
        (("--fixed", "1?"), "--fixed: must be 12 characters"),
        (("--fixed", "0???????????", "--first-open"), "--first-open: --fixed closes"),
        (("--speed", "fast"), "--speed: must be LOW:HIGH"),
        (("--speed", "-1:1"), "above 0"),
        (("--drift", "0.9"), "--drift: must lie within -0.5..0.5"),
        (("--drift", "nan"), "--drift"),
        (("--jitter", "0.4"), "--jitter: must lie within 0..0.15"),
        (("--objective", "noise:much"), "--objective: must be a name or a mix"),
        (("--objective", "noise:1,noise:2"), "twice"),
        (("--method", "exact", "--steps", "9"), "--steps"),
        (("--rule", "median"), "rule"),
        (
            ("--min-closed", "9", "--open", "8", "--max-pulses", "1", "--fixed", "1?????0????1"),
            "conflict",
        ),
        (
            ("--max-open", "2", "--min-open", "3"),
            "--min-open 3 and --max-open 2 conflict: no code of 12 chips keeps both",
        ),
        (("--max-open", "0"), "--max-open"),
        (("--min-period", "0"), "--min-period"),
        (
            ("--min-period", "7", "--max-open", "2", "--open", "5"),
            "--open 5..5, --max-open 2 and --min-period 7 conflict",
        ),
        (
            ("--device", "dark.toml"),
            "--chip-ns: dark opens for 10 ns at most, a chip must not last longer",
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


def test_starts_from_the_relaxation(cep, workplace):
    """One move leaves the search no better than its starts: those drawn from the relaxation win
    over the others."""
    x = 9 * np.linspace(0, 1, 12) ** 2
    write_motion("faster.json", StoredMotion(Trajectory.from_samples(np.stack([x, 0.5 * x], 1))))
    options = (
        "optimize",
        "--trajectory",
        "faster.json",
        "--direction",
        "forward",
        "--chips",
        "40",
        "--open",
        "20",
    )
    options += ("--objective", "min-mtf", "--steps", "1", "--seed", "1", "--force")
    plain = cep.succeeds(*options)
    started = cep.succeeds(*options, "--bound", "sdp")
    assert started["objective"] < plain["objective"] - 0.1
    assert started["min_mtf"] <= started["bound"]


@pytest.mark.parametrize(
    ("motion", "objective"),
    [
        ("straight", "noise"),
        ("curved", "min-mtf"),
        pytest.param(
            "curved",
            "noise",
            marks=pytest.mark.slow(reason="relaxes a mean over all samples of the band"),
        ),
    ],
)
def test_a_relaxation_bounds_more_tightly(cep, workplace, motion, objective):
    along = {
        "straight": ("--linear", "10"),
        "curved": ("--trajectory", "trajectory.json", "--direction", "forward"),
    }
    options = (
        "optimize",
        *along[motion],
        "--chips",
        "8",
        "--open",
        "4",
        "--steps",
        "500",
        "--objective",
        objective,
    )
    quick = cep.succeeds(*options, "--force")
    tight = cep.succeeds(*options, "--force", "--bound", "sdp")
    if objective == "noise":  # dB: no code has less than the bound
        assert quick["bound"] + 0.1 < tight["bound"] <= tight["noise_gain_db"]
    else:
        assert tight["min_mtf"] <= tight["bound"] < 0.9 * quick["bound"]


def test_a_comparison_that_the_time_ended_is_told(cep, workplace, monkeypatch):
    """Long codes: their baselines may take a quarter of the time."""
    limits = []

    def cut_short(_length_px, chips, *, time_s, **_options):
        limits.append(time_s)
        return SimpleNamespace(code=ShutterCode("1" * chips), stopped="time")

    monkeypatch.setattr("cep.search.recipe.dnf_search", cut_short)
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

    for name in ("cep.search.recipe.anneal", "cep.search.frames.anneal_frames"):
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
def test_the_time_rules_unless_moves_are_given(cep, workplace, budgets, given, budget):
    cep.succeeds(*QUICK, *given)
    steps, time_s = budget
    ((moves, left_s),) = budgets
    assert moves == steps
    assert time_s / 2 <= left_s <= time_s  # what the baselines took is off
    del budgets[:]
    cep.succeeds(*QUICK, *given, "--frames", "2")
    single, joint = budgets
    assert single[0] == joint[0] == steps
    assert time_s / 4 <= single[1] <= time_s / 2 <= joint[1] <= time_s


@pytest.mark.parametrize("more", [(), ("--frames", "2")])
def test_the_result_says_what_ended_the_search(cep, workplace, more):
    for given, stopped, words in (
        (("--steps", "900"), "steps", "moves made"),
        (("--time", "0.2"), "time", "stopped by the time"),
        (("--steps", "1000000000", "--time", "0.2"), "time", "stopped by the time"),
    ):
        found = cep.succeeds(*QUICK, *more, *given)
        assert (found["stopped"], found["interrupted"]) == (stopped, False)
        assert found["steps"] >= (900 if stopped == "steps" else 1)
        assert bool(found["warnings"]) == (len(given) == 4)
        if len(given) == 4:
            assert "ended the search before its 1,000,000,000 moves" in found["warnings"][0]
        file = found["files"][0] if more else found["file"]
        assert read_code(file).problem["stopped"] == stopped
        cep(*QUICK, *more, *given)
        assert words in cep.out


def test_a_proof_says_so_and_takes_no_budget(cep, workplace):
    assert cep.succeeds(*QUICK, "--method", "exact")["stopped"] == "proven"
    for option in ("--steps", "--time"):
        line = cep.refuses(*QUICK, "--method", "exact", option, "9")
        assert f"{option}: not valid with --method exact" in line


def test_the_front_says_what_ended_it(cep, workplace):
    quick = ("pareto", "--chips", "12", "--open", "6", "--force")
    for given, stopped in (
        (("--steps", "900"), "steps"),
        (("--time", "0.2"), "time"),
        (("--steps", "1000000000", "--time", "0.2"), "time"),
    ):
        found = cep.succeeds(*quick, *given)
        assert (found["stopped"], found["interrupted"]) == (stopped, False)
        assert bool(found["warnings"]) == (len(given) == 4)


def test_the_fronts_time_rules_unless_moves_are_given(cep, workplace, monkeypatch):
    seen = []
    real = pareto.pareto_front

    def hasty(problem, *, steps, time_s, **options):
        seen.append((steps, time_s))
        return real(problem, **options, steps=100, time_s=60.0)

    monkeypatch.setattr("lab.fronts.run.pareto_front", hasty)
    for given in ((), ("--time", "7"), ("--steps", "90"), ("--steps", "90", "--time", "7")):
        cep.succeeds("pareto", "--chips", "12", "--open", "6", "--force", *given)
    assert seen == [(None, 60.0), (None, 7.0), (90, math.inf), (90, 7.0)]


# -- one code for a class of motions --------------------------------------------------------------

SMALL = ("--chips", "8", "--open", "4", "--steps", "300")


def test_one_code_for_all_motions_of_a_folder(cep, workplace):
    for name, direction in (("first", "known"), ("second", "unknown")):
        Path("shots", name).mkdir(parents=True)
        bent = Trajectory.from_samples([[0, 0], [9, 3], [14, 12]], direction=direction)
        write_motion(Path("shots", name, "trajectory.json"), StoredMotion(bent))
    found = cep.succeeds("optimize", "--all", "shots", *SMALL, "-o", "all.json")
    assert (found["motions"], found["other_motions"], found["others_db"]) == (2, 0, None)
    assert read_code("all.json").code.bits == found["bits"]
    assert all(
        row["behind_db"] >= -1e-6 for row in found["baselines"].values() if row["within_limits"]
    )
    assert any("2 motions are few" in line for line in found["warnings"])
    told = cep("optimize", "--all", "shots", *SMALL, "-o", "told.json").out
    first, second, *_ = told.splitlines()
    assert first == found["verdict"]
    assert second == f"told.json: {found['bits']}"


def test_one_code_for_walks_and_for_shakes_of_a_recording(cep, workplace):
    options = ("--motions", "3", "--length", "20", *SMALL, "--objective", "noise")
    found = cep.succeeds("optimize", "--class", "walks", *options, "-o", "walks.json")
    assert (found["motions"], found["other_motions"], found["open"]) == (3, 300, 4)
    again = cep.succeeds("optimize", "--class", "walks", *options, "-o", "again.json")
    assert (again["bits"], again["others_db"]) == (found["bits"], found["others_db"])
    t = np.linspace(0, 2, 400)
    rows = np.column_stack([t, np.sin(9 * t), np.cos(7 * t), 0 * t])
    np.savetxt("gyro.csv", rows, delimiter=",", header="t [s],x [rad/s],y [rad/s],z [rad/s]")
    shaken = cep.succeeds(
        "optimize", "--class", "gyro.csv", "--chip-ns", "10000000", *options, "-o", "gyro.json"
    )
    assert read_code("gyro.json").problem["class"]["kind"] == "gyro.csv"
    assert shaken["chip_ns"] == 10_000_000
    line = cep.refuses(
        "optimize", "--class", "gyro.csv", "--chip-ns", "1000000000", *options, "-o", "long.json"
    )
    assert (
        "gyro.csv: 8.0 s does not fit the trace of 2 s; the exposure is --chips times --chip-ns"
        in line
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--all", "nowhere"), "nowhere: no such folder"),
        (("--all", "empty"), "empty: holds no */trajectory.json"),
        (
            ("--all", "empty", "--class", "walks"),
            "--class: not valid with --all, which searches one code for many motions",
        ),
        (("--all", "empty", "--motions", "5"), "--motions: needs --class"),
        (
            ("--class", "walks", "--trajectory", "trajectory.json"),
            "--trajectory: not valid with --class",
        ),
        (("--class", "walks", "--linear", "30"), "--linear: not valid with --class"),
        (("--class", "walks", "--direction", "forward"), "--direction: not valid with --class"),
        (("--class", "walks", "--speed", "0.9:1.1"), "--speed: not valid with --class"),
        (
            ("--class", "walks", "--method", "exact"),
            "--method: a code for a class of motions needs anneal",
        ),
        (("--class", "walks", "--length", "0"), "--length: must lie within 1..1000 px, got 0"),
        (
            ("--class", "walks", "--objective", "min-mtf"),
            "--objective: a class is searched by noise or mse alone",
        ),
        (
            ("--class", "wals"),
            "--class: must be walks or a gyro recording, and there is no file wals",
        ),
        (("--class", "trajectory.json"), "trajectory.json: "),
        (("--linear", "30", "--length", "20"), "--length: needs --class"),
    ],
)
def test_a_class_and_what_does_not_go_with_it(cep, workplace, options, message):
    Path("empty").mkdir()
    assert message in cep.refuses("optimize", *options, "-o", "refused.json")
    assert not Path("refused.json").exists()


def test_a_full_disk_loses_no_code_and_names_the_file(cep, workplace, monkeypatch):
    asked = ("optimize", "--linear", "14", "--chips", "14", "--method", "exact")

    def full(*_arguments, **_options):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as disk:
        disk.setattr(Path, "write_text", full)
        told = cep.fails(*asked, "-o", "best.json")
        two = cep.fails(
            "optimize",
            "--linear",
            "14",
            "--chips",
            "6",
            "--frames",
            "2",
            "--steps",
            "200",
            "-o",
            "two.json",
        )
    assert told == "cep: best.json: No space left on device; found: 11111001101010\n"
    assert re.search(r"two_1.json: No space left on device; found: [01]{6}, [01]{6}\n$", two)
    assert not Path("best.json").exists()


def test_proofs_in_blocks_say_where_they_went(cep, workplace):
    asked = ("optimize", "--linear", "14", "--chips", "14", "--method", "exact")
    told = cep.refuses(*asked, "--workers", "1", "--cache", "kept")
    assert told.endswith("the repository: python -m lab prove --chips 14 -o kept\n")
    assert "--workers: is for a folder" in cep.refuses(*asked, "--workers", "1")
