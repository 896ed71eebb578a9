"""Motion from a gyroscope on the camera: path, dwell and direction are measured."""

from __future__ import annotations

import math
from dataclasses import dataclass

from numpy.typing import ArrayLike

from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.gyro import Gyro
from motdiff.gyro import DEFAULT_AXES, GyroTrace, roll_rad, trajectory_from_gyro
from motdiff.photo_values import luminance
from motdiff.psf_frame import PSF_PX
from motdiff.trajectory import check_length

_ROLL_LIMIT_PX = 1.0
_TRUSTED_STEP_S = 0.01  # hands shake up to about 12 Hz; a slower recording misses part of it


@dataclass(frozen=True)
class GyroEstimator:
    """Integrate a gyroscope's rates over the exposure.

    Only the photo's size is used: the trajectory is that of
    :func:`motdiff.gyro.trajectory_from_gyro`, with known direction and dwell, and shares its
    assumptions (rotation only, small angles, one motion for the whole photo).

    ``confidence`` is 1 less the share of the motion that the trajectory cannot hold: displacement
    by roll at the photo's corner over the extent of the path, and the longest gap between readings
    over the exposure; an exposure with no reading inside has 0.

    Parameters
    ----------
    focal_px : float, px
        Focal length divided by the pixel pitch.
    start_s : float, seconds
        Opening of the shutter, on the trace's clock.
    exposure_s : float, seconds
    axes : str, optional
        Directions of the sensor's axes, as of :func:`motdiff.gyro.image_rates_rad_s`. When omitted
        they are taken as :data:`motdiff.gyro.DEFAULT_AXES`, with a warning: wrong axes give a
        mirrored or turned path.
    """

    trace: GyroTrace
    focal_px: float
    start_s: float
    exposure_s: float
    axes: str | None = None

    def estimate(self, photo: ArrayLike) -> MotionEstimate:
        """Return the motion during the exposure of ``photo``, (H, W) or (H, W, C).

        ValueError if the exposure does not lie within the trace, a parameter is not positive, or
        the path needs a frame larger than the photo, as that of rates in deg/s that were read as
        rad/s.
        """
        height, width = luminance(photo).shape
        window = {"start_s": self.start_s, "exposure_s": self.exposure_s}
        axes = DEFAULT_AXES if self.axes is None else self.axes
        trajectory = trajectory_from_gyro(self.trace, focal_px=self.focal_px, axes=axes, **window)
        needed = trajectory.frame_size()
        if needed > max(height, width):  # before anything of that size is made
            raise ValueError(
                f"rate_unit: the rates move the image by {trajectory.extent_px:.4g} px during the"
                f" exposure; the frame of {needed} px that this needs is larger than the photo"
                f" ({width} x {height} px): are they in deg/s (rate_unit='deg'), or is the focal"
                " length or the unit of the times another?"
            )
        check_length(trajectory)
        roll = roll_rad(self.trace, axes=axes, **window)
        corner_px = 0.5 * math.hypot(height, width)
        inside = (self.trace.t_s >= self.start_s) & (
            self.trace.t_s <= self.start_s + self.exposure_s
        )
        readings = int(inside.sum())
        step_s = 1 / self.trace.sample_rate_hz
        warnings = [*self.trace.warnings]
        if self.axes is None:  # a wrong guess shows nowhere else: the path looks just as likely
            warnings.append(
                f"axes: taken as {axes} (x, y, z as seen from behind the camera); other axes, as"
                " right,up,back of an upright phone, give a mirrored or turned path"
            )
        if roll * corner_px > _ROLL_LIMIT_PX:
            warnings.append(
                f"Roll about the optical axis moved the corners by {roll * corner_px:.1f} px; "
                "the trajectory leaves it out."
            )
        if readings < 2 or step_s > _TRUSTED_STEP_S:
            warnings.append(
                f"Only {readings} gyro readings during the exposure ({1 / step_s:.0f} Hz): faster"
                " shake is not seen."
            )
        frame = max(PSF_PX, needed)
        if frame > PSF_PX:
            warnings.append(
                f"The path needs a PSF frame of {frame} px, more than the usual {PSF_PX} px; if"
                " that is too long, the rates may be in deg/s."
            )
        # the motion by roll at a corner, which one path for the whole photo cannot hold
        lost = roll * corner_px / max(trajectory.extent_px + roll * corner_px, 1e-9)
        sampled = max(0.0, 1 - step_s / self.exposure_s) if readings else 0.0
        details: dict[str, object] = {
            "roll_rad": roll,
            "roll_at_corner_px": roll * corner_px,
            "readings": readings,
            "sample_rate_hz": 1 / step_s,
            "focal_px": self.focal_px,
            "start_s": self.start_s,
            "exposure_s": self.exposure_s,
            "axes": axes,
            "columns": self.trace.columns,
        }
        return MotionEstimate(
            Gyro.name,
            (trajectory,),
            (1.0,),
            trajectory.psf(frame),
            (1 - lost) * sampled,
            tuple(warnings),
            details,
        )
