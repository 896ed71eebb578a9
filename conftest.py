"""Settings of every test and doctest."""

import gc
import os

# Arrays are small here: more threads only wait for each other, most of all where pytest's workers use all cores.
# Set before numpy and torch are imported; the workers inherit it, and what the tests start.
os.environ.setdefault("OMP_NUM_THREADS", "1")


def pytest_collection_finish() -> None:
    """Keep what all tests share out of garbage collections: the benchmarks do one before each estimate."""
    gc.freeze()
