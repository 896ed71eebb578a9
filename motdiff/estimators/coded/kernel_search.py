"""Search for a path that explains the kernels of coded photos, where these show no one scene."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from torch import Tensor

from motdiff.estimators.coded.candidates import CandidatePath, Evolution
from motdiff.estimators.coded.exposures import Exposures
from motdiff.estimators.coded.fit import KNOTS, PhotoFit
from motdiff.estimators.coded.misfit import Term, descend
from motdiff.estimators.coded.starts import (
    crossed,
    decoded_paths,
    loop_reversals,
    orders,
    random_walks,
)
from motdiff.types import FloatArray

_DECODED = 64  # starting paths of each kind
_ORDERS = 48
_WALKS = 48
_APART_PX = 0.3  # nearer candidates are one
_EVOLUTION = Evolution(rounds=6, patience=2, improved=0.98, population=8, apart_px=_APART_PX)
_CHILDREN_FITTED = 10
_PARENTS = 4  # of the population, crossed with all


class KernelSearch(PhotoFit):
    """Search of a path that explains the photos' kernels."""

    apart_px = _APART_PX

    def __init__(
        self, exposures: Exposures, rng: np.random.Generator, *, spend: Callable[[float], None]
    ) -> None:
        from motdiff.psf_frame import without_faint_parts
        from motdiff.tracing import simplest_trajectory

        super().__init__(exposures, ())
        self.rng = rng
        self.spend = spend
        self.traced = simplest_trajectory(without_faint_parts(exposures.kernels[0]))
        self.length_px = float(np.clip(self.traced.length_px, 8, 90))
        self.coarse_kernels = {sigma_px: self.kernels(sigma_px) for sigma_px in (4.0, 2.5, 1.5)}
        self.sharpest = self.kernels(1.0, saturated=True)

    def run(self) -> list[CandidatePath]:
        """Paths that explain the kernels, best first."""
        terms: list[Term] = [self.sharpest, self.kernel_roughness]
        x, costs = self.best(terms, self._starts(), steps=6, keep=_EVOLUTION.population)
        self.spend(0.25)
        x, costs = _EVOLUTION.run(
            self.unknowns,
            x,
            costs,
            changed=lambda parents: self._changed(terms, parents),
            spend=lambda share: self.spend(0.5 * share),
        )
        x, costs = self.best(terms, x[:3], steps=20, keep=3)
        self.spend(0.25)
        return self.described(terms, x, costs)

    def _starts(self) -> Tensor:
        """Candidates from all kinds of starts, fitted coarse to fine."""
        starts = [
            self._decoded(_DECODED),
            orders(self.traced, knots=KNOTS, count=_ORDERS),
            random_walks(self.rng, KNOTS, np.full(_WALKS, self.length_px)),
        ]
        x = self.pack(np.concatenate(starts))
        for term, keep in zip(self.coarse_kernels.values(), (48, 24, 10), strict=True):
            x, _ = self.best([term, self.kernel_roughness], x, steps=8, keep=keep)
        return x

    def _decoded(self, count: int, shifts: FloatArray | None = None) -> FloatArray:
        return decoded_paths(
            self.exposures.kernels,
            self.exposures.codes,
            knots=KNOTS,
            count=count,
            length_px=self.length_px,
            rng=self.rng,
            shifts=shifts,
        )

    def _changed(self, terms: Sequence[Term], x: Tensor) -> tuple[Tensor, Tensor]:
        """Children of candidates, fitted coarse to fine, and their costs."""
        new = self.pack(np.stack(self._children(x)))
        new, _ = descend([self.coarse_kernels[2.5], self.kernel_roughness], new, steps=3)
        new, _ = self.best(
            [self.coarse_kernels[1.5], self.kernel_roughness], new, steps=4, keep=_CHILDREN_FITTED
        )
        return descend(terms, new, steps=5)

    def _children(self, x: Tensor) -> list[FloatArray]:
        """Cross the best with each other and decoded paths, and reverse loops."""
        shifts = self.unknowns.kernel_shifts(x)
        paths = self.paths(x) + shifts[:, :1].numpy()  # all aligned with the first kernel
        children = []
        for i, path in enumerate(paths[:_PARENTS]):
            partners = [*paths[:i], *paths[i + 1 :]]
            if i < 2:
                partners += list(self._decoded(12, shifts[i].numpy().astype(np.float64)))
            children += loop_reversals(path, count=4 if i < 2 else 2, rng=self.rng)
            crossings = (crossed(path, partner, rng=self.rng) for partner in partners)
            children += [child for child in crossings if child is not None]
        return children
