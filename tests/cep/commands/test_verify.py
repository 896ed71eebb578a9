"""``cep hw verify``: what the controller holds, and what a recording shows."""

import signal
from pathlib import Path

import numpy as np
import pytest
from emulators.cxp_controller import CxpController

from cep.files.code_files import read_code
from hw.program import Program

CODE = ("110100100011", "--chip-ns", "200000")


@pytest.fixture
def recording(cep, workplace):
    cep.succeeds("export", *CODE, "--format", "vcd", "-o", "played.vcd")
    return "--vcd", "played.vcd", "--signal", "shutter"


@pytest.mark.skipif(not hasattr(signal, "SIGALRM"), reason="no pseudo-terminals on this system")
def test_what_the_controller_holds(cep):
    with CxpController() as device:
        port = ("--port", device.port)
        cep.succeeds("upload", *CODE, *port)
        held = cep.succeeds("hw", "verify", *CODE, *port)
        assert (held["read_back"], held["trust"]) == (True, "A")
        assert cep("hw", "verify", *CODE, *port).out.endswith(
            "12 chips of 200000 ns, bit for bit, trust A\n"
        )
        assert cep("hw", "verify", "110100100010", "--chip-ns", "200000", *port).code == 1
        assert (
            "holds another program than it was sent: 1 of 12 chips differ, the first is chip 11"
            in cep.err
        )
        cep.succeeds("upload", *CODE, *port, "--clock-ppm", "3000")
        assert cep.succeeds("hw", "verify", *CODE, *port, "--clock-ppm", "3000")["read_back"]
        assert cep("hw", "verify", *CODE, *port).code == 1


def test_a_recording_of_the_code_gives_the_code_and_its_psf(cep, recording):
    found = cep.succeeds("hw", "verify", *CODE, *recording, "--linear", "20", "-o", "seen.json")
    assert found["played"]
    (play,) = found["plays"]
    assert (play["bits"], play["same_bits"]) == (CODE[0], True)
    assert [play[name] for name in ("clock_ppm", "jitter_ns", "worst_ns")] == pytest.approx(
        [0, 0, 0], abs=1e-3
    )
    assert {str(code) for code in found["files"]} == {path.name for path in Path().glob("seen*")}
    assert (read_code("seen.json").code.bits, read_code("seen.json").code.chip_ns) == (
        CODE[0],
        200_000,
    )
    assert np.load("seen_psf.npy").sum() == pytest.approx(0.5, abs=1e-6)  # 6 of 12 chips are open


@pytest.mark.parametrize("ppm", [-1500, 1500])
def test_a_fast_clock_has_a_positive_sign_as_calibrate_gives_it(cep, recording, ppm):
    lines = Path("played.vcd").read_text().splitlines()
    text = [
        f"#{round(int(line[1:]) / (1 + ppm * 1e-6))}" if line.startswith("#") else line
        for line in lines
    ]
    Path("played.vcd").write_text("\n".join(text) + "\n")
    found = cep.succeeds("hw", "verify", *CODE, *recording)
    assert found["plays"][0]["clock_ppm"] == pytest.approx(ppm, abs=5)


def test_another_code_is_a_failure_of_one_line(cep, recording):
    assert (
        cep(
            "hw", "verify", "110100100001", "--chip-ns", "200000", *recording, "-o", "seen.json"
        ).code
        == 1
    )
    assert cep.err.startswith(
        "cep: play 1: another code was played: 1 of 12 chips differ, first chip 10;"
    )
    assert cep.err.count("\n") == 1
    assert read_code("seen.json").code.bits == CODE[0]  # what was played can be used all the same


@pytest.mark.parametrize("option", ["--capture", "--vcd"])
def test_an_export_of_saleae_logic_is_a_recording_too(cep, workplace, option):
    program = Program(CODE[0], 200_000)
    rows = [(0, 0, 1), *((10**7 + at, level, 1) for at, level in program.edges)]
    text = "Time [s],LC shutter,Channel 1\n" + "".join(
        f"{at / 1e9:.9f},{a},{b}\n" for at, a, b in rows
    )
    Path("digital.csv").write_text(text)
    found = cep.succeeds(
        "hw", "verify", *CODE, option, "digital.csv", "--signal", "LC shutter", "-o", "seen.json"
    )
    assert (found["file"], found["signal"], found["played"]) == ("digital.csv", "LC shutter", True)
    assert found["plays"][0]["start_ns"] == pytest.approx(10**7, abs=1e-3)
    assert read_code("seen.json").code.bits == CODE[0]
    assert "no signal 'D7'" in cep.refuses(
        "hw", "verify", *CODE, option, "digital.csv", "--signal", "D7"
    )
    Path("digital.csv").write_text(text[:-3])
    assert "digital.csv: line" in cep.refuses(
        "hw", "verify", *CODE, option, "digital.csv", "-o", "cut.json"
    )
    assert not Path("cut.json").exists()


def test_bad_recordings_and_options(cep, recording):
    for name, content in (
        ("junk.vcd", b"junk"),
        ("empty.vcd", b""),
        ("noise.vcd", bytes(range(128, 256))),
    ):
        Path(name).write_bytes(content)
        assert f"cep: {name} is no " in cep.refuses(
            "hw", "verify", *CODE, "--vcd", name, "-o", "seen.json"
        )
    cut = Path("played.vcd").read_text()[:150]
    Path("cut.vcd").write_text(cut)
    cep.refuses("hw", "verify", *CODE, "--vcd", "cut.vcd", "-o", "seen.json")
    assert "cannot be read" in cep.refuses("hw", "verify", *CODE, "--vcd", "none.vcd")
    assert "no signal 'D7'" in cep.refuses(
        "hw", "verify", *CODE, "--vcd", "played.vcd", "--signal", "D7"
    )
    assert "exactly one of them" in cep.refuses("hw", "verify", *CODE)
    assert "exactly one of them" in cep.refuses("hw", "verify", *CODE, *recording, "--port", "x")
    assert not Path("seen.json").exists()
