"""Number of chips where none is asked for: at most 52, as motion and shutter allow."""

import pytest

from cep.search.chip_count import (
    STANDARD_CHIPS,
    STANDARD_EXPOSURE_S,
    problem_of_standard_chips,
)
from cep.search.problem import SearchProblem
from hw.device import DeviceProfile
from motdiff.trajectory import Trajectory


def along(length_px, **options):
    return lambda chips: SearchProblem.along(
        Trajectory.straight(length_px), chips=chips, exposure_s=STANDARD_EXPOSURE_S, **options
    )


@pytest.mark.parametrize(
    ("length_px", "chips"), [(60.0, 52), (13.0, 52), (12.9, 32), (8.0, 32), (5.0, 16), (0.6, 2)]
)
def test_a_chip_covers_at_least_a_quarter_of_a_pixel(length_px, chips):
    problem = problem_of_standard_chips(along(length_px))
    assert problem.chips == chips
    assert problem.chips * problem.chip_ns == pytest.approx(STANDARD_EXPOSURE_S * 1e9)


@pytest.mark.parametrize("limit", [{"min_chip_ns": 2_000_000}, {"max_chips": 20}])
def test_a_shutter_that_cannot_play_more_gets_fewer_chips(limit):
    shutter = DeviceProfile(name="slow", **limit)
    assert problem_of_standard_chips(along(40.0, device=shutter)).chips == 16


def test_what_is_impossible_with_any_number_is_said_of_the_standard_one():
    with pytest.raises(ValueError, match=f"^chips: {STANDARD_CHIPS} chips are too many"):
        problem_of_standard_chips(along(0.4))
    with pytest.raises(ValueError, match=r"open.*32"):  # of so many chips the motion allows
        problem_of_standard_chips(along(8.0, open_range=(40, 40)))
    with pytest.raises(ValueError, match="stays in place"):
        problem_of_standard_chips(along(0.0))
