"""Settings of every test and doctest."""

import os

# Arrays are small here: more threads only wait for each other, most of all where pytest's workers use all cores.
# Set before numpy and torch are imported; the workers inherit it, and what the tests start.
os.environ.setdefault("OMP_NUM_THREADS", "1")
