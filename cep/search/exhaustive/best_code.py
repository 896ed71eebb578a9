"""Best code of an exhaustive search so far: minima of the offered codes, in float64."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cep.optics.band import band_samples, circle_samples
from cep.optics.code import ShutterCode
from cep.optics.exposure import chip_basis
from cep.proofs.certify.minimum import Minimum, chip_minimum, min_chip, mtf_minimum
from cep.search.exhaustive.blocks import MARGIN
from cep.search.exhaustive.scan import dot
from cep.search.problem import SearchProblem

Codes = NDArray[np.uint64]
Patterns = NDArray[np.int8]
# minima as close as this are equal: the brighter code wins, then the shorter, then the first bits
_TIE = 1e-9
_RESTARTS = 16  # random codes from which the first limit is climbed to
_CLIMBED = 20  # chips below which no climb is needed
_SEEN = 256  # frequencies at which a climb judges: it only has to be good, the scan proves
_OVERSAMPLING = 8  # frequencies per 1 / chips on the unit circle
_BATCH = 2**13  # codes judged at once
_DARK = 1e-9  # |H| at which no code passes anything
_LEAST = 1e-6  # relative gain of a step


class BestCode:
    """The best of the codes offered, and the limit that it sets for all others.

    Attributes
    ----------
    on_circle : bool
        Whether minima are over the whole unit circle, in chips; otherwise at band samples. On the
        circle shifts are as good as the code, and so its mirror images that keep the limits.
    basis : (n, Q) complex
        Contribution of each chip at all frequencies.
    bits : str
        Empty before a code was offered.
    value : float
        Minimum of that code.
    limit : float
        Proven minimum below which codes are discarded.
    ceiling : float
        Largest minimum judged.
    """

    def __init__(self, problem: SearchProblem) -> None:
        self.problem = problem
        self.on_circle = not problem.scenarios
        self.basis = _basis(problem)
        if np.abs(self.basis).sum(axis=0).min() < _DARK:
            raise ValueError(
                "scenarios: at some frequency no code passes anything, every minimum is 0"
            )
        self.bits = ""
        self.value = -1.0
        self.limit = 0.0
        self.ceiling = 0.0

    def offer(self, codes: Codes) -> None:
        """Judge codes in float64; the best one sets the limit."""
        for at in range(0, codes.size, _BATCH):
            words = codes[at : at + _BATCH, None] >> np.arange(self.problem.chips, dtype=np.uint64)
            bits = (words & np.uint64(1)).astype(np.int8)
            bits = bits[self.problem.satisfied(bits)]
            sampled = np.abs(dot(bits, self.basis)).min(axis=1)
            for index in np.argsort(-sampled, kind="stable"):
                if sampled[index] < self.limit * (1 - MARGIN):
                    break  # all that follow are lower still
                self._consider(bits[index], float(sampled[index]))

    def _consider(self, bits: NDArray[np.int8], sampled: float) -> None:
        name = "".join(str(int(bit)) for bit in bits)
        if self.on_circle:
            # at the start; of two mirror images the one that opens more and earlier
            core = name.strip("0")
            if self.problem.mirrors:
                core = max(core, core[::-1])
            name = core.ljust(bits.size, "0")
        value = sampled
        if self.on_circle:  # the minimum may lie between the samples
            value = min(sampled, min_chip(ShutterCode(name)))
        self.ceiling = max(self.ceiling, value)
        tie = _TIE * max(value, 1e-3)
        if value > self.value + tie:
            limit = value
            if self.on_circle:  # what discards others must be proven itself
                limit = chip_minimum(ShutterCode(name)).lower
            self.limit = max(self.limit, limit)
        elif value <= self.value - tie or _rank(name) <= _rank(self.bits):
            return
        self.bits = name
        self.value = max(value, self.value)

    def minimum(self) -> Minimum:
        """Certify the minimum of the best code over the continuum, the worst of all motions."""
        code = ShutterCode(self.bits)
        if self.on_circle:
            return chip_minimum(code)
        minima = [
            mtf_minimum(scenario.path(reversed_path=is_reversed), code)
            for scenario, is_reversed in self.problem.ways()
        ]
        worst = min(minima, key=lambda minimum: minimum.upper)
        return replace(worst, lower=min(minimum.lower for minimum in minima))

    def climb(self) -> None:
        """Climb from random codes, for a good limit from the start: the outcome is the same."""
        if self.problem.chips < _CLIMBED:
            return
        rng = np.random.default_rng(0)
        sample = self.basis[:, rng.permutation(self.basis.shape[1])[:_SEEN]]
        # where few codes keep the limits, one pulse may be among them
        single = np.eye(self.problem.chips, dtype=np.int8)[[0, self.problem.chips // 2]]
        single = single[self.problem.satisfied(single)]
        starts = [*self.problem.random_codes(_RESTARTS, rng=rng), *single]
        for code in starts:
            self.offer(packed(climbed(code, sample, self.problem.satisfied)))


def packed(code: Patterns) -> Codes:
    """Pack a code into a word, the first chip in its lowest bit."""
    places = np.arange(code.size, dtype=np.uint64)
    return np.array([(code.astype(np.uint64) << places).sum()], dtype=np.uint64)


def _basis(problem: SearchProblem) -> NDArray[np.complex128]:
    """Contribution of each chip at all frequencies, (n, Q): in chips on the circle."""
    if not problem.scenarios:
        samples = circle_samples(problem.chips, oversampling=_OVERSAMPLING)
        phases = -2j * np.pi * np.arange(problem.chips)[:, None] * samples.fx
        return np.asarray(np.exp(phases), dtype=np.complex128)
    rows = []
    for scenario, is_reversed in problem.ways():
        path = scenario.path(reversed_path=is_reversed)
        samples = band_samples(path)
        rows.append(chip_basis(path, problem.chips, samples.fx, samples.fy))
    return np.concatenate(rows, axis=1)


def _rank(bits: str) -> tuple[int, int, str]:
    """Sort codes of equal minima: brighter, then shorter, then those that open earlier."""
    return bits.count("1"), -len(bits.strip("0")), bits


def climbed(
    code: Patterns,
    basis: NDArray[np.complex128],
    satisfied: Callable[[Patterns], NDArray[np.bool_]],
) -> Patterns:
    """Flip the one or two chips that raise the smallest |H| most, for as long as any do.

    Parameters
    ----------
    code : (n,) int8
    basis : (n, Q) complex
        Contribution of each chip at each frequency.
    satisfied : callable
        Which of (R, n) codes may be visited.
    """
    first, second = np.triu_indices(code.size)
    best = -1.0
    while True:
        neighbours = np.repeat(code[None], first.size, axis=0)
        rows = np.arange(first.size)
        neighbours[rows, first] ^= 1
        # a pair of one chip and itself is a single flip
        neighbours[rows, second] ^= (first != second).astype(np.int8)
        neighbours = neighbours[satisfied(neighbours)]
        lowest = np.abs(dot(neighbours, basis)).min(axis=1, initial=np.inf)
        if not len(neighbours) or lowest.max() <= best + _LEAST * abs(best):
            return code
        code = neighbours[lowest.argmax()]
        best = float(lowest.max())
