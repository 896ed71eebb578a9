"""Torch jobs side by side, one thread each: for arrays too small to share one."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import torch

__all__ = ["side_by_side"]

_Result = TypeVar("_Result")


def side_by_side(
    jobs: Sequence[Callable[[], _Result]], *, tell: Callable[[int], None] = lambda _finished: None
) -> list[_Result]:
    """Run every job without gradients, as many at a time as there are cores, and give their results in order.

    Fewer where the environment says so: a process that shares the machine with others of its kind, as a benchmark's
    workers do, is started with ``OMP_NUM_THREADS``.

    Parameters
    ----------
    jobs : sequence of callables
    tell : callable, optional
        Called with the number of finished jobs.
    """
    threads = torch.get_num_threads()
    results: list[_Result] = []
    try:
        workers = max(1, min(len(jobs), _cores()))
        with ThreadPoolExecutor(workers, initializer=torch.set_num_threads, initargs=(1,)) as pool:
            runs = [pool.submit(torch.no_grad()(job)) for job in jobs]
            try:
                for run in runs:
                    results.append(run.result())
                    tell(len(results))
            except BaseException:  # Ctrl-C: do not start what still waits
                pool.shutdown(wait=False, cancel_futures=True)
                raise
    finally:
        torch.set_num_threads(threads)
    return results


def _cores() -> int:
    told = os.environ.get("OMP_NUM_THREADS", "").strip()
    cores = os.cpu_count() or 1
    return min(cores, int(told)) if told.isdigit() else cores
