"""Motion in its order in time, from photos taken through known codes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from motdiff.estimators.method import Method, codes_option

if TYPE_CHECKING:
    from motdiff.estimators.coded.estimator import CodedEstimator

__all__ = ["Coded"]


@dataclass(frozen=True, kw_only=True)
class Coded(Method):
    """From photos of one motion through known codes."""

    name = "coded"
    about = "with --code"
    cites: ClassVar[tuple[str, ...]] = (
        "harikumar1999",
        "levenberg1944",
        "marquardt1963",
        "inokuchi1984",
    )
    smallest_px = 48  # of the search of each photo's kernel, by PMP

    codes: tuple[str, ...] = codes_option()

    def make(
        self, *, seed: int = 0, progress: Callable[[float], None] | None = None
    ) -> CodedEstimator:
        """Make the estimator."""
        from motdiff.estimators.coded.estimator import CodedEstimator

        return CodedEstimator(self.codes, seed=seed, progress=progress)

    def loading_shares(self) -> tuple[float, float, float]:
        """Shares of the estimate, whose search takes long."""
        return 0.02, 0.05, 0.06
