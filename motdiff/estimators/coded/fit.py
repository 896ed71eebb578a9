"""Fit of candidate paths to coded photos: its terms, and the candidates' registration."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from motdiff.estimators.coded.candidates import distinct
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
from motdiff.psf_frame import centroid_px
from motdiff.types import FloatArray

KNOTS = 53
"""Of a path that is fitted finely."""
# allowed on the three grids; the last is the error of straight pieces between knots
_PATH_ERRORS_PX = (1.0, 0.3, 0.04)
_LOOSE = 0.3  # roughness beside kernels, beside photos: second differences of 0.2 px
_STIFF = 30.0
_SATURATION = 60.0  # a fifth of what a sure kernel costs that is off by all of itself


class PhotoFit:
    """Terms for paths of so many knots.

    Parameters
    ----------
    spectra : sequence of SceneSpectra
        As :meth:`Exposures.spectra` returns them.

    Attributes
    ----------
    scenes : list of SceneTerm
        On three grids, coarse to fine; empty where only kernels are compared.
    loose, stiff : Roughness
        Beside kernels and coarse grids, and beside the photos.
    """

    def __init__(
        self, exposures: Exposures, spectra: Sequence[SceneSpectra], *, knots: int = KNOTS
    ) -> None:
        self.exposures = exposures
        self.knots = knots
        self.unknowns = Unknowns(knots, len(exposures.codes))
        self.loose = Roughness(self.unknowns, _LOOSE)
        self.stiff = Roughness(self.unknowns, _STIFF)
        self._otfs = CodedOtfs(exposures.codes, knots)
        self._centroids = torch.tensor(
            np.array([centroid_px(kernel)[::-1] for kernel in exposures.kernels]),
            dtype=torch.float32,
        )
        self.scenes = [
            SceneTerm(self.unknowns, self._otfs, on_grid, path_error_px=error_px)
            for on_grid, error_px in zip(spectra, _PATH_ERRORS_PX, strict=False)
        ]

    @cached_property
    def nearly(self) -> list[Term]:
        """The photos on the finest grid, for a path that is off by some 0.3 px."""
        scene = SceneTerm(
            self.unknowns,
            self._otfs,
            self.scenes[-1].spectra,
            path_error_px=_PATH_ERRORS_PX[1],
        )
        return [scene, self.stiff]

    @cached_property
    def finest(self) -> list[Term]:
        """By which paths are judged: the photos on the finest grid, and their smoothness."""
        return [self.scenes[-1], SmoothMotion(self.unknowns)]

    def beside_photos(self, grid: int) -> list[Term]:
        """Terms of the photos alone on one of the three grids; the coarsest leaves paths loose."""
        return [self.scenes[grid], self.loose if grid == 0 else self.stiff]

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

    def registered(self, x: Tensor) -> Tensor:
        """Candidates with the photos' shifts by correlation, where these are of one scene."""
        return self.scenes[0].registered(x) if self.scenes else x

    def misfit(self, x: Tensor) -> float:
        """Misfit by a candidate (1, N), as a multiple of the noise; NaN without a scene."""
        if not self.scenes:
            return float("nan")
        return float(self.scenes[-1].cost(x)) / self.scenes[-1].values

    def paths(self, x: Tensor) -> FloatArray:
        """Paths (B, K, 2) of candidates."""
        return self.unknowns.paths(x).numpy().astype(np.float64)

    def best(
        self, terms: Sequence[Term], x: Tensor, *, steps: int, keep: int
    ) -> tuple[Tensor, Tensor]:
        """Candidates after some steps of descent, the best of them."""
        return distinct(self.unknowns, *descend(terms, x, steps=steps), keep=keep)
