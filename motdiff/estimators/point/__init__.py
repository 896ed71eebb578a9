"""Motion from the streak of a point light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from motdiff.estimators.method import Method, codes_option

if TYPE_CHECKING:
    from motdiff.estimators.base import Estimator

__all__ = ["Point"]


@dataclass(frozen=True, kw_only=True)
class Point(Method):
    """From the trail of a small light, in its order in time where codes are given."""

    name = "point"
    about = "of a small light; with --code in its order in time"
    cites: ClassVar[tuple[str, ...]] = ("howie2017",)

    codes: tuple[str, ...] | None = codes_option(default=None)

    def make(self, *, seed: int = 0, progress: Callable[[float], None] | None = None) -> Estimator:
        """Make the estimator of an open photo, or of trails through codes."""
        if self.codes is None:
            from motdiff.estimators.point.estimator import PointEstimator

            return PointEstimator()
        from motdiff.estimators.coded.trail_estimator import TrailEstimator

        return TrailEstimator(self.codes, seed=seed, progress=progress)

    def loading_shares(self) -> tuple[float, float, float] | None:
        """Shares of the estimate through codes, whose search takes long."""
        if self.codes is None:
            return None
        return 0.02, 0.05, 0.06
