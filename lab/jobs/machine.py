"""Description of the machine that computed a figure: hardware, system and versions."""

from __future__ import annotations

import os
import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

_MAKERS = (
    "coded-exposure",
    "numpy",
    "scipy",
    "opencv-python-headless",
    "scikit-image",
    "torch",
    "numba",
)


@cache
def machine() -> dict[str, Any]:
    """Describe the machine of this process, without its name or its user's.

    Returns
    -------
    dict
        ``processor``, ``cores`` (that this process may use), ``memory_gib`` (None where unknown),
        ``system``, ``python``, ``versions`` of the packages that figures depend on (None where one
        is not installed as a package).
    """
    return {
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0))
        if hasattr(os, "sched_getaffinity")
        else os.cpu_count(),
        "memory_gib": _memory_gib(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": {name: _version(name) for name in _MAKERS},
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:  # not Linux
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, "") or platform.processor() or platform.machine()


def _memory_gib() -> float | None:
    try:
        return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1)
    # Windows has no sysconf, other systems not all names
    except (AttributeError, ValueError, OSError):
        return None


def _version(distribution: str) -> str | None:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return None
