"""Shared by the hardware tests: the emulated controller, and an alarm against hanging."""

from __future__ import annotations

import importlib.util
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

if not hasattr(signal, "SIGALRM"):
    collect_ignore_glob = ["test_link.py", "test_cxp.py"]  # no pseudo-terminals on this system

_LIMIT_S = 90


def _load_emulator() -> None:
    # With importlib mode the tests are no package: the emulator is imported by its path, once per process.
    path = Path(__file__).parents[1] / "emulators" / "cxp_controller.py"
    spec = importlib.util.spec_from_file_location("cxp_controller", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["cxp_controller"] = module
    spec.loader.exec_module(module)


if hasattr(signal, "SIGALRM"):
    _load_emulator()


@pytest.fixture(autouse=True)
def _never_hang() -> Iterator[None]:
    if not hasattr(signal, "SIGALRM"):
        yield
        return

    def ring(*_: object) -> None:
        raise TimeoutError(f"test took longer than {_LIMIT_S} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(_LIMIT_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
