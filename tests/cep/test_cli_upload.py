"""``cep upload`` over a real serial connection to a controller on a pseudo-terminal."""

import importlib.util
import json
import signal
import sys
from pathlib import Path

import pytest

from cep.files import read_code

if not hasattr(signal, "SIGALRM"):
    pytest.skip("no pseudo-terminals on this system", allow_module_level=True)

_SPEC = importlib.util.spec_from_file_location(
    "cxp_controller_of_the_command_line", Path(__file__).parents[1] / "emulators" / "cxp_controller.py"
)
emulator = importlib.util.module_from_spec(_SPEC)
sys.modules[_SPEC.name] = emulator  # dataclasses look their module up there
_SPEC.loader.exec_module(emulator)


@pytest.fixture
def controller():
    with emulator.CxpController() as device:
        yield device


def test_a_code_is_loaded_read_back_and_armed(cep, workplace, controller):
    found = cep.succeeds("upload", "code.json", "--port", controller.port, "--arm", "-o", "upload.json")
    assert {"runs", "edges", "duration_ns", "checks", "trust"} <= set(found)
    assert found["trust"] == "read back"
    assert found["armed"]
    assert found["chips"] == read_code("code.json").code.chips
    assert json.loads(Path("upload.json").read_text()) == found
    assert not controller.shutter_open


def test_without_arm_nothing_is_armed(cep, workplace, controller):
    assert not cep.succeeds("upload", "1101", "--port", controller.port)["armed"]


def test_what_the_controller_cannot_play_is_refused(cep, workplace, controller):
    line = cep.refuses("upload", "1101", "--port", controller.port, "--chip-ns", "1001")
    assert "tick" in line
    line = cep.refuses("upload", "10" * 600, "--port", controller.port, "--chip-ns", "1000000")
    assert "too long" in line


def test_a_devices_limits_are_checked_before_the_port_is_opened(cep, workplace):
    Path("slow.toml").write_text('schema = "hw.device/1"\nname = "slow"\nmin_on_ns = 5000000\n')
    line = cep.refuses("upload", "1010", "--port", "/dev/nothing-there", "--device", "slow.toml")
    assert "slow" in line
    assert "5 ms" in line
