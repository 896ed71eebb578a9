import json
import subprocess
import tomllib

import pytest
from emulators.tools import require_tool
from hypothesis import given, settings
from hypothesis import strategies as st

from hw.device import DeviceProfile
from hw.export import EXPORTERS, export_program
from hw.export.pulse_pal import pulse_train
from hw.export.scpi import commands, sample_rate, samples
from hw.program import Program

RASKAR = "1010000111000001010000110011110111010111001001100111"

CHIPS_NS = {
    "arduino": st.integers(100, 65_535).map(lambda ticks: 500 * ticks),
    "rp2": st.integers(125, 2**32 + 2).map(lambda cycles: 8 * cycles),
    "pulsepal": st.integers(2, 72_000_000 // 151).map(lambda cycles: 50_000 * cycles),
    "scpi": st.integers(16, 2 * 10**9),
    "dmd": st.one_of(st.integers(1, 10**4), st.integers(1, 2**53)).map(lambda us: 1000 * us),
}
"""What a format can represent, where that is not everything."""
ANY_NS = st.one_of(st.integers(1, 10**6), st.integers(1, 2**63 - 1))

codes = st.text("01", min_size=1, max_size=150).filter(lambda bits: "1" in bits)
devices = st.builds(
    DeviceProfile,
    name=st.just("mine"),
    closed_level=st.integers(0, 1),
    on_bias_ns=st.one_of(st.just(0), st.integers(1, 10**5)),
)


@st.composite
def exports(draw):
    """Draw (format, program in its domain, the text exported for some device)."""
    name = draw(st.sampled_from(sorted(EXPORTERS)))
    device = draw(devices)
    chips_ns = CHIPS_NS.get(name, ANY_NS)
    if name == "camera":
        chips_ns = chips_ns.filter(lambda chip_ns: chip_ns > device.on_bias_ns)
    program = Program(draw(codes), chip_ns=draw(chips_ns))
    return name, program, EXPORTERS[name].export(program, device)


@settings(deadline=None, max_examples=400)
@given(exports())
def test_parse_back_gives_the_identical_program(exported):
    name, program, text = exported
    back = EXPORTERS[name].parse_back(text)
    assert back == program
    assert (back.edges, back.duration_ns) == (program.edges, program.duration_ns)


def test_a_format_that_is_not_known_is_refused():
    program = Program("1011", chip_ns=200_000)
    assert export_program(program, "csv") == EXPORTERS["csv"].export(program)
    names = ", ".join(EXPORTERS)
    with pytest.raises(ValueError, match=f"^file_format: must be one of {names}, got 'nope'$"):
        export_program(program, "nope")


def _files(program, device):
    return {name: each.export(program, device) for name, each in EXPORTERS.items()}


def test_a_shutter_that_is_closed_when_high_is_driven_inverted():
    program = Program("1011", chip_ns=200_000)
    plain = _files(program, DeviceProfile(name="low"))
    turned = _files(program, DeviceProfile(name="high", closed_level=1))
    # csv, json, vcd, c and dmd say open and closed, the others say how to drive a pin
    assert {name for name in EXPORTERS if plain[name] != turned[name]} == {
        "arduino",
        "rp2",
        "pulsepal",
        "scpi",
        "camera",
    }
    for name, text in turned.items():
        assert EXPORTERS[name].parse_back(text) == program


def test_csv_text():
    program = Program("0110", chip_ns=1_234_567)
    assert EXPORTERS["csv"].export(program).splitlines() == [
        "# format: hw.csv/1",
        "# chip_ns: 1234567",
        "# chips: 4",
        f"# code_crc32: 0x{program.code_crc32:08x}",
        "time_us,level",
        "1234.567,1",
        "3703.701,0",
        "4938.268,0",
    ]


def test_csv_closes_at_the_end_of_an_open_last_chip_once():
    rows = EXPORTERS["csv"].export(Program("01", chip_ns=500)).splitlines()[5:]
    assert rows == ["0.500,1", "1.000,0"]


def test_json_fields():
    program = Program(RASKAR, chip_ns=200_000)
    manifest = json.loads(EXPORTERS["json"].export(program))
    assert manifest["schema"] == "hw.program/1"
    assert manifest["bits"] == RASKAR
    assert [tuple(edge) for edge in manifest["edges"]] == list(program.edges)
    assert manifest["code_crc32"] == f"0x{program.code_crc32:08x}"


@pytest.mark.parametrize(
    ("name", "written", "wrong"),
    [
        ("csv", "400.000,1", "600.000,1"),
        ("json", "400000,\n   1", "600000,\n   1"),
        ("vcd", "#600000\n1s", "#600000\n0s"),
        ("c", "0xb0", "0xd0"),
        ("arduino", "0xb0", "0xd0"),
        ("rp2", "0xb0000000", "0xd0000000"),
        ("pulsepal", "0, 8, 12", "0, 4, 12"),
        ("pulsepal", "0, 8, 12", "0, 8, 13"),
        ("scpi", "-1,1,-1,1,1,-1", "-1,1,1,-1,1,-1"),
        ("camera", ", 400.000", ", 200.000"),
        ("dmd", "200,200\n400,0", "200,400\n200,0"),
    ],
)
def test_the_edges_are_read_back_from_what_plays(monkeypatch, name, written, wrong):
    program = Program("1011", chip_ns=200_000)
    text = EXPORTERS[name].export(program)
    assert written in text
    monkeypatch.setattr(EXPORTERS[name], "export", lambda *_: text.replace(written, wrong))
    with pytest.raises(RuntimeError, match=f"{name}: reading the text back gave other edges"):
        export_program(program, name)


REFUSALS = [
    ("arduino", "1", 200_100, "200000 ns would do"),
    ("arduino", "1", 49_500, "50000 ns would do"),
    ("arduino", "1", 32_768_000, "32767500 ns would do"),
    ("arduino", "1" * 65_536, 50_000, "at most 65535"),
    ("rp2", "1", 1001, "1000 ns would do"),
    ("rp2", "1", 8, "1000 ns would do"),
    ("rp2", "1", 8 * (2**32 + 3), "34359738384 ns would do"),
    ("rp2", "1" * 224, 1000, "queue holds 223"),
    ("pulsepal", "1", 120_000, "100000 ns would do"),
    ("pulsepal", "1", 50_000, "100000 ns would do"),
    ("pulsepal", "1" * 5001, 100_000, "at most 5000"),
    ("pulsepal", "1", 1801 * 10**9, "at most 3600 s"),
    ("scpi", "1", 15, "at least 16 ns"),
    ("scpi", "1", 3 * 10**13 + 1, "within 1 ppm"),
    ("scpi", "1" * 999_999, 1000, "at most 999998 chips"),
    ("camera", "10" * 4096, 1000, "at most 4095"),
    ("dmd", "1", 105_001, "105000 ns would do"),
    ("dmd", "1", 999, "1000 ns would do"),
]


@pytest.mark.parametrize(("name", "bits", "chip_ns", "words"), REFUSALS)
def test_what_a_format_cannot_say_is_refused_with_what_would_do(name, bits, chip_ns, words):
    with pytest.raises(ValueError, match=words) as caught:
        EXPORTERS[name].export(Program(bits, chip_ns))
    assert "\n" not in str(caught.value)


def test_the_largest_each_format_can_say():
    for name, bits, chip_ns in [
        ("arduino", "1" * 65_535, 32_767_500),
        ("rp2", "1" * 223, 8 * (2**32 + 2)),
        ("pulsepal", "1" * 5000, 100_000),
        ("pulsepal", "1", 1800 * 10**9),
        ("scpi", "01" * 10_000, 16),
        ("camera", "10" * 4095, 1),
        ("dmd", "01" * 500, 1000),
    ]:
        program = Program(bits, chip_ns)
        assert EXPORTERS[name].parse_back(EXPORTERS[name].export(program)) == program


def test_a_camera_is_told_the_widths_without_what_it_adds_itself():
    camera = DeviceProfile(name="camera", on_bias_ns=13_500)
    program = Program("0110010", chip_ns=50_000)
    recipe = tomllib.loads(EXPORTERS["camera"].export(program, camera))
    assert recipe["pulses"] == {
        "count": 2,
        "active_level": 1,
        "on_bias_us": 13.5,
        "first_delay_us": 50.0,
        "widths_us": [86.5, 36.5],
        "gaps_us": [113.5],
        "last_delay_us": 50.0,
    }
    assert recipe["flir"] == {"register": "0x830", "value": "0x83050002"}
    assert recipe["ximea"]["XI_PRM_EXPOSURE_BURST_COUNT"] == 2
    assert "matrix_vision" not in recipe  # it exposes all pulses alike
    alike = tomllib.loads(EXPORTERS["camera"].export(Program("10010", 50_000), camera))
    assert alike["matrix_vision"] == {
        "ExposureMode": "Timed",
        "ExposureTime": 36.5,
        "mvMultiExposureCount": 2,
    }
    with pytest.raises(ValueError, match="shortest opening is 13500 ns: the camera adds 13500 ns"):
        EXPORTERS["camera"].export(Program("10", 13_500), camera)


def test_dmd_list():
    lines = EXPORTERS["dmd"].export(Program("0110010", chip_ns=105_000)).splitlines()
    assert lines[4:] == [
        "# patterns: 2",
        "# leading_dark_us: 105",
        "exposure_us,dark_us",
        "210,210",
        "105,105",
    ]


@settings(deadline=None)
@given(codes, st.integers(2, 1000), st.integers(0, 20))
def test_pulse_train_plays_the_program(bits, cycles, leading):
    """By the device's rule: a pulse lasts phase 1, and one that starts no later than its
    predecessor ends joins it."""
    program = Program("0" * leading + bits, 50_000 * cycles)
    train = pulse_train(program)
    assert train.onsets_cycles[0] == 0
    assert train.delay_cycles + train.onsets_cycles[-1] + train.phase_cycles < train.train_cycles
    edges = []
    for onset in train.onsets_cycles:
        begin = (train.delay_cycles + onset) * 50_000
        if edges and edges[-1][0] >= begin:
            edges.pop()
        else:
            edges.append((begin, 1))
        edges.append((begin + train.phase_cycles * 50_000, 0))
    assert tuple(edges) == program.edges


@settings(deadline=None)
@given(codes, st.integers(16, 10**9), st.integers(0, 1))
def test_waveform_rests_closed_at_both_ends_and_plays_the_program(bits, chip_ns, closed_level):
    program = Program(bits, chip_ns)
    device = DeviceProfile(name="mine", closed_level=closed_level)
    levels = samples(program, device)
    closed = 2 * closed_level - 1
    assert len(levels) >= 8
    assert levels[0] == levels[-1] == closed
    opened = "".join("0" if level == closed else "1" for level in levels)
    assert opened.rstrip("0") == f"0{bits}".rstrip("0")
    assert abs(float(sample_rate(program)) * chip_ns / 1e9 - 1) <= 1e-6
    assert commands(program, device)[4] == f"DATA:ARB SHUTTER,{','.join(map(str, levels))}"


def test_scpi_script_is_the_commands_line_by_line():
    program = Program("101", chip_ns=300_000)
    script = EXPORTERS["scpi"].export(program)
    assert tuple(line for line in script.splitlines() if not line.startswith("#")) == commands(
        program
    )
    assert "FUNC:ARB:SRAT 3333.333333" in script
    assert "DATA:ARB SHUTTER,-1,1,-1,1,-1,-1,-1,-1" in script


def test_suffixes_differ_and_every_format_says_what_it_is():
    suffixes = {name: each.suffix for name, each in EXPORTERS.items()}
    assert len(set(suffixes.values())) == len(EXPORTERS)
    assert suffixes["arduino"] == ".ino"
    assert all(
        20 < len(each.summary) < 90 and "\n" not in each.summary for each in EXPORTERS.values()
    )


@pytest.mark.parametrize(
    ("bits", "chip_ns"), [(RASKAR, 200_000), ("1", 2**63 - 1), ("0" * 100 + "1" * 101, 1)]
)
def test_c_header_compiles_and_plays(tmp_path, bits, chip_ns):
    require_tool("gcc")
    program = Program(bits, chip_ns=chip_ns)
    (tmp_path / "code.h").write_text(EXPORTERS["c"].export(program))
    (tmp_path / "main.c").write_text("""
#include <stdio.h>
#include "code.h"
#include "code.h"
int main(void) {
    unsigned k;
    printf("%llu %u %u ", (unsigned long long)SHUTTER_CODE_CHIP_NS, SHUTTER_CODE_BYTES, (unsigned)sizeof shutter_code);
    for (k = 0; k < SHUTTER_CODE_CHIPS; k++) putchar('0' + (shutter_code[k / 8] >> (7 - k % 8) & 1));
    return 0;
}
""")
    command = [
        "gcc",
        "-std=c99",
        "-pedantic",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-o",
        "main",
        "main.c",
    ]
    built = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert built.returncode == 0, built.stderr
    played = subprocess.run(
        [tmp_path / "main"], capture_output=True, text=True, timeout=10, check=True
    )
    size = len(program.to_bytes())
    assert played.stdout == f"{chip_ns} {size} {size} {bits}"
