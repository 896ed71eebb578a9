"""Blind estimation with the patch-wise minimal pixels prior (PMP)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from motdiff.estimators.method import Method

if TYPE_CHECKING:
    from motdiff.estimators.pmp.estimator import PmpEstimator

__all__ = ["Pmp"]


@dataclass(frozen=True, kw_only=True)
class Pmp(Method):
    """Blind, by a classical search."""

    name = "pmp"
    about = "blind, classical"
    cites: ClassVar[tuple[str, ...]] = (
        "wen2021pmp",
        "xu2013",
        "cho2009",
        "beck2009",
        "liu2008",
        "hu2012",
    )
    smallest_px = 48  # as motdiff.photo_values.LEAST_PX, which loads numpy
    is_blind = True

    def make(
        self, *, seed: int = 0, progress: Callable[[float], None] | None = None
    ) -> PmpEstimator:
        """Make the estimator; the seed is that of the drawn paths."""
        from motdiff.estimators.pmp.estimator import PmpEstimator

        return PmpEstimator(seed=seed, progress=progress)

    def loading_shares(self) -> tuple[float, float, float]:
        """Shares of a photo's estimate: docs/decisions/code.md."""
        return 0.12, 0.26, 0.32
