"""The second opinion: it confirms what is proven, and refuses every kind of forgery."""

import ast
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cep.codes.published import PUBLISHED, names
from cep.files.code_files import StoredCode, read_code, write_code
from cep.optics.code import ShutterCode
from cep.proofs.certify.certificate import BOTH, certify
from cep.proofs.verify import path_lines, verify
from motdiff.motions import boracchi_foi
from motdiff.trajectory import Trajectory

RASKAR = PUBLISHED["raskar-52"]
codes = st.text("01", min_size=1, max_size=24).filter(lambda bits: "1" in bits).map(ShutterCode)


def shake(seed, length_px=60.0, direction="unknown"):
    return replace(
        boracchi_foi(np.random.default_rng(seed), max_length_px=length_px, samples=300),
        direction=direction,
    )


def bow(length_px, sagitta_px):
    """Nearly straight path: across it H hardly changes."""
    t = np.linspace(0, 1, 65)
    return Trajectory.from_samples(
        np.stack([length_px * t, sagitta_px * np.sin(np.pi * t)], axis=1), direction="known"
    )


def stored(certificate):
    """As it comes back from a file."""
    return json.loads(json.dumps(certificate.to_dict()))


def confirmed(code, trajectory=None):
    certificate = certify(code, trajectory)
    verdict = verify(stored(certificate), bits=code.bits)
    assert verdict.holds, verdict.reasons
    assert verdict.reasons
    return certificate


def test_it_shares_no_code_with_what_it_checks():
    allowed = {
        "numpy",
        "numpy.typing",
        "math",
        "dataclasses",
        "typing",
        "collections.abc",
        "__future__",
    }
    file = Path(__file__).resolve().parents[3] / "cep" / "proofs" / "verify.py"
    tree = ast.parse(file.read_text())
    found = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    found |= {
        alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.Import)
        for alias in node.names
    }
    assert found <= allowed


@pytest.mark.parametrize("name", names())
def test_published_codes_are_confirmed(name):
    certificate = confirmed(PUBLISHED[name])
    assert certificate.relative_width <= 1e-6
    assert (certificate.upper == 0) == (name == "merl-31-t62")


@given(codes)
@settings(max_examples=60, deadline=None)
def test_any_code_is_confirmed(code):
    confirmed(code)


@pytest.mark.parametrize(
    ("code", "path", "kind"),
    [
        (ShutterCode("1101011"), None, "sign change"),
        (ShutterCode("1111"), None, "root of unity"),
        (ShutterCode("1101011"), Trajectory.straight(12.0, angle_rad=0.4), "sign change"),
        (ShutterCode("1111"), Trajectory.straight(12.0, angle_rad=-2.4), "root of unity"),
        (RASKAR, Trajectory.straight(130.0, angle_rad=1.0), "closed form"),
        (RASKAR, shake(1), "kantorovich"),
        (RASKAR, shake(2, direction="known"), "kantorovich"),
        (ShutterCode("110100"), shake(3, 30.0), "kantorovich"),
        (ShutterCode("11100000011110000100001111111111"), bow(24.0, 0.003), "kantorovich"),
    ],
)
def test_zeros_are_confirmed(code, path, kind):
    certificate = confirmed(code, path)
    assert (certificate.lower, certificate.upper) == (0, 0)
    assert certificate.zero.kind == kind
    assert verify(stored(certificate), bits=code.bits).holds


@pytest.mark.parametrize("direction", ["known", "unknown"])
@pytest.mark.parametrize("seed", [2, 4])
def test_minima_above_zero_along_a_curve_are_confirmed(seed, direction):
    code = ShutterCode("110100110")
    certificate = confirmed(code, shake(seed, 4.0, direction))
    assert certificate.lower > 0
    assert certificate.relative_width <= 1e-3
    assert certificate.directions == (("forward",) if direction == "known" else BOTH)


def test_straight_motion_is_confirmed_in_light_true_units():
    certificate = confirmed(RASKAR, Trajectory.straight(20.0, angle_rad=0.3))
    assert certificate.lower > 0
    accelerated = Trajectory.from_samples(np.outer(np.linspace(0, 1, 40) ** 2, [6.0, 8.0]))
    assert confirmed(ShutterCode("1101"), accelerated).lower > 0


def test_the_worse_direction_counts():
    code = ShutterCode("110100110")
    path = shake(2, 4.0)
    both = certify(code, path)
    ways = [certify(code, replace(way, direction="known")) for way in (path, path.reversed())]
    assert both.upper == pytest.approx(min(way.upper for way in ways))
    assert both.lower == pytest.approx(min(way.lower for way in ways))
    assert both.direction == ("forward" if ways[0].upper <= ways[1].upper else "backward")


def test_a_code_file_is_enough(tmp_path):
    code = ShutterCode("110100110")
    for path in (None, shake(2, 4.0), shake(1)):
        write_code(
            tmp_path / "code.json", StoredCode(code, certificate=certify(code, path).to_dict())
        )
        found = read_code(tmp_path / "code.json")
        assert verify(found.certificate, bits=found.code.bits).holds


# -- forgeries ------------------------------------------------------------------------------------

CHIPS = stored(certify(RASKAR))
NULL = stored(certify(PUBLISHED["merl-31-t62"]))
CROSSING = stored(certify(ShutterCode("1101011")))
CURVED_CODE = ShutterCode("110100110")
CURVED = stored(certify(CURVED_CODE, shake(2, 4.0)))
CURVED_NULL = stored(certify(RASKAR, shake(1)))


@pytest.mark.parametrize(("bits", "honest"), [(RASKAR.bits, CHIPS), (CURVED_CODE.bits, CURVED)])
def test_bounds_that_were_moved_are_refused(bits, honest):
    assert verify(honest, bits=bits).holds
    raised = verify(
        honest | {"lower": 1.01 * honest["lower"], "upper": 1.02 * honest["upper"]}, bits=bits
    )
    assert not raised.holds
    assert "below the lower bound" in raised.reasons[-1]
    lowered = verify(
        honest | {"lower": 0.98 * honest["lower"], "upper": 0.99 * honest["upper"]}, bits=bits
    )
    assert not lowered.holds
    assert "above the upper bound" in lowered.reasons[-1]
    assert not verify(honest | {"upper": 0.5 * honest["lower"]}, bits=bits).holds
    # a wider interval is a weaker claim, and true
    assert verify(
        honest | {"lower": 0.9 * honest["lower"], "upper": 1.1 * honest["upper"]}, bits=bits
    ).holds


@pytest.mark.parametrize(("bits", "honest"), [(RASKAR.bits, CHIPS), (CURVED_CODE.bits, CURVED)])
@pytest.mark.parametrize(
    "zero",
    [
        None,
        {"kind": "root of unity", "order": 2},
        {"kind": "root of unity", "order": 6},
        {"kind": "sign change", "factor": [1, 1], "radius": 1e-6},
        {"kind": "sign change", "factor": [1], "radius": 1e-6},
        {"kind": "closed form"},
        {"kind": "kantorovich", "alone_within": 0.01},
        {"kind": "kantorovich", "alone_within": 1e-4},
        {"kind": "because"},
    ],
)
def test_false_zeros_are_refused(bits, honest, zero):
    places = (
        ([0.5], [1 / 6], honest["at"]) if honest["unit"] == "chips" else ([0.1, 0.2], honest["at"])
    )
    for at in places:
        verdict = verify(honest | {"lower": 0.0, "upper": 0.0, "zero": zero, "at": at}, bits=bits)
        assert not verdict.holds


@pytest.mark.parametrize(
    ("bits", "honest", "change"),
    [
        (PUBLISHED["merl-31-t93"].bits, NULL, {"bits": PUBLISHED["merl-31-t93"].bits}),
        (PUBLISHED["merl-31-t62"].bits, NULL, {"at": [1 / 3]}),
        (PUBLISHED["merl-31-t62"].bits, NULL, {"at": [0.2]}),
        ("1101011", CROSSING, {"at": [0.25]}),
        ("1101011", CROSSING, {"zero": CROSSING["zero"] | {"factor": [1, 1, 0, 1, 0, 1, 2]}}),
        ("1101011", CROSSING, {"zero": CROSSING["zero"] | {"factor": [1, 0, 1]}}),
        (RASKAR.bits, CURVED_NULL, {"at": [CURVED_NULL["at"][0] + 0.003, CURVED_NULL["at"][1]]}),
        (RASKAR.bits, CURVED_NULL, {"at": [0.7, 0.1]}),
        (RASKAR.bits, CURVED_NULL, {"direction": "sideways"}),
        (RASKAR.bits, CURVED_NULL, {"directions": []}),
    ],
)
def test_zeros_that_were_moved_are_refused(bits, honest, change):
    assert not verify(honest | change, bits=bits).holds


def test_another_code_or_path_is_refused():
    assert not verify(CHIPS, bits=RASKAR.bits[::-1]).holds
    other = shake(4, 4.0)
    assert not verify(CURVED, bits=CURVED_CODE.bits, path=(other.t, other.xy)).holds
    bare = {name: value for name, value in CURVED.items() if name != "trajectory"}
    assert "trajectory" in verify(bare, bits=CURVED_CODE.bits).reasons[-1]
    same = shake(2, 4.0)
    assert verify(bare, bits=CURVED_CODE.bits, path=(same.t, same.xy)).holds


@pytest.mark.parametrize(
    "change",
    [
        {"unit": "metres"},
        {"lower": -1.0},
        {"lower": float("nan")},
        {"upper": float("inf")},
        {"upper": "much"},
        {"at": []},
        {"at": [None]},
        {"at": [0.1, 0.2]},
        {"lower": None},
    ],
)
def test_nonsense_is_refused(change):
    assert not verify(CHIPS | change, bits=RASKAR.bits).holds
    for missing in ("unit", "lower", "upper", "at"):
        assert not verify(
            {name: value for name, value in CHIPS.items() if name != missing}, bits=RASKAR.bits
        ).holds
    assert not verify(CHIPS, bits="").holds


def test_other_dwell_times_are_another_path():
    t = np.linspace(0, 1, 3)
    xy = np.array([[-4.0, 0.0], [0.0, 0.0], [4.0, 0.0]])
    even = Trajectory(t, xy, "known")
    certificate = stored(certify(CURVED_CODE, even))
    assert verify(certificate, bits=CURVED_CODE.bits, path=(t, xy)).holds
    assert not verify(certificate, bits=CURVED_CODE.bits, path=([0.0, 0.4, 1.0], xy)).holds


def test_each_direction_is_looked_at_in_full():
    """Forward the shutter sees a straight stretch, whose |H| depends on one frequency, and
    backward a bend."""
    straight = np.linspace(0, 8, 11)
    bend = 2 * np.linspace(0, 1, 11)[1:]
    xy = np.concatenate(
        [
            np.stack([straight, 0 * straight], axis=1),
            np.stack([8 + 4 * np.sin(bend), 5 * (1 - np.cos(bend))], axis=1),
        ]
    )
    path = Trajectory.from_samples(xy)
    code = ShutterCode("1101000000")
    honest = stored(certify(code, path))
    assert (honest["direction"], honest["upper"]) == ("backward", 0.0)
    one_way = stored(certify(code, replace(path, direction="known")))
    assert one_way["lower"] > 0.01
    assert verify(one_way, bits=code.bits).holds
    assert not verify(one_way | {"directions": list(BOTH)}, bits=code.bits).holds


@pytest.mark.parametrize("angle", [0.3, 0.64, 2.2, -0.9])
def test_an_oblique_path_of_changing_speed_is_confirmed(angle):
    """The lowest frequency along it may lie farther out than the band's sides: another on the same
    line is named."""
    along = 20 * np.linspace(0, 1, 40) ** 2
    path = Trajectory.from_samples(np.outer(along, [np.cos(angle), np.sin(angle)]))
    for bits in ("1" * 20, "1101000101"):
        certificate = confirmed(ShutterCode(bits), path)
        assert np.abs(certificate.at).max() <= 0.5


@pytest.mark.parametrize(
    "zero",
    [
        5,
        "root",
        {"kind": "root of unity", "order": 10**12 + 39},
        {"kind": "root of unity", "order": 1e400},
    ],
)
def test_a_proof_that_makes_no_sense_is_refused_at_once(zero):
    assert not verify(NULL | {"zero": zero}, bits=PUBLISHED["merl-31-t62"].bits).holds


def test_giving_up_is_no_confirmation():
    verdict = verify(CURVED, bits=CURVED_CODE.bits, budget=10)
    assert not verdict.holds
    assert "could not be confirmed" in verdict.reasons[-1]


@pytest.mark.parametrize("seed", range(20))
def test_nowhere_in_a_cell_is_the_modulus_below_its_bound(seed):
    """Large cells around random frequencies, sampled densely."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=(6, 2)) * 3
    path = Trajectory.from_samples(np.cumsum(steps, axis=0), direction="known")
    code = ShutterCode("".join(rng.choice(["0", "1"], 7)) + "1")
    lines = path_lines(code.bits, path.t, path.xy)
    half = np.full(2, float(rng.choice([0.002, 0.005, 0.01])))
    cells = rng.uniform(-0.5, 0.5, (40, 2))
    size, loss = lines.bound_cells(cells, half, np.array([True, True]))
    grid = np.stack(np.meshgrid(*2 * [np.linspace(-1, 1, 21)]), axis=-1).reshape(-1, 2) * half
    lowest = (
        np.abs(lines.look((cells[:, None] + grid).reshape(-1, 2))[0]).reshape(40, -1).min(axis=1)
    )
    assert (lowest >= size - loss - 1e-12).all()
