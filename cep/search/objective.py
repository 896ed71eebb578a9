"""Objectives as decibels to minimise, for many codes at once.

========= =============================================================================================
min-mtf   ``-20 log10 min |H|``
flatness  ``10 log10 (variance of |H| over the band / duty^2)``
noise     ``10 log10 mean 1 / |H|^2``
mse       ``10 log10`` of the Wiener filter's mean square error under the camera's noise
========= =============================================================================================

H is light-true, so a darker code pays for its lost light everywhere but in ``flatness``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cep.band import BandSamples, band_samples, circle_samples
from cep.code import ShutterCode
from cep.exposure import chip_basis
from cep.minimum import min_chip, mtf_minimum
from cep.mtf import inverse_scene, noise_variance
from cep.search.problem import SearchProblem

__all__ = ["Objective"]

RealArray = NDArray[Any]


@dataclass(frozen=True)
class _Part:
    """Columns of the basis that belong to one scenario in one direction."""

    columns: slice
    samples: BandSamples
    scenario: int
    reversed_path: bool


class Objective:
    """A problem's objective on sampled frequencies.

    Parameters
    ----------
    problem : SearchProblem
    oversampling : int
        Samples per 1 / extent on a straight motion; curved paths always take the full grid.
    dtype : numpy dtype
        float32 for searching, float64 for judging.

    Attributes
    ----------
    basis : (n, 2, F) ndarray
        Real and imaginary parts of the chip basis, all scenarios and directions side by side: a flip is one row.
    """

    def __init__(self, problem: SearchProblem, *, oversampling: int, dtype: type = np.float32) -> None:
        self.problem = problem
        blocks: list[NDArray[Any]] = []
        parts: list[_Part] = []
        if not problem.scenarios:
            samples = circle_samples(problem.chips, oversampling=oversampling)
            chips = np.arange(problem.chips) - (problem.chips - 1) / 2
            blocks.append(np.exp(-2j * np.pi * np.outer(chips, samples.fx)) / problem.chips)
            parts.append(_Part(slice(0, samples.fx.size), samples, 0, False))
        for index, scenario in enumerate(problem.scenarios):
            samples = band_samples(scenario.trajectory, oversampling=oversampling)
            forward = chip_basis(scenario.trajectory, problem.chips, samples.fx, samples.fy)
            # the reversed path visits the same chips in the opposite order
            copies = [forward, forward[::-1]] if problem.both_directions(scenario.trajectory) else [forward]
            for turned, copy in enumerate(copies):
                start = parts[-1].columns.stop if parts else 0
                blocks.append(copy)
                parts.append(_Part(slice(start, start + samples.fx.size), samples, index, bool(turned)))
        basis = np.concatenate(blocks, axis=1)
        self.basis: RealArray = np.ascontiguousarray(np.stack([basis.real, basis.imag], axis=1).astype(dtype))
        self._parts = parts
        self._weights: list[RealArray] = [part.samples.weight.astype(dtype) for part in parts]
        self._priors: list[RealArray] = [inverse_scene(part.samples).astype(dtype) for part in parts]
        self._shares_across: list[RealArray] = [part.samples.radius2_weight.astype(dtype) for part in parts]
        self._noise = np.array(
            [noise_variance(problem.camera, k / problem.chips) for k in range(problem.chips + 1)], dtype=np.float64
        )
        shares = np.array([s.weight for s in problem.scenarios] or [1.0])
        self._shares = shares / shares.sum()

    def otf(self, codes: RealArray) -> RealArray:
        """(R, 2, F) real and imaginary OTF of (R, n) codes."""
        flat = codes.astype(self.basis.dtype) @ self.basis.reshape(len(self.basis), -1)
        return np.asarray(flat.reshape(len(codes), *self.basis.shape[1:]))

    def cost(self, otf: RealArray, open_chips: NDArray[np.intp], *, soft: bool = False) -> NDArray[np.float64]:
        """Cost (R,) in dB, lower is better, of (R, 2, F) OTFs whose codes have (R,) open chips.

        ``soft`` replaces each minimum's ``-20 log10 min |H|`` by ``5 log10 sum 1/|H|^4``, which is never below it: all
        low values count, and that gives a search a slope. At n = 52, k = 26, 700,000 moves and equal temperatures it
        reached min |P| = 1.81 on average of six seeds (1.71 to 1.92), the plain minimum 1.62 (1.54 to 1.71).
        """
        squared = otf * otf
        return self.cost_of_power(squared[:, 0] + squared[:, 1], open_chips, soft=soft)

    def cost_of_power(
        self, power: RealArray, open_chips: NDArray[np.intp], *, soft: bool = False
    ) -> NDArray[np.float64]:
        """Cost (R,) of (R, F) squared moduli |H|^2, as :meth:`cost`."""
        power = np.maximum(power, 1e-30)
        worst = np.full((self._shares.size, len(power)), -np.inf)
        for index, part in enumerate(self._parts):
            total = sum(
                weight * self._decibels(name, power[:, part.columns], index, open_chips, soft)
                for name, weight in self.problem.objective_mix
            )
            worst[part.scenario] = np.maximum(worst[part.scenario], total)
        if self.problem.rule == "mean":
            return np.asarray(self._shares @ worst, dtype=np.float64)
        return np.asarray(worst.max(axis=0), dtype=np.float64)

    def cost_of(self, codes: RealArray) -> NDArray[np.float64]:
        """Cost (R,) of (R, n) codes."""
        return self.cost(self.otf(codes), codes.sum(axis=1, dtype=np.intp))

    def exact_cost(self, code: ShutterCode) -> float:
        """Cost of one code with every minimum taken over the continuum; meant for the finest samples and float64.

        A curved path's H is a complex function of two frequencies: for nearly every code it has isolated true zeros,
        which no code can flip away. Such codes cost 60 dB more than their sampled minimum, so that they still rank.
        """
        chips, open_chips = code.array[None], np.array([code.open_chips])
        otf = self.otf(chips)
        if any(name == "min-mtf" for name, _ in self.problem.objective_mix):
            for part in self._parts:
                modulus = np.hypot(otf[0, 0, part.columns], otf[0, 1, part.columns])
                deepest = int(modulus.argmin())
                found = max(_continuum_minimum(self.problem, part, code), 1e-3 * modulus[deepest])
                # the deepest sample stands for the continuum between it and its neighbours
                otf[0, :, part.columns.start + deepest] *= min(found / max(modulus[deepest], 1e-300), 1.0)
        return float(self.cost(otf, open_chips)[0])

    def _decibels(
        self, name: str, power: RealArray, part: int, open_chips: NDArray[np.intp], soft: bool
    ) -> NDArray[np.float64]:
        weight = self._weights[part]
        if name == "min-mtf":
            lowest = power.min(axis=1, keepdims=True)
            value = 1 / lowest[:, 0].astype(np.float64)
            if soft:
                ratio = lowest / power
                value *= np.sqrt((ratio * ratio).sum(axis=1).astype(np.float64))
        elif name == "noise":
            value = ((1 / power) @ weight).astype(np.float64)
        elif name == "flatness":
            duty = open_chips / self.problem.chips
            mean_power, mean = (power @ weight).astype(np.float64), (np.sqrt(power) @ weight).astype(np.float64)
            value = np.maximum(mean_power - mean**2, 1e-12) / duty**2
        else:
            noise = self._noise[open_chips].astype(power.dtype)[:, None]
            per_noise, prior = power / noise, self._priors[part]
            shares = self._shares_across[part]
            errors = sum(shares[:, q] / (per_noise + prior[:, q]) for q in range(shares.shape[1]))
            value = (errors @ weight).astype(np.float64)
        return np.asarray(10 * np.log10(value), dtype=np.float64)


def _continuum_minimum(problem: SearchProblem, part: _Part, code: ShutterCode) -> float:
    if not problem.scenarios:
        return min_chip(code) / code.chips
    played = code.reversed() if part.reversed_path else code
    return mtf_minimum(problem.scenarios[part.scenario].trajectory, played, budget=0).upper
