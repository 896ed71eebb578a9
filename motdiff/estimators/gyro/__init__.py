"""Motion from a gyroscope on the camera: path, dwell and direction are measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from motdiff.estimators.method import Method, option

if TYPE_CHECKING:
    from motdiff.estimators.gyro.estimator import GyroEstimator
    from motdiff.gyro import GyroTrace

__all__ = ["Gyro"]


@dataclass(frozen=True, kw_only=True)
class Gyro(Method):
    """From a gyroscope's recording."""

    name = "gyro"
    about = "from a recording"
    one_photo_as = "start_s is the opening of one photo"

    gyro: GyroTrace = option(
        "gyro", "Table of time and three rates (rad/s); needed.", flag="--gyro", metavar="FILE"
    )
    rate_unit: str | None = option(
        "text",
        "rad or deg, of the rates; as the header says when omitted, else rad.",
        flag="--gyro-unit",
        metavar="UNIT",
        default=None,
        choices=("rad", "deg"),
    )
    focal_px: float = option("number", "Focal length, px; needed.", flag="--focal", metavar="PX")
    start_s: float = option(
        "number",
        "Opening of the shutter on the recording's clock, s; needed.",
        flag="--start",
        metavar="S",
    )
    exposure_s: float = option(
        "duration",
        "Exposure time: 1/20, 0.05, 50ms or 500us; needed.",
        flag="--exposure",
        metavar="S",
    )
    axes: str | None = option(
        "text",
        "Directions of the recording's x, y and z axes, seen from behind the camera with the photo"
        " upright: right, left, up, down, forward or back. A phone held upright: right,up,back;"
        " sideways, its top to the left: up,left,back, to the right: down,right,back. Wrong axes"
        " mirror or turn the path.",
        flag="--gyro-axes",
        metavar="X,Y,Z",
        default=None,
        shown_default="right,down,forward, as a camera's",
    )

    def make(
        self, *, seed: int = 0, progress: Callable[[float], None] | None = None
    ) -> GyroEstimator:
        """Make the estimator, which draws nothing at random."""
        del seed, progress
        if self.rate_unit is not None:
            raise ValueError("rate_unit: is for a file; a recording that was read is in rad/s")
        from motdiff.estimators.gyro.estimator import GyroEstimator

        return GyroEstimator(
            self.gyro,
            focal_px=self.focal_px,
            start_s=self.start_s,
            exposure_s=self.exposure_s,
            axes=self.axes,
        )
