"""Settings of every test and doctest."""

import gc
import os
import signal
from collections import Counter
from collections.abc import Iterator
from typing import Any

import pytest

# Arrays are small here: more threads only wait for each other, most of all where pytest's workers
# use all cores. Set before numpy and torch are imported; the workers inherit it, and what the
# tests start.
os.environ.setdefault("OMP_NUM_THREADS", "1")


def pytest_collection_finish() -> None:
    """Keep what all tests share out of garbage collections: the benchmarks do one before each
    estimate.
    """
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def _signals_of_a_foreground_job() -> Iterator[None]:
    """Let tests and their children be interrupted where a script's background job or nohup ignores
    the signals.

    A process hands ignored signals down to its children, but not its handlers.
    """
    handlers = {"SIGINT": signal.default_int_handler, "SIGHUP": lambda *_: None}
    ignored = [
        number
        for number in (getattr(signal, name, None) for name in handlers)
        if number is not None and signal.getsignal(number) is signal.SIG_IGN
    ]
    for number in ignored:
        signal.signal(number, handlers[number.name])
    yield
    for number in ignored:
        signal.signal(number, signal.SIG_IGN)


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Say which tests were skipped, and how to have them."""
    skipped = terminalreporter.stats.get("skipped", [])
    if not skipped:
        return
    reasons = Counter(str(report.longrepr[2]).removeprefix("Skipped: ") for report in skipped)
    listed = "; ".join(f"{count} x {reason}" for reason, count in reasons.most_common())
    terminalreporter.write_line(f"{len(skipped)} skipped: {listed}.")
    terminalreporter.write_line(
        "`.ci/tools` installs emulators, compilers and a browser; pip, the packages."
    )
