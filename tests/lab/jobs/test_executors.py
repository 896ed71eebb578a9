"""The engine on a real Dask cluster of worker processes, which are lost, have other sources, or
never were."""

import os
import shutil
import socket
import sys
import threading
from importlib.util import find_spec
from pathlib import Path

import bench_work
import numpy as np
import pytest
from emulators.cluster import ROOT, cluster_in, killing_one, require_dask

from cep.commands.console import BAD_INPUT
from cep.commands.errors import explain
from lab.jobs.cells import Cell
from lab.jobs.engine import run_cells

COUNT = 12


@pytest.fixture(autouse=True)
def _dask():
    require_dask()


@pytest.fixture
def cluster(tmp_path, monkeypatch):
    with cluster_in(tmp_path, monkeypatch) as made:
        yield made


def cells(log, slow_s=0.15):
    """Cells with arrays of 320 kB: joblib would leave such on one worker, and lose them with
    it."""
    return [
        Cell(
            (str(n),),
            bench_work.total,
            {"pixels": np.full((200, 200), float(n)), "log": str(log), "slow_s": slow_s},
        )
        for n in range(COUNT)
    ]


def events(log):
    return [line.split() for line in log.read_text().splitlines()]


def test_a_worker_killed_in_a_cell_loses_and_doubles_nothing(cluster, tmp_path):
    log = tmp_path / "log"
    cache = tmp_path / "cache"
    workers = {process.pid for process in cluster.add_workers(2)}
    kill_one, killed = killing_one(log, from_share=0.25)
    outcome = run_cells(cells(log), cache=cache, dask=cluster.address, progress=kill_one)
    assert len(killed) == 1
    assert set(killed) < workers
    assert outcome.figures == {(str(n),): {"total": 4e4 * n} for n in range(COUNT)}
    assert (outcome.missing, outcome.failures, outcome.warnings) == (0, {}, ())
    assert len(list(cache.iterdir())) == COUNT
    begun = [(pid, cell) for kind, pid, cell in events(log) if kind == "begin"]
    ended = [(pid, cell) for kind, pid, cell in events(log) if kind == "end"]
    assert {cell for _, cell in ended} == {str(n) for n in range(COUNT)}
    # what was not ended was begun by the one that was killed
    assert {int(pid) for pid, _ in set(begun) - set(ended)} <= set(killed)
    assert len(begun) > COUNT
    # all that is on disk is believed: nothing runs once more
    again = run_cells(cells(log), cache=cache, dask=cluster.address)
    assert again.figures == outcome.figures
    assert all(result.cached for result in again.results)
    assert len(events(log)) == len(begun) + len(ended)


def test_a_lost_scheduler_leaves_what_is_finished(cluster, tmp_path, capfd):
    log = tmp_path / "log"
    cache = tmp_path / "cache"
    cluster.add_workers(1)

    def kill_scheduler(fraction, _note):
        if fraction >= 0.2:
            cluster.scheduler.kill()

    with pytest.raises(
        RuntimeError, match=f"dask: the cluster at {cluster.address} failed .* run again to go on"
    ) as caught:
        run_cells(cells(log), cache=cache, dask=cluster.address, progress=kill_scheduler)
    assert "\n" not in str(caught.value)
    finished = len(list(cache.iterdir()))
    assert 0.2 * COUNT <= finished < COUNT
    assert str(os.getpid()) not in {
        pid for _, pid, _ in events(log)
    }  # even one worker is the cluster
    outcome = run_cells(cells(log, slow_s=0.15), cache=cache)
    assert sum(result.cached for result in outcome.results) == finished
    assert outcome.figures == {(str(n),): {"total": 4e4 * n} for n in range(COUNT)}
    assert "Traceback" not in capfd.readouterr().err


def listening(reply):
    """Return the address of somebody who answers every caller with ``reply``, and what stops
    them."""
    server = socket.create_server(("127.0.0.1", 0))
    callers = []

    def serve():
        while True:
            try:
                caller, _ = server.accept()
            except OSError:  # closed: the test is over
                return
            callers.append(caller)
            caller.sendall(reply)

    thread = threading.Thread(target=serve)
    thread.start()

    def stop():
        server.shutdown(socket.SHUT_RDWR)
        server.close()
        thread.join()
        for caller in callers:
            caller.close()

    return f"tcp://127.0.0.1:{server.getsockname()[1]}", stop


@pytest.mark.parametrize(
    "reply", [b"", b"HTTP/1.1 400 Bad Request\r\n" * 20], ids=["silent", "web server"]
)
def test_who_listens_may_be_no_scheduler(tmp_path, reply, capfd):
    address, stop = listening(reply)
    try:
        with pytest.raises(ValueError, match=f"dask: no scheduler answers at {address}") as caught:
            run_cells(cells(tmp_path / "log"), cache=tmp_path / "cache", dask=address)
    finally:
        stop()
    assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""
    assert not (tmp_path / "log").exists()


@pytest.mark.parametrize(
    "address", ["tcp://127.0.0.1:9", "nonsense", "http://127.0.0.1:8786", "tcp://127.0.0.1:port"]
)
def test_a_dead_address_is_one_line(tmp_path, address, capfd):
    with pytest.raises(ValueError, match=f"dask: no scheduler answers at {address}") as caught:
        run_cells(cells(tmp_path / "log"), cache=tmp_path / "out" / "cells", dask=address)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""
    assert list(tmp_path.iterdir()) == []


def test_a_scheduler_without_workers(cluster, tmp_path, monkeypatch):
    monkeypatch.setattr("lab.jobs.executors._WORKERS_S", 0.3)
    with pytest.raises(
        ValueError, match=f"dask: the scheduler at {cluster.address} has no workers"
    ):
        run_cells(cells(tmp_path / "log"), cache=tmp_path / "cache", dask=cluster.address)


def test_workers_without_the_program_are_told(cluster, tmp_path):
    cluster._environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
    }  # without the folder of the tests
    cluster.add_workers(1)
    with pytest.raises(
        ValueError, match=f"the workers at {cluster.address} lack this program .*bench_work"
    ):
        run_cells(cells(tmp_path / "log"), cache=tmp_path / "cache", dask=cluster.address)


def copied(folder):
    for package in ("cep", "motdiff", "hw", "lab"):
        shutil.copytree(
            ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__")
        )
    return folder


def other_code(root):
    path = root / "cep/optics/scene.py"
    path.write_text(path.read_text(encoding="utf-8") + "\nSCENE_STD = 0.3\n", encoding="utf-8")


def other_weights(root):
    path = root / "cep/restoration/denoiser/denoiser.safetensors"
    path.write_bytes(path.read_bytes()[:-1] + b"?")


def a_module_less(root):
    (root / "cep/report/page.py").unlink()


def as_before_workers_were_asked(root):
    for name in ("fingerprint", "executors"):
        path = root / f"lab/jobs/{name}.py"
        path.write_text(
            path.read_text(encoding="utf-8").replace("all_sources", "_nothing"), encoding="utf-8"
        )


@pytest.mark.parametrize(
    "change", [other_code, other_weights, a_module_less, as_before_workers_were_asked]
)
def test_a_worker_with_other_sources_is_named_before_anything_runs(cluster, tmp_path, change):
    from distributed import Client  # not everybody has it

    copy = copied(tmp_path / "copy")
    change(copy)
    cluster.add_workers(1)
    cluster.add_workers(1, root=copy)
    with Client(cluster.address, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
        homes = client.run(lambda: find_spec("cep").origin)
    (odd,) = [worker for worker, home in homes.items() if Path(home).is_relative_to(copy)]
    log = tmp_path / "log"
    cache = tmp_path / "out" / "cells"
    with pytest.raises(
        ValueError, match=f"dask: the worker at {odd} has another state of this program"
    ) as caught:
        run_cells(cells(log), cache=cache, dask=cluster.address)
    assert "(1 of 2 workers): install there what is installed here" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert explain(caught.value) == BAD_INPUT
    assert not log.exists()
    assert not (tmp_path / "out").exists()


def test_equal_sources_in_another_place_are_the_same(cluster, tmp_path):
    cluster.add_workers(1, root=copied(tmp_path / "copy"))
    outcome = run_cells(
        cells(tmp_path / "log", slow_s=0.0), cache=tmp_path / "cache", dask=cluster.address
    )
    assert (len(outcome.figures), outcome.failures) == (COUNT, {})


def test_a_worker_with_other_sources_that_joins_later_makes_nothing(cluster, tmp_path):
    copy = copied(tmp_path / "copy")
    other_code(copy)
    log = tmp_path / "log"
    cache = tmp_path / "cache"
    (first,) = cluster.add_workers(1)
    later = []

    def replace_it(fraction, _note):
        if not later and fraction >= 0.2:
            first.kill()  # before it has made the rest
            later.extend(cluster.add_workers(1, root=copy))

    with pytest.raises(
        RuntimeError, match=r"worker at tcp://.* has another state of this program"
    ) as caught:
        run_cells(cells(log, slow_s=0.5), cache=cache, dask=cluster.address, progress=replace_it)
    assert "run again to go on" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert {int(pid) for _, pid, _ in events(log)} == {first.pid}
    assert 0.2 * COUNT <= len(list(cache.iterdir())) < COUNT


def test_without_dask_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ValueError, match=r"pip install 'coded-exposure\[cluster\]'"):
        run_cells(cells(tmp_path / "log"), cache=tmp_path / "cache", dask="tcp://127.0.0.1:9")
