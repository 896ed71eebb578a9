"""Fit of candidate paths to coded photos stage by stage, and search beside kernels alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from motdiff.estimators.coded.candidates import (
    SAME_PX,
    CandidatePath,
    Evolution,
    candidate_paths,
    distinct,
)
from motdiff.estimators.coded.exposures import Exposures
from motdiff.estimators.coded.misfit import (
    KernelTerm,
    Roughness,
    SmoothMotion,
    Term,
    Unknowns,
    descend,
)
from motdiff.estimators.coded.otfs import CodedOtfs
from motdiff.estimators.coded.scene_term import SceneSpectra, SceneTerm
from motdiff.estimators.coded.starts import (
    crossed,
    decoded_paths,
    loop_reversals,
    orders,
    random_walks,
)
from motdiff.psf_frame import centroid_px, without_faint_parts
from motdiff.tracing.quadratic import simplest_trajectory
from motdiff.types import FloatArray

KNOTS = 53
"""Of a path that is fitted finely."""
_KERNEL_ROUGHNESS = 0.3
_SATURATION = 60.0  # a fifth of what a sure kernel costs that is off by all of itself
# of the search of kernels: starting paths of each kind
_DECODED = 64
_ORDERS = 48
_WALKS = 48
_APART_PX = 0.3  # nearer candidates are one
_EVOLUTION = Evolution(rounds=6, patience=2, improved=0.98, population=8, apart_px=_APART_PX)
_CHILDREN_FITTED = 10
_PARENTS = 4  # of the population, crossed with all


class Stage(NamedTuple):
    """How finely a path is fitted to photos.

    Attributes
    ----------
    grid : int
        Of the spectra, coarse to fine.
    path_error_px : float
        Error of the path that is allowed for.
    roughness : float, optional
        Weight of the path's second differences; None, their scale is unknown.
    """

    grid: int
    path_error_px: float
    roughness: float | None


# To 0.08 cycles/px photos tell a path so little that it may drift 1.6 px from the true one. Loose,
# it comes from far away; stiff, a smooth one stays smooth.
LOOSE = Stage(0, 1.0, 0.3)
STIFF = Stage(0, 1.0, 300.0)
MIDDLE = Stage(1, 0.3, 30.0)
NEAR = Stage(2, 0.3, 30.0)
FINEST = Stage(2, 0.04, None)
"""By which paths are judged; its error is that of straight pieces between knots."""

Schedule = tuple[tuple[Stage, int, int], ...]
"""Stages of a fit with steps of descent and candidates that are kept."""


class PhotoFit:
    """Terms for paths of so many knots.

    Parameters
    ----------
    spectra : sequence of SceneSpectra
        As :meth:`Exposures.spectra` returns them.

    Attributes
    ----------
    kernel_roughness : Roughness
        Beside kernels.
    apart_px : float
        Candidates nearer to a better one are dropped.
    """

    apart_px = SAME_PX

    def __init__(
        self, exposures: Exposures, spectra: Sequence[SceneSpectra], *, knots: int = KNOTS
    ) -> None:
        self.exposures = exposures
        self.knots = knots
        self.unknowns = Unknowns(knots, len(exposures.codes))
        self.kernel_roughness = Roughness(self.unknowns, _KERNEL_ROUGHNESS)
        self._otfs = CodedOtfs(exposures.codes, knots)
        self._centroids = torch.tensor(
            np.array([centroid_px(kernel)[::-1] for kernel in exposures.kernels]),
            dtype=torch.float32,
        )
        self._spectra = spectra
        self._terms: dict[Stage, tuple[SceneTerm, Term]] = {}

    @property
    def has_scene(self) -> bool:
        """Whether the photos are compared, not their kernels alone."""
        return bool(self._spectra)

    def beside_photos(self, stage: Stage) -> tuple[SceneTerm, Term]:
        """Terms of the photos, and of the path's roughness."""
        if stage not in self._terms:
            scene = SceneTerm(
                self.unknowns,
                self._otfs,
                self._spectra[stage.grid],
                path_error_px=stage.path_error_px,
            )
            smooth = (
                SmoothMotion(self.unknowns)
                if stage.roughness is None
                else Roughness(self.unknowns, stage.roughness)
            )
            self._terms[stage] = scene, smooth
        return self._terms[stage]

    def kernels(self, sigma_px: float, *, saturated: bool = False) -> KernelTerm:
        """Term of the kernels through a Gaussian; saturated, a wrong kernel costs little."""
        return KernelTerm(
            self.unknowns,
            self._otfs,
            self.exposures.kernels,
            sigma_px=sigma_px,
            weights=self.exposures.weights,
            saturation=_SATURATION if saturated else None,
        )

    def pack(self, paths: FloatArray) -> Tensor:
        """Candidates of paths (B, K, 2), centred, whose PSFs share the kernels' centroids."""
        centred = torch.tensor(paths - paths.mean(axis=1, keepdims=True), dtype=torch.float32)
        shifts = self._centroids - self._otfs.centroids(centred)
        gains = torch.tensor(np.tile(self.exposures.gains, (len(paths), 1)), dtype=torch.float32)
        return self.unknowns.pack(centred, gains, shifts)

    def registered(self, paths: FloatArray) -> Tensor:
        """Candidates of paths, photos of one scene shifted as their correlation says."""
        x = self.pack(paths)
        return self.beside_photos(MIDDLE)[0].registered(x) if self.has_scene else x

    def misfit(self, x: Tensor) -> float:
        """Misfit by a candidate (1, N), as a multiple of the noise; NaN without a scene."""
        if not self.has_scene:
            return float("nan")
        scene = self.beside_photos(FINEST)[0]
        return float(scene.cost(x)) / scene.values

    def paths(self, x: Tensor) -> FloatArray:
        """Paths (B, K, 2) of candidates."""
        return self.unknowns.paths(x).numpy().astype(np.float64)

    def fitted(self, x: Tensor, schedule: Schedule) -> tuple[Tensor, Tensor]:
        """Candidates fitted to the photos stage by stage, the best of them, and their costs."""
        for stage, steps, keep in schedule:
            x, costs = self.best(self.beside_photos(stage), x, steps=steps, keep=keep)
        return x, costs

    def best(
        self, terms: Sequence[Term], x: Tensor, *, steps: int, keep: int
    ) -> tuple[Tensor, Tensor]:
        """Candidates after some steps of descent, the best of them."""
        x, costs = descend(terms, x, steps=steps)
        return distinct(self.unknowns, x, costs, keep=keep, apart_px=self.apart_px)

    def described(self, terms: Sequence[Term], x: Tensor, costs: Tensor) -> list[CandidatePath]:
        """Candidates (B, N) with their misfit and the expected errors of their knots."""
        return candidate_paths(
            self.unknowns, terms, x, costs, misfit=self.misfit, variance_share=0.5
        )


class KernelSearch(PhotoFit):
    """Search of a path that explains the photos' kernels."""

    apart_px = _APART_PX

    def __init__(
        self, exposures: Exposures, rng: np.random.Generator, *, spend: Callable[[float], None]
    ) -> None:
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
