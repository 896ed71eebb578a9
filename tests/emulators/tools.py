"""Emulators and compilers that tests need: a clear skip where one is absent, a failure where all
are promised."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from hw.emulation.uno import EmulationError, build_board

NODE_FOLDER = Path(__file__).with_name("node")
PROMISED = "CODED_EXPOSURE_REQUIRE_TOOLS"


def require_tool(*names: str) -> None:
    """Go on only if all these programs are installed."""
    absent = [name for name in names if shutil.which(name) is None]
    if absent:
        give_up(f"{', '.join(absent)} not installed: see .ci/tools")


def require_node_module(*names: str) -> None:
    """Go on only if node and these modules of its are installed."""
    require_tool("node")
    absent = [name for name in names if not (NODE_FOLDER / "node_modules" / name).is_dir()]
    if absent:
        give_up(
            f"node modules {', '.join(absent)} not installed: npm ci --prefix tests/emulators/node"
        )


def require_simavr() -> None:
    """Go on only if the emulated Uno can be built."""
    try:
        build_board()
    except EmulationError as error:
        give_up(str(error))


def give_up(reason: str) -> None:
    """Skip the test, or fail it where continuous integration has promised every tool."""
    if os.environ.get(PROMISED):
        pytest.fail(reason)
    pytest.skip(reason)
