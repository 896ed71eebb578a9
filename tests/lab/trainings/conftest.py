"""Fixtures of the trainings' tests."""

import numpy as np
import pytest
import torch


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture(autouse=True)
def same_draws():
    """Dropout and new networks draw from torch's own generator: the same whatever ran before."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        yield


@pytest.fixture(scope="module")
def photos():
    """Two sharp photos of blocks, (3, 100, 110) uint8."""
    rng = np.random.default_rng(0)
    return [
        torch.from_numpy(
            np.kron(rng.integers(0, 256, (3, 20, 22)), np.ones((5, 5))).astype(np.uint8)
        )
    ] * 2
