"""Cost of codes on a problem's sampled frequencies, in decibels: a mix of its objectives.

Of two cameras that play a code and its complement, the restoration from both photos sees the mean
of both powers. With OTFs C of the code and O of the open shutter, both linear in the chips, the
complement has O - C, and

    ``(|C|^2 + |O - C|^2) / 2 = |C - O / 2|^2 + |O / 2|^2``.

So all that a single code does with H, a pair does with the OTF of chips +-1/2, on a floor of the
power that no code changes. The noise is that of half of the light, which is both cameras' mean:
exact for codes that are half open.

The objectives are those of :data:`cep.search.objectives.OBJECTIVES`.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cep.optics.band import ACROSS, BandSamples, band_samples, circle_samples
from cep.optics.code import ShutterCode
from cep.optics.exposure import chip_rows, coded_sum, distinct_rows
from cep.optics.response import open_time
from cep.optics.scene import inverse_scene, noise_variance
from cep.proofs.certify.minimum import min_chip, mtf_minimum
from cep.search.objectives import Spectrum
from cep.search.problem import SearchProblem
from motdiff.trajectory import Trajectory

RealArray = NDArray[Any]
# fields of a problem on which the samples depend
_SAMPLED = ("chips", "scenarios", "direction", "frames", "response", "scene")


@dataclass(frozen=True)
class Part:
    """Columns of the basis that belong to one scenario's path in one direction.

    The unit circle has no path.
    """

    columns: slice
    samples: BandSamples
    scenario: int
    path: Trajectory | None


class CodeCost:
    """Cost of codes by a problem's objective, on sampled frequencies.

    Parameters
    ----------
    problem : SearchProblem
    oversampling : int
        Samples per 1 / extent on a straight motion; curved paths always take the full grid.
    across : int
        Nodes across a straight motion, as of :func:`cep.optics.band.band_samples`.
    dtype : numpy dtype
        float32 for searching, float64 for judging.

    Attributes
    ----------
    rows : (n, V, 2, F) ndarray
        Change of the OTF, real and imaginary, when a chip opens; all scenarios and directions side
        by side. V is 4 where the shutter's response makes neighbours matter (2 left + right, 1 for
        open), else 1.
    parts : tuple of Part
    priors, shares_across : (F, Q) ndarray
        Inverse scene spectrum at each column's radii, and the shares of these.
    open_half : (2, F) ndarray or None
        Half of the OTF of the open shutter, where a second camera plays the complement.
    floor : (F,) ndarray
        Power of that, below which none is: 0 for one camera.
    noise : (n + 1,) ndarray
        Variance of the noise by number of open chips, with the dark current of the whole exposure;
        see :meth:`noise_of`. Of two cameras, of the mean of both photos.
    scenario_shares : (scenarios,) ndarray
    """

    def __init__(
        self,
        problem: SearchProblem,
        *,
        oversampling: int,
        across: int = ACROSS,
        dtype: type = np.float32,
    ) -> None:
        self.problem = problem
        blocks: list[NDArray[Any]] = []
        parts: list[Part] = []
        start = 0
        if not problem.scenarios:
            samples = circle_samples(problem.chips, oversampling=oversampling)
            # about the middle chip, which changes the phase of P alone
            chips = np.arange(problem.chips) - (problem.chips - 1) / 2
            blocks.append(
                np.exp(-2j * np.pi * np.outer(chips, samples.fx))[:, None] / problem.chips
            )
            parts.append(Part(slice(0, samples.fx.size), samples, 0, None))
        ramps = problem.response is not None
        rows: NDArray[Any] = np.empty(0)
        for index, scenario in enumerate(problem.scenarios):
            samples = band_samples(scenario.trajectory, oversampling=oversampling, across=across)
            for path in problem.directed(scenario.trajectory):
                if path is not scenario.trajectory and not ramps:
                    # the forward rows, which come first: the chips are met in the opposite order
                    rows = rows[::-1]
                else:
                    rows = chip_rows(
                        path,
                        problem.chips,
                        samples.fx,
                        samples.fy,
                        response=problem.response,
                    )
                blocks.append(distinct_rows(rows, problem.response))
                stop = start + samples.fx.size
                parts.append(Part(slice(start, stop), samples, index, path))
                start = stop
        # real and imaginary parts apart: the compiled loops add rows without complex arithmetic
        basis = np.concatenate(blocks, axis=2)
        self.rows: RealArray = np.ascontiguousarray(
            np.stack([basis.real, basis.imag], axis=2).astype(dtype)
        )
        self.open_half: RealArray | None = None
        self.floor: RealArray = np.zeros(basis.shape[-1], dtype)
        if problem.frames == 2:
            # with ramps exact where the shutter opens as fast as it closes
            self.open_half = coded_sum(self.rows, np.ones((1, problem.chips)))[0] / 2
            self.floor = (self.open_half**2).sum(axis=0)
        self.parts = tuple(parts)
        self.shares_across: RealArray = _stacked(
            [motion.samples.radius2_weight for motion in parts]
        ).astype(dtype)
        self.priors: RealArray = _stacked(
            [inverse_scene(motion.samples, scene=problem.scene) for motion in parts]
        ).astype(dtype)
        self._set_noise()
        shares = np.array([s.weight for s in problem.scenarios] or [1.0])
        self.scenario_shares: NDArray[np.float64] = shares / shares.sum()

    @classmethod
    def fine(cls, problem: SearchProblem) -> CodeCost:
        """Return the cost by which codes are judged in the end.

        8 samples hide zeros between them, and float32 ranks codes that are almost as good by
        rounding.
        """
        return cls(problem, oversampling=64, dtype=np.float64)

    def instead(self, objective: str | tuple[tuple[str, float], ...]) -> CodeCost:
        """Judge by another objective on the same samples; the tables are shared."""
        return self.for_problem(replace(self.problem, objective=objective))

    def for_problem(self, problem: SearchProblem) -> CodeCost:
        """Judge by a problem with another objective, camera or limits, on the same samples.

        Raises
        ------
        ValueError
            If the problem has other motions, another scene, shutter or number of chips or frames:
            the samples are of these.
        """
        changed = [
            name for name in _SAMPLED if getattr(problem, name) != getattr(self.problem, name)
        ]
        if changed:
            raise ValueError(f"{changed[0]}: must be that of the samples")
        code_cost = copy(self)
        code_cost.problem = problem
        code_cost._set_noise()
        return code_cost

    def _set_noise(self) -> None:
        camera = self.problem.camera
        chips = self.problem.chips
        chip_s = self.problem.chip_ns * 1e-9
        counts = np.arange(chips + 1)
        # a code of several openings integrates dark current for the whole exposure, a single
        # opening for as long as it lasts
        scene = self.problem.scene
        self.noise, self._noise_of_one = (
            noise_variance(camera, counts / chips, integration_s=integrated * chip_s, scene=scene)
            for integrated in (chips, counts)
        )
        if self.problem.frames == 2:
            half_light = noise_variance(camera, 1 / 2, integration_s=chips * chip_s, scene=scene)
            self.noise = self._noise_of_one = np.full(chips + 1, half_light / 2)

    def otf(self, codes: RealArray) -> RealArray:
        """Return real and imaginary OTF (R, 2, F) of codes (R, n).

        For two cameras it is that of the code less half of the open shutter.
        """
        otf = coded_sum(self.rows, codes)
        return otf if self.open_half is None else otf - self.open_half

    def duty(self, codes: RealArray) -> NDArray[np.float64]:
        """(R,) open fraction of the exposure, with the shutter's ramps where there are any.

        Of two cameras their mean, half of the open shutter's.
        """
        if self.problem.frames == 2:
            every_chip = np.ones((1, self.problem.chips))
            return np.full(len(codes), open_time(every_chip, self.problem.response) / 2)
        return open_time(codes, self.problem.response)

    def noise_of(self, codes: RealArray) -> NDArray[np.float64]:
        """(R,) variance of the noise through (R, n) codes."""
        chips = self.problem.chips
        on = np.asarray(codes) != 0
        single = on[:, 0] + (on[:, 1:] & ~on[:, :-1]).sum(axis=1) == 1
        open_chips = self.duty(codes) * chips  # ramps make it a fraction: interpolated
        counts = np.arange(chips + 1)
        return np.where(
            single,
            np.interp(open_chips, counts, self._noise_of_one),
            np.interp(open_chips, counts, self.noise),
        )

    def cost(
        self, otf: RealArray, duty: NDArray[np.float64], noise: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        """Cost (R,) in dB, lower is better, of (R, 2, F) OTFs with (R,) open fractions.

        The variance (R,) of the noise is that of :attr:`noise` when omitted, as for codes of many
        openings.
        """
        # decibels are averaged, not powers: one bad motion would rule the mean of these
        scenario_costs = self._each(otf, duty, noise)
        if self.problem.rule == "mean":
            return np.asarray(self.scenario_shares @ scenario_costs, dtype=np.float64)
        return np.asarray(scenario_costs.max(axis=0), dtype=np.float64)

    def each_cost_of(self, codes: RealArray) -> NDArray[np.float64]:
        """Cost (scenarios, R), dB, of (R, n) codes on every scenario, in its worse direction."""
        return self._each(self.otf(codes), self.duty(codes), self.noise_of(codes))

    def cost_of(self, codes: RealArray) -> NDArray[np.float64]:
        """Cost (R,) of (R, n) codes."""
        return self.cost(self.otf(codes), self.duty(codes), self.noise_of(codes))

    def exact_cost(self, code: ShutterCode) -> float:
        """Cost of one code, dB, with every minimum taken over the continuum.

        Two cameras' are sampled, finely in a cost for judging: both powers rarely vanish together.

        A curved path's H is a complex function of two frequencies: for nearly every code it has
        isolated true zeros, which no code can flip away. Such codes cost 60 dB more than their
        sampled minimum, so that they still rank.
        """
        chips = code.array[None]
        otf = self.otf(chips)
        continuum = any(criterion.continuum for criterion, _ in self.problem.criteria)
        if continuum and self.problem.frames == 1:
            for motion in self.parts:
                modulus = np.hypot(otf[0, 0, motion.columns], otf[0, 1, motion.columns])
                deepest = int(modulus.argmin())
                minimum = max(
                    continuum_minimum(self.problem, motion.path, code),
                    1e-3 * modulus[deepest],  # 60 dB
                )
                # the deepest sample stands for the continuum between it and its neighbours
                otf[0, :, motion.columns.start + deepest] *= min(
                    minimum / max(modulus[deepest], 1e-300), 1.0
                )
        return float(self.cost(otf, self.duty(chips), self.noise_of(chips))[0])

    def _each(
        self, otf: RealArray, duty: NDArray[np.float64], noise: NDArray[np.float64] | None
    ) -> NDArray[np.float64]:
        if noise is None:
            noise = np.interp(
                duty * self.problem.chips, np.arange(self.problem.chips + 1), self.noise
            )
        squared = otf * otf
        # at a true zero 1 / |H|^2 must stay finite, in float32 as well
        power = np.maximum(squared[:, 0] + squared[:, 1] + self.floor, 1e-30)
        worst = np.full((self.scenario_shares.size, len(power)), -np.inf)
        for motion in self.parts:
            spectrum = Spectrum(
                power[:, motion.columns],
                motion.samples.weight.astype(power.dtype),
                self.priors[motion.columns],
                self.shares_across[motion.columns],
                duty,
                noise,
            )
            total = sum(
                weight * (10 * np.log10(criterion.figure(spectrum)))
                for criterion, weight in self.problem.criteria
            )
            # of both directions of a scenario the worse one counts
            worst[motion.scenario] = np.maximum(worst[motion.scenario], total)
        return worst


def sample_count(problem: SearchProblem, *, oversampling: int) -> int:
    """Columns that an objective has, without making its tables."""
    if not problem.scenarios:
        return circle_samples(problem.chips, oversampling=oversampling).fx.size
    return sum(
        len(problem.directed(scenario.trajectory))
        * band_samples(scenario.trajectory, oversampling=oversampling).fx.size
        for scenario in problem.scenarios
    )


def _stacked(tables: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Stack (F, Q) tables, those with fewer columns filled up with zero shares."""
    widest = max(table.shape[1] for table in tables)
    return np.concatenate(
        [np.pad(table, ((0, 0), (0, widest - table.shape[1]))) for table in tables]
    )


def continuum_minimum(problem: SearchProblem, path: Trajectory | None, code: ShutterCode) -> float:
    """Smallest |H| over the continuum along a path; None: unit circle."""
    if path is None:
        return min_chip(code) / code.chips
    return mtf_minimum(path, code, budget=0, response=problem.response).upper
