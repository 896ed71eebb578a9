"""Archive of a Pareto search: the codes so far that no other beats, judged quickly and exactly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cep.optics.code import ShutterCode
from cep.optics.straight_motion import uniform_length_px
from cep.proofs.measure import HOPELESS_DB
from cep.search.cost import CodeCost, continuum_minimum
from cep.search.problem import SearchProblem
from lab.fronts.front import FrontPoint, non_dominated
from motdiff.types import FloatArray

Codes = NDArray[np.int8]

EQUAL_DB = 1e-7
"""Figures as close are equal: those of a code and its mirror image agree only up to rounding."""

# what coarse samples may make of the minimum, in float32, and of the noise
_SLACK_DB = np.array([1e-3, 0.05])
_SAMPLES = 1024  # of coarse ones on the unit circle, or 8 a chip
_JUDGED = 32  # codes at once
_SWAPS = 4096  # neighbours of a code that are looked at
_NUMBERS = 2**22  # evaluated at once: 16 MB


class Judge:
    """Figures of codes: quick ones on coarse samples, and exact ones.

    Parameters
    ----------
    problem : SearchProblem

    Attributes
    ----------
    sampled_only : bool
        Whether a path is curved: minima are then over the samples.
    """

    def __init__(self, problem: SearchProblem) -> None:
        self._problem = replace(problem, objective="noise")
        self.sampled_only = not problem.straight
        coarse = int(np.clip(_SAMPLES // problem.chips, 8, 64))
        noise = CodeCost(self._problem, oversampling=coarse)
        self._coarse = (noise.instead("min-mtf"), noise)
        noise = CodeCost.fine(self._problem)
        self._fine = (noise.instead("min-mtf"), noise, noise.instead("mse"))
        self._mirrored = problem.response is None and all(
            uniform_length_px(s.trajectory) is not None for s in problem.scenarios
        )

    def key(self, code: Codes) -> bytes:
        """Key of a code, the same for shifted and mirrored ones where these are equivalent."""
        if not self._mirrored:
            return code.tobytes()
        bits = np.trim_zeros(code).tobytes()
        return min(bits, bits[::-1])

    def quick(self, codes: Codes) -> FloatArray:
        """(R, 2) minimum over coarse samples, dB, and the negative of the noise."""
        return self._figures(self._coarse, codes)

    def exact(self, codes: Codes) -> FloatArray:
        """(R, 2) minimum, dB, and the negative of the noise; -inf for a zero."""
        figures = self._figures(self._fine[:2], codes)
        if not self.sampled_only:
            with np.errstate(divide="ignore"):
                figures[:, 0] = 20 * np.log10([self._minimum(ShutterCode(code)) for code in codes])
        return figures

    def points(self, codes: Sequence[Codes]) -> tuple[FrontPoint, ...]:
        """Judge codes in every figure."""
        if not len(codes):
            return ()
        array = np.array(codes, dtype=np.int8)
        mse_db = self._figures(self._fine[2:], array)[:, 0]
        unit = 1.0 if self._problem.scenarios else float(self._problem.chips)
        return tuple(
            FrontPoint(
                ShutterCode(code),
                unit * 10 ** (low / 20),
                # samples may well miss a zero, the mean over all does not
                -quiet if np.isfinite(low) else np.inf,
                int(code.sum()),
                -mse,
            )
            for code, (low, quiet), mse in zip(
                array, self.exact(array).tolist(), mse_db.tolist(), strict=True
            )
        )

    def _figures(self, code_costs: Sequence[CodeCost], codes: Codes) -> FloatArray:
        step = max(1, _NUMBERS // code_costs[0].rows[0, 0].size)
        parts = []
        for batch in (codes[i : i + step] for i in range(0, len(codes), step)):
            arguments = (
                code_costs[0].otf(batch),
                code_costs[0].duty(batch),
                code_costs[0].noise_of(batch),
            )
            parts.append(
                np.stack([-code_cost.cost(*arguments) for code_cost in code_costs], axis=1)
            )
        return np.concatenate(parts) if parts else np.empty((0, len(code_costs)))

    def _minimum(self, code: ShutterCode) -> float:
        problem = self._problem
        return min(
            continuum_minimum(problem, path, code) for path in problem.directed_paths() or (None,)
        )


class Archive:
    """Codes that no other beats.

    Parameters
    ----------
    judge : Judge
    problem : SearchProblem
        Its limits are kept.

    Attributes
    ----------
    codes : (R, n) int8
    values : (R, 2) float
        Minimum, dB, and the negative of the noise.
    """

    def __init__(self, judge: Judge, problem: SearchProblem) -> None:
        self.judge = judge
        self.problem = problem
        self.codes: Codes = np.empty((0, problem.chips), np.int8)
        self.values: FloatArray = np.empty((0, 2))
        self._first = 1 if judge.sampled_only else 0  # column from which figures count
        self._seen: set[bytes] = set()
        self._looked_around: set[bytes] = set()

    @property
    def counted(self) -> FloatArray:
        """Return the figures that count, (R, 2), or (R, 1) where minima do not."""
        return self.values[:, self._first :]

    def offer(self, codes: Codes) -> None:
        """Judge the codes that might be better on coarse samples, and keep those that are."""
        codes = np.unique(codes[self.problem.satisfied(codes)], axis=0)
        hopes = (self.judge.quick(codes) + _SLACK_DB)[:, self._first :]
        while len(codes):
            # coarse samples overestimate: a code dominated on them is dominated
            beaten = (self.counted[None] >= hopes[:, None]).all(axis=2).any(axis=1)
            codes = codes[~beaten]
            hopes = hopes[~beaten]
            chosen = np.flatnonzero(non_dominated(hopes))[:_JUDGED]
            self._judge([code for code in codes[chosen] if self.judge.key(code) not in self._seen])
            codes = np.delete(codes, chosen, axis=0)
            hopes = np.delete(hopes, chosen, axis=0)

    def look_around(self, rng: np.random.Generator) -> bool:
        """Offer all swaps of one code whose neighbours are not yet evaluated; False when there is
        none.
        """
        code = next((c for c in self.codes if c.tobytes() not in self._looked_around), None)
        if code is None:
            return False
        self._looked_around.add(code.tobytes())
        open_chips = np.flatnonzero(code)
        closed_chips = np.flatnonzero(code == 0)
        pairs = np.arange(open_chips.size * closed_chips.size)
        if pairs.size > _SWAPS:
            pairs = rng.choice(pairs, _SWAPS, replace=False)
        swapped = np.repeat(code[None], pairs.size, axis=0)
        if pairs.size:
            swapped[np.arange(pairs.size), open_chips[pairs // closed_chips.size]] = 0
            swapped[np.arange(pairs.size), closed_chips[pairs % closed_chips.size]] = 1
        self.offer(swapped)
        return True

    def _judge(self, codes: list[Codes]) -> None:
        fresh = {self.judge.key(code): code for code in codes}
        if not fresh:
            return
        self._seen |= fresh.keys()
        new = np.array(list(fresh.values()))
        values = self.judge.exact(new)
        sound = np.isfinite(values).all(axis=1) & (values[:, 1] > -HOPELESS_DB)
        all_values = np.concatenate([self.values, values[sound]])
        codes_of = np.concatenate([self.codes, new[sound]])
        counted = np.round(all_values[:, self._first :] / EQUAL_DB)
        keep = np.flatnonzero(non_dominated(counted))
        # of equal ones the first found
        keep = keep[np.sort(np.unique(counted[keep], axis=0, return_index=True)[1])]
        self.values = all_values[keep]
        self.codes = codes_of[keep]
