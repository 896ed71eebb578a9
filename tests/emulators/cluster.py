"""A Dask cluster of processes on this machine."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

from emulators.tools import give_up
from lab.jobs.fingerprint import all_sources

ROOT = Path(__file__).parents[2]


class Cluster:
    """A scheduler, and workers of one thread each: separate processes that are not restarted."""

    def __init__(self, folder):
        self._processes = []
        contact = folder / "scheduler.json"
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(
                map(str, (ROOT, ROOT / "tests", ROOT / "tests/helpers"))
            ),
        }
        self._folder = folder
        self._environment = environment
        options = ("--host", "127.0.0.1", "--port", "0", "--scheduler-file", contact)
        self.scheduler = self._start("scheduler", *options, environment=environment)
        self.address = self._address(contact)

    def add_workers(self, count, *, root=None):
        """Start workers, with the packages below ``root`` instead of these."""
        environment = self._environment
        if root is not None:
            environment = {
                **environment,
                "PYTHONPATH": os.pathsep.join(
                    map(str, (root, ROOT / "tests", ROOT / "tests/helpers"))
                ),
            }
        options = (
            "--no-nanny",
            "--nthreads",
            "1",
            "--local-directory",
            self._folder,
            "--death-timeout",
            "60",
        )
        return [
            self._start("worker", self.address, *options, environment=environment)
            for _ in range(count)
        ]

    def stop(self):
        for process in self._processes:
            process.kill()
            process.wait()

    def _start(self, kind, *options, environment):
        command = [
            sys.executable,
            "-m",
            f"distributed.cli.dask_{kind}",
            "--no-dashboard",
            *map(str, options),
        ]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        # "python -m" would find the packages of the current folder before those of the environment
        self._processes.append(
            subprocess.Popen(command, env=environment, cwd=self._folder, **quiet)
        )
        return self._processes[-1]

    def _address(self, contact):
        deadline = time.monotonic() + 120
        while True:
            try:
                return json.loads(contact.read_text())["address"]
            except (FileNotFoundError, json.JSONDecodeError):  # not written yet, or half
                assert self.scheduler.poll() is None
                assert time.monotonic() < deadline
                time.sleep(0.05)


def require_dask():
    if find_spec("distributed") is None:
        give_up("dask.distributed not installed: pip install 'coded-exposure[cluster]'")


@contextmanager
def cluster_in(folder, monkeypatch):
    """Start a cluster without workers, whose files lie in a folder, and stop it and its workers at
    the end."""
    require_dask()
    monkeypatch.setattr(
        "lab.jobs.executors._WORKERS_S", 60.0
    )  # a busy machine is slow to start one
    all_sources.cache_clear()  # they may have been edited since the last test
    made = Cluster(folder)
    try:
        yield made
    finally:
        made.stop()


def killing_one(log, *, from_share):
    """Return a progress callback that kills one process in the midst of its work, and the list of
    those it killed."""
    killed = []

    def kill_one(share, _note):
        if not killed and share >= from_share and (victim := running(log)) is not None:
            os.kill(victim, signal.SIGKILL)
            killed.append(victim)

    return kill_one, killed


def running(log):
    """Return the process whose work has begun last and not ended, None where there is none.

    Each line of the log: "begin" or "end", the process, and a name of the work.
    """
    found = [line.split() for line in log.read_text().splitlines()] if log.exists() else []
    ended = {(pid, name) for kind, pid, name in found if kind == "end"}
    begun = [int(pid) for kind, pid, name in found if kind == "begin" and (pid, name) not in ended]
    return begun[-1] if begun else None
