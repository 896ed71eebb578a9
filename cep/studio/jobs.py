"""Long work for the page: one job at a time, in a process that does not outlive its page."""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import count
from multiprocessing.connection import Connection
from typing import Any

from cep.studio import work

# for a page that is loaded again, which is the same page, or does not listen yet
_GRACE_S = 5.0
_LAST_S = 120.0  # to measure the best so far
# glibc gives large arrays back when they are freed: an estimate then takes 60 MB less
_MALLOC = {"MALLOC_ARENA_MAX": "2", "MALLOC_MMAP_THRESHOLD_": "1000000"}
_STOP_S = 3.0  # to put a shutter's controller to rest, or to end
_MOST_LISTENERS = 64  # each holds a connection open


class BusyError(Exception):
    """Another job is running, or too many pages listen."""

    field = "job"


@dataclass
class Job:
    """One job as its page sees it.

    Attributes
    ----------
    number : int
    page : str
        Page that started it.
    kind : str
        Name in :data:`cep.studio.work.KINDS`.
    state : {"running", "done", "failed", "stopped"}
    share : float
        Finished share, 0..1.
    note : str
        What is being done.
    best : mapping
        Best so far, where the work tells it.
    result : mapping
    error : mapping
        ``field`` and ``message``, where it failed.
    """

    number: int
    page: str
    kind: str
    state: str = "running"
    share: float = 0.0
    note: str = "starting"
    best: Mapping[str, Any] = field(default_factory=dict)
    result: Mapping[str, Any] = field(default_factory=dict)
    error: Mapping[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Fields for JSON."""
        return {name: value for name, value in vars(self).items() if name != "page"}


class Jobs:
    """The one job of a server, and the pages that listen to it.

    Used from the server's event loop alone. Processes are forked from a helper that has loaded the
    library, where the system can: a job then starts in milliseconds, and its memory goes back when
    it ends.
    """

    def __init__(self) -> None:
        methods = multiprocessing.get_all_start_methods()
        # not fork: this process has threads, whose locks a child would inherit as they are
        self._context: Any = multiprocessing.get_context(
            "forkserver" if "forkserver" in methods else "spawn"
        )
        self._numbers = count(int(time.time()))  # a page may have seen jobs of an earlier run
        self._process: Any = None
        self._job: Job | None = None
        self._listeners: dict[str, set[asyncio.Queue[Job | None]]] = {}
        self._leaving: dict[str, asyncio.TimerHandle] = {}
        self._stopping: asyncio.TimerHandle | None = None
        self._loop: asyncio.AbstractEventLoop | None = None  # of the listeners
        self.closing = False

    def warm(self) -> None:
        """Load the library in the helper, ahead of the first job."""
        if self._context.get_start_method() == "forkserver":
            from multiprocessing import forkserver

            for name, setting in _MALLOC.items():  # inherited by the helper and its children
                os.environ.setdefault(name, setting)
            self._context.set_forkserver_preload(["cep.studio.work", "cep.search.optimize"])
            forkserver.ensure_running()

    def start(self, page: str, kind: str, order: Mapping[str, Any]) -> Job:
        """Start a job for a page, which must listen soon; BusyError where another one runs.

        One that the page itself has started, as the verdict over the light, gives way.
        """
        if self._job is not None and self._job.state == "running":
            if not work.KINDS[self._job.kind].gives_way:
                where = "this page" if self._job.page == page else "another page"
                raise BusyError(
                    f"{work.KINDS[self._job.kind].name} is running in {where}; stop it first"
                )
            self._end("stopped")
        job = self._job = Job(next(self._numbers), page, kind)
        ours, theirs = self._context.Pipe(duplex=False)
        process = self._process = self._context.Process(
            target=work.run, args=(kind, dict(order), theirs), daemon=True
        )
        process.start()
        theirs.close()  # else the pipe would not end with the process
        loop = asyncio.get_running_loop()

        def tell(message: Mapping[str, Any] | None) -> None:
            with suppress(RuntimeError):  # the loop is closed: the server has ended
                # asyncio's queues belong to the thread of their loop
                loop.call_soon_threadsafe(self._told, job, message)

        threading.Thread(target=_listen, args=(ours, tell), daemon=True).start()
        if page not in self._listeners:
            self._await(page)
        self._publish(job)
        return job

    def stop(self, page: str) -> None:
        """Ask the job of a page to come to its end: a search may still measure the best so far."""
        job = self._job
        if job is None or job.page != page or job.state != "running" or self._stopping is not None:
            return
        if work.KINDS[job.kind].keeps_best:
            job.note = "stopping: the best so far is measured"
            with suppress(ProcessLookupError, TypeError):
                os.kill(self._process.pid, signal.SIGINT)
            self._stopping = asyncio.get_running_loop().call_later(_LAST_S, self._end, "stopped")
            self._publish(job)
        else:
            self._end("stopped")

    def current(self, page: str) -> Job | None:
        """Return the last job of a page."""
        if self._job is None or self._job.page != page:
            return None
        return self._job

    def listen(self, page: str) -> asyncio.Queue[Job | None]:
        """Return a queue of what happens to a page's job, beginning with what is."""
        if sum(map(len, self._listeners.values())) >= _MOST_LISTENERS:
            raise BusyError("too many pages listen; close some of them")
        if (timer := self._leaving.pop(page, None)) is not None:
            timer.cancel()
        self._loop = asyncio.get_running_loop()
        queue: asyncio.Queue[Job | None] = asyncio.Queue()
        self._listeners.setdefault(page, set()).add(queue)
        queue.put_nowait(self.current(page))
        return queue

    def leave(self, page: str, queue: asyncio.Queue[Job | None]) -> None:
        """Forget a listener; the job of a page without listeners ends a few seconds later."""
        listeners = self._listeners.get(page, set())
        listeners.discard(queue)
        if not listeners:
            self._listeners.pop(page, None)
            self._await(page)

    def dismiss(self) -> None:
        """Let every listener know that nothing more comes; may be called in a signal's handler."""
        self.closing = True
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._wake)

    def _wake(self) -> None:
        for queues in self._listeners.values():
            for queue in queues:
                queue.put_nowait(None)

    def close(self) -> None:
        """End the job."""
        for timer in self._leaving.values():
            timer.cancel()
        if self._job is not None and self._job.state == "running":
            self._end("stopped")

    def _await(self, page: str) -> None:
        """Give a page without listeners its time."""
        if (timer := self._leaving.pop(page, None)) is not None:
            timer.cancel()
        self._leaving[page] = asyncio.get_running_loop().call_later(_GRACE_S, self._left, page)

    def _left(self, page: str) -> None:
        self._leaving.pop(page, None)
        if self._job is not None and self._job.page == page and self._job.state == "running":
            self._end("stopped")

    def _end(self, state: str) -> None:
        """End the process at once; one that drives a shutter first puts it to rest."""
        job = self._job
        process = self._process
        assert job is not None
        job.state = state
        self._settle()
        if process.is_alive():
            if work.KINDS[job.kind].needs_rest:
                with suppress(ProcessLookupError):
                    os.kill(process.pid, signal.SIGINT)
                process.join(_STOP_S)
            process.kill()
            process.join(_STOP_S)
        self._publish(job)

    def _settle(self) -> None:
        if self._stopping is not None:
            self._stopping.cancel()
            self._stopping = None

    def _told(self, job: Job, message: Mapping[str, Any] | None) -> None:
        if job.state != "running":
            return
        if message is None:  # the pipe was closed: the process was killed, as for its memory
            error = {"field": "job", "message": "the work ended without a result"}
            message = {"state": "failed", "error": error}
        for name, value in message.items():
            setattr(job, name, value)
        if job.state != "running":
            self._settle()
        self._publish(job)

    def _publish(self, job: Job) -> None:
        for queue in self._listeners.get(job.page, ()):
            queue.put_nowait(job)


def _listen(pipe: Connection, tell: Callable[[Mapping[str, Any] | None], None]) -> None:
    """Pass on what the process says, until it is gone."""
    with pipe:
        while True:
            try:
                tell(pipe.recv())
            except (EOFError, OSError):
                break
    tell(None)
