"""``cep upload`` over a real serial connection to a controller on a pseudo-terminal."""

import json
import signal
from pathlib import Path

import pytest
from emulators.cxp_controller import CxpController

from cep.files.code_files import StoredCode, read_code, write_code
from cep.optics.code import ShutterCode
from hw.device import DeviceProfile
from hw.export import EXPORTERS
from hw.program import Program

if not hasattr(signal, "SIGALRM"):
    pytest.skip("no pseudo-terminals on this system", allow_module_level=True)


@pytest.fixture
def controller():
    with CxpController() as device:
        yield device


def test_a_code_is_loaded_read_back_and_armed(cep, workplace, controller):
    found = cep.succeeds("upload", "code.json", "--port", controller.port, "--arm")
    assert {"runs", "edges", "duration_ns", "checks", "trust"} <= set(found)
    assert found["trust"] == "A"
    assert found["armed"]
    assert found["chips"] == read_code("code.json").code.chips
    assert not controller.shutter_open


def test_without_arm_nothing_is_armed(cep, workplace, controller):
    assert not cep.succeeds("upload", "1101", "--port", controller.port)["armed"]


def test_what_the_controller_cannot_play_is_refused(cep, workplace, controller):
    line = cep.refuses("upload", "1101", "--port", controller.port, "--chip-ns", "1001")
    assert "tick" in line
    assert line.endswith("; search a code that can with --device cxp-avr\n")
    line = cep.refuses("upload", "10" * 600, "--port", controller.port, "--chip-ns", "1000000")
    assert "too long" in line


def test_a_devices_limits_are_checked_before_the_port_is_opened(cep, workplace):
    Path("slow.toml").write_text('schema = "hw.device/1"\nname = "slow"\nmin_on_ns = 5000000\n')
    line = cep.refuses("upload", "1010", "--port", "/dev/nothing-there", "--device", "slow.toml")
    assert "slow" in line
    assert "5 ms" in line


@pytest.fixture
def strict(workplace):
    """A code that was searched for a light that may be on for 2 ms and 3 parts of 10; its profile
    is gone."""
    profile = DeviceProfile(
        name="strict", max_on_ns=2_000_000, max_duty=0.3, max_chip_ns=5_000_000
    )
    about = {"device": profile.to_dict()}
    write_code("strict.json", StoredCode(ShutterCode("1100000000", 1_000_000), problem=about))


HARMFUL = ["--chip-ns", "4000000"]


@pytest.mark.parametrize(
    "command",
    [
        ("export", "--format", "arduino", "-o", "out"),
        ("export", "--format", "csv", "-o", "out"),
        ("upload", "--port", "/dev/nothing-there", "--arm"),
        ("upload", "--port", "/dev/nothing-there", "--driver", "pulse-pal"),
    ],
    ids=lambda command: " ".join(command[:3]),
)
def test_the_limits_of_the_shutter_a_code_was_searched_for_are_kept(
    cep, workplace, strict, command
):
    words = list(command)
    line = cep.refuses(words[0], "strict.json", *HARMFUL, *words[1:])
    assert "strict: longest opening is 8 ms; at most 2 ms" in line
    assert "--device" in line
    assert line.count("\n") == 1
    assert not Path("out").exists()


def test_another_shutter_is_named_by_an_option(cep, workplace, strict, controller):
    found = cep.succeeds("export", "strict.json", "--format", "arduino", "-o", "sketch.ino")
    assert found["checks"]["device"] == "strict"
    assert (
        cep.succeeds("upload", "strict.json", "--port", controller.port)["checks"]["device"]
        == "strict"
    )
    generic = cep.succeeds(
        "upload", "strict.json", *HARMFUL, "--port", controller.port, "--device", "generic"
    )
    assert generic["checks"]["device"] == "generic"
    assert cep.succeeds("hw", "verify", "strict.json", *HARMFUL, "--port", controller.port)[
        "read_back"
    ]


def test_the_shutter_travels_with_a_code_through_a_search_and_a_recording(cep, workplace):
    Path("strict.toml").write_text(
        'schema = "hw.device/1"\nname = "strict"\nmax_on_ns = 2000000\nclosed_level = 1\n'
    )
    search = (
        "--linear",
        "8",
        "--chips",
        "8",
        "--open",
        "3",
        "--method",
        "exact",
        "--device",
        "strict.toml",
    )
    cep.succeeds("optimize", *search, "-o", "searched.json")
    Path("strict.toml").unlink()
    cep.succeeds("export", "searched.json", "--format", "vcd", "-o", "played.vcd")
    cep.succeeds("hw", "verify", "searched.json", "--capture", "played.vcd", "-o", "played.json")
    for file in ("searched.json", "played.json"):
        assert "strict" in cep.refuses("export", file, *HARMFUL, "--format", "c", "-o", "out.h")
    cep.succeeds("export", "searched.json", "--format", "arduino", "-o", "out.ino")
    assert "#define CLOSED_LEVEL 1" in Path("out.ino").read_text()


@pytest.mark.parametrize(
    ("device", "words"),
    [
        ("led-strobe", "longest opening is 80 ms; at most 33 ms"),
        ("gone.toml", "--device NAME|FILE"),
        ({"schema": "hw.device/1"}, "--device NAME|FILE"),
        ({"schema": "hw.device/1", "name": "x", "max_on_ns": "2 ms"}, "max_on_ns"),
        (17, "device"),
    ],
)
def test_a_shutter_in_a_code_file_that_is_a_name_or_no_profile(cep, workplace, device, words):
    document = {
        "schema": "cep.code/1",
        "bits": "1100",
        "chip_ns": 40_000_000,
        "problem": {"device": device},
    }
    Path("odd.json").write_text(json.dumps(document))
    line = cep.refuses("export", "odd.json", "--format", "csv", "-o", "out.csv")
    assert words in line
    assert "odd.json" in line
    assert not Path("out.csv").exists()
    assert cep.refuses("audit", "odd.json") if device == 17 else cep.succeeds("audit", "odd.json")


@pytest.mark.parametrize(
    ("file_format", "meant_ns", "chip_ns"),
    [
        ("arduino", 641_026, 641_000),
        ("arduino", 49_990, 50_000),
        ("rp2", 641_026, 641_024),
        ("dmd", 641_026, 641_000),
        ("pulsepal", 10_049_000, 10_050_000),
        ("csv", 641_026, 641_026),
    ],
)
def test_an_export_rounds_the_chip_to_the_ticks_of_its_device_and_says_so(
    cep, workplace, file_format, meant_ns, chip_ns
):
    chips = ("1101", "--chip-ns", meant_ns)
    found = cep.succeeds("export", *chips, "--format", file_format, "-o", "out")
    assert (found["chip_ns"], found["duration_ns"]) == (chip_ns, 4 * chip_ns)
    assert EXPORTERS[file_format].parse_back(Path("out").read_text()) == Program("1101", chip_ns)
    assert len(found["warnings"]) == (chip_ns != meant_ns)
    assert all(
        f"out: its chips last {chip_ns} ns instead of {meant_ns} ns" in line
        for line in found["warnings"]
    )


def test_a_chip_that_rounding_would_change_by_more_than_half_a_percent_is_refused(cep, workplace):
    line = cep.refuses("export", "1101", "--chip-ns", 641_026, "--format", "pulsepal", "-o", "out")
    assert "600000 ns would do" in line


def test_what_is_rounded_keeps_the_limits_of_its_shutter(cep, workplace):
    Path("sharp.toml").write_text('schema = "hw.device/1"\nname = "sharp"\nmax_on_ns = 1282600\n')
    chips = ("110", "--format", "arduino", "--device", "sharp.toml", "-o", "out.ino", "--chip-ns")
    assert "longest opening is 1.283 ms" in cep.refuses(
        "export", *chips, 641_300
    )  # 641.5 us, rounded
    assert cep.succeeds("export", *chips, 641_200)["chip_ns"] == 641_000
    Path("out.ino").unlink()
    assert cep.succeeds("export", *chips[:4], "cxp-avr", *chips[5:], 641_026)["chip_ns"] == 641_000


def test_a_code_is_played_at_once(cep, workplace, controller):
    found = cep.succeeds("upload", "code.json", "--port", controller.port, "--play")
    assert (found["played"], found["armed"], found["lease_ms"]) == (True, False, None)
    assert controller.plays == [read_code("code.json").code.bits]


def test_a_pulse_pal_plays_the_code(cep, workplace):
    from emulators.pulse_pal import PulsePal

    with PulsePal() as device:
        arguments = (
            "upload",
            "1101",
            "--chip-ns",
            "200000",
            "--port",
            device.port,
            "--driver",
            "pulse-pal",
        )
        found = cep.succeeds(*arguments, "--play")
        assert (found["trust"], found["read_back"], found["played"]) == ("B", False, True)
        assert cep.succeeds(*arguments, "--arm")["lease_ms"] is None


def test_a_waveform_generator_plays_the_code_and_is_not_left_armed(cep, workplace):
    pytest.importorskip("pyvisa_py")
    from emulators.awg import Awg

    with Awg() as device:
        arguments = (
            "upload",
            "1101",
            "--chip-ns",
            "200000",
            "--port",
            device.resource,
            "--driver",
            "scpi",
        )
        found = cep.succeeds(*arguments, "--play")
        assert (found["trust"], found["played"], found["armed"]) == ("B", True, False)
        assert (len(device.plays), device.output) == (1, False)
        assert cep.succeeds(*arguments, "--arm")["armed"]
        assert device.output


def test_ctrl_c_that_the_controller_does_not_acknowledge_is_told(
    cep, workplace, controller, monkeypatch
):
    def interrupted(*_, **__):
        error = KeyboardInterrupt()
        error.add_note("ttyX did not confirm ABORT: the shutter may still be open")
        raise error

    monkeypatch.setattr("hw.drivers.cxp.Controller.upload", interrupted)
    assert cep("upload", "code.json", "--port", controller.port).code == 130
    assert cep.err.splitlines() == [
        "cep: warning: ttyX did not confirm ABORT: the shutter may still be open",
        "cep: interrupted",
    ]


def test_drivers_and_their_options(cep, workplace):
    assert "must be one of cxp, pulse-pal, scpi" in cep.refuses(
        "upload", "101", "--port", "x", "--driver", "arduino"
    )
    assert "only cxp does" in cep.refuses(
        "upload", "101", "--port", "x", "--driver", "pulse-pal", "--clock-ppm", "3"
    )
    assert "give one of them" in cep.refuses("upload", "101", "--port", "x", "--arm", "--play")
    assert "there is no such port" in cep.refuses(
        "upload", "101", "--port", "/dev/none", "--driver", "pulse-pal"
    )
    pytest.importorskip("pyvisa_py")
    assert "cep: " in cep.refuses(
        "upload", "101", "--port", "TCPIP::127.0.0.1::1::SOCKET", "--driver", "scpi"
    )
