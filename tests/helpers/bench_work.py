"""Work for cells in the tests of the benchmark's engine: what it did is appended to a log."""

import os
import signal
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from lab.block_proofs.blocks import judge_block


def square(*, value, log=None):
    note(log, f"square {value}")
    return {"square": value * value, "parity": "even" if value % 2 == 0 else "odd"}


def total(*, pixels, log, slow_s=0.0):
    """Sum an array, slowly; its begin and end are told apart in the log, with the process."""
    with slowly(log, f"{pixels[0, 0]:.0f}", slow_s):
        return {"total": float(np.sum(pixels))}


def size_of(*, file):
    return {"bytes": len(Path(file).read_bytes())}


def returns(*, what):
    return {
        "nothing": None,
        "nan": {"a": float("nan")},
        "inf": {"a": -np.inf},
        "list": {"a": [1]},
        "numpy": {"a": np.float32(0.1), "b": np.int64(3), "c": np.bool_(True)},
    }[what]


def fails(*, value):
    if value % 2:
        raise ValueError(f"value:\n must be even, got {value}")
    if value == 0:
        raise ZeroDivisionError
    return {"value": value}


def inner_threads(*, seed):
    return {"threads": os.environ.get("OMP_NUM_THREADS")}


def interrupts(*, value, at):
    if value == at:
        signal.raise_signal(signal.SIGINT)
    return {"value": value}


def kills_its_process(*, value, at):
    if value == at:
        time.sleep(0.2)
        os.kill(os.getpid(), signal.SIGKILL)
    return {"value": value}


def judged_slowly(**block):
    """Judge a block of a proof, slowly; the log is named by the environment, as a proof passes the
    block alone."""
    with slowly(os.environ["CEP_TEST_LOG"], block["first"], 0.3):
        return judge_block(**block)


@contextmanager
def slowly(log, name, slow_s):
    """Note begin and end of work with the process, and wait before it."""
    note(log, f"begin {os.getpid()} {name}")
    time.sleep(slow_s)
    yield
    note(log, f"end {os.getpid()} {name}")


def note(log, line):
    if log is not None:
        with open(log, "a", encoding="utf-8") as stream:
            stream.write(line + "\n")
