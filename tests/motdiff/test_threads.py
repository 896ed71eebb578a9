"""Jobs side by side: the order of their results, their threads and gradients, and what happens
when one fails."""

import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import torch
from threadpoolctl import threadpool_info, threadpool_limits

from motdiff import threads
from motdiff.threads import one_thread, one_thread_a_call, side_by_side, threads_here


@pytest.fixture(autouse=True)
def three_threads(monkeypatch):
    """A number that no job leaves behind by chance; and an environment that limits nothing."""
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    yield
    torch.set_num_threads(before)


def cores(monkeypatch, count):
    monkeypatch.setattr(threads.os, "cpu_count", lambda: count)


def test_results_come_in_the_order_of_the_jobs_not_of_their_ends(monkeypatch):
    cores(monkeypatch, 2)
    last_is_done = threading.Event()
    jobs = [lambda: last_is_done.wait(10) and "first", lambda: last_is_done.set() or "second"]
    assert side_by_side(jobs) == ["first", "second"]


@pytest.mark.parametrize(
    ("count", "limit", "jobs", "expected"),
    [
        *[(1, None, 4, 1), (3, None, 6, 3), (8, None, 2, 2), (None, None, 3, 1)],
        *[(8, "1", 4, 1), (8, "2", 6, 2), (2, "8", 4, 2), (3, "0", 4, 1), (3, "no number", 6, 3)],
    ],
)
def test_as_many_run_at_a_time_as_there_are_cores_and_the_environment_allows(
    monkeypatch, count, limit, jobs, expected
):
    cores(monkeypatch, count)
    if limit is not None:
        monkeypatch.setenv("OMP_NUM_THREADS", limit)
    assert most_at_a_time(jobs, expected) == expected


def most_at_a_time(jobs, expected):
    """Run jobs that wait until as many as expected are there."""
    lock = threading.Lock()
    running = 0
    most = 0
    together = threading.Barrier(expected)

    def job():
        nonlocal running, most
        with lock:
            running += 1
            most = max(most, running)
        together.wait(10)
        time.sleep(0.02)  # one too many would be seen
        with lock:
            running -= 1

    side_by_side([job] * jobs)
    return most


@pytest.mark.parametrize("limit", [None, "4"])
def test_one_thread_is_one_job_at_a_time_and_ends(monkeypatch, limit):
    cores(monkeypatch, 4)
    if limit is not None:
        monkeypatch.setenv("OMP_NUM_THREADS", limit)

    def alone():
        with one_thread():
            assert torch.get_num_threads() == 1
            with one_thread():
                assert most_at_a_time(4, 1) == 1
            assert most_at_a_time(4, 1) == 1
            assert torch.get_num_threads() == 1
            raise ValueError("no kernel")

    with pytest.raises(ValueError, match="no kernel"):  # it ends however it is left
        alone()
    assert torch.get_num_threads() == 3
    assert most_at_a_time(4, 4) == 4


def test_one_thread_limits_nobody_else(monkeypatch):
    cores(monkeypatch, 2)
    with one_thread(), ThreadPoolExecutor(1) as other:
        assert other.submit(most_at_a_time, 2, 2).result() == 2


def test_one_thread_holds_for_jobs_within_jobs(monkeypatch):
    cores(monkeypatch, 2)
    with one_thread():
        assert side_by_side([lambda: most_at_a_time(2, 1)]) == [1]


def test_whoever_only_imports_it_waits_for_no_torch():
    code = (
        "import sys, motdiff.threads, cep.calibration.calibrate_folder; assert 'torch' not in"
        " sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).parents[2])


def test_each_job_has_one_thread_and_no_gradients(monkeypatch):
    cores(monkeypatch, 2)
    weight = torch.ones(2, requires_grad=True)

    def job():
        return torch.get_num_threads(), torch.is_grad_enabled(), (2 * weight).requires_grad

    assert side_by_side([job] * 4) == [(1, False, False)] * 4
    assert torch.get_num_threads() == 3
    assert torch.is_grad_enabled()


def test_finished_jobs_are_counted():
    told = []
    side_by_side([lambda: None] * 3, tell=told.append)
    assert told == [1, 2, 3]


def test_no_jobs_have_no_results():
    assert side_by_side([]) == []
    assert torch.get_num_threads() == 3


@pytest.mark.parametrize("error", [ValueError("no kernel"), KeyboardInterrupt()])
def test_a_failure_is_raised_at_once_and_what_waits_is_not_started(monkeypatch, error):
    cores(monkeypatch, 1)
    started = []

    def fails():
        raise error

    def slow():
        started.append(True)
        time.sleep(0.02)

    with pytest.raises(type(error)):
        side_by_side([fails, *[slow] * 100])
    assert len(started) < 100
    assert torch.get_num_threads() == 3


def test_a_stop_between_two_jobs_ends_the_run(monkeypatch):
    cores(monkeypatch, 1)
    started = []

    def stop(_finished):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        side_by_side([lambda: started.append(time.sleep(0.02))] * 100, tell=stop)
    assert 1 <= len(started) < 100
    assert torch.get_num_threads() == 3


@pytest.mark.parametrize("kept", [one_thread, one_thread_a_call])
def test_torch_and_blas_have_one_thread_while_it_lasts(kept):
    def threads():
        pools = {
            pool["filepath"]: pool["num_threads"]
            for pool in threadpool_info()
            if pool["user_api"] == "blas"
        }
        return {"torch": torch.get_num_threads(), **pools}

    def failing():
        with kept():
            assert set(threads().values()) == {1}
            raise ValueError("no kernel")

    with threadpool_limits(3, user_api="blas"):
        before = threads()
        assert before["torch"] == 3  # a BLAS that begins with one thread may take no more
        with pytest.raises(ValueError, match="no kernel"):
            failing()
        assert threads() == before


@pytest.mark.parametrize("first_out", [0, 1])
def test_two_threads_within_it_leave_the_process_what_it_had(first_out):
    inside = [threading.Event(), threading.Event()]
    leave = [threading.Event(), threading.Event()]

    def run(k):
        with one_thread_a_call(), one_thread_a_call():
            inside[k].set()
            assert leave[k].wait(20)
            return torch.get_num_threads()

    def count():
        both.wait(20)
        return torch.get_num_threads()

    before = blas_threads()
    both = threading.Barrier(2)
    with ThreadPoolExecutor(2) as pool:
        runs = []
        for k in (0, 1):
            runs.append(pool.submit(run, k))
            assert inside[k].wait(20)
        assert blas_threads() <= {1}
        for k in (first_out, 1 - first_out):
            leave[k].set()
            assert runs[k].result(20) == 1
        assert [of.result(20) for of in [pool.submit(count), pool.submit(count)]] == [3, 3]
    assert blas_threads() == before
    with ThreadPoolExecutor(1) as fresh:
        assert fresh.submit(torch.get_num_threads).result() == 3


def test_one_that_enters_after_the_first_has_left_limits_the_blas_again():
    inside = threading.Event()
    leave = threading.Event()

    def stay():
        with one_thread_a_call():
            inside.set()
            assert leave.wait(20)

    before = blas_threads()
    with ThreadPoolExecutor(1) as pool:
        with one_thread_a_call():
            other = pool.submit(stay)
            assert inside.wait(20)
        with one_thread_a_call():
            assert blas_threads() <= {1}
        leave.set()
        other.result(20)
    assert blas_threads() == before


def test_a_stop_on_the_way_in_leaves_nothing_behind(monkeypatch):
    before = blas_threads()

    def stopped():
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(threads, "_one_thread_here", stopped)
        with pytest.raises(KeyboardInterrupt), one_thread_a_call():
            pass
    with one_thread_a_call():
        assert blas_threads() <= {1}
    assert blas_threads() == before
    assert torch.get_num_threads() == 3


def test_within_itself_it_ends_with_the_outer_one():
    with one_thread_a_call():
        with one_thread_a_call():
            pass
        assert torch.get_num_threads() == 1
        assert blas_threads() <= {1}
    assert torch.get_num_threads() == 3


def blas_threads():
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def test_jobs_still_run_side_by_side_where_each_call_has_one_thread(monkeypatch):
    cores(monkeypatch, 2)
    with one_thread_a_call():
        assert most_at_a_time(4, 2) == 2


@pytest.mark.parametrize(
    ("count", "limit", "expected"),
    [(6, None, 6), (None, None, 1), (6, "4", 4), (6, "9", 6), (6, "x", 6)],
)
def test_a_call_has_all_cores_that_the_environment_allows(monkeypatch, count, limit, expected):
    cores(monkeypatch, count)
    if limit is not None:
        monkeypatch.setenv("OMP_NUM_THREADS", limit)
    assert threads_here() == expected
    assert side_by_side([threads_here, threads_here]) == [1, 1] or count is None
