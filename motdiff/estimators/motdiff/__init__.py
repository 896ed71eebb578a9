"""MoTDiff: the kernel of a corrected search, and paths drawn for it by a diffusion model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from motdiff.estimators.method import Method

if TYPE_CHECKING:
    from motdiff.estimators.motdiff.estimator import MotDiffEstimator

__all__ = ["MotDiff"]


@dataclass(frozen=True, kw_only=True)
class MotDiff(Method):
    """Blind, by the diffusion model."""

    name = "motdiff"
    about = "blind, diffusion model"
    cites: ClassVar[tuple[str, ...]] = (
        "choi2025motdiff",
        "ho2020",
        "nichol2021",
        "song2021",
        "lin2024",
        "wang2022pvt",
        "wang2022ssformer",
        "wei2020",
        "wen2021pmp",
        "whittle1953",
        "immerkaer1996",
        "marziliano2002",
        "hu2012",
    )
    smallest_px = 64  # a PSF frame: the lag maps need as much
    is_blind = True

    def make(
        self, *, seed: int = 0, progress: Callable[[float], None] | None = None
    ) -> MotDiffEstimator:
        """Make the estimator; the seed is that of the drawn paths."""
        from motdiff.estimators.motdiff.estimator import MotDiffEstimator

        return MotDiffEstimator(seed=seed, progress=progress)

    def loading_shares(self) -> tuple[float, float, float]:
        """Shares of a photo's estimate: docs/decisions/code.md."""
        return 0.12, 0.28, 0.36

    def weight_files(self) -> tuple[Path, ...]:
        """Weights of the correction and of the drawn paths."""
        from motdiff.weights import CORRECTION_WEIGHTS, PATH_WEIGHTS

        return (CORRECTION_WEIGHTS, PATH_WEIGHTS)
