"""Results of estimators of the user's own: a PSF, a trajectory, a whole estimate, and what is none
of them."""

import numpy as np
import pytest

from motdiff.estimators.description import as_estimate
from motdiff.metrics import mnc
from motdiff.trajectory import Trajectory

PATH = Trajectory.from_samples([[0, 0], [9, 3], [14, 12]])


def test_a_psf_is_scaled_centred_and_traced():
    estimate = as_estimate(np.pad(3 * PATH.psf(31), ((2, 0), (0, 2))), "mine")
    assert (estimate.method, estimate.confidence, estimate.psf.shape) == ("mine", 0.0, (64, 64))
    assert mnc(estimate.psf, PATH.psf(64)) > 0.98
    assert estimate.best.length_px == pytest.approx(PATH.length_px, rel=0.1)


def test_a_trajectory_has_its_own_psf_and_an_estimate_stays():
    estimate = as_estimate(PATH, "mine")
    assert estimate.best is PATH
    np.testing.assert_array_equal(estimate.psf, PATH.psf(64))
    assert as_estimate(estimate, "another") is estimate


@pytest.mark.parametrize(
    ("found", "kind"),
    [
        (None, "NoneType"),
        ({"psf": 1}, "dict"),
        (np.zeros((9, 9)), "float64 of shape"),
        (np.ones(9), "float64 of shape"),
        (-np.ones((9, 9)), "float64 of shape"),
        (np.ones((9, 9)) + 0j, "complex128 of shape"),
        (np.full((9, 9), np.nan), "float64 of shape"),
    ],
)
def test_any_other_result_is_refused_by_its_kind(found, kind):
    with pytest.raises(ValueError, match=rf"^estimate\(photo\) must return a PSF .* got .*{kind}"):
        as_estimate(found, "mine")
