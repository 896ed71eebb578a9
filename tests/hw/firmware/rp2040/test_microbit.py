"""The controller's `cxp.py` on another, real MicroPython: 1.9.2 on an emulated Cortex-M0 of 16 kB,
by the real driver.

The shutter there is timed by software, so only the order of its edges is looked at.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from emulators.microbit.shrink import pieces
from emulators.tools import give_up, require_tool

from hw.cxp.protocol import Op, State, pack_arm
from hw.drivers.cxp import Controller
from hw.drivers.driver import Trust
from hw.errors import WrongStateError
from hw.program import Program

ROOT = Path(__file__).parents[4]
FIRMWARE = ROOT / "hw" / "firmware" / "rp2040"
BENCH = ROOT / "tests" / "emulators" / "microbit" / "bench.py"
RASKAR = "1010000111000001010000110011110111010111001001100111"


@pytest.fixture(scope="module")
def microbit(tmp_path_factory) -> Iterator[object]:
    require_tool("qemu-system-arm")
    from emulators.microbit import qemu

    if not qemu.FIRMWARE.exists():
        give_up("firmware-microbit-micropython not installed: see .ci/tools")
    sources = [
        path.read_text(encoding="utf-8")
        for path in (FIRMWARE / "cxp_text.py", FIRMWARE / "cxp.py", BENCH)
    ]
    *first, loop = pieces(*sources)
    with qemu.Microbit(tmp_path_factory.mktemp("microbit") / "gpio.log") as board:
        # The heap is small enough for scraps to matter.
        board.execute(["import gc", *(f"{piece}\ngc.collect()" for piece in first)], last=loop)
        yield board


def test_load_read_back_arm_trigger(microbit):
    from emulators.microbit.qemu import PIN0

    program = Program(RASKAR, chip_ns=5_000_000)
    with Controller.open(microbit.port, timeout_s=0.5) as controller:
        assert controller.announced.firmware == "cxp-bench 1"
        assert not controller.announced.trigger_input
        report = controller.upload(program, arm=True)
        assert report.read_back
        assert report.trust is Trust.B  # a shutter timed by software is not proven
        before = len(microbit.events(PIN0))
        assert microbit.events(PIN0)[-1] == 0
        controller.trigger()
        status = controller.wait(timeout_s=30)
        assert (status.state, status.pos, status.late) == (State.DONE, 52, 0)
        assert status.runs == 1
        # It closed at start: 27 events with the 26 edges.
        assert (before, microbit.events(PIN0)[before:]) == (
            1,
            [level for _, level in program.edges],
        )
        assert len(program.edges) == 26


def test_abort_lease_and_refusals(microbit):
    from emulators.microbit.qemu import PIN0

    with Controller.open(microbit.port, timeout_s=0.5) as controller:
        controller.abort()
        controller.upload(Program("1" * 64, chip_ns=1_000_000_000))
        with pytest.raises(WrongStateError):
            controller.trigger()
        controller.arm()
        before = len(microbit.events(PIN0))
        controller.trigger()
        assert controller.status().state is State.PLAY
        controller.abort()
        assert controller.status().state is State.LOADED
        assert microbit.events(PIN0)[before:] == [1, 0]
        controller.link.request(Op.ARM, pack_arm(5))
        while controller.status().state is State.ARMED:
            pass
        assert controller.status().state is State.LOADED
