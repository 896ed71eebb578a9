"""The emulated Uno itself: what it says when it cannot run, its clock, its captures, its end."""

import itertools
import os
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from emulators.avr import HEX
from emulators.tools import require_simavr, require_tool

from hw.drivers.cxp import Controller
from hw.emulation import uno as board_module
from hw.emulation.uno import CLOCK_HZ, SIGNALS, EmulatedUno, EmulationError, build_board
from hw.program import Program

PROGRAM = Program("110100", chip_ns=200_000)


def play(uno):
    with Controller.open(uno.port) as controller:
        controller.upload(PROGRAM, arm=True)
        controller.trigger()
        controller.wait(timeout_s=5)


@pytest.fixture
def no_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("PATH", str(tmp_path))
    return tmp_path


def compiler(folder, name, script):
    file = folder / name
    file.write_text(f"#!/bin/sh\n{script}\n")
    file.chmod(0o755)


def test_without_a_compiler_it_says_what_to_install(no_cache):
    with pytest.raises(
        EmulationError, match="needs a C compiler and simavr: install gcc, libsimavr-dev"
    ):
        EmulatedUno().start()


@pytest.mark.parametrize(
    ("says", "words"),
    [
        (
            "board.c:1: fatal error: sim_avr.h: No such file or directory",
            "without libsimavr-dev: install",
        ),
        ("/usr/bin/ld: cannot find -lelf", "without libelf-dev: install"),
        ("board.c:9:1: error: out of luck", r"\(board.c:9:1: error: out of luck\): install"),
        ("", "the compiler says nothing"),
    ],
)
def test_when_it_cannot_be_compiled_it_names_the_package(no_cache, says, words):
    compiler(no_cache, "gcc", f'echo "{says}" >&2; exit 1')
    with pytest.raises(EmulationError, match=words) as caught:
        build_board()
    assert "\n" not in str(caught.value)
    assert list((no_cache / "cache" / "coded-exposure").iterdir()) == []


def test_it_is_compiled_once(tmp_path, monkeypatch):
    require_simavr()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    board = build_board()
    assert board.parent == tmp_path / "coded-exposure"
    assert os.access(board, os.X_OK)
    monkeypatch.setenv("PATH", "")
    assert build_board() == board
    assert list(board.parent.iterdir()) == [board]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"speed": -1}, "speed is -1"),
        ({"speed": float("nan")}, "speed is nan"),
        ({"clock_ppm": 200_000}, "clock_ppm is 200000"),
        ({"noise": 1.5}, "noise is 1.5"),
        ({"noise_seed": -1}, "noise_seed is -1"),
        ({"firmware": "nowhere.hex"}, "firmware nowhere.hex is no file"),
    ],
)
def test_bad_options_are_named(options, words):
    with pytest.raises(ValueError, match=words):
        EmulatedUno(**options)


def test_a_firmware_that_is_none_is_refused(tmp_path):
    require_simavr()
    for text in ("", "this is no firmware\n"):
        (tmp_path / "bad.hex").write_text(text)
        with pytest.raises(EmulationError, match=r"bad\.hex: the firmware is no Intel hex file"):
            EmulatedUno(tmp_path / "bad.hex").start()


def test_off_it_says_so_and_still_knows_what_its_pins_did():
    require_simavr()
    uno = EmulatedUno()
    for act in (uno.trigger, uno.hang, uno.unplug, lambda: uno.port):
        with pytest.raises(EmulationError, match="is off: start it"):
            act()
    assert uno.edges() == ()
    with uno:
        play(uno)
        seen = uno.edges()
        with pytest.raises(EmulationError, match="is on already"):
            uno.start()
    uno.stop()
    assert uno.edges() == seen
    assert [level for _, level in seen] == [level for _, level in PROGRAM.edges]
    with pytest.raises(ValueError, match="one of shutter, busy, trigger"):
        uno.edges("reset")


@pytest.mark.parametrize(("hertz", "period"), [(100, 160_000), (250e3, 64), (300e3, 53), (8e6, 2)])
def test_triggers_come_as_often_as_asked_and_outlast_a_reset(hertz, period):
    require_simavr()
    with EmulatedUno(speed=0) as uno:
        uno.trigger(pulses=20, hertz=hertz)
        uno.hang()  # the watchdog resets the board
        end = time.monotonic() + 20
        while len(uno.edges("trigger")) < 40:
            assert time.monotonic() < end
            time.sleep(0.02)
        edges = uno.edges("trigger")
    assert [level for _, level in edges] == [1, 0] * 20
    rises = [cycle for cycle, level in edges if level]
    gaps = [later - earlier for earlier, later in itertools.pairwise(rises)]
    # what is seen between two instructions is late by less than one of them
    assert sum(abs(gap - period) > 8 for gap in gaps) <= 1, gaps  # but for the reset
    assert rises[-1] - rises[0] >= 18 * period - 8


def test_triggers_that_cannot_be_made_are_refused():
    uno = EmulatedUno()
    for wrong in ({"pulses": 0}, {"hertz": 0.5}, {"hertz": 9e6}, {"hertz": float("nan")}):
        with pytest.raises(ValueError, match=f"{next(iter(wrong))} is"):
            uno.trigger(**wrong)


def test_killed_from_outside_it_says_so():
    require_simavr()
    with EmulatedUno() as uno:
        uno._board.kill()
        with pytest.raises(EmulationError, match="has stopped"):
            uno.trigger()
    assert uno.edges() == ()


def read_vcd(path):
    """Signals of a VCD file as lists of (time in units, level), and its unit."""
    names = {}
    changes = {}
    unit = ""
    time_ = 0
    for line in path.read_text().splitlines():
        words = line.split()
        if words[0] == "$timescale":
            unit = " ".join(words[1:-1])
        elif words[0] == "$var":
            names[words[3]] = words[4]
            changes[words[4]] = []
        elif line[0] == "#":
            time_ = int(line[1:])
        elif line[0] in "01":
            changes[names[line[1:]]].append((time_, int(line[0])))
    return unit, changes


@pytest.mark.parametrize("clock_ppm", [0.0, 20_000.0, -2_000.0])
def test_a_capture_has_true_time_whatever_the_crystal(tmp_path, clock_ppm):
    require_simavr()
    with EmulatedUno(clock_ppm=clock_ppm) as uno:
        play(uno)
        uno.write_vcd(tmp_path / "capture.vcd")
        cycles = uno.edges()
    unit, changes = read_vcd(tmp_path / "capture.vcd")
    assert unit == "100 ps"
    assert set(changes) == set(SIGNALS)
    assert changes["shutter"][0] == (0, 0)
    told = changes["shutter"][1:]
    assert [level for _, level in told] == [level for _, level in cycles]
    for (unit_time, _), (cycle, _) in zip(told, cycles, strict=True):
        assert unit_time == pytest.approx(
            cycle / (CLOCK_HZ * (1 + clock_ppm * 1e-6)) * 1e10, abs=0.51
        )
    assert changes["busy"][0] == (0, 0)
    assert [level for _, level in changes["busy"]] == [0, 1, 0]


def test_sigrok_reads_the_capture(tmp_path):
    require_simavr()
    require_tool("sigrok-cli")
    with EmulatedUno() as uno:
        play(uno)
        uno.write_vcd(tmp_path / "capture.vcd")
    command = ["sigrok-cli", "-I", "vcd:downsample=625", "-i", str(tmp_path / "capture.vcd")]
    command += ["-P", "timing:data=shutter", "-A", "timing=time"]
    told = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    lengths_us = [float(word) for word in told if word[0].isdigit()]
    assert lengths_us == pytest.approx([400, 200, 200], abs=0.3)


def test_it_does_not_outlive_who_started_it():
    require_simavr()
    script = (
        "import sys, time\nfrom hw.emulation.uno import EmulatedUno\nwith EmulatedUno(sys.argv[1])"
        " as uno:\n    print(uno.port, flush=True)\n    time.sleep(60)\n"
    )
    root = str(Path(__file__).parents[3])
    command = [sys.executable, "-c", script, str(HEX)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": root}
    ) as owner:
        port = Path(owner.stdout.readline().strip())
        assert port.exists()
        owner.kill()
    end = time.monotonic() + 20
    while port.exists():  # the terminal goes with the process that has it open
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.parametrize(("code", "flags"), [(0, ["-I/opt/simavr"]), (1, None)])
def test_headers_are_where_pkg_config_finds_them_or_in_the_usual_places(monkeypatch, code, flags):
    monkeypatch.setattr(board_module.shutil, "which", lambda _name: "/usr/bin/pkg-config")
    answer = SimpleNamespace(returncode=code, stdout="-I/opt/simavr\n")
    monkeypatch.setattr(board_module.subprocess, "run", lambda *_arguments, **_options: answer)
    usual = ["-I/usr/include/simavr", "-I/usr/local/include/simavr"]
    assert board_module._include_flags() == (flags or usual)
    monkeypatch.setattr(board_module.shutil, "which", lambda _name: None)
    assert board_module._include_flags() == usual
