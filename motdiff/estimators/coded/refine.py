"""Refinement of a motion that is known roughly, by photos of it taken through known codes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from motdiff.crops import LEAST_PX, pick_crops, textured_luminance
from motdiff.estimators.base import Estimator
from motdiff.estimators.coded.codes import check_codes
from motdiff.estimators.coded.estimator import CodedEstimator
from motdiff.estimators.coded.misfit import KernelTerm, Roughness, SceneTerm, Term, Unknowns, descend, scene_spectra
from motdiff.estimators.coded.otfs import CodedOtfs
from motdiff.estimators.coded.search import Exposures
from motdiff.progress import Progress
from motdiff.psf_frame import centroid_px
from motdiff.threads import one_thread_a_call
from motdiff.trajectory import Trajectory

__all__ = ["PathRefiner", "RefinedPath"]

FloatArray = NDArray[np.float64]

_KNOTS = 53
_SATURATION, _LOOSE = 60.0, 0.3  # as in search
_SMOOTH_OVER = 0.12  # of the exposure: an error of the path changes over such times
_ROUGH_PX = 0.03  # error of each knot beside the smooth one
_ANYWHERE_PX = 100.0  # the place of the whole path is of no account
_FIXED_PX = 1e-3
_ORDERS_KEPT = 4
_SIDE_STEP_PX, _LARGEST_SIDE_PX, _LEAST_INSIDE_PX = 6, 252, 96
_STEERED = (0.5, 1.0, 2.0)  # descents with other deviations end in other minima
_NEAREST_COST = 2.0  # in fits
_TRUSTED = 0.5  # confidence in a kernel
# stated is this times what the curvature of the fit gives: docs/decisions/motion-estimation.md
_ERROR_RATIO = 1.5


@dataclass(frozen=True)
class RefinedPath:
    """A path before and after it was fitted to photos.

    Attributes
    ----------
    given, trajectory : Trajectory
        Before and after.
    cost : float
        Sum of squares, that of the deviation from the given path included.
    given_misfit, misfit : float
        Of the photos, before and after, as a multiple of what noise alone leaves; NaN where only kernels are compared.
    values : int
        How many values that misfit is the mean of.
    deviation_px : float
        Expected error of the refined path, rms over time.
    """

    given: Trajectory
    trajectory: Trajectory
    cost: float
    given_misfit: float
    misfit: float
    values: int
    deviation_px: float


class PathRefiner(CodedEstimator):
    """Fit paths that are known roughly to photos of that motion, each taken through a known code.

    Each path may deviate from what is given by an error that is smooth in time and of the size ``deviation_px``. It is
    fitted to the kernels of the photos, each found in its photo alone, and to the photos themselves where two or more
    show one scene.

    Parameters
    ----------
    codes : sequence of str
        Bits of each photo's code, in the order of the photos.
    deviation_px : float
        Expected error of the given path, rms over time.
    kernels : Estimator, optional
        What finds the kernel of each photo; :class:`motdiff.estimators.pmp.PmpEstimator` when omitted.
    progress : callable, optional
        Called with the finished share 0..1.

    Raises
    ------
    ValueError
        As :func:`motdiff.estimators.coded.codes.check_codes`, or if the deviation is not above 0.
    """

    method = "refined"

    def __init__(
        self,
        codes: Sequence[str],
        *,
        deviation_px: float = 1.0,
        kernels: Estimator | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        super().__init__(codes, kernels=kernels, progress=progress)
        if not (np.isfinite(deviation_px) and deviation_px > 0):
            raise ValueError(f"deviation_px: must be above 0, got {deviation_px:g}")
        self._deviation_px = deviation_px

    def refine(self, paths: Sequence[Trajectory], photos: Sequence[ArrayLike]) -> list[RefinedPath]:
        """Refine a path, given in one or several orders in time.

        Parameters
        ----------
        paths : sequence of Trajectory
        photos : sequence of I (H, W) or (H, W, 3) array_like, linear light 0..1

        Returns
        -------
        list of RefinedPath
            Of the orders that explain the photos best, each from descents with half, once and twice the given
            deviation; best first.

        Raises
        ------
        ValueError
            As :meth:`estimate_from`.
        """
        with one_thread_a_call():
            progress = Progress(self._tell)
            progress.expect(1.0)
            exposures, factor = self._seen(photos, progress)
            found = self._refined(paths, exposures, factor, progress)
            progress.finish()
            return found

    def _refined(
        self, paths: Sequence[Trajectory], exposures: Exposures, factor: int, progress: Progress
    ) -> list[RefinedPath]:
        fit = _Fit(exposures)
        given = [path.scaled(1 / factor) for path in paths]
        progress.expect(_NEAREST_COST * (len(given) > 1) + min(len(given), _ORDERS_KEPT) * len(_STEERED))
        near = given
        if len(given) > 1:
            near = fit.nearest(given)
            progress.spend(_NEAREST_COST)
        found = []
        for path in near:
            for steered in _STEERED:
                found.append(fit.refined(path, self._deviation_px / factor, steered=steered, factor=factor))
                progress.spend(1.0)
        return sorted(found, key=lambda one: one.cost)

    def _seen(self, photos: Sequence[ArrayLike], progress: Progress) -> tuple[Exposures, int]:
        """Return the photos with their kernels, and by how much they were made smaller for these."""
        check_codes(self._codes, photos=len(photos))
        greys = [textured_luminance(photo, least_px=LEAST_PX) for photo in photos]
        for i, grey in enumerate(greys[1:], 2):
            if grey.shape != greys[0].shape:
                (h, w), (h0, w0) = grey.shape, greys[0].shape
                raise ValueError(f"photo {i}: has {w} x {h} px, the first one {w0} x {h0}; give photos of one size")
        found = self._kernels_of(greys, progress)
        scales = [one.details.get("scale", 1.0) for one in found if one.confidence >= _TRUSTED]
        factor = max([1, *(round(1 / scale) for scale in scales if isinstance(scale, float))])
        if factor > 1:  # the blur outgrew the search in one of them
            size = (greys[0].shape[1] // factor, greys[0].shape[0] // factor)
            greys = [np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.float64) for grey in greys]
            found = self._kernels_of(greys, progress)
        return self._exposures(greys, found), factor


class _Fit:
    """Terms of the sum of squares for the photos."""

    def __init__(self, exposures: Exposures) -> None:
        self.exposures = exposures
        self.unknowns = Unknowns(_KNOTS, len(exposures.codes))
        self.otfs = CodedOtfs(exposures.codes, _KNOTS)
        self.kernels = self._kernel_term(1.0, _SATURATION)
        centroids = np.array([centroid_px(kernel)[::-1] for kernel in exposures.kernels])
        self.centroids = torch.tensor(centroids, dtype=torch.float32)
        self.scenes = self._scene_terms()

    def nearest(self, paths: Sequence[Trajectory]) -> list[Trajectory]:
        """Those of the paths from which the photos are explained best after a few steps."""
        x = self._pack(np.stack([_knots(path) for path in paths]))
        loose = Roughness(self.unknowns, _LOOSE)
        terms: list[Term] = [self._kernel_term(1.5), loose]
        if self.scenes:
            x = self.scenes[0].registered(x)
            terms = [self.scenes[0], self.kernels, loose]
        _, costs = descend(terms, x, steps=4)
        return [paths[i] for i in torch.argsort(costs)[:_ORDERS_KEPT].tolist()]

    def refined(self, path: Trajectory, deviation_px: float, *, steered: float, factor: int) -> RefinedPath:
        """Descend from a path with so many times its deviation."""
        start = _knots(path)
        prior = _PathPrior(self.unknowns, start, deviation_px)
        guide = _PathPrior(self.unknowns, start, steered * deviation_px)
        x = self._pack(start[None])
        given_misfit, scene = float("nan"), None
        if self.scenes:
            scene = self.scenes[-1]
            x = self.scenes[0].registered(x)
            given_misfit = self._misfit_of_given(x)
            for term, steps in zip(self.scenes, (6, 6, 12), strict=True):
                x, _ = descend([term, self.kernels, guide], x, steps=steps)
        else:
            x, _ = descend([self.kernels, guide], x, steps=20)
        move = self.unknowns.paths(x)[0].numpy().astype(np.float64) - start
        terms: list[Term] = [self.kernels, prior, *([scene] if scene else [])]
        return RefinedPath(
            given=path.scaled(factor),
            trajectory=_moved(path, move).scaled(factor),
            cost=sum(float(term.cost(x)) for term in terms),
            given_misfit=given_misfit,
            misfit=float(scene.cost(x)) / scene.values if scene else float("nan"),
            values=scene.values if scene else 0,
            deviation_px=_ERROR_RATIO * factor * self._deviation(terms, x),
        )

    def _misfit_of_given(self, x: Tensor) -> float:
        """Misfit of the photos along a path that stays as it is; shifts and gains are fitted."""
        still = _PathPrior(self.unknowns, self.unknowns.paths(x)[0].numpy(), _FIXED_PX, rough_px=_FIXED_PX)
        for term in self.scenes:
            x, _ = descend([term, still], x, steps=4)
        return float(self.scenes[-1].cost(x)) / self.scenes[-1].values

    def _deviation(self, terms: Sequence[Term], x: Tensor) -> float:
        size = self.unknowns.size
        matrix, slope = torch.zeros(1, size, size), torch.zeros(1, size)
        for term in terms:
            term.add_normal(x, matrix, slope)
        curvature = matrix[0].double() + 1e-9 * matrix[0].diagonal().mean() * torch.eye(size)
        spread = torch.linalg.inv(curvature)[: 2 * _KNOTS, : 2 * _KNOTS]
        centring = torch.eye(_KNOTS).double() - 1 / _KNOTS
        variance = torch.stack([(centring @ spread[a::2, a::2] @ centring).diagonal() for a in (0, 1)])
        return float(variance.clamp(min=0).sum(0).mean().sqrt())

    def _pack(self, paths: FloatArray) -> Tensor:
        """Candidates of paths (B, K, 2), with the kernels' shifts that lay centroid on centroid."""
        points = torch.tensor(paths, dtype=torch.float32)
        shifts = self.centroids - self.otfs.centroids(points)
        gains = torch.tensor(np.tile(self.exposures.gains, (len(paths), 1)), dtype=torch.float32)
        return self.unknowns.pack(points, gains, shifts)

    def _kernel_term(self, sigma_px: float, saturation: float | None = None) -> KernelTerm:
        return KernelTerm(
            self.unknowns, self.otfs, self.exposures.kernels,
            sigma_px=sigma_px, weights=self.exposures.weights, saturation=saturation,
        )  # fmt: skip

    def _scene_terms(self) -> list[SceneTerm]:
        """Terms of the photos on three grids, coarse to fine; none where the scene is not shared or too small."""
        photos = self.exposures.photos
        if len(photos) < 2:
            return []
        y, x = (np.concatenate(axis) for axis in zip(*(np.nonzero(k) for k in self.exposures.kernels), strict=True))
        margin_px = int(np.ceil(0.5 * max(np.ptp(y), np.ptp(x)))) + 10
        side = min(_LARGEST_SIDE_PX, *(n // _SIDE_STEP_PX * _SIDE_STEP_PX for n in photos[0].shape))
        if side - 2 * margin_px < _LEAST_INSIDE_PX:
            return []
        top, left = pick_crops(photos[0], size=side, count=1)[0]
        cut = [photo[top : top + side, left : left + side] for photo in photos]
        spectra = scene_spectra(cut, grids=[side // part for part in (6, 3, 2)], margin_px=margin_px)
        return [
            SceneTerm(self.unknowns, self.otfs, one, path_error_px=error_px)
            for one, error_px in zip(spectra, (1.0, 0.3, 0.0), strict=True)
        ]


class _PathPrior:
    """Deviation from a path as a Gaussian process in time: smooth, of an expected size, and of any shift."""

    def __init__(self, unknowns: Unknowns, path: FloatArray, deviation_px: float, rough_px: float = _ROUGH_PX) -> None:
        t = np.linspace(0, 1, unknowns.knots)
        covariance = 0.5 * deviation_px**2 * np.exp(-0.5 * ((t[:, None] - t) / _SMOOTH_OVER) ** 2)
        covariance += rough_px**2 * np.eye(len(t)) + _ANYWHERE_PX**2
        self._matrix = torch.tensor(np.linalg.inv(covariance), dtype=torch.float32)
        self._path = torch.tensor(path, dtype=torch.float32)
        self._unknowns = unknowns

    def cost(self, x: Tensor) -> Tensor:
        """See :class:`motdiff.estimators.coded.misfit.Term`."""
        away = self._unknowns.paths(x) - self._path
        return torch.einsum("bkd,kl,bld->b", away, self._matrix, away)

    def add_normal(self, x: Tensor, matrix: Tensor, slope: Tensor) -> None:
        """See :class:`motdiff.estimators.coded.misfit.Term`."""
        away, end = self._unknowns.paths(x) - self._path, 2 * self._unknowns.knots
        for axis in (0, 1):
            matrix[:, axis:end:2, axis:end:2] += self._matrix
            slope[:, axis:end:2] += away[..., axis] @ self._matrix


def _knots(path: Trajectory) -> FloatArray:
    """Positions (K, 2) at evenly spaced times, centred."""
    points: FloatArray = path.at(np.linspace(0, 1, _KNOTS))
    return np.asarray(points - points.mean(axis=0))


def _moved(path: Trajectory, move: FloatArray) -> Trajectory:
    """Path moved by (K, 2) px at evenly spaced times: what it has between the knots stays."""
    at = np.linspace(0, 1, _KNOTS)
    t = np.union1d(path.t, at)
    shift = np.stack([np.interp(t, at, move[:, axis]) for axis in (0, 1)], axis=1)
    return Trajectory.from_samples(path.at(t) + shift, t=t, direction=path.direction)
