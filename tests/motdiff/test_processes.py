"""Processes that end with the one that started them, even when it is killed."""

import subprocess
import sys

import pytest
from killed_parents import outliving

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="/proc tells which processes live"
)

CELLS = """
import bench_work, numpy as np
from lab.jobs.cells import Cell
from lab.jobs.engine import run_cells
cells = [
    Cell(
        (str(n),),
        bench_work.total,
        {{"pixels": n * np.ones((2, 2)), "log": {log!r}, "slow_s": 600.0}},
    )
    for n in range(3)
]
run_cells(cells, cache={cache!r}, workers=2)
"""

BANK = """
import os, time
from pathlib import Path
from motdiff.training import motion_bank

def drawn(mix, seed, indices):
    Path({busy!r}).touch()
    time.sleep(600)

motion_bank._drawn_rows = drawn
motion_bank.build_bank(None, count=1000, seed=0, workers=2)
"""


def test_a_process_with_a_living_parent_is_left_alone():
    lives_on = """
import os, time
from motdiff.processes import end_with_parent
end_with_parent(os.getppid())
time.sleep(0.7)
"""
    assert (
        subprocess.run([sys.executable, "-c", lives_on], timeout=60, check=False).returncode == 0
    )


@pytest.mark.slow(reason="processes that load the library")
def test_workers_of_cells_end_with_a_killed_run(tmp_path):
    """One works, the other begins, and a third is kept by joblib for its semaphores."""
    log = tmp_path / "log"
    assert (
        outliving(CELLS.format(log=str(log), cache=str(tmp_path / "cache")), busy=log, least=2)
        == []
    )


@pytest.mark.slow(reason="processes that load the library")
def test_workers_of_a_bank_of_motions_end_with_a_killed_run(tmp_path):
    busy = tmp_path / "busy"
    assert outliving(BANK.format(busy=str(busy)), busy=busy, least=2) == []
