"""Tracing: what was drawn comes back in order, and the time spent along it is found."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lab.evaluation.map_tracing import trace_map
from lab.evaluation.metrics import ordered_distance_px
from motdiff.metrics import mnc_subpixel
from motdiff.tracing import path
from motdiff.tracing.dwell import fit_dwell
from motdiff.tracing.graph import Branch, BranchGraph
from motdiff.tracing.path import smoothest_trail, trace_psf, trace_psf_to_trajectory
from motdiff.trajectory import Trajectory

HR_PX = 0.25
TURN = 2 * np.pi


def line(start, end, samples=200):
    return np.linspace(start, end, samples)


def rotated(points, angle_rad):
    c = np.cos(angle_rad)
    s = np.sin(angle_rad)
    return np.asarray(points) @ np.array([[c, s], [-s, c]])


def figure_eight(size_px=10.0):
    t = np.linspace(0.05, 0.95, 600) * TURN
    return np.column_stack([size_px * np.sin(t), 0.6 * size_px * np.sin(2 * t)])


def spiral():
    t = np.linspace(0, 1, 800)
    return (2 + 9 * t)[:, None] * np.column_stack([np.cos(2.5 * TURN * t), np.sin(2.5 * TURN * t)])


def loop_crossing_itself(crossing_rad):
    """Two straight legs that cross at the origin at ``crossing_rad``, joined by a loop."""
    legs = (
        rotated([[-12.0, 0.0], [12.0, 0.0]], -crossing_rad / 2),
        rotated([[12.0, 0.0], [-12.0, 0.0]], crossing_rad / 2),
    )
    # an arc that leaves one leg and meets the other along their own directions
    radius = 12 * np.tan(crossing_rad / 2)
    centre = np.array([12 / np.cos(crossing_rad / 2), 0.0])
    half = np.pi / 2 + crossing_rad / 2
    turn = np.linspace(-half, half, 400)
    arc = centre + radius * np.column_stack([np.cos(turn), np.sin(turn)])
    return np.concatenate([line(*legs[0]), arc, line(*legs[1])])


SHAPES = {
    "straight": line((-8, -3), (9, 5)),
    "L": np.concatenate([line((-8, -8), (-8, 8)), line((-8, 8), (8, 8))[1:]]),
    "figure eight": figure_eight(),
    "spiral": spiral(),
    "T: an end that touches the path": np.concatenate(
        [
            line((-10, 0), (8, 0)),
            4
            * np.column_stack([2 + np.sin(a := np.linspace(0, 1.5 * np.pi, 300)), 1 - np.cos(a)])[
                1:
            ],
        ]
    ),
}


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("angle_rad", [0.0, 0.5, 2.0])
def test_shapes_come_back_in_order(name, angle_rad):
    truth = Trajectory.from_samples(rotated(SHAPES[name], angle_rad))
    path = trace_map(truth.hr_map())
    assert ordered_distance_px(path, truth.xy) < 0.75 * HR_PX
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() < 2 * HR_PX


def test_a_closed_loop_is_run_once_all_round():
    angles = np.linspace(0, TURN, 500)
    truth = Trajectory.from_samples(9 * np.column_stack([np.cos(angles), np.sin(angles)]))
    path = trace_map(truth.hr_map())
    np.testing.assert_allclose(np.linalg.norm(path, axis=1), 9, atol=2 * HR_PX)
    length_px = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    assert length_px == pytest.approx(TURN * 9, rel=0.06)


@settings(max_examples=25, deadline=None)
@given(crossing_rad=st.floats(np.radians(35), np.radians(110)), angle_rad=st.floats(0, TURN))
def test_crossings_are_passed_straight_at_any_angle(crossing_rad, angle_rad):
    truth = Trajectory.from_samples(rotated(loop_crossing_itself(crossing_rad), angle_rad))
    scale = min(1.0, 28 / np.abs(truth.xy).max())
    truth = truth.scaled(scale)
    assert ordered_distance_px(trace_map(truth.hr_map()), truth.xy) < HR_PX


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_order_of_the_samples_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    steps = np.cumsum(rng.normal(0, 0.12, 300)) + rng.uniform(0, TURN)
    truth = Trajectory.from_samples(
        0.12 * np.cumsum(np.column_stack([np.cos(steps), np.sin(steps)]), axis=0)
    )
    there = trace_map(truth.hr_map())
    back = trace_map(truth.reversed().hr_map())
    # the two drawings may differ in single pixels, since rounding and thinning run the other way
    distances = [min(np.linalg.norm(b - p) for p in there) for b in back]
    assert np.mean(distances) < HR_PX


@pytest.mark.parametrize("angle_rad", [0.0, 0.7, 1.9])
def test_a_reversal_that_runs_its_own_pixels_again_is_followed(angle_rad):
    corners = [
        (-10, 0),
        (6, 0),
        (0, 0),
        (0, 10),
    ]  # the camera shoots over, comes back, and leaves sideways
    legs = [line(*pair) for pair in itertools.pairwise(corners)]
    truth = Trajectory.from_samples(
        rotated(np.concatenate([legs[0], *(leg[1:] for leg in legs[1:])]), angle_rad)
    )
    assert ordered_distance_px(trace_map(truth.hr_map()), truth.xy) < 0.75 * HR_PX


def test_gaps_are_bridged_and_dust_is_dropped():
    truth = Trajectory.from_samples(SHAPES["straight"])
    hr = truth.hr_map()
    columns = np.flatnonzero(hr.any(axis=0))
    hr[:, columns[30:33]] = 0
    hr[10, 10:12] = 1
    assert ordered_distance_px(trace_map(hr), truth.xy) < HR_PX


def test_dwell_of_a_two_speed_line_is_found():
    t = np.array([0.0, 0.75, 1.0])
    truth = Trajectory.from_samples(np.array([[-10.0, 0.3], [0.0, 0.3], [10.0, 0.3]]), t=t)
    found = fit_dwell(line((-10, 0), (10, 0)), truth.psf(64))
    if found.x[0] > found.x[-1]:
        found = found.reversed()
    middle = truth.at(0.75)[0]
    assert np.interp(middle, found.x, found.t) == pytest.approx(0.75, abs=0.01)
    assert mnc_subpixel(found.psf(64), truth.psf(64)) > 0.995


def test_dwell_fit_finds_a_global_shift():
    truth = Trajectory.from_samples(figure_eight())
    found = fit_dwell(truth.xy + np.array([0.45, -0.3]), truth.psf(64))
    assert mnc_subpixel(found.psf(64), truth.psf(64)) > 0.99
    assert ordered_distance_px(found.xy, truth.xy) < 0.15


@pytest.mark.parametrize("shape", [(64, 64), (41, 35), (64, 33)])
def test_frames_of_any_shape(shape):
    truth = Trajectory.from_samples(figure_eight(), t=np.linspace(0, 1, 600) ** 1.5)
    whole = truth.psf(65)
    rows, columns = (slice(32 - n // 2, 32 - n // 2 + n) for n in shape)
    found = trace_psf_to_trajectory(whole[rows, columns])
    assert mnc_subpixel(found.psf(65), whole) > 0.97
    assert ordered_distance_px(found.xy, truth.xy) < 0.5


def test_a_large_frame_gives_what_a_small_one_gives():
    truth = Trajectory.from_samples(figure_eight())
    small, large = (fit_dwell(truth.xy, truth.psf(size)) for size in (41, 201))
    np.testing.assert_allclose(small.t, large.t, atol=1e-9)


def test_a_noisy_psf_is_traced():
    truth = Trajectory.from_samples(rotated(figure_eight(), 0.4))
    psf = truth.psf(64)
    noisy = np.maximum(psf + np.random.default_rng(1).normal(0, 0.05 * psf.max(), psf.shape), 0)
    assert ordered_distance_px(trace_psf(noisy), truth.xy) < 0.5
    assert mnc_subpixel(trace_psf_to_trajectory(noisy).psf(96), psf) > 0.95


def test_map_and_dwell_beat_the_bare_map():
    t = np.linspace(0, 1, 600)
    truth = Trajectory.from_samples(figure_eight(), t=t + 0.12 * np.sin(3 * TURN / 2 * t) ** 2 * t)
    hr = truth.hr_map()
    psf = truth.psf(64)
    fitted = mnc_subpixel(fit_dwell(trace_map(hr), psf).psf(64), psf)
    assert fitted > mnc_subpixel(hr.reshape(64, 4, 64, 4).mean(axis=(1, 3)), psf)
    assert fitted > 0.98


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    kind=st.sampled_from(["delta", "blob", "noise", "corner", "bar", "flat", "speckle"]),
)
def test_any_psf_with_light_gives_a_trajectory(seed, kind):
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(1, 30, 2))
    psf = np.zeros(shape)
    y, x = np.indices(shape)
    if kind == "delta":
        psf[rng.integers(shape[0]), rng.integers(shape[1])] = 1e-7
    elif kind == "blob":
        psf = np.exp(-((x - shape[1] / 2) ** 2 + (y - shape[0] / 2) ** 2) / 18)
    elif kind == "noise":
        psf = rng.random(shape) + 1e-3
    elif kind == "corner":
        psf[0, 0] = psf[-1, -1] = 1e6
    elif kind == "bar":
        psf[shape[0] // 2] = 1
    elif kind == "flat":
        psf += 1
    else:
        psf[rng.random(shape) < 0.2] = 1
        psf[0, 0] = 1
    found = trace_psf_to_trajectory(psf)
    assert np.isfinite(found.xy).all()
    assert found.direction == "unknown"
    assert found.extent_px <= max(shape) + 4


def test_a_delta_is_a_tiny_path_at_its_place():
    psf = np.zeros((31, 31))
    psf[15, 18] = 1
    np.testing.assert_allclose(trace_psf(psf).mean(axis=0), [3, 0], atol=0.3)
    found = trace_psf_to_trajectory(psf)
    assert found.extent_px < 1.5
    assert mnc_subpixel(found.psf(31), psf) > 0.95


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: trace_psf(np.zeros((9, 9))), "psf: must be"),
        (lambda: trace_psf(np.ones(9)), "psf: must be"),
        (lambda: trace_psf_to_trajectory(-np.ones((9, 9))), "psf: must be"),
        (lambda: fit_dwell(np.zeros((0, 2)), np.ones((9, 9))), "path_px: must be"),
        (lambda: fit_dwell(np.zeros((3, 3)), np.ones((9, 9))), "path_px: must be"),
        (lambda: fit_dwell([[0, np.inf]], np.ones((9, 9))), "path_px: must be"),
    ],
)
def test_bad_input_is_one_clear_line(call, message):
    with pytest.raises(ValueError, match=f"^{message}") as caught:
        call()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("share", "covered"), [(0.2, False), (1.0, True)])
def test_a_faint_line_across_is_left_out_and_a_bright_one_is_walked(share, covered):
    """What has a fifth of the light per pixel in a blind kernel is more likely noise than
    motion."""
    along, across = (
        Trajectory.straight(length, angle_rad=angle)
        for length, angle in ((24.0, 0.0), (8.0, np.pi / 2))
    )
    path = Trajectory.from_samples(trace_psf(along.psf(41) + share * across.psf(41) * 8 / 24))
    assert (np.ptp(path.xy[:, 1]) > 6) == covered
    assert path.length_px > 24 + 2 * 8 if covered else path.length_px == pytest.approx(25, abs=3)


def test_a_line_is_worth_the_square_of_its_light_over_the_median_and_never_more_than_one():
    light = np.zeros((61, 61))
    light[10:21], light[25:36], light[40:51] = (
        1.0,
        3.0,
        0.5,
    )  # strips, each wider than what the light is smoothed by
    rows = 4 * (np.array([15.0, 30.0, 45.0]) + path._MARGIN_PX)
    columns = 4 * (np.arange(15.0, 46.0) + path._MARGIN_PX)
    lines = [
        Branch(np.c_[columns, np.full_like(columns, row)], (2 * i, 2 * i + 1))
        for i, row in enumerate(rows)
    ]
    graph = path._with_weights(
        BranchGraph(np.concatenate([line.points[[0, -1]] for line in lines]), tuple(lines)), light
    )
    assert [line.weight for line in graph.branches] == pytest.approx([1.0, 1.0, 0.25], abs=0.01)


@pytest.mark.parametrize(
    ("extra_px", "weight", "passes"), [(0.0, 1.0, 1), (60.0, 1.0, 2), (60.0, 0.03, 0)]
)
def test_the_mark_of_two_strands_counts_as_much_as_their_line(extra_px, weight, passes):
    """A straight line of 60 px with one of 30 px that leaves it in the middle, drawn wide enough
    for two strands."""
    legs = [line((0, 0), (30, 0), 31), line((30, 0), (60, 0), 31), line((30, 0), (30, 30), 31)]
    ends = [(0, 1), (1, 2), (1, 3)]
    branches = [Branch(points, end) for points, end in zip(legs[:2], ends[:2], strict=True)]
    branches.append(Branch(legs[2], ends[2], extra_px=extra_px, weight=weight))
    trail = smoothest_trail(
        BranchGraph(np.array([[0.0, 0.0], [30, 0], [60, 0], [30, 30]]), tuple(branches))
    )
    upright = np.abs(np.diff(trail[:, 1])).sum()
    assert upright == pytest.approx(30 * passes)
