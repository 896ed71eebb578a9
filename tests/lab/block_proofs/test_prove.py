"""A proof in blocks: killed, stopped and continued, it loses nothing and counts nothing twice."""

import json
import sys
import time
from pathlib import Path

import bench_work
import pytest
from children import child
from emulators.cluster import cluster_in, killing_one

from cep.search.exhaustive.exact import exact
from cep.search.optima import OPTIMA
from cep.search.problem import SearchProblem
from lab.block_proofs import prove as module
from lab.block_proofs.blocks import plan_blocks
from lab.block_proofs.proof_file import FILE_NAME
from lab.block_proofs.prove import prove

ROOT = Path(__file__).parents[3]
PROBLEM = (22, (1, 22))
PLAN = plan_blocks(22, 1, 22)


@pytest.fixture(autouse=True)
def _short_start(monkeypatch):
    monkeypatch.setattr(module, "_START_STEPS", 2000)


def lines(folder):
    return [json.loads(line) for line in (folder / FILE_NAME).read_text().splitlines()]


def assert_whole(folder, found):
    """Check that the file holds every block once, and that the result is the known optimum."""
    records = lines(folder)[1:]
    assert sorted(record["first"] for record in records) == [block.first for block in PLAN.blocks]
    assert sum(record["codes"] for record in records) == PLAN.codes
    assert (found.finished, found.judged) == (len(PLAN.blocks), PLAN.codes)
    known = exact(SearchProblem(chips=22), threads=1)
    assert found.proven
    assert found.code == known.code
    assert found.minimum == known.minimum
    assert max(record["bound"] for record in records) <= found.minimum.upper


def test_blocks_prove_the_optimum_and_are_not_judged_again(tmp_path, monkeypatch):
    shares = []
    found = prove(*PROBLEM, folder=tmp_path, progress=lambda share, _best: shares.append(share))
    assert_whole(tmp_path, found)
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    before = (tmp_path / FILE_NAME).read_bytes()
    monkeypatch.setattr(
        module, "judge_block", lambda **_: pytest.fail("a finished block was judged again")
    )
    again = prove(*PROBLEM, folder=tmp_path)
    assert (again.code, again.proven) == (found.code, True)
    assert (tmp_path / FILE_NAME).read_bytes() == before


def test_a_better_code_raises_the_bound_of_later_blocks(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_first_code", lambda *_: "11100010010000000000" + "00")
    monkeypatch.setattr(module, "_FIRST_ROUND", 1)
    found = prove(*PROBLEM, folder=tmp_path)
    assert_whole(tmp_path, found)
    bounds = [record["bound"] for record in lines(tmp_path)[1:]]
    assert bounds == sorted(bounds)
    assert bounds[0] == pytest.approx(1.0, abs=1e-5)
    assert bounds[-1] > 1.1


def test_the_first_bound_is_the_best_known_code_within_the_limits():
    bits = module._first_code(plan_blocks(23, 12, 12), 1)
    assert bits == OPTIMA[4].bits + "0"
    assert (len(OPTIMA[4].bits), OPTIMA[4].bits.count("1")) == (22, 12)
    # no bundled code of 20 open chips has 23 chips or fewer: the annealing's code
    assert module._first_code(plan_blocks(23, 20, 20), 1).count("1") == 20


def test_interrupted_it_keeps_finished_blocks_and_goes_on(tmp_path):
    def stop(share, _best):
        if share > 0.4:
            raise KeyboardInterrupt

    part = prove(*PROBLEM, folder=tmp_path, progress=stop)
    assert not part.proven
    assert part.finished == len(lines(tmp_path)) - 1 < len(PLAN.blocks)
    assert part.to_dict()["upper"] > part.to_dict()["lower"]
    before = (tmp_path / FILE_NAME).read_bytes()
    assert_whole(tmp_path, prove(*PROBLEM, folder=tmp_path))
    assert (tmp_path / FILE_NAME).read_bytes().startswith(before)


def test_threads_side_by_side_leave_nothing_out(tmp_path):
    assert_whole(tmp_path, prove(*PROBLEM, folder=tmp_path, workers=3))


@pytest.mark.slow  # starts a scheduler and two workers
def test_a_worker_of_a_cluster_killed_in_mid_run_loses_and_doubles_nothing(tmp_path, monkeypatch):
    log = tmp_path / "log"
    folder = tmp_path / "proof"
    monkeypatch.setenv("CEP_TEST_LOG", str(log))
    monkeypatch.setattr(module, "judge_block", bench_work.judged_slowly)
    kill_one, killed = killing_one(log, from_share=1e-9)  # a block is done
    with cluster_in(tmp_path, monkeypatch) as cluster:
        workers = {process.pid for process in cluster.add_workers(2)}
        found = prove(*PROBLEM, folder=folder, dask=cluster.address, progress=kill_one)
    assert len(killed) == 1
    assert set(killed) < workers
    assert_whole(folder, found)
    events = [line.split() for line in log.read_text().splitlines()]
    begun = [block for kind, _, block in events if kind == "begin"]
    # the block of the one that was killed began again
    assert len(begun) > len(set(begun)) == len(PLAN.blocks)


@pytest.mark.slow  # starts a process that imports all
def test_a_run_that_is_killed_is_continued(tmp_path):
    code = (
        f"import sys, time; sys.path.insert(0, {str(ROOT)!r})\n"
        "from lab.block_proofs import prove as module\n"
        "module._START_STEPS = 2000\n"
        "def slow(share, best):\n    time.sleep(0.3)\n"
        f"module.prove(22, (1, 22), folder={str(tmp_path)!r}, progress=slow)"
    )
    path = tmp_path / FILE_NAME
    deadline = time.monotonic() + 120
    with child([sys.executable, "-c", code]) as running:
        while not path.exists() or path.read_bytes().count(b"\n") < 3:
            assert running.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.02)
        with pytest.raises(ValueError, match="another run works on this proof"):
            prove(*PROBLEM, folder=tmp_path)
    before = path.read_bytes()
    assert 3 <= before.count(b"\n") < 1 + len(PLAN.blocks)
    assert_whole(tmp_path, prove(*PROBLEM, folder=tmp_path))
    assert path.read_bytes().startswith(before)


def test_a_line_cut_short_is_judged_again(tmp_path):
    prove(*PROBLEM, folder=tmp_path)
    path = tmp_path / FILE_NAME
    path.write_bytes(path.read_bytes()[:-20])
    assert_whole(tmp_path, prove(*PROBLEM, folder=tmp_path))


def change(folder, number, **fields):
    found = lines(folder)
    found[number] |= fields
    (folder / FILE_NAME).write_text("".join(json.dumps(line) + "\n" for line in found))


def test_a_file_cut_short_in_its_first_line_is_begun_anew(tmp_path):
    (tmp_path / FILE_NAME).write_text('{"schema": "cep.proof/1", "ver')
    assert_whole(tmp_path, prove(*PROBLEM, folder=tmp_path))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda folder: change(folder, 0, version=0), "a proof of version 0, not 1"),
        (lambda folder: change(folder, 0, schema="cep.code/1"), "is no proof"),
        (
            lambda folder: change(folder, 0, chips=23),
            "a proof for 23 chips, 1 to 22 open, not for 22 chips",
        ),
        (
            lambda folder: change(folder, 2, codes=5),
            "line 3: the block does not add up: 5 codes instead of",
        ),
        (lambda folder: change(folder, 2, until=7), "line 3: there is no block of prefixes"),
        (
            lambda folder: change(folder, 2, **lines(folder)[1]),
            "line 3: the block of prefixes .* comes twice",
        ),
        (
            lambda folder: change(folder, 2, survivors="1101 1"),
            "line 3: the block does not add up: as many minima",
        ),
        (lambda folder: change(folder, 2, survivors=None), "line 3: survivors: must be a string"),
        (lambda folder: change(folder, 2, bound="2"), "line 3: bound: must be a number"),
        (lambda folder: (folder / FILE_NAME).write_text("{\n"), "line 1 is damaged"),
        (
            lambda folder: (folder / FILE_NAME).write_text("[" * 100_000 + "\n"),
            "line 1 is damaged",
        ),
        (lambda folder: (folder / FILE_NAME).write_text("notes"), "is no proof"),
    ],
)
def test_what_is_wrong_with_a_folder_is_refused_and_stays(tmp_path, damage, message):
    prove(*PROBLEM, folder=tmp_path)
    damage(tmp_path)
    before = (tmp_path / FILE_NAME).read_bytes()
    with pytest.raises(ValueError, match=message) as caught:
        prove(*PROBLEM, folder=tmp_path)
    assert "\n" not in str(caught.value)
    assert (tmp_path / FILE_NAME).read_bytes() == before


def test_a_block_that_fails_ends_the_run_and_the_others_stay(tmp_path, monkeypatch):
    def failing(first, **arguments):
        if first > 0:
            raise ValueError("bound: too low")
        return judge(first=first, **arguments)

    judge = module.judge_block
    monkeypatch.setattr(module, "judge_block", failing)
    with pytest.raises(RuntimeError, match="block 1: bound: too low; finished blocks are kept"):
        prove(*PROBLEM, folder=tmp_path)
    assert len(lines(tmp_path)) == 2


def test_a_run_that_judges_no_block_leaves_nothing(tmp_path, monkeypatch):
    def unanswered(*_arguments, **_options):
        raise ValueError("dask: no scheduler answers")

    monkeypatch.setattr(module, "run_tasks", unanswered)
    with pytest.raises(ValueError, match="no scheduler answers"):
        prove(*PROBLEM, folder=tmp_path / "new", dask="tcp://127.0.0.1:1")
    assert list(tmp_path.iterdir()) == []
