"""Proof of the best code in blocks, on the cores of this machine or a Dask cluster; finished
blocks stay on disk.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from cep.jobs.cells import Finished
from cep.jobs.engine import run_tasks
from cep.jobs.executors import Task, in_threads
from cep.optics.code import ShutterCode
from cep.proofs.certify.minimum import chip_minimum
from cep.search.exhaustive.block_proof import BlockPlan, certified, core, judge_block, plan_blocks
from cep.search.exhaustive.proof import BlockLog, ExactResult
from cep.search.exhaustive.proof_file import ProofFile
from cep.search.problem import SearchProblem
from cep.search.recipe import search_code

# minima as close as this are equal: the brighter code wins, then the shorter, then the first bits
_TIE = 1e-8
_START_STEPS = 4_000_000  # moves of the annealing that sets the first bound
_FIRST_ROUND = (
    4  # blocks of a cluster, the next round twice as many: early ones find the better codes
)


def prove(
    problem: SearchProblem,
    *,
    folder: Path | str,
    workers: int = 1,
    dask: str | None = None,
    progress: Callable[[float, ShutterCode], None] | None = None,
    threads: int | None = None,
) -> ExactResult:
    """Find the code with the largest minimum of |P| over the unit circle, and prove it block by
    block.

    Parameters
    ----------
    problem : SearchProblem
        Objective "min-mtf", without scenarios, and without limits but on the number of open chips.
    folder : path
        Of the proof, made where it is missing; a proof in it is continued.
    workers : int
        Threads that judge blocks; the compiled code lets them run side by side.
    dask : str, optional
        Address of the scheduler of a cluster to run on instead.
    progress : callable, optional
        Called with the fraction of the codes accounted for and the best code so far.
    threads : int, optional
        Of the annealing for the first bound, which starts from the bundled codes.

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
    """Return the best survivor of some records, closed chips added behind it; empty where there is
    none.
    """
    found: dict[str, float] = {}
    for record in records:
        found |= zip(
            record["survivors"].split(), map(float, record["minima"].split()), strict=True
        )
    if not found:
        return ""
    least = max(found.values()) * (1 - _TIE)
    equal = [bits for bits, value in found.items() if value >= least]
    return max(equal, key=lambda bits: (bits.count("1"), -len(bits), bits)).ljust(plan.chips, "0")


def _first(problem: SearchProblem, threads: int | None) -> str:
    """Return a code to begin with, proven before or annealed; the outcome does not depend on
    it.
    """
    found = search_code(
        problem, rng=np.random.default_rng(0), steps=_START_STEPS, time_s=math.inf, threads=threads
    )
    return core(found.code.bits).ljust(problem.chips, "0")


def _judge(
    proof: ProofFile,
    best: str,
    workers: int,
    dask: str | None,
    progress: Callable[[float, ShutterCode], None] | None,
) -> None:
    """Judge the missing blocks, each with the best bound that is known when it is handed out."""
    plan = proof.plan
    done = sum(plan.blocks[index].codes for index in proof.records)
    bound = certified(best.rstrip("0")) if best else 0.0
    tasks = (_task(plan, index, bound) for index in proof.missing)  # "bound" is that of the moment
    stream = _in_rounds(tasks, dask) if dask is not None else in_threads(tasks, workers)
    if progress is not None:
        progress(done / plan.codes, ShutterCode(best))
    with closing(stream) as finishing:
        for key, finished in finishing:
            if finished.failure:
                raise RuntimeError(
                    f"block {key}: {finished.failure}; finished blocks are kept, run again to"
                    " go on"
                )
            proof.keep(finished.figures)
            done += plan.blocks[int(key)].codes
            better = best_of(plan, proof.records.values()) or best
            if better != best:
                best = better
                bound = max(bound, certified(better.rstrip("0")))
            if progress is not None:
                progress(done / plan.codes, ShutterCode(best))


def _in_rounds(tasks: Iterator[Task], dask: str) -> Generator[tuple[str, Finished]]:
    """Yield the blocks of a cluster, which is given a whole round at once; each round is twice the
    one before.
    """
    size = _FIRST_ROUND
    while now := dict(islice(tasks, size)):
        yield from run_tasks(now, workers=1, dask=dask)
        size *= 2


def _task(plan: BlockPlan, index: int, bound: float) -> Task:
    block = plan.blocks[index]
    given = {
        "chips": plan.chips,
        "fewest": plan.fewest,
        "most": plan.most,
        "first": block.first,
        "until": block.until,
        "bound": bound,
    }
    return str(index), (judge_block, given)


def _result(proof: ProofFile, best: str, seconds: float) -> ExactResult:
    plan = proof.plan
    code = ShutterCode(best)
    minimum = chip_minimum(code)
    records = proof.records.values()
    complete = not proof.missing
    bound = max((record["bound"] for record in records), default=0.0)
    # a bound above the best code would have hidden the codes between
    proven = complete and bound <= minimum.upper
    log = BlockLog(
        chips=plan.chips,
        limits={"fewest_open": plan.fewest, "most_open": plan.most},
        domain="the unit circle",
        file=str(proof.path),
        blocks=len(plan.blocks),
        finished=len(records),
        codes=plan.codes,
        judged=sum(record["codes"] for record in records),
        bound=bound,
        bits=best,
        lower=minimum.lower,
        upper=minimum.upper if proven else math.sqrt(plan.most),
        cpu_s=sum(record["seconds"] for record in records),
    )
    return ExactResult(code, minimum, log, seconds, proven)
