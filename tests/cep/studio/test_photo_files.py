"""Files beside a photo of the studio: the motion comes back whole, previews are small enough."""

import cv2
import numpy as np
import pytest

from cep.studio.fields import FieldError
from cep.studio.photo_files import PREVIEW_PX, beside, read_motion, write_motion, write_preview
from motdiff.estimators.base import MotionEstimate
from motdiff.trajectory import Trajectory

PATH = Trajectory.from_samples(
    [(0.0, 0.0), (5.0, 1.0), (7.0, 6.0)], t=[0.0, 0.2, 1.0], direction="known"
)


@pytest.mark.parametrize(
    "details", [{"psf_confidence": 0.4, "motion_blur": True, "seed": 3}, {"seed": 3}]
)
def test_a_motion_comes_back_with_what_restoring_needs(tmp_path, details):
    photo = tmp_path / "photo.tif"
    motion = MotionEstimate(
        "motdiff",
        (PATH,),
        (1.0,),
        PATH.psf(15),
        confidence=0.7,
        warnings=("The sky is flat.",),
        psf_warnings=(),
        details=details,
    )
    write_motion(photo, motion)
    stored = read_motion(photo)
    np.testing.assert_array_equal(stored.psf, motion.psf)
    np.testing.assert_allclose(stored.best.xy, PATH.xy, atol=1e-12)
    np.testing.assert_array_equal(stored.best.t, PATH.t)
    assert stored.best.direction == "known"
    assert (stored.confidence, stored.warnings, stored.psf_warnings) == (
        0.7,
        ("The sky is flat.",),
        (),
    )
    assert stored.details == {name: value for name, value in details.items() if name != "seed"}
    # another photo of the folder has none
    with pytest.raises(FieldError, match="its motion has not been found yet"):
        read_motion(photo.with_stem("other"))


@pytest.mark.parametrize(("side_px", "step"), [(PREVIEW_PX, 1), (PREVIEW_PX + 1, 2), (40, 1)])
def test_a_preview_has_every_nth_pixel(tmp_path, side_px, step):
    photo = tmp_path / "photo.tif"
    write_preview(photo, "sharp", np.full((24, side_px), 0.5))
    preview = cv2.imread(str(beside(photo, "sharp.jpg")), cv2.IMREAD_GRAYSCALE)
    assert preview.shape == (-(-24 // step), -(-side_px // step))
    assert max(preview.shape) <= PREVIEW_PX
