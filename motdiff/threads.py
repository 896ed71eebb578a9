"""Thread limits: jobs side by side with one thread each, or one thread in total."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar, copy_context
from threading import Lock
from typing import TypeVar

from threadpoolctl import threadpool_limits

_Result = TypeVar("_Result")

# torch's own count does not matter: small arrays are fastest with 1
_ALONE = ContextVar("_ALONE", default=False)
_WITHIN = ContextVar("_WITHIN", default=False)  # nested contexts change nothing


@contextmanager
def one_thread_a_call() -> Iterator[None]:
    """Limit each call of torch, and of numpy's and scipy's BLAS, to one thread in a context.

    Threads on small arrays mostly wait, and on a busy machine they wait for a core each time: a
    photo that took 2.5 s with one thread took 14 s and 24 CPU-s with four on four busy cores.
    :func:`side_by_side` runs independent jobs in parallel. Torch's sums may depend on the number
    of threads in their last bits. Where several threads of a process are within it at once, the
    BLAS may have more again when one of them leaves.
    """
    if _WITHIN.get():
        yield
        return
    token = _WITHIN.set(True)
    try:
        with _THREADS.one_a_call():
            yield
    finally:
        _WITHIN.reset(token)


class _Threads:
    """Thread counts of a call: the BLAS has one count per process, torch one per thread.

    A new thread begins with what any set last.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._users = 0
        self._limited = False

    @contextmanager
    def one_a_call(self) -> Iterator[None]:
        import torch

        with self._lock:
            if not self._users:
                self._before = torch.get_num_threads()
            # one at a time: a second one would find the first's limit, and leave it to the process
            # for ever
            limits = not self._limited
            self._limited = True
            self._users += 1
        try:
            _one_thread_here()
            with threadpool_limits(1, user_api="blas") if limits else nullcontext():
                yield
        finally:
            with self._lock:
                self._users -= 1
                if limits:
                    self._limited = False
                torch.set_num_threads(self._before)


_THREADS = _Threads()


def _one_thread_here() -> None:
    import torch

    # a thread that has not asked takes the process's count at its first call, not its own
    torch.get_num_threads()
    torch.set_num_threads(1)


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep everything, :func:`side_by_side` as well, to one thread while the context lasts.

    For work that runs beside others of its kind, and for processor time: threads that wait for
    each other count as such.
    """
    token = _ALONE.set(True)
    try:
        with one_thread_a_call():
            yield
    finally:
        _ALONE.reset(token)


def side_by_side(
    jobs: Sequence[Callable[[], _Result]], *, tell: Callable[[int], None] = lambda _finished: None
) -> list[_Result]:
    """Run jobs without gradients, as many at a time as there are cores; results in order.

    One at a time within :func:`one_thread`, and fewer where the environment says so: a process
    that shares the machine with others of its kind, as a benchmark's workers do, is started with
    ``OMP_NUM_THREADS``. ``tell`` gets the number of finished jobs.
    """
    import torch

    results: list[_Result] = []
    workers = max(1, min(len(jobs), _cores()))
    with one_thread_a_call(), ThreadPoolExecutor(workers, initializer=_one_thread_here) as pool:
        # each with the context of here: a job that runs others side by side keeps to one thread as
        # well
        runs = [pool.submit(copy_context().run, torch.no_grad()(job)) for job in jobs]
        try:
            for run in runs:
                results.append(run.result())
                tell(len(results))
        except BaseException:  # Ctrl-C: do not start what still waits
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return results


def threads_here() -> int:
    """Return the number of threads that one call on large arrays may use here."""
    return 1 if _WITHIN.get() else _cores()


def _cores() -> int:
    if _ALONE.get():
        return 1
    limit = os.environ.get("OMP_NUM_THREADS", "").strip()
    cores = os.cpu_count() or 1
    return min(cores, int(limit)) if limit.isdigit() else cores
