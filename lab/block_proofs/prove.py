"""Proof of the largest minimum of |P| in blocks, on this machine's cores or a Dask cluster."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from cep.optics.code import ShutterCode
from cep.proofs.certify.minimum import Minimum, chip_minimum
from cep.search.code_search import SearchOptions, search_code
from cep.search.problem import SearchProblem
from lab.block_proofs.blocks import BlockPlan, certified, core, judge_block, plan_blocks
from lab.block_proofs.proof_file import ProofFile
from lab.jobs.cells import Finished, worked
from lab.jobs.engine import run_tasks
from lab.jobs.executors import Task

Progress = Callable[[float, ShutterCode], None]

# minima as close as this are equal: the brighter code wins, then the shorter, then the first bits
_TIE = 1e-8
_START_STEPS = 4_000_000  # moves of the annealing that sets the first bound
# blocks of a cluster's first round, the next one twice as many: early blocks find better codes,
# whose bounds spare the later ones work
_FIRST_ROUND = 4


@dataclass(frozen=True, kw_only=True)
class BlockProof:
    """State of a proof in blocks; its records are in the file.

    Attributes
    ----------
    plan : BlockPlan
    file : Path
    code : ShutterCode
        The best code so far: of equal minima the brightest, then the shortest.
    minimum : Minimum
        Of its |P| on the unit circle.
    finished : int
        Blocks judged.
    judged : int
        Codes of the ring that these account for.
    bound : float
        The highest under which a block was judged.
    proven : bool
        Whether no code is better; False when interrupted.
    cpu_s : float
        Processor time of the finished blocks.
    seconds : float
    """

    plan: BlockPlan
    file: Path
    code: ShutterCode
    minimum: Minimum
    finished: int
    judged: int
    bound: float
    proven: bool
    cpu_s: float
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """Give the state as JSON-ready data."""
        return {
            "file": self.file,
            "bits": self.code.bits,
            "chips": self.plan.chips,
            "limits": {"fewest_open": self.plan.fewest, "most_open": self.plan.most},
            "domain": "the unit circle",
            "blocks": len(self.plan.blocks),
            "finished": self.finished,
            "codes": self.plan.codes,
            "judged": self.judged,
            "bound": self.bound,
            "lower": self.minimum.lower,
            # mean |P|^2 is the number of open chips (Parseval)
            "upper": self.minimum.upper if self.proven else math.sqrt(self.plan.most),
            "proven": self.proven,
            "cpu_s": self.cpu_s,
            "seconds": self.seconds,
        }


def prove(
    chips: int,
    open_range: tuple[int, int],
    *,
    folder: Path | str,
    workers: int = 1,
    dask: str | None = None,
    progress: Progress | None = None,
    threads: int | None = None,
) -> BlockProof:
    """Find the code with the largest minimum of |P| over the unit circle, and prove it.

    Parameters
    ----------
    chips : int
        Longest code.
    open_range : (int, int)
        Fewest and most open chips.
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
    BlockProof
        Ctrl-C returns the best so far.

    Raises
    ------
    ValueError
        If the limits are not valid, or the folder holds another proof or a damaged one.
    OSError
        If the proof cannot be written.
    RuntimeError
        If a block fails, or the cluster does; finished blocks are kept.
    """
    start_s = time.monotonic()
    plan = plan_blocks(chips, *open_range)
    with ProofFile.open(folder, plan) as proof:
        best = best_survivor(plan, proof.records.values())
        try:
            if not best and proof.missing:
                best = _first_code(plan, threads)
            _judge(proof, best, workers, dask, progress)
        except KeyboardInterrupt:  # the file says what is missing
            pass
        best = best_survivor(plan, proof.records.values()) or best
        if not best:
            raise KeyboardInterrupt
        return _state(proof, best, time.monotonic() - start_s)


def best_survivor(plan: BlockPlan, records: Iterable[Mapping[str, Any]]) -> str:
    """Return the best survivor of some records, closed chips added behind it; empty if none."""
    minima: dict[str, float] = {}
    for record in records:
        minima |= zip(
            record["survivors"].split(), map(float, record["minima"].split()), strict=True
        )
    if not minima:
        return ""
    limit = max(minima.values()) * (1 - _TIE)
    equal = [bits for bits, minimum in minima.items() if minimum >= limit]
    return max(equal, key=lambda bits: (bits.count("1"), -len(bits), bits)).ljust(plan.chips, "0")


def _first_code(plan: BlockPlan, threads: int | None) -> str:
    """Return a code proven before or annealed; it sets the first bound, not the outcome."""
    problem = SearchProblem.along(chips=plan.chips, open_range=(plan.fewest, plan.most))
    start = search_code(problem, SearchOptions(steps=_START_STEPS), threads=threads)
    return core(start.code.bits).ljust(plan.chips, "0")


def _judge(
    proof: ProofFile, best: str, workers: int, dask: str | None, progress: Progress | None
) -> None:
    """Judge the missing blocks, each with the best bound that is known when it is handed out."""
    plan = proof.plan
    codes = sum(plan.blocks[index].codes for index in proof.records)
    bound = certified(best.rstrip("0")) if best else 0.0
    # a generator: each task takes the bound of the moment it is drawn
    tasks = (_task(plan, index, bound) for index in proof.missing)
    stream = _in_threads(tasks, workers) if dask is None else _in_rounds(tasks, dask)
    if progress is not None:
        progress(codes / plan.codes, ShutterCode(best))
    with closing(stream) as finishing:
        for key, block in finishing:
            if block.failure:
                raise RuntimeError(
                    f"block {key}: {block.failure}; finished blocks are kept, run again to go on"
                )
            proof.keep(block.figures)
            codes += plan.blocks[int(key)].codes
            better = best_survivor(plan, proof.records.values()) or best
            if better != best:
                best = better
                bound = max(bound, certified(better.rstrip("0")))
            if progress is not None:
                progress(codes / plan.codes, ShutterCode(best))


def _in_threads(tasks: Iterator[Task], workers: int) -> Generator[tuple[str, Finished]]:
    """Yield the blocks of threads; a task is drawn just before a thread is free for it."""

    def run(task: Task) -> tuple[str, Finished]:
        key, call = task
        return key, worked(*call)

    with ThreadPoolExecutor(workers) as pool:
        try:
            running = [pool.submit(run, task) for task in islice(tasks, workers + 1)]
            while running:
                wait(running, return_when=FIRST_COMPLETED)
                for future in [future for future in running if future.done()]:
                    running.remove(future)
                    yield future.result()
                    running += [pool.submit(run, task) for task in islice(tasks, 1)]
        finally:
            pool.shutdown(cancel_futures=True)


def _in_rounds(tasks: Iterator[Task], dask: str) -> Generator[tuple[str, Finished]]:
    """Yield the blocks of a cluster, which is given a whole round at once."""
    size = _FIRST_ROUND
    while batch := dict(islice(tasks, size)):
        yield from run_tasks(batch, workers=1, dask=dask)
        size *= 2


def _task(plan: BlockPlan, index: int, bound: float) -> Task:
    block = plan.blocks[index]
    arguments = {
        "chips": plan.chips,
        "fewest": plan.fewest,
        "most": plan.most,
        "first": block.first,
        "until": block.until,
        "bound": bound,
    }
    return str(index), (judge_block, arguments)


def _state(proof: ProofFile, best: str, seconds: float) -> BlockProof:
    minimum = chip_minimum(ShutterCode(best))
    records = proof.records.values()
    bound = max((record["bound"] for record in records), default=0.0)
    return BlockProof(
        plan=proof.plan,
        file=proof.path,
        code=ShutterCode(best),
        minimum=minimum,
        finished=len(records),
        judged=sum(record["codes"] for record in records),
        bound=bound,
        # a bound above the best code would have hidden the codes between
        proven=not proof.missing and bound <= minimum.upper,
        cpu_s=sum(record["seconds"] for record in records),
        seconds=seconds,
    )
