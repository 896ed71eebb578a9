"""Refinement of an approximate motion by photos of it taken through known codes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from motdiff.estimators.base import Estimator
from motdiff.estimators.coded.candidates import expected_deviation_px
from motdiff.estimators.coded.codes import check_codes
from motdiff.estimators.coded.exposures import Exposures, exposures_of
from motdiff.estimators.coded.fit import FINEST, KNOTS, LOOSE, MIDDLE, PhotoFit
from motdiff.estimators.coded.misfit import PathQuadratic, Term, Unknowns, descend
from motdiff.path_psfs import interpolated
from motdiff.progress import Progress
from motdiff.threads import one_thread_a_call
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

NOISE_GAIN = 4.0 * KNOTS
"""Decrease of the sum of squares by noise alone: twice the coordinates of the knots."""
_SMOOTH_OVER = 0.12  # of the exposure: an error of the path changes over such times
_ROUGH_PX = 0.03  # error of each knot beside the smooth one
_ANYWHERE_PX = 100.0  # the position of the whole path does not matter
_FIXED_PX = 1e-3  # so stiff that only shifts and gains are fitted
_MOST_ORDERS = 4  # the best few after the quick descent
_DEVIATION_FACTORS = (0.5, 1.0, 2.0)  # descents with other deviations end in other minima
_NEAREST_COST = 2.0  # in fits
# of true to computed error: docs/decisions/motion-estimation.md
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
        Of the photos, before and after, as a multiple of what noise alone leaves; NaN where only
        kernels are compared.
    values : float
        Sum of squares that noise alone leaves, the unit of the misfits; 0 beside kernels.
    deviation_px : float
        Expected error of the refined path, rms over time.
    """

    given: Trajectory
    trajectory: Trajectory
    cost: float
    given_misfit: float
    misfit: float
    values: float
    deviation_px: float


def refined_paths(
    paths: Sequence[Trajectory],
    photos: Sequence[ArrayLike],
    codes: Sequence[str],
    *,
    deviation_px: float = 1.0,
    kernels: Estimator | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[RefinedPath]:
    """Fit a path, given in one or several orders in time, to photos of it through known codes.

    Each path may deviate from the given one by an error that is smooth in time and of the size
    ``deviation_px``. It is fitted to the kernels of the photos, each estimated in its photo alone,
    and to the photos themselves where two or more show one scene.

    Parameters
    ----------
    photos : sequence of I (H, W) or (H, W, 3) array_like, linear light 0..1
    codes : sequence of I str
        Bits of each photo's code.
    deviation_px : float
        Expected error of the given path, rms over time.
    kernels : Estimator, optional
        Estimator of each photo's kernel; PMP when omitted.
    progress : callable, optional
        Called with the finished share 0..1.

    Returns
    -------
    list of RefinedPath
        Of the orders that explain the photos best, each from descents with half, once and twice
        the given deviation; best first.

    Raises
    ------
    ValueError
        As :func:`motdiff.estimators.coded.codes.check_codes` and
        :func:`motdiff.estimators.coded.exposures.exposures_of`, or if the deviation is not above
        0.
    """
    check_codes(codes)
    if not (np.isfinite(deviation_px) and deviation_px > 0):
        raise ValueError(f"deviation_px: must be above 0, got {deviation_px:g}")
    with one_thread_a_call():
        work = Progress(progress)
        work.expect(1.0)
        exposures = exposures_of(photos, codes, kernels=kernels, progress=work)
        fit = _RefiningFit(exposures)
        factor = exposures.shrunk
        orders = [path.scaled(1 / factor) for path in paths]
        fits = min(len(orders), _MOST_ORDERS) * len(_DEVIATION_FACTORS)
        work.expect(_NEAREST_COST * (len(orders) > 1) + fits)
        if len(orders) > 1:
            orders = fit.nearest(orders)
            work.spend(_NEAREST_COST)
        refined = []
        for path in orders:
            for candidate in fit.refined(path, deviation_px / factor, factor=factor):
                refined.append(candidate)
                work.spend(1.0)
        work.finish()
        return sorted(refined, key=lambda candidate: candidate.cost)


class _RefiningFit(PhotoFit):
    def __init__(self, exposures: Exposures) -> None:
        super().__init__(exposures, exposures.spectra())
        self.sharpest = self.kernels(1.0, saturated=True)

    def nearest(self, paths: Sequence[Trajectory]) -> list[Trajectory]:
        """Paths with the least cost after a few steps of descent."""
        x = self.registered(np.stack([_knots(path) for path in paths]))
        terms: list[Term] = [self.kernels(1.5), self.kernel_roughness]
        if self.has_scene:
            terms = [self.beside_photos(LOOSE)[0], self.sharpest, self.kernel_roughness]
        _, costs = descend(terms, x, steps=4)
        return [paths[i] for i in torch.argsort(costs)[:_MOST_ORDERS].tolist()]

    def refined(
        self, path: Trajectory, deviation_px: float, *, factor: int
    ) -> Iterator[RefinedPath]:
        """Descend from a path with half, once and twice its deviation."""
        start = _knots(path)
        prior = _path_prior(self.unknowns, start, deviation_px)
        scene = self.beside_photos(FINEST)[0] if self.has_scene else None
        terms: list[Term] = [self.sharpest, prior, *([scene] if scene else [])]
        x0 = self.registered(start[None])
        given_misfit = self._misfit_of_given(x0)
        for deviation_factor in _DEVIATION_FACTORS:
            x = self._descended(
                x0, _path_prior(self.unknowns, start, deviation_factor * deviation_px)
            )
            knots_px = expected_deviation_px(self.unknowns, terms, x)
            yield RefinedPath(
                given=path.scaled(factor),
                trajectory=_moved(path, self.paths(x)[0] - start).scaled(factor),
                cost=sum(float(term.cost(x)) for term in terms),
                given_misfit=given_misfit,
                misfit=self.misfit(x),
                values=scene.values if scene else 0.0,
                deviation_px=_ERROR_RATIO * factor * float(np.sqrt((knots_px**2).mean())),
            )

    def _descended(self, x: Tensor, prior: Term) -> Tensor:
        if not self.has_scene:
            return descend([self.sharpest, prior], x, steps=20)[0]
        for stage, steps in ((LOOSE, 6), (MIDDLE, 6), (FINEST, 12)):
            x, _ = descend([self.beside_photos(stage)[0], self.sharpest, prior], x, steps=steps)
        return x

    def _misfit_of_given(self, x: Tensor) -> float:
        """Misfit of the photos along a path that stays as it is; shifts and gains are fitted."""
        fixed = _path_prior(
            self.unknowns, self.unknowns.paths(x)[0].numpy(), _FIXED_PX, rough_px=_FIXED_PX
        )
        for stage in (LOOSE, MIDDLE, FINEST) if self.has_scene else ():
            x, _ = descend([self.beside_photos(stage)[0], fixed], x, steps=4)
        return self.misfit(x)


def _path_prior(
    unknowns: Unknowns, path: FloatArray, deviation_px: float, rough_px: float = _ROUGH_PX
) -> PathQuadratic:
    """Deviation from a path as a Gaussian process: smooth in time, of any shift."""
    t = np.linspace(0, 1, unknowns.knots)
    covariance = 0.5 * deviation_px**2 * np.exp(-0.5 * ((t[:, None] - t) / _SMOOTH_OVER) ** 2)
    covariance += rough_px**2 * np.eye(len(t)) + _ANYWHERE_PX**2
    return PathQuadratic(unknowns, np.asarray(np.linalg.inv(covariance), np.float64), path)


def _knots(path: Trajectory) -> FloatArray:
    """Positions (K, 2) at evenly spaced times, centred."""
    points: FloatArray = path.at(np.linspace(0, 1, KNOTS))
    return np.asarray(points - points.mean(axis=0))


def _moved(path: Trajectory, move: FloatArray) -> Trajectory:
    """Path moved by (K, 2) px at evenly spaced times; its detail between the knots stays."""
    knot_times = np.linspace(0, 1, KNOTS)
    t = np.union1d(path.t, knot_times)
    shift = interpolated(t, knot_times, move)
    return Trajectory.from_samples(path.at(t) + shift, t=t, direction=path.direction)
