"""Wrong values for the hardware commands: the option as it was typed, what would be right, and
nothing overwritten."""

import json
import re
import signal
from pathlib import Path

import pytest
from emulators.cxp_controller import CxpController

PARAMETER = re.compile(r"\b[a-z]+_[a-z_]+\b")
TOO_LONG = str(2**63)
needs_terminals = pytest.mark.skipif(
    not hasattr(signal, "SIGALRM"), reason="no pseudo-terminals on this system"
)


def names_the_option(cep, option, *arguments):
    """Run, expect a refusal that names the option and no parameter of Python, and return the
    line."""
    line = cep.refuses(*arguments)
    assert option in line
    assert not PARAMETER.search(line.replace(TOO_LONG, "")), line
    return line


@pytest.mark.parametrize(
    ("option", "arguments"),
    [
        ("--chip-ns", ("export", "101", "--format", "csv", "--chip-ns", TOO_LONG)),
        ("--format", ("export", "101", "--format", "vhs")),
        ("--port", ("hw", "info", "--port", "")),
        ("--port", ("hw", "trigger", "--port", " ")),
        ("--port", ("hw", "verify", "101", "--port", "")),
        *(
            ("--port", ("upload", "101", "--port", "", "--driver", driver))
            for driver in ("cxp", "pulse-pal", "scpi")
        ),
        *(
            ("--clock-ppm", ("upload", "101", "--port", "x", "--clock-ppm", ppm))
            for ppm in ("1e9", "-1e6", "nan")
        ),
        ("--clock-ppm", ("hw", "verify", "101", "--port", "x", "--clock-ppm", "1e9")),
        *(
            ("--seconds", ("hw", "calibrate", "--port", "x", "--seconds", wrong))
            for wrong in ("0", "nan", "4000")
        ),
        *(("--watch", ("hw", "info", "--port", "x", "--watch", wrong)) for wrong in ("0", "nan")),
    ],
)
def test_a_wrong_value_is_said_of_the_option(cep, workplace, option, arguments):
    names_the_option(cep, option, *arguments)


@needs_terminals
@pytest.mark.parametrize("command", [("upload",), ("hw", "verify")])
@pytest.mark.parametrize(
    ("chip_ns", "words"), [("1000", "50 us|50000"), ("100001", "500 ns"), (TOO_LONG, "2\\^63")]
)
def test_a_chip_that_the_controller_cannot_play_is_named_in_words(cep, command, chip_ns, words):
    with CxpController() as device:
        line = cep.refuses(*command, "101", "--port", device.port, "--chip-ns", chip_ns)
    assert re.search(words, line)
    assert not PARAMETER.search(line), line


def test_a_chip_time_of_a_file_is_said_of_the_file(cep, workplace):
    Path("slow.json").write_text(
        json.dumps({"schema": "cep.code/1", "bits": "101", "chip_ns": 2**63})
    )
    line = cep.refuses("export", "slow.json", "--format", "csv")
    assert "slow.json" in line
    assert "--chip-ns" not in line


def test_options_that_a_check_of_the_controller_has_no_use_for_are_refused(cep, workplace):
    for option, value in [
        ("--signal", "D0"),
        ("--trigger", "D1"),
        ("--linear", "9"),
        ("--trajectory", "t.json"),
        ("-o", "x.json"),
    ]:
        assert option in cep.refuses("hw", "verify", "code.json", "--port", "x", option, value)
    assert "--clock-ppm" in cep.refuses(
        "hw", "verify", "code.json", "--capture", "x.vcd", "--clock-ppm", "5"
    )


def test_no_output_replaces_what_is_read_even_by_force(cep, workplace):
    cep.succeeds("export", "code.json", "--format", "vcd", "-o", "played.vcd")
    before = {path.name: path.read_bytes() for path in Path().iterdir()}
    verify = (
        "hw",
        "verify",
        "code.json",
        "--capture",
        "played.vcd",
        "--signal",
        "shutter",
        "--force",
    )
    for arguments in (
        ("export", "code.json", "--format", "csv", "-o", "code.json", "--force"),
        (*verify, "-o", "code.json"),
        (*verify, "-o", "played.vcd"),
        (*verify, "--trajectory", "trajectory.json", "-o", "trajectory.json"),
    ):
        assert "is what is read" in cep.refuses(*arguments)
    assert {path.name: path.read_bytes() for path in Path().iterdir()} == before


def test_a_code_of_many_bits_is_no_file_name(cep, workplace):
    bits = "110" * 200
    assert "no such port" in cep.refuses("upload", bits, "--port", "/dev/none")
    assert "none.vcd" in cep.refuses(
        "hw", "verify", bits, "--capture", "none.vcd", "-o", "seen.json"
    )


@pytest.mark.parametrize("output", ["nowhere/out.x", "there.x", "folder"])
def test_outputs_are_checked_before_any_device_or_compiler_is_touched(
    cep, workplace, monkeypatch, output
):
    def touched(*_, **__):
        pytest.fail("the work began before the output was checked")

    Path("there.x").touch()
    Path("folder").mkdir()
    for name in (
        "hw.emulation.uno.build_board",
        "hw.recordings.recording_file.parse_vcd",
    ):
        monkeypatch.setattr(name, touched)
    Path("played.vcd").write_text("$")
    for arguments in (
        ("hw", "emulate", "uno", "--vcd"),
        ("hw", "emulate", "uno", "--link"),
        ("hw", "verify", "code.json", "--capture", "played.vcd", "-o"),
        ("export", "code.json", "--format", "csv", "-o"),
    ):
        assert f"cep: {output}: " in cep.refuses(*arguments, output)
