"""Proven optimum by exhaustive search: codes are discarded where |H| is below the best minimum.

On the unit circle a shift in time and the reversal change nothing, so the codes of n chips are
those of every length up to n with both end chips open, one of each mirror pair, or both where the
reversal may break the limit on the pulses' period. :mod:`cep.search.exhaustive.scan` discards
nearly all of them, billions a second. The few that it leaves are judged in float64, and the winner
is certified over the continuum.

References
----------
arXiv 1910.13994 enumerates Newman polynomials (0/1 coefficients) up to degree 40 for a smallest
modulus above 2 on the unit circle: the first has degree 38. There the degree counts; for a shutter
the light does as well.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from os import cpu_count
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from cep.optics.band import band_samples, circle_samples
from cep.optics.code import ShutterCode
from cep.optics.exposure import chip_basis
from cep.proofs.certify.minimum import Minimum, chip_minimum, min_chip, mtf_minimum
from cep.search.annealing.anneal import anneal
from cep.search.annealing.proposals import LoopLimits
from cep.search.exhaustive.scan import BYTES, INNER, dot
from cep.search.exhaustive.scan_tables import MARGIN, LimitTables, Scanner
from cep.search.problem import SearchProblem

Codes = NDArray[np.uint64]
Progress = Callable[[float, ShutterCode], None]
_SLICE = 2**30  # codes between looks at Ctrl-C: a tenth of a second
_SLICES = 128  # at least, of a long proof, so that a better code helps it
# slices side by side, the next round twice as many: early ones find the better codes
_FIRST_ROUND = 16
_GROWTH = 1.01  # of the limit, at which the scan's tables are made again
# minima as close as this are equal: the brighter code wins, then the shorter, then the first bits
_TIE = 1e-9
_ANNEALED = 20  # chips from which an annealing gives the first limit
_ANNEALED_MOVES = 2**18  # its code only has to be good, the scan proves
_OVERSAMPLING = 8  # frequencies per 1 / chips on the unit circle
_BATCH = 2**13  # codes judged at once
_DARK = 1e-9  # |H| at which no code passes anything


@dataclass(frozen=True)
class LengthLog:
    """Counts for the codes of one length (all codes, along a trajectory).

    Attributes
    ----------
    length : int
        Chips between the first and the last open one.
    codes : int
        Codes of that length, each way round counted.
    judged : int
        Codes within the limit on light that the scan took up: mirror images mostly once, and none
        that break a run limit in their first, last or middle chips.
    complete : bool
    """

    length: int
    codes: int
    judged: int = 0
    complete: bool = False


@dataclass(frozen=True)
class ProofLog:
    """Log of a proof, sufficient to repeat it.

    Attributes
    ----------
    chips : int
    limits : dict
        Limits on light and runs.
    domain : str
        Frequencies of the minimum.
    lengths : tuple of LengthLog
    margin : float
        Relative rounding allowance: codes are discarded below (1 - margin) times the best code's
        certified minimum.
    bits : str
        Best code.
    lower, upper : float
        The largest minimum lies between them; ``upper`` is Parseval's bound until the proof is
        complete.
    versions : dict
    """

    chips: int
    limits: dict[str, int | str | None]
    domain: str
    lengths: tuple[LengthLog, ...]
    margin: float
    bits: str
    lower: float
    upper: float
    versions: dict[str, str]

    @property
    def complete(self) -> bool:
        """Whether every code was accounted for."""
        return all(entry.complete for entry in self.lengths)


@dataclass(frozen=True, kw_only=True)
class BundledLog:
    """What a proof covers that was made before and comes with the package.

    Attributes
    ----------
    chips : int
        Most chips of the codes that it covers.
    limits : dict
    domain : str
    file : str
        The proof, or the page with its table, in the documentation.
    bits : str
        Best code.
    lower, upper : float
        The largest minimum lies between them.
    judged : int
        Codes judged in this run.
    """

    chips: int
    limits: dict[str, int | str | None]
    domain: str
    file: str
    bits: str
    lower: float
    upper: float
    judged: int = 0


@dataclass(frozen=True)
class ExactResult:
    """The best code of all, or the best so far.

    Attributes
    ----------
    code : ShutterCode
    minimum : Minimum
        Of |P| on the unit circle in chips, or of |H| over the band along the worst of the
        problem's trajectories.
    proof : ProofLog or BundledLog
    seconds : float
    proven : bool
        Whether no code is better; False when interrupted.
    """

    code: ShutterCode
    minimum: Minimum
    proof: ProofLog | BundledLog
    seconds: float
    proven: bool


def codes_to_count(problem: SearchProblem) -> int:
    """Count the codes that a proof goes through, mirror images mostly once."""
    if problem.scenarios:
        return int(2**problem.chips)
    return int(2 ** max(problem.chips - 1 - problem.mirrors, 0))


def exact(
    problem: SearchProblem, *, progress: Progress | None = None, threads: int | None = None
) -> ExactResult:
    """Find the code with the largest minimum of |H|, and prove it.

    Parameters
    ----------
    problem : SearchProblem
        Objective "min-mtf". Without scenarios the minimum is over the whole unit circle; with them
        it is the smallest at their band samples, in every direction that counts.
    progress : callable, optional
        Called repeatedly with the fraction done, 0..1, and the best code so far. It may raise
        KeyboardInterrupt.
    threads : int, optional
        All cores when omitted. The result does not depend on it.

    Returns
    -------
    ExactResult
        Of equal minima the brightest code is taken, then the shortest. Ctrl-C returns the best so
        far.

    Raises
    ------
    ValueError
        For another objective, too many chips, or a motion that no code can serve.
    """
    start_s = time.monotonic()
    if problem.frames == 2:
        raise ValueError("frames: not valid with method='exact', which counts codes of one camera")
    if [name for name, _ in problem.objective_mix] != ["min-mtf"] or problem.rule != "worst":
        raise ValueError(
            'objective: only the largest "min-mtf" in the worst scenario can be proven'
        )
    if problem.chips > 8 * BYTES:
        raise ValueError(f"chips: at most {8 * BYTES} can be counted out, got {problem.chips}")
    # through ramps |H| depends on neighbours, so that parts of a code cannot be summed alone
    if problem.response is not None and not problem.response.instant:
        raise ValueError(
            "response: a proof needs a shutter that opens at once, leave the response out"
        )
    best = BestCode(problem)
    proof = _Proof(best)
    try:
        best.anneal()
        proof.count(progress, threads or cpu_count() or 1)
    except KeyboardInterrupt:
        pass  # the log says what is missing
    if not best.bits:
        raise KeyboardInterrupt
    minimum = best.minimum()
    log = proof.log(minimum)
    seconds = time.monotonic() - start_s
    return ExactResult(ShutterCode(best.bits), minimum, log, seconds, log.complete)


class _Proof:
    """All codes of a problem, length by length, and their counts."""

    def __init__(self, best: BestCode) -> None:
        self.best = best
        self.problem = best.problem
        self.limits = LoopLimits.of(best.problem)
        self.tables: LimitTables | None = None
        self.lock = Lock()
        n = best.problem.chips
        sizes = {n: 2**n - 1}
        if best.on_circle:  # of each length those with both ends open
            sizes = {m: 2 ** max(m - 2, 0) for m in range(1, n + 1)}
        self.logs = {length: LengthLog(length, codes) for length, codes in sizes.items()}

    def count(self, progress: Progress | None, threads: int) -> None:
        """Go through all codes, length by length."""
        total = sum(entry.codes for entry in self.logs.values())
        before = 0
        for length, entry in list(self.logs.items()):

            def report(share: float, before: int = before, codes: int = entry.codes) -> None:
                if progress is not None and self.best.bits:
                    progress((before + share * codes) / total, ShutterCode(self.best.bits))

            # shorter codes have no chips beside the inner block and the two ends
            if length < INNER + 2:
                self._list(length)
            else:
                self._scan(length, threads, report)
            before += entry.codes
            report(1.0, before - entry.codes)

    def _list(self, length: int) -> None:
        # so few codes that each is judged
        codes = np.arange(1, 2**length, dtype=np.uint64)
        if self.best.on_circle:
            codes = codes[((codes & np.uint64(1)) == 1) & ((codes >> np.uint64(length - 1)) == 1)]
        self.best.offer(codes)
        self.logs[length] = replace(self.logs[length], judged=codes.size, complete=True)

    def _scan(self, length: int, threads: int, report: Callable[[float], None]) -> None:
        halt = np.zeros(1, dtype=np.bool_)
        todo = list(self._scanner(length).spans(min(_SLICE, max(2**16, 2**length // _SLICES))))
        total = len(todo)
        scanned = 0
        size = _FIRST_ROUND
        with ThreadPoolExecutor(threads) as pool:
            try:
                while todo:
                    # a round has one limit, so that what is discarded where does not depend on who
                    # is faster
                    scanner = self._scanner(length)
                    batch = todo[:size]
                    todo = todo[size:]
                    running = [pool.submit(self._slice, scanner, span, halt) for span in batch]
                    for future in as_completed(running):
                        count = self.logs[length].judged + future.result()
                        self.logs[length] = replace(self.logs[length], judged=count)
                        scanned += 1
                        report(scanned / total)
                    size *= 2
            finally:
                halt[0] = True
        self.logs[length] = replace(self.logs[length], complete=True)

    def _scanner(self, length: int) -> Scanner:
        if self.tables is None:
            self.tables = LimitTables(self.best.basis, self.limits, self.best.limit)
        elif self.best.limit > _GROWTH * self.tables.limit:
            self.tables = self.tables.tightened(self.best.limit)
        return Scanner(
            self.tables, length, ends_open=self.best.on_circle, mirrors=self.problem.mirrors
        )

    def _slice(self, scanner: Scanner, heads: tuple[int, int], halt: NDArray[np.bool_]) -> int:
        # the scan leaves off here where its buffer is full, and goes on from here
        span = np.array([*heads, 0], dtype=np.int64)
        scanned = np.zeros(1, dtype=np.int64)
        room = scanner.buffer()
        while span[0] < span[1] and not halt[0]:
            survivors = scanner.run(span, room, scanned, halt)
            with self.lock:
                self.best.offer(survivors)
        return int(scanned[0])

    def log(self, minimum: Minimum) -> ProofLog:
        """Log the proof, with the certified minimum of the best code."""
        best = self.best
        low, high = self.problem.open_limits
        # until all is judged: mean |P|^2 is the number of open chips; |H| nowhere exceeds the duty
        upper = float(np.sqrt(high)) if best.on_circle else high / self.problem.chips
        if all(entry.complete for entry in self.logs.values()):
            upper = best.ceiling
        return ProofLog(
            chips=self.problem.chips,
            limits={"fewest_open": low, "most_open": high} | asdict(self.problem.runs),
            domain="the unit circle" if best.on_circle else f"{best.basis.shape[1]} band samples",
            lengths=tuple(self.logs.values()),
            margin=MARGIN,
            bits=best.bits,
            lower=minimum.lower if best.on_circle else best.value,
            upper=upper,
            versions={name: version(name) for name in ("numpy", "numba")},
        )


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
        minima = [mtf_minimum(path, code) for path in self.problem.directed_paths()]
        worst = min(minima, key=lambda minimum: minimum.upper)
        return replace(worst, lower=min(minimum.lower for minimum in minima))

    def anneal(self) -> None:
        """Offer an annealed code, for a good limit from the start: the outcome is the same."""
        if self.problem.chips < _ANNEALED:
            return
        annealed = anneal(self.problem, rng=np.random.default_rng(0), steps=_ANNEALED_MOVES)
        self.offer(np.array([int(annealed.code.bits[::-1], 2)], dtype=np.uint64))
        if annealed.stopped == "interrupted":
            raise KeyboardInterrupt


def _basis(problem: SearchProblem) -> NDArray[np.complex128]:
    """Contribution of each chip at all frequencies, (n, Q): in chips on the circle."""
    if not problem.scenarios:
        samples = circle_samples(problem.chips, oversampling=_OVERSAMPLING)
        phases = -2j * np.pi * np.arange(problem.chips)[:, None] * samples.fx
        return np.asarray(np.exp(phases), dtype=np.complex128)
    rows = []
    for path in problem.directed_paths():
        samples = band_samples(path)
        rows.append(chip_basis(path, problem.chips, samples.fx, samples.fy))
    return np.concatenate(rows, axis=1)


def _rank(bits: str) -> tuple[int, int, str]:
    """Sort codes of equal minima: brighter, then shorter, then those that open earlier."""
    return bits.count("1"), -len(bits.strip("0")), bits
