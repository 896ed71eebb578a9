"""Shared by the hardware tests: an alarm against hanging."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest

if not hasattr(signal, "SIGALRM"):
    # no pseudo-terminals on this system
    collect_ignore_glob = [
        "cxp/test_link.py",
        "drivers/test_cxp.py",
        "drivers/test_pulse_pal.py",
        "emulation/test_uno.py",
        "test_port.py",
        "firmware/*",
    ]

_LIMIT_S = 90


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
