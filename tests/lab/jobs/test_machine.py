"""What is told of the machine: enough to judge a figure, nothing of whose machine it is."""

import json
import os
import platform
from importlib.metadata import version
from pathlib import Path

from lab.jobs.machine import machine


def test_a_figure_can_be_judged():
    found = machine()
    assert found["python"] == platform.python_version()
    assert found["versions"]["numpy"] == version("numpy")
    assert 1 <= found["cores"] <= os.cpu_count()
    assert found["processor"]
    assert platform.machine() in found["system"]
    if Path("/proc/meminfo").exists():
        total_kib = int(Path("/proc/meminfo").read_text().split()[1])
        assert abs(found["memory_gib"] - total_kib / 2**20) <= 0.06  # rounded


def test_nobody_is_named():
    assert set(machine()) == {"processor", "cores", "memory_gib", "system", "python", "versions"}
    assert str(Path.home()) not in json.dumps(machine())
