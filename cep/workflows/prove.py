"""Proof of the best code in blocks, on processes or a Dask cluster; finished blocks stay on disk."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from cep.codes.optima import OPTIMA
from cep.jobs.engine import run_tasks
from cep.optics.code import ShutterCode
from cep.proofs.certify.minimum import chip_minimum, min_chip
from cep.search.exhaustive.block_proof import BlockPlan, certified, core, judge_block, plan_blocks
from cep.search.exhaustive.proof import BlockLog, ExactResult
from cep.search.exhaustive.proof_file import ProofFile
from cep.search.problem import SearchProblem
from cep.search.recipe import search_code

__all__ = ["best_of", "prove"]

_TIE = 1e-8  # minima as close as this are equal: the brighter code wins, then the shorter, then the first bits
_START_STEPS = 4_000_000  # moves of the annealing that sets the first bound
_FIRST_ROUND = 4  # blocks a worker, the next round twice as many: early ones find the better codes


def prove(
    problem: SearchProblem,
    *,
    folder: Path | str,
    workers: int = 1,
    dask: str | None = None,
    progress: Callable[[float, ShutterCode], None] | None = None,
    threads: int | None = None,
) -> ExactResult:
    """Find the code with the largest minimum of |P| over the unit circle, and prove it block by block.

    Parameters
    ----------
    problem : SearchProblem
        Objective "min-mtf", without scenarios, and without limits but on the number of open chips.
    folder : path
        Of the proof, made where it is missing; a proof in it is continued.
    workers : int
        Processes; 1 runs in this one.
    dask : str, optional
        Address of the scheduler of a cluster to run on instead.
    progress : callable, optional
        Called with the fraction of the codes accounted for and the best code so far.
    threads : int, optional
        Of the annealing; the first bound is the better one of its code's and of the optima's known for fewer chips.

    Returns
    -------
    ExactResult
        Of equal minima the brightest code, then the shortest. Ctrl-C returns the best so far.

    Raises
    ------
    ValueError
        If the problem is another one, or the folder holds another proof or a damaged one.
    OSError
        If the proof cannot be written.
    RuntimeError
        If a block fails, or the cluster does; finished blocks are kept.
    """
    began_s = time.monotonic()
    plan = plan_blocks(problem)
    with ProofFile.open(folder, plan) as proof:
        best = best_of(plan, proof.records.values())
        try:
            if not best and proof.missing:
                best = _first(problem, threads)
            _judge(proof, best, workers, dask, progress)
        except KeyboardInterrupt:  # the file says what is missing
            pass
        best = best_of(plan, proof.records.values()) or best
        if not best:
            raise KeyboardInterrupt
        return _result(proof, best, time.monotonic() - began_s)


def best_of(plan: BlockPlan, records: Any) -> str:
    """Return the best survivor of some records, closed chips added behind it; empty where there is none."""
    found: dict[str, float] = {}
    for record in records:
        found |= zip(record["survivors"].split(), map(float, record["minima"].split()), strict=True)
    if not found:
        return ""
    least = max(found.values()) * (1 - _TIE)
    equal = [bits for bits, value in found.items() if value >= least]
    return max(equal, key=lambda bits: (bits.count("1"), -len(bits), bits)).ljust(plan.chips, "0")


def _first(problem: SearchProblem, threads: int | None) -> str:
    """Return a code to begin with, proven for fewer chips or annealed; the outcome does not depend on it."""
    found = search_code(problem, rng=np.random.default_rng(0), steps=_START_STEPS, time_s=math.inf, threads=threads)
    known = (bits.ljust(problem.chips, "0") for bits in OPTIMA if len(bits) <= problem.chips)
    allowed = (code for bits in known if problem.allows(code := ShutterCode(bits)))
    best = max((found.code, *allowed), key=min_chip)
    return core(best.bits).ljust(problem.chips, "0")


def _judge(
    proof: ProofFile,
    best: str,
    workers: int,
    dask: str | None,
    progress: Callable[[float, ShutterCode], None] | None,
) -> None:
    """Judge the missing blocks, round by round: each round has the best bound that was known at its start."""
    plan = proof.plan
    done = sum(plan.blocks[index].codes for index in proof.records)
    bound = certified(best.rstrip("0")) if best else 0.0
    waiting, size = proof.missing, _FIRST_ROUND * max(workers, 1)
    while waiting:
        now, waiting = waiting[:size], waiting[size:]
        if progress is not None:
            progress(done / plan.codes, ShutterCode(best))
        tasks = {str(index): (judge_block, _arguments(plan, index, bound)) for index in now}
        with closing(run_tasks(tasks, workers=workers, dask=dask)) as finishing:
            for key, finished in finishing:
                if finished.failure:
                    raise RuntimeError(f"block {key}: {finished.failure}; finished blocks are kept, run again to go on")
                proof.keep(finished.figures)
                done += plan.blocks[int(key)].codes
                best = best_of(plan, proof.records.values()) or best
                if progress is not None:
                    progress(done / plan.codes, ShutterCode(best))
        bound = max(bound, certified(best.rstrip("0")))
        size *= 2


def _arguments(plan: BlockPlan, index: int, bound: float) -> Mapping[str, Any]:
    block = plan.blocks[index]
    return {
        "chips": plan.chips, "fewest": plan.fewest, "most": plan.most, "first": block.first, "until": block.until,
        "bound": bound,
    }  # fmt: skip


def _result(proof: ProofFile, best: str, seconds: float) -> ExactResult:
    plan, code = proof.plan, ShutterCode(best)
    minimum = chip_minimum(code)
    records = proof.records.values()
    complete = not proof.missing
    bound = max((record["bound"] for record in records), default=0.0)
    # a bound above the best code would have hidden the codes between
    proven = complete and bound <= minimum.upper
    log = BlockLog(
        chips=plan.chips, limits={"fewest_open": plan.fewest, "most_open": plan.most}, domain="the unit circle",
        file=str(proof.path), blocks=len(plan.blocks), finished=len(records), codes=plan.codes,
        judged=sum(record["codes"] for record in records), bound=bound, bits=best, lower=minimum.lower,
        upper=minimum.upper if proven else math.sqrt(plan.most), cpu_s=sum(record["seconds"] for record in records),
    )  # fmt: skip
    return ExactResult(code, minimum, log, seconds, proven)
