"""``cep hw`` over a real serial connection to a controller on a pseudo-terminal."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest
from children import child
from emulators.cxp_controller import (
    ABORT,
    ARM,
    ARMED,
    DONE,
    FAULT,
    IDLE,
    LOAD,
    LOADED,
    PLAY,
    STATUS,
    TRIG,
    CxpController,
    Faults,
)
from emulators.tools import require_simavr

from hw.drivers.cxp import Controller
from hw.program import Program
from hw.recordings.recording_file import read_recording

if not hasattr(signal, "SIGALRM"):
    pytest.skip("no pseudo-terminals on this system", allow_module_level=True)

RASKAR = "1010000111000001010000110011110111010111001001100111"


@pytest.fixture
def controller():
    with CxpController() as device:
        yield device


def quick(opened):
    """Open a controller as `opened` does, but give up soon."""
    return lambda port: opened(port, timeout_s=0.02, attempts=3)


def test_step_by_step(cep, controller):
    port = ("--port", controller.port)
    assert cep.succeeds("hw", "info", *port)["state"] == "idle"
    code = (RASKAR, "--chip-ns", "200000", *port)
    assert cep.succeeds("upload", *code)["trust"] == "A"
    assert (controller.bits, controller.ticks) == (RASKAR, 400)
    info = cep.succeeds("hw", "info", *port)
    assert (info["state"], info["firmware"]) == ("loaded", "cxp-avr 1")
    assert cep.succeeds("upload", *code, "--arm")["armed"]
    assert controller.state == ARMED
    played = cep.succeeds("hw", "trigger", *port)
    assert (played["state"], played["plays"], played["missed_edges"]) == ("done", 1, 0)
    assert controller.plays == [RASKAR]
    cep.succeeds("upload", *code, "--arm")
    assert cep.succeeds("hw", "abort", *port)["state"] == "loaded"


def test_the_device_states_its_limits_in_nanoseconds(cep, controller):
    shown = cep.succeeds("hw", "info", "--port", controller.port)
    with Controller.open(controller.port) as opened:
        hello = opened.announced
    tick_ns = hello.tick_ns
    assert shown["min_chip_ns"] == hello.min_ticks * tick_ns > tick_ns
    assert shown["max_chip_ns"] == hello.max_ticks * tick_ns > shown["min_chip_ns"]


def test_pages_for_people(cep, controller):
    port = ("--port", controller.port)
    for words, expected in [
        (("hw", "info", *port), "cxp-avr 1"),
        (("upload", RASKAR, "--chip-ns", "200000", *port, "--arm"), "armed for 10000 ms"),
        (("hw", "trigger", *port), "played, 0 edges missed, shutter closed"),
        (("hw", "abort", *port), "closed, loaded"),
        (("hw", "info", *port, "--watch", "0.05"), "1 states seen"),
    ]:
        assert cep(*words).code == 0, cep.err
        assert expected in cep.out


def test_what_the_device_refuses_is_a_failure_of_one_line(cep, controller):
    assert cep("hw", "trigger", "--port", controller.port).code == 1
    assert "not allowed in its present state" in cep.err
    assert cep.err.count("\n") == 1
    assert cep.out == ""


def test_what_cannot_be_played_is_refused_before_anything_is_loaded(cep):
    with CxpController(max_on_ticks=600) as device:
        line = cep.refuses("upload", "1111", "--chip-ns", "200000", "--port", device.port)
        assert "longest opening is 800 us; at most 300 us" in line
        assert device.bits == ""


SLOW = ("1" * 100, "--chip-ns", "30000000")  # 3 s


@pytest.mark.parametrize("state", [ARMED, PLAY, DONE, FAULT])
def test_an_abort_that_the_state_belies_is_a_failure_that_warns_of_an_open_shutter(cep, state):
    with CxpController(Faults(stuck_play=True, state_after={ABORT: state})) as device:
        cep.succeeds("upload", *SLOW, "--port", device.port)
        cep.fails("hw", "abort", "--port", device.port)
    assert "the shutter may still be open" in cep.err


def test_an_abort_that_is_not_answered_warns_of_an_open_shutter(cep, monkeypatch):
    monkeypatch.setattr("hw.drivers.cxp.Controller.open", quick(Controller.open))
    for lost in (ABORT, STATUS):
        with CxpController(Faults(lost_replies={lost: 10**6})) as device:
            cep.fails("hw", "abort", "--port", device.port)
            assert "does not answer" in cep.err
            assert "the shutter may still be open" in cep.err


@pytest.mark.parametrize("state", [IDLE, LOADED, FAULT])
def test_what_is_not_armed_is_not_said_to_be(cep, state):
    with CxpController(Faults(state_after={ARM: state})) as device:
        cep.succeeds("upload", *SLOW, "--port", device.port)
        cep.fails("upload", *SLOW, "--arm", "--port", device.port)
        assert "ARM" in cep.err
        assert device.ops[-2:] == [ABORT, STATUS]


def test_a_trigger_right_after_arming_is_no_failure_but_nothing_is_armed_any_more(cep):
    command = ("upload", *SLOW, "--arm")
    faults = Faults(stuck_play=True, state_after={ARM: PLAY})
    for trigger_input in (True, False):
        with CxpController(faults, trigger_input=trigger_input) as device:
            port = ("--port", device.port)
            cep.succeeds("upload", *SLOW, *port)
            if not trigger_input:
                cep.fails(*command, *port)  # nothing but itself has begun this play
                assert device.state == LOADED
                continue
            assert not cep.succeeds(*command, *port)["armed"]
            cep.succeeds("hw", "abort", *port)
            cep.succeeds("upload", *SLOW, *port)
            assert "triggered already" in cep(*command, *port).out
            assert device.state == PLAY


@pytest.mark.parametrize("state", [IDLE, LOADED, ARMED, DONE])
@pytest.mark.parametrize("command", ["upload", "trigger"])
def test_what_was_not_played_is_not_said_to_be(cep, command, state):
    with CxpController(Faults(state_after={TRIG: state})) as device:
        port = ("--port", device.port)
        if command == "trigger":
            cep.succeeds("upload", *SLOW, *port, "--arm")
            cep.fails("hw", "trigger", *port)
        else:
            cep.fails("upload", *SLOW, *port, "--play")
        assert "TRIG" in cep.err
        assert device.ops[-2:] == [ABORT, STATUS]


@pytest.mark.parametrize("state", [IDLE, ARMED, PLAY, DONE, FAULT])
def test_what_is_not_loaded_is_not_said_to_be(cep, state):
    with CxpController(Faults(stuck_play=True, state_after={LOAD: state})) as device:
        cep.fails("upload", *SLOW, "--port", device.port)
        assert "LOAD" in cep.err
        assert (device.state, device.ops[-2:]) == (LOADED, [ABORT, STATUS])


def test_a_failure_whose_abort_is_not_obeyed_warns_of_an_open_shutter(cep):
    with CxpController(Faults(stuck_play=True, state_after={ARM: FAULT, ABORT: PLAY})) as device:
        cep.fails("upload", *SLOW, "--port", device.port, "--arm")
        assert "the shutter may still be open" in cep.err


def test_the_clock_is_measured(cep):
    with CxpController(clock_ppm=-20_000) as device:
        found = cep.succeeds("hw", "calibrate", "--port", device.port, "--seconds", "1")
    assert found["clock_ppm"] == pytest.approx(-20_000, abs=2000)
    assert "ceramic resonator" in found["warnings"][0]


def test_a_measured_clock_stretches_the_chips(cep, controller):
    found = cep.succeeds(
        "upload", RASKAR, "--chip-ns", "200000", "--port", controller.port, "--clock-ppm", "-2021"
    )
    assert (found["trust"], found["clock_ppm"]) == ("A", -2021)
    assert controller.ticks == pytest.approx(400 * (1 - 2021e-6), abs=1e-4)


def test_a_watcher_sees_what_others_do_and_disturbs_nothing(cep, controller):
    cep.succeeds("upload", RASKAR, "--chip-ns", "30000000", "--port", controller.port, "--arm")
    controller.state, controller.play_start = 3, time.monotonic()  # as an external trigger does
    seen = cep.succeeds("hw", "info", "--port", controller.port, "--watch", "2.5")
    assert [change["state"] for change in seen["changes"]] == ["play", "done"]
    assert controller.runs == 1


def test_watching_ends_at_ctrl_c_with_what_was_seen(controller):
    command = [
        sys.executable,
        "-c",
        "from cep.commands.main import run; run()",
        "hw",
        "info",
        "--watch",
        "inf",
        "--json",
    ]
    with child(
        [*command, "--port", controller.port],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=os.environ,
    ) as watcher:
        deadline = time.monotonic() + 60
        while len(controller.ops) < 3 and time.monotonic() < deadline:
            time.sleep(0.02)
        watcher.send_signal(signal.SIGINT)
        out, err = watcher.communicate(timeout=60)
    assert (watcher.returncode, err) == (0, "")
    assert [change["state"] for change in json.loads(out)["changes"]] == ["idle"]


def test_watching_for_no_time_is_refused(cep, controller):
    for seconds in ("0", "-1", "nan"):
        assert "--watch: must be above 0" in cep.refuses(
            "hw", "info", "--port", controller.port, "--watch", seconds
        )


def test_ctrl_c_on_a_terminal_ends_an_emulation_with_all_that_its_pins_did(tmp_path):
    require_simavr()
    link = tmp_path / "uno"
    vcd = tmp_path / "played.vcd"
    cep = [sys.executable, "-c", "from cep.commands.main import run; run()"]
    with child(
        [*cep, "hw", "emulate", "uno", "--link", str(link), "--vcd", str(vcd), "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    ) as emulator:
        deadline = time.monotonic() + 60
        while not link.is_symlink() and time.monotonic() < deadline:
            time.sleep(0.02)
        with Controller.open(str(link)) as controller:
            controller.upload(Program(RASKAR, chip_ns=200_000), arm=True)
            controller.trigger()
            controller.wait(timeout_s=30)
        os.killpg(
            emulator.pid, signal.SIGINT
        )  # as the terminal does: all processes that it started get it
        out, _ = emulator.communicate(timeout=60)
    assert emulator.returncode == 0
    assert json.loads(out)["edges"] == len(read_recording(vcd).trace("shutter").edges) == 26
    assert not link.is_symlink()


@pytest.mark.parametrize("command", ["info", "trigger", "abort", "calibrate"])
def test_ports_that_are_none_of_ours(cep, command, tmp_path):
    assert "there is no such port" in cep.refuses(
        "hw", command, "--port", str(tmp_path / "ttyNONE")
    )


def test_what_is_no_serial_port_at_all(cep, tmp_path):
    (tmp_path / "code.json").write_text("{}")
    assert "it is no serial port" in cep.refuses(
        "hw", "info", "--port", str(tmp_path / "code.json")
    )
    assert "it is a folder" in cep.refuses("hw", "info", "--port", str(tmp_path))


def test_a_port_that_babbles_or_is_busy(cep):
    with CxpController(Faults(babble=b"ERROR\r\n")) as device:
        assert "no CXP1 reply: wrong baud rate" in cep.refuses("hw", "info", "--port", device.port)
    with CxpController() as device, Controller.open(device.port):
        assert "another program has it open" in cep.refuses("hw", "info", "--port", device.port)


def test_a_device_that_disappears_is_a_failure(cep):
    with CxpController(Faults(unplug_on=2)) as device:
        assert cep("upload", RASKAR, "--chip-ns", "200000", "--port", device.port).code == 1
        assert "is gone" in cep.err


@pytest.fixture
def ports(monkeypatch):
    """The machine's serial ports, as a test wants them."""
    from hw import port

    def plug(*infos):
        from hw.cxp import link

        found = tuple(port.PortInfo(*info) for info in infos)
        monkeypatch.setattr(port, "list_ports", lambda: found)
        monkeypatch.setattr(link, "list_ports", lambda: found)

    return plug


def test_controllers_are_found_by_asking(cep, controller, ports):
    with CxpController(Faults(silent=True)) as mute:
        ports((controller.port, "USB UART", "A1"), (mute.port, "printer", None))
        plain = cep.succeeds("hw", "info")["ports"]
        assert [(row["port"], row["controller"]) for row in plain] == [
            (controller.port, None),
            (mute.port, None),
        ]
        assert controller.ops == []
        asked = cep.succeeds("hw", "info", "--ask")["ports"]
        assert [(row["firmware"], row["controller"]) for row in asked] == [
            ("cxp-avr 1", True),
            (None, False),
        ]
        assert "is silent" in asked[1]["answer"]
        assert cep.succeeds("hw", "info", "--port", "auto")["state"] == "idle"


def test_a_controller_is_found_by_its_serial_number(cep, controller, ports):
    ports((controller.port, "USB UART", "A1"))
    assert cep.succeeds("upload", "101", "--port", "A1")["read_back"]
    assert controller.state == LOADED


def test_none_or_several_controllers_are_not_guessed(cep, controller, ports):
    ports()
    assert "no serial port answers" in cep.refuses("hw", "info", "--port", "auto")
    with CxpController() as other:
        ports((controller.port, "one", None), (other.port, "two", None))
        assert "name one of them" in cep.refuses("hw", "info", "--port", "auto")
        ports((controller.port, "one", "S"), (other.port, "two", "S"))
        assert "serial number S is that of" in cep.refuses("hw", "info", "--port", "S")


@pytest.mark.parametrize("ending", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_being_ended_while_playing_closes_the_shutter(controller, ending):
    command = [
        sys.executable,
        "-c",
        "from cep.commands.main import run; run()",
        "upload",
        "1" * 100,
        "--play",
    ]
    with child(
        [*command, "--chip-ns", "30000000", "--port", controller.port],
        stderr=subprocess.PIPE,
        env=os.environ,
    ) as playing:
        deadline = time.monotonic() + 60
        while not controller.plays and time.monotonic() < deadline:
            time.sleep(0.02)
        assert controller.shutter_open
        playing.send_signal(ending)
        _, err = playing.communicate(timeout=60)
    assert (playing.returncode, err) == (130, "cep: interrupted\n")
    assert (controller.state, controller.shutter_open) == (LOADED, False)


@pytest.mark.parametrize("arguments", [("--ask", "--port", "x"), ("--watch", "1")])
def test_options_of_the_other_kind_of_information_are_refused(cep, arguments):
    assert arguments[0] in cep.refuses("hw", "info", *arguments)


@pytest.mark.parametrize("name", ["hw list", "hw load", "hw arm", "hw monitor", "camera show"])
def test_a_command_that_was_merged_names_its_successor(cep, name):
    line = cep.refuses(*name.split(), "--port", "x")
    assert line.startswith(f"cep: {name} is now: cep ")


def test_a_pulse_pal_is_closed_by_abort(cep):
    from emulators.pulse_pal import PulsePal

    with PulsePal() as device:
        code = ("1101", "--chip-ns", "200000")
        port = ("--port", device.port, "--driver", "pulse-pal")
        cep.succeeds("upload", *code, *port, "--arm")
        assert cep.succeeds("hw", "abort", *port) == {"port": device.port, "trust": "B"}
