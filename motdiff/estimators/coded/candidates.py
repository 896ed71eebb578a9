"""Candidate paths: distances, expected errors, and the estimate of the best ones."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.coded.misfit import Term, Unknowns
from motdiff.metrics import rms_distance_px
from motdiff.psf_frame import PSF_PX
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

EXPLAINED = 1.1
"""Misfit up to which a path explains the photos; right paths have 0.6 to 1.1."""
UNEXPLAINED = 1.25
"""Misfit above which a path does not explain the photos."""
SAME_PX = 1.0
"""Rms distance within which two paths count as one."""
_DOUBTFUL = 0.75  # probability below which a warning asks for another photo
_MOST_PATHS = 3  # the best, and alternatives
_MISFIT_POWER = 4.0  # so steep that a misfit of 1.5 leaves a fifth


@dataclass(frozen=True)
class CandidatePath:
    """A path that explains the photos.

    Attributes
    ----------
    path : (K, 2) float, px
        At times spaced evenly over the exposure.
    cost : float
        Its sum of squares.
    misfit : float
        Of the photos, as a multiple of what noise alone leaves; NaN where only kernels are
        compared.
    deviation_px : (K,) float
        Standard deviation of each knot, as the fit's curvature and misfit give it.
    """

    path: FloatArray
    cost: float
    misfit: float
    deviation_px: FloatArray = field(repr=False)


def explained_share(misfit: float, explained: float = 1.0) -> float:
    """Factor of a probability for a misfit above ``explained``; the power is a guess."""
    return 1.0 if np.isnan(misfit) else min(1.0, (misfit / explained) ** -_MISFIT_POWER)


def cost_gap(paths: Sequence[CandidatePath]) -> float | None:
    """Cost of the next path that lies elsewhere, less that of the first; None without one."""
    best = paths[0]
    for path in paths[1:]:
        if rms_distance_px(path.path, best.path) > SAME_PX:
            return path.cost - best.cost
    return None


def unexplained_warnings(misfit: float) -> list[str]:
    """Return a warning where a path does not explain the photos, else none."""
    if not misfit > UNEXPLAINED:
        return []
    return [
        f"the path leaves {misfit:.1f} times the noise unexplained: was the motion the same in"
        " each photo, and are the codes given in the order of the photos?"
    ]


def distance_px(unknowns: Unknowns, x: Tensor, y: Tensor) -> float:
    """Rms distance of the paths of two candidates (N,), after the best shift."""
    difference = unknowns.paths((x - y)[None])[0]
    return float((difference - difference.mean(0)).square().sum(1).mean().sqrt())


def distinct(
    unknowns: Unknowns, x: Tensor, costs: Tensor, *, keep: int, apart_px: float = SAME_PX
) -> tuple[Tensor, Tensor]:
    """Best candidates of (B, N) and their costs, none within ``apart_px`` of a better one."""
    index = list[int]()
    for i in torch.argsort(costs).tolist():
        if all(distance_px(unknowns, x[i], x[j]) > apart_px for j in index):
            index.append(i)
        if len(index) == keep:
            break
    return x[index], costs[index]


@dataclass(frozen=True)
class Evolution:
    """Rounds in which changed candidates compete with those that they were made of.

    Attributes
    ----------
    rounds : int
        Most rounds.
    patience : int
        Rounds without improvement after which it ends.
    improved : float
        Share of the least cost: a smaller fall is no improvement.
    population : int
        Candidates kept after each round.
    apart_px : float
        A candidate nearer to a better one is left out.
    """

    rounds: int
    patience: int
    improved: float
    population: int
    apart_px: float = SAME_PX

    def run(
        self,
        unknowns: Unknowns,
        x: Tensor,
        costs: Tensor,
        *,
        changed: Callable[[Tensor], tuple[Tensor, Tensor]],
        spend: Callable[[float], None] = lambda _share: None,
    ) -> tuple[Tensor, Tensor]:
        """Candidates and costs, best first, after changes of the best ones while that helps.

        Parameters
        ----------
        changed : callable
            Makes new candidates of (B, N), fitted, and returns them with their costs.
        spend : callable, optional
            Called with each share of the work that is done; all together are 1.
        """
        idle_rounds = 0
        for index in range(self.rounds):
            new, new_costs = changed(x)
            least_cost = float(costs.min())
            x, costs = distinct(
                unknowns,
                torch.cat([x, new]),
                torch.cat([costs, new_costs]),
                keep=self.population,
                apart_px=self.apart_px,
            )
            idle_rounds = 0 if float(costs[0]) < self.improved * least_cost else idle_rounds + 1
            spend(1 / self.rounds)
            if idle_rounds == self.patience:
                spend((self.rounds - 1 - index) / self.rounds)
                break
        return x, costs


def merged(
    unknowns: Unknowns, results: Sequence[tuple[Tensor, Tensor]], *, keep: int, same_px: float
) -> tuple[Tensor, Tensor, int]:
    """Join the results of several searches, each candidates and their costs, best first.

    Returned are the best distinct candidates, their costs, and how many searches ended within
    ``same_px`` of the best.
    """
    candidates, costs = (torch.cat(tensors) for tensors in zip(*results, strict=True))
    x, costs = distinct(unknowns, candidates, costs, keep=keep, apart_px=same_px)
    return x, costs, sum(distance_px(unknowns, x[0], best[0]) < same_px for best, _ in results)


def expected_deviation_px(
    unknowns: Unknowns, terms: Sequence[Term], candidate: Tensor
) -> FloatArray:
    """Return the standard deviation (K,) of each knot of a candidate (1, N), from ``J^T J``."""
    knots = unknowns.knots
    size = unknowns.size
    JJ = torch.zeros(1, size, size)
    Jr = torch.zeros(1, size)
    for term in terms:
        term.add_normal(candidate, JJ, Jr)
    curvature = JJ[0].double()
    # scaled to a diagonal of 1, as light and px differ by orders of magnitude
    scale = curvature.diagonal().clamp(min=1e-12).sqrt()
    scaled = curvature / scale[:, None] / scale + 1e-9 * torch.eye(size)
    covariance = (torch.linalg.inv(scaled) / scale[:, None] / scale)[: 2 * knots, : 2 * knots]
    centring = torch.eye(knots).double() - 1 / knots  # a shift of the whole path is no error
    variances = [
        (centring @ covariance[axis::2, axis::2] @ centring).diagonal().clamp(min=0)
        for axis in (0, 1)
    ]
    return np.asarray((variances[0] + variances[1]).sqrt().numpy(), dtype=np.float64)


def candidate_paths(
    unknowns: Unknowns,
    terms: Sequence[Term],
    x: Tensor,
    costs: Tensor,
    *,
    misfit: Callable[[Tensor], float],
    variance_share: float = 1.0,
) -> list[CandidatePath]:
    """Candidates (B, N) with their misfits and the expected errors of their knots.

    Parameters
    ----------
    misfit : callable
        Of a candidate (1, N); above 1 it scales the variances.
    variance_share : float
        Of the variances by the curvature.
    """
    paths = []
    for candidate, cost in zip(x[:, None], costs.tolist(), strict=True):
        path = unknowns.paths(candidate)[0].numpy().astype(np.float64)
        unexplained = misfit(candidate)
        noise_factor = np.sqrt(variance_share * max(1.0, unexplained))  # max(1, NaN) is 1
        deviation_px = noise_factor * expected_deviation_px(unknowns, terms, candidate)
        paths.append(CandidatePath(path, cost, unexplained, deviation_px))
    return paths


def motion_of_paths(
    method: str,
    paths: Sequence[CandidatePath],
    *,
    probability: float,
    shares: ArrayLike,
    deviation_px: FloatArray,
    scale: float = 1.0,
    warnings: Sequence[str] = (),
    details: Mapping[str, object],
) -> MotionEstimate:
    """Motion estimate of the best of some paths, with alternatives.

    Parameters
    ----------
    paths : sequence of CandidatePath, best first
    probability : float
        That the order of the best one is right.
    shares : (N - 1,) float
        Of the remaining probability, for each other path, relative to each other.
    deviation_px : (K,) float
        Expected error of the best path at evenly spaced times.
    scale : float
        Factor of the paths.
    warnings : sequence of str
    details : mapping
        Beside ``order_confidence``, ``path_uncertainty_px``, ``deviation_px`` and ``misfit``.
    """
    best = paths[0]
    paths = paths[:_MOST_PATHS]
    weights = np.ones(1)
    if len(paths) > 1:
        share = np.asarray(shares, dtype=np.float64)[: len(paths) - 1]
        # at most its own: the best one stays the likeliest
        alternatives = np.minimum((1 - probability) * share / share.sum(), probability)
        weights = np.array([probability, *alternatives]) / (probability + alternatives.sum())
    trajectories = tuple(
        Trajectory.from_samples(scale * path.path, direction="known") for path in paths
    )
    psf_warnings = [*unexplained_warnings(best.misfit), *warnings]
    all_warnings = list(psf_warnings)
    if probability < _DOUBTFUL:
        all_warnings.insert(
            0,
            f"the order in time is uncertain (confidence {probability:.2f}): take another photo of"
            " this motion; cep calibrate --next chooses its code",
        )
    return MotionEstimate(
        method=method,
        trajectories=trajectories,
        weights=tuple(weights.tolist()),
        psf=trajectories[0].psf(trajectories[0].frame_size(PSF_PX)),
        confidence=probability,
        warnings=tuple(all_warnings),
        psf_warnings=tuple(psf_warnings),
        details={
            "order_confidence": probability,
            "path_uncertainty_px": float(np.sqrt((deviation_px**2).mean())),
            "deviation_px": deviation_px.tolist(),
            "misfit": best.misfit if np.isfinite(best.misfit) else None,
            **details,
        },
    )
