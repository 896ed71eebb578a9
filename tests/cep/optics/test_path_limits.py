"""Paths that are too long, too wide or too dense are refused before any work, through every verb
that takes one."""

import numpy as np
import pytest

import cep
from cep.optics.path_limits import LARGEST_FRAME_PX, MOST_SAMPLES, check_frame, check_resolved
from motdiff.trajectory import LONGEST_PX, Trajectory

CODE = cep.ShutterCode("101100111000")


def wave(samples, *, width_px):
    t = np.linspace(0, 1, samples)
    return Trajectory.from_samples(np.column_stack([width_px * t, 2 * np.sin(9 * t)]), t=t)


@pytest.mark.parametrize("length_px", [300.0, 3000.0, LONGEST_PX])
def test_straight_motions_of_thousands_of_px_are_measured(length_px):
    path = Trajectory.straight(length_px, angle_rad=0.3)
    check_frame(path)
    assert cep.audit(CODE, path, flips=0).metrics.min_mtf == pytest.approx(
        0, abs=1e-9
    )  # a chip's own zero


def test_an_accelerated_straight_motion_may_be_as_long():
    t = np.linspace(0, 1, 30)
    check_frame(Trajectory.from_samples(np.column_stack([4000 * t**2, 0 * t]), t=t))


@pytest.mark.parametrize(
    ("path", "words"),
    [
        (Trajectory.straight(LONGEST_PX + 1), "is 4097 px long, at most 4096 px can be handled"),
        (Trajectory.straight(200_000), "is 200000 px long, at most 4096 px can be handled"),
        (wave(20, width_px=LARGEST_FRAME_PX + 9), "needs a PSF of .* px around its zero"),
        (
            wave(MOST_SAMPLES + 1, width_px=30),
            "has 20001 samples, at most 20000 of such a path can be measured",
        ),
        (wave(900, width_px=900), "has 900 samples, at most .* of such a path can be measured"),
    ],
)
def test_others_are_refused_by_the_verbs(path, words):
    problem = cep.SearchProblem.along(path, chips=12)
    for call in (
        lambda: cep.optimize(problem, steps=10),
        lambda: cep.advise(problem),
        lambda: cep.audit(CODE, path),
    ):
        with pytest.raises(ValueError, match=words):
            call()


def test_a_chip_covers_a_quarter_of_a_pixel_or_more():
    path = Trajectory.straight(6.0)
    check_resolved(path, 24)
    with pytest.raises(ValueError, match=r"25 chips are too many .* at most 24 can be resolved"):
        check_resolved(path, 25)
    at_rest = Trajectory.straight(0.0)
    check_resolved(at_rest, 1)  # an open shutter needs no motion
    with pytest.raises(ValueError, match=r"stays in place, .* needs a motion of at least 0\.5 px"):
        check_resolved(at_rest, 2)
