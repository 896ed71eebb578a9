"""Damaged files, and files that are none, through every reader: accepted, or refused in one clear
line, at once."""

import pickle
import random
from io import BytesIO

import numpy as np
import pytest
import torch
from fuzz_readers import ACCEPTED, GOOD, READERS, REFUSED, mutated, outcome
from named_pipes import empty_pipe

COUNT = 40
SLOW = {
    "mat": 4,
    "mat photo": 2,
    "levin": 2,
    "denoiser": 8,
    "network": 8,
    "correction": 8,
    "learned code": 8,
}
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


class Trap:
    """Loading its pickle makes a file."""

    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return open, (str(self.mark), "w")


def pickles(mark):
    """Pickles of a :class:`Trap` as they come: bare, by torch, and as arrays of objects."""
    trap = np.array([[Trap(mark)]], dtype=object)
    checkpoint = BytesIO()
    array = BytesIO()
    arrays = BytesIO()
    torch.save(Trap(mark), checkpoint)
    np.save(array, trap, allow_pickle=True)
    np.savez(arrays, psf=trap, blurred=trap)
    wrapped = {"torch": checkpoint, "npy": array, "npz": arrays}
    return {
        "text": pickle.dumps(Trap(mark), protocol=0),
        "binary": pickle.dumps(Trap(mark)),
        **{name: stream.getvalue() for name, stream in wrapped.items()},
    }


def test_a_pickle_is_refused_and_never_loaded(tmp_path, reader):
    mark = tmp_path / "mark"
    path = tmp_path / f"pickle{READERS[reader].suffix}"
    for name, data in pickles(mark).items():
        path.write_bytes(data)
        kind, text = outcome(READERS[reader], path)
        assert (name, kind) == (name, REFUSED), text
        assert not mark.exists(), name
