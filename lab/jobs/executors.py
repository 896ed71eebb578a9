"""Executors of cells: processes of this machine or a Dask cluster, in order of completion."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from functools import partial
from importlib import import_module
from itertools import islice
from typing import Any

from joblib import Parallel, delayed, parallel_config
from joblib._dask import DaskDistributedBackend
from joblib.externals.loky.process_executor import TerminatedWorkerError

from lab.jobs.cells import Figure, Finished, worked
from lab.jobs.fingerprint import all_sources
from lab.jobs.machine import machine
from motdiff.processes import end_with_parent

_Call = tuple[Callable[..., Mapping[str, Figure]], Mapping[str, Any]]
Task = tuple[str, _Call]
"""A key, with a function and its arguments."""
Tasks = Mapping[str, _Call]
"""Functions and their arguments, by fingerprint."""

_CONNECT_S = 5.0
_WORKERS_S = 10.0
_DIED = "its process died: not enough memory, or a crash in compiled code"
_INSTALL = "install there what is installed here, and start it again"


def in_processes(tasks: Tasks, workers: int) -> Generator[tuple[str, Finished]]:
    """Yield fingerprints with finished cells, from ``workers`` processes of one inner thread each.

    A cell that kills its process fails; the cells that ran beside it are run again. The processes
    end with this one.
    """

    def run(some: Tasks) -> Generator[tuple[str, Finished]]:
        beginning = {"initializer": _begin_worker, "initargs": (os.getpid(),)}
        with (
            parallel_config("loky", n_jobs=workers, inner_max_num_threads=1, **beginning),
            warnings.catch_warnings(),
        ):
            # loky restarts processes whose memory has grown, as PyTorch's does, and warns of it
            warnings.filterwarnings(
                "ignore", "A worker stopped while some jobs were given", UserWarning
            )
            yield from _spread(some, _one, pre_dispatch=2 * workers)

    waiting = dict(tasks)
    while waiting:
        try:
            with closing(run(waiting)) as finishing:
                for key, finished in finishing:
                    del waiting[key]
                    yield key, finished
        except TerminatedWorkerError:
            # one of those that were handed out: each alone shows which
            for key in list(islice(waiting, 2 * workers)):
                task = waiting.pop(key)
                try:
                    yield from run({key: task})
                except TerminatedWorkerError:
                    yield key, Finished({}, _DIED, 0.0, machine())


def on_cluster(tasks: Tasks, address: str) -> Generator[tuple[str, Finished]]:
    """Yield fingerprints with finished cells, from the Dask cluster whose scheduler is at
    ``address``.

    Dask runs the cells of a lost worker again on another one; a result sent twice counts once.
    Workers must have the sources and weights that are here, and so must those that join later:
    figures are kept under the versions of these. A worker that joins later without this program,
    or with a version too old to report its sources, is not detected, and the run waits for it.
    Other versions of libraries are allowed and recorded in each result's machine.

    Raises
    ------
    ValueError
        If Dask is not installed, no scheduler answers, it has no workers, or one lacks this
        program or has another state of it.
    RuntimeError
        If the cluster goes away, or a worker with another state of this program joins it.
    """
    try:
        from distributed import Client
    except ImportError:
        raise ValueError(
            "dask: a cluster needs the extra: pip install 'coded-exposure[cluster]'"
        ) from None
    with _unlogged("distributed.client"):  # an error is one line, not a traceback of Dask's thread
        try:
            with ThreadPoolExecutor(1) as pool:  # a notebook's thread has an event loop already
                pool.submit(asyncio.run, _greeting(address)).result()
            client = Client(address, timeout=_CONNECT_S, set_as_default=False)
        except (
            Exception
        ) as error:  # the server may be no scheduler: HTTP raises MemoryError, for example
            reason = " ".join(str(error).split()) or f"waited {_CONNECT_S:g} s"
            raise ValueError(
                f"dask: no scheduler answers at {address}, as tcp://host:8786 would ({reason})"
            ) from None
        with client:
            try:
                client.wait_for_workers(1, timeout=_WORKERS_S)
            except TimeoutError:
                raise ValueError(
                    f"dask: the scheduler at {address} has no workers: dask worker {address}"
                ) from None
            try:  # otherwise joblib waits for ever for cells that no worker can import
                for module in sorted({__name__, *(work.__module__ for work, _ in tasks.values())}):
                    client.run(import_module, module)
            except ImportError as error:
                raise ValueError(
                    f"dask: the workers at {address} lack this program ({error}), install it there"
                ) from None
            _refuse_other_sources(client)
            try:
                with parallel_config(_ClusterBackend(client=client)):
                    yield from _spread(
                        tasks, partial(_of_these_sources, all_sources()), pre_dispatch="all"
                    )
            except (
                Exception
            ) as error:  # an error of the cluster: cells return reasons instead of raising
                reason = " ".join(f"{type(error).__name__}: {error}".split())
                raise RuntimeError(
                    f"dask: the cluster at {address} failed ({reason}); finished cells are kept,"
                    " run again to go on"
                ) from None


class _ClusterBackend(DaskDistributedBackend):  # type: ignore[misc]
    """Joblib's backend without its shortcut, which runs cells in this process while one thread is
    connected.
    """

    def effective_n_jobs(self, n_jobs: int = -1) -> int:
        return max(2, int(super().effective_n_jobs(n_jobs)))


async def _greeting(address: str) -> None:
    """Connect to a scheduler once: Client would wait for ever for a server that never answers."""
    from distributed import Security
    from distributed.comm import connect

    async with asyncio.timeout(_CONNECT_S):
        connection = await connect(
            address, timeout=_CONNECT_S, **Security().get_connection_args("client")
        )
        await connection.close()


def _refuse_other_sources(client: Any) -> None:
    states = client.run(all_sources, on_error="return")
    # OSError: the worker was lost meanwhile; an older version lacks the function
    reported = {
        worker: state for worker, state in states.items() if not isinstance(state, OSError)
    }
    if outdated := sorted(worker for worker, state in reported.items() if state != all_sources()):
        raise ValueError(
            f"dask: the worker at {outdated[0]} has another state of this program ({len(outdated)}"
            f" of {len(states)} workers): {_INSTALL}"
        )


def _spread(
    tasks: Tasks, call: Callable[..., tuple[str, Finished]], *, pre_dispatch: int | str
) -> Generator[tuple[str, Finished]]:
    """Run the tasks with joblib's backend of the moment, each a batch of its own: none waits for
    another to be kept.
    """
    # arguments go as one dict: joblib would put each large array on a single Dask worker, and it
    # would die with it; nor are they mapped into files, which fill /dev/shm and are read-only
    parallel = Parallel(
        return_as="generator_unordered", batch_size=1, pre_dispatch=pre_dispatch, max_nbytes=None
    )
    calls = [delayed(call)(key, *task) for key, task in tasks.items()]
    with _dropped(parallel(calls)) as finishing:
        for item in finishing:  # noqa: UP028 - "yield from" would close the stream before _dropped can
            yield item


def _one(
    key: str, work: Callable[..., Mapping[str, Figure]], arguments: Mapping[str, Any]
) -> tuple[str, Finished]:
    return key, worked(work, arguments)


def _of_these_sources(
    sources: str, key: str, work: Callable[..., Mapping[str, Figure]], arguments: Mapping[str, Any]
) -> tuple[str, Finished]:
    """Refuse on a worker that joined after the check of all workers; an exception here ends the
    run.
    """
    if all_sources() != sources:
        from distributed import get_worker

        raise RuntimeError(
            f"the worker at {get_worker().address} has another state of this program: {_INSTALL}"
        )
    return _one(key, work, arguments)


def _begin_worker(parent: int) -> None:
    # a terminal sends Ctrl-C here too; joblib ends this process
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent(parent)


@contextmanager
def _dropped(stream: Generator[Any]) -> Iterator[Generator[Any]]:
    """Close a stream without joblib's warning of dropped cells on cancellation."""
    try:
        yield stream
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            stream.close()


@contextmanager
def _unlogged(name: str) -> Iterator[None]:
    logger = logging.getLogger(name)
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        logger.setLevel(level)
