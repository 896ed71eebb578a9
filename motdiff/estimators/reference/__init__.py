"""Motion from a pair of photos: blurred and sharp, of the same scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from motdiff.estimators.method import Method, option

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from motdiff.estimators.reference.estimator import ReferenceEstimator

__all__ = ["Reference"]


@dataclass(frozen=True, kw_only=True)
class Reference(Method):
    """Beside a sharp photo of the scene."""

    name = "reference"
    about = "beside a sharp photo"

    sharp: ArrayLike = option(
        "photo",
        "A sharp photo of the same scene, needed; or a folder with one for each photo, by name.",
        flag="--sharp",
        metavar="PATH",
    )

    def make(
        self, *, seed: int = 0, progress: Callable[[float], None] | None = None
    ) -> ReferenceEstimator:
        """Make the estimator, which draws nothing at random."""
        del seed, progress
        from motdiff.estimators.reference.estimator import ReferenceEstimator

        return ReferenceEstimator(self.sharp)
