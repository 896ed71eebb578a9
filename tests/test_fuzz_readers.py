"""Damaged files, and files that are none, through every reader: accepted, or refused in one clear line, at once."""

import random

import pytest
from fuzz_readers import ACCEPTED, GOOD, READERS, REFUSED, mutated, outcome
from named_pipes import empty_pipe

COUNT = 40
SLOW = {"mat": 4, "mat photo": 2, "levin": 2, "denoiser": 8, "network": 8, "correction": 8, "learned code": 8}
"""Cases of readers that take long: a process of its own for each file, or megabytes."""


@pytest.fixture(params=READERS)
def reader(request):
    if request.param == "dng":
        pytest.importorskip("rawpy")
    return request.param


def test_good_files_are_accepted(tmp_path, reader):
    path = tmp_path / f"good{READERS[reader].suffix}"
    for data in READERS[reader].seeds()[: SLOW.get(reader, 9)]:
        path.write_bytes(data)
        assert outcome(READERS[reader], path) == (ACCEPTED, "")


def test_mutated_files_are_accepted_or_refused_in_one_clear_line(tmp_path, reader):
    path = tmp_path / f"case{READERS[reader].suffix}"
    kinds = {}
    for number in range(SLOW.get(reader, COUNT)):
        path.write_bytes(mutated(READERS[reader], random.Random(f"23:{reader}:{number}")))
        kinds[number] = outcome(READERS[reader], path)
    assert {number: kind for number, kind in kinds.items() if kind[0] not in GOOD} == {}
    assert any(kind == REFUSED for kind, _ in kinds.values())


def test_a_pipe_is_refused_without_waiting_for_it(tmp_path, reader):
    with empty_pipe(tmp_path / f"pipe{READERS[reader].suffix}") as path:
        kind, text = outcome(READERS[reader], path)
    assert kind == REFUSED, text
    assert "regular file" in text
