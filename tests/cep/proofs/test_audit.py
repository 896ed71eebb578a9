"""Neighbours of a code, against brute force; zeros where theory puts them."""

import json
import re
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cep.codes.published import CLAIMS, PUBLISHED
from cep.files.code_files import StoredCode, write_code
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_otf
from cep.proofs.audit import (
    audit,
    better_neighbours,
    grid_claims,
)
from cep.proofs.certify.certificate import certify
from cep.proofs.certify.minimum import min_chip
from motdiff.trajectory import Trajectory

BENT = Trajectory.from_samples([[0, 0], [6, 1], [9, 5]])


def flipped(bits, places):
    return "".join(str(1 - int(bit)) if k in places else bit for k, bit in enumerate(bits))


@settings(max_examples=15, deadline=None)
@given(st.text("01", min_size=6, max_size=8).filter(lambda bits: "1" in bits))
def test_the_best_neighbours_are_found(bits):
    code = ShutterCode(bits)
    found = {len(n.flips): n for n in better_neighbours(code, flips=3)}
    for flips in (1, 2, 3):
        others = [flipped(bits, places) for places in combinations(range(len(bits)), flips)]
        best = max(min_chip(ShutterCode(other)) for other in others if "1" in other)
        if best > 1.01 * min_chip(code) + 1e-9:
            assert found[flips].minimum == pytest.approx(best, rel=1e-6)
        if flips in found:
            assert found[flips].code.bits == flipped(bits, [k - 1 for k in found[flips].flips])
            assert found[flips].minimum > min_chip(code)


def test_the_best_code_has_no_better_neighbour():
    best = max((ShutterCode(f"{n:09b}") for n in range(1, 2**9)), key=min_chip)
    assert better_neighbours(best, flips=3) == ()


def test_an_open_shutter_has_zeros_at_multiples_of_one_over_its_length():
    found = certify(ShutterCode("1" * 8), None)
    assert found.upper == 0
    assert found.at[0] * 8 == pytest.approx(round(found.at[0] * 8), abs=1e-6)


@pytest.mark.parametrize("direction", ["known", "unknown"])
def test_the_minimum_along_a_path_counts_the_worse_direction(direction):
    path = Trajectory(BENT.t, BENT.xy, direction)
    code = ShutterCode("110100")
    found = certify(code, path)
    line = np.linspace(-0.5, 0.5, 201)
    fx, fy = np.meshgrid(line, line)
    paths = [path] if direction == "known" else [path, path.reversed()]
    dense = min(float(np.abs(coded_otf(p, code, fx, fy)).min()) for p in paths)
    # a curved path's zeros are isolated points: both searches come close to one
    assert found.lower <= found.upper <= dense + 1e-4


def test_neighbours_along_a_path_are_better_there():
    known = Trajectory(BENT.t, BENT.xy, "known")
    code = ShutterCode("111111")
    for neighbour in better_neighbours(code, known, flips=2):
        assert neighbour.minimum > certify(code, known).upper


def test_three_flips_of_a_known_code():
    """Against a plain search over all 22,100 triples on a grid of 16 points a chip."""
    found = better_neighbours(PUBLISHED["raskar-52"], flips=3)
    assert [n.flips for n in found] == [(37,), (37, 48), (14, 37, 40)]
    assert found[1].minimum == pytest.approx(1.6170, abs=1e-4)


@pytest.mark.parametrize(("chips", "flips"), [(52, 3), (256, 3), (257, 2)])
def test_three_flips_are_tried_of_256_chips_and_two_of_more(chips, flips, monkeypatch):
    tried = []

    def none_better(code, trajectory=None, *, flips):
        tried.append(flips)
        return ()

    monkeypatch.setattr("cep.proofs.audit.better_neighbours", none_better)  # takes a minute
    code = ShutterCode(np.random.default_rng(0).integers(0, 2, chips))
    assert audit(code).flips == flips
    assert tried == [flips]


def test_four_flips_are_refused():
    with pytest.raises(ValueError, match="flips: must be 0 to 3"):
        better_neighbours(PUBLISHED["bdinr-8"], flips=4)


def test_neighbours_on_a_curve_against_brute_force():
    path = Trajectory.from_samples([[0, 0], [1.5, 0.3], [2.2, 1.2]])
    bits = "110010"
    here = certify(ShutterCode(bits), path).upper
    every = [flipped(bits, places) for places in combinations(range(6), 2)]
    best = max((certify(ShutterCode(b), path).upper, b) for b in every if "1" in b)
    (found,) = (
        n for n in better_neighbours(ShutterCode(bits), path, flips=2) if len(n.flips) == 2
    )
    assert best[0] > here
    assert found.minimum == pytest.approx(best[0], rel=1e-3)


@pytest.mark.parametrize(("name", "points"), [(name, claim[0]) for name, claim in CLAIMS.items()])
def test_grids_are_called_what_they_are(name, points):
    code = PUBLISHED[name]
    truth = certify(code, None).upper
    claims = {claim.points: claim for claim in grid_claims(code, None, truth)}
    assert list(claims) == sorted(claims)
    for claim in claims.values():
        assert claim.minimum == pytest.approx(np.abs(np.fft.fft(code.array, claim.points)).min())
    if points in claims:
        expected = {"merl-31-t62": "hides the zero", "merl-50-t850": "honest"}.get(
            name, "overstates"
        )
        assert claims[points].verdict == expected
    assert grid_claims(ShutterCode("1" * 16), None, 0.0)[0].verdict == "honest"


def test_grids_along_a_path():
    # the open shutter's zeros at multiples of 1/32 lie on these grids; those of 31 px lie between
    assert {c.verdict for c in grid_claims(ShutterCode("1"), Trajectory.straight(32.0), 0.0)} == {
        "honest"
    }
    bent = Trajectory.from_samples([[0, 0], [14, 3], [31, 5]])
    truth = certify(ShutterCode("1101"), bent)
    assert truth.upper == 0
    assert "hides the zero" in {c.verdict for c in grid_claims(ShutterCode("1101"), bent, 0.0)}


def test_the_samples_of_the_path_that_was_asked_for_are_not_printed_again():
    found = audit(ShutterCode("110100"), BENT, flips=0).to_dict()
    assert "trajectory" not in found["certificate"]
    assert found["motion"]["length_px"] == BENT.length_px


def test_zeros_are_listed_by_direction():
    known = Trajectory(BENT.t, BENT.xy, "known")
    assert set(audit(ShutterCode("1101"), flips=0).zeros) == {"both"}
    assert set(audit(ShutterCode("1101"), known, flips=0).zeros) == {"forward"}
    both = audit(ShutterCode("1101"), BENT, flips=0).zeros
    assert set(both) == {"forward", "backward"}
    at = np.array([zero.at for zero in both["backward"].found]).reshape(-1, 2)
    otf = coded_otf(BENT.reversed(), ShutterCode("1101"), at[:, 0], at[:, 1])
    assert np.abs(otf) == pytest.approx(np.zeros(len(at)), abs=1e-9)


def test_the_command_tells_zeros_grids_and_no_verdict(cep):
    found = cep.succeeds("audit", "merl-31-t62", "--flips", "1")
    assert [(zero["at"], zero["method"]) for zero in found["zeros"]] == [
        ([1 / 6], "root of unity of order 6")
    ]
    assert found["zeros_complete"]
    assert {grid["verdict"] for grid in found["grids"]} == {"hides the zero"}
    assert found["verified"] is None
    assert found["certificate"]["upper"] == 0
    assert found["certificate"]["unit"] == "chips"
    shown = cep("audit", "merl-31-t62", "--flips", "0").out
    assert "root of unity of order 6" in shown
    assert "hides the zero" in shown


def test_a_proven_zero_within_the_band_leaves_no_inverse(cep):
    """1/|H|^2 has no finite mean there, which no set of samples shows; a zero beyond the band does
    no harm."""
    found = audit(PUBLISHED["merl-31-t62"], flips=0)
    assert found.no_inverse
    assert found.metrics.noise_gain_db == found.metrics.dnf_db == np.inf
    beyond = audit(PUBLISHED["merl-31-t62"], Trajectory.straight(10.0), flips=0)  # 0.52 cycles/px
    assert beyond.zeros["both"].found
    assert not beyond.no_inverse
    assert not audit(PUBLISHED["raskar-52"], flips=0).no_inverse
    assert not audit(
        ShutterCode("1101"), BENT, flips=0
    ).no_inverse  # a curved path's are single points
    assert cep.succeeds("audit", "merl-31-t62", "--flips", "0")["noise_gain_db"] is None
    assert re.search(r"noise_gain_db +infinite", cep("audit", "merl-31-t62", "--flips", "0").out)


def test_the_command_judges_a_stored_code_with_the_camera_of_its_search(cep, tmp_path):
    path = tmp_path / "code.json"
    write_code(
        path,
        StoredCode(PUBLISHED["raskar-52"], problem={"camera": Camera(read_noise_e=100).to_dict()}),
    )
    asked = ("audit", path, "--linear", "52", "--flips", "0")
    assert cep.succeeds(*asked)["choice"] in ("code", "strobe")
    assert cep.succeeds(*asked, "--read-noise", "2")["choice"] == "snapshot"
    assert cep.succeeds(*asked, "--camera", "sony-imx250")["choice"] == "snapshot"
    write_code(path, StoredCode(PUBLISHED["raskar-52"], problem={"camera": {"bits": 99}}))
    assert (
        cep.refuses(*asked)
        == f"cep: {path}: problem.camera: bits: must be a whole number within 1..16, got 99;"
        " --camera names another\n"
    )
    assert cep.succeeds(*asked, "--camera", "sony-imx250")["choice"] == "snapshot"


def test_the_command_says_along_a_motion_whether_the_code_is_the_exposure_to_take(cep):
    asked = ("audit", "raskar-52", "--linear", "52", "--flips", "0", "--read-noise")
    quiet, noisy = (cep.succeeds(*asked, noise) for noise in ("2", "100"))
    assert quiet["choice"] == "snapshot"
    assert noisy["choice"] in ("code", "strobe")  # for photographs even pulses may be better
    assert cep(*asked, "2").out.startswith("Coding does not pay here: expose 1/26 of the time")
    assert " dB over this code. " in quiet["verdict"]
    assert noisy["gains_db"]["code"] > noisy["gains_db"]["snapshot"]
    assert cep.succeeds("audit", "raskar-52", "--flips", "0")["verdict"] is None


def test_the_command_checks_a_stored_certificate(cep, workplace):
    code = ShutterCode("110100")
    path = Trajectory.from_samples([[0, 0], [1.5, 0.3], [2.2, 1.2]])
    for motion in (None, path):
        write_code("mine.json", StoredCode(code, certificate=certify(code, motion).to_dict()))
        found = cep.succeeds("audit", "mine.json", "--flips", "0")
        assert found["verified"]["holds"], found["verified"]
        document = json.loads(Path("mine.json").read_text())
        document["certificate"]["lower"] *= 1.01
        document["certificate"]["upper"] *= 1.01
        Path("forged.json").write_text(json.dumps(document))
        found = cep.succeeds("audit", "forged.json", "--flips", "0")
        assert not found["verified"]["holds"]
        assert "not confirmed" in found["warnings"][0]
        assert "refused" in cep("audit", "forged.json", "--flips", "0").out
