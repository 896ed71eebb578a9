"""What an estimate costs: time, processor time, memory."""

from __future__ import annotations

import ctypes
import gc
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from motdiff.estimators.base import Estimator, MotionEstimate

__all__ = ["Watched"]

_CLEAR, _STATUS = Path("/proc/self/clear_refs"), Path("/proc/self/status")


@dataclass
class Watched:
    """An estimator with a look at what its last estimate cost.

    Attributes
    ----------
    estimator : Estimator
    wall_s : float or None, seconds
    memory_mib : float or None, MiB
        Most that the process has held at once, above what it held before; Linux only.
    """

    estimator: Estimator
    wall_s: float | None = None
    memory_mib: float | None = None

    def estimate(self, photo: NDArray[np.float64]) -> MotionEstimate:
        """Estimate as the estimator does."""
        _give_back()
        before = _status_mib("VmRSS") if _forget_peak() else None
        began_s = time.perf_counter()
        found = self.estimator.estimate(photo)
        self.wall_s = time.perf_counter() - began_s
        peak = _status_mib("VmHWM")
        self.memory_mib = None if before is None or peak is None else max(peak - before, 0.0)
        return found


def _give_back() -> None:
    """Return freed memory to the system, as glibc can: kept for later, it would hide what the next estimate needs."""
    gc.collect()
    try:
        ctypes.CDLL(None).malloc_trim(0)
    except (AttributeError, OSError, TypeError):
        return  # another C library


def _forget_peak() -> bool:
    try:
        _CLEAR.write_text("5", encoding="ascii")
    except OSError:
        return False
    return True


def _status_mib(name: str) -> float | None:
    try:
        lines = _STATUS.read_text(encoding="utf-8").splitlines()
    except OSError:
        return None
    sizes = (line.split()[1] for line in lines if line.startswith(f"{name}:"))
    return next((int(size) / 1024 for size in sizes), None)
