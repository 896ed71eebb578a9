import contextlib
import json
import shutil
import subprocess

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hw.export import EXPORTERS, exporter
from hw.program import Program

RASKAR = "1010000111000001010000110011110111010111001001100111"

programs = st.builds(
    Program.from_bits,
    st.text("01", min_size=1, max_size=150).filter(lambda bits: "1" in bits),
    chip_ns=st.one_of(st.integers(1, 10**6), st.integers(1, 2**63 - 1)),
)
formats = st.sampled_from(sorted(EXPORTERS))


@contextlib.contextmanager
def _one_short_line_if_refused():
    message = ""
    try:
        yield
    except ValueError as error:
        message = str(error)
    assert "\n" not in message
    assert len(message) < 300


@settings(deadline=None, max_examples=200)
@given(formats, programs)
def test_parse_back_gives_the_identical_program(name, program):
    back = EXPORTERS[name].parse_back(EXPORTERS[name].export(program))
    assert back == program
    assert (back.edges, back.duration_ns) == (program.edges, program.duration_ns)


@settings(deadline=None, max_examples=600)
@given(formats, programs, st.data())
def test_an_altered_text_is_refused_or_means_the_same(name, program, data):
    text = EXPORTERS[name].export(program)
    at = data.draw(st.integers(0, len(text) - 1))
    new = data.draw(st.one_of(st.just(""), st.sampled_from('01579afx,.:"[]{}-#/ \n'), st.characters()))
    length = data.draw(st.sampled_from([0, 1, 1, 1, 5]))
    altered = text[:at] + new + text[at + length :]
    with _one_short_line_if_refused():
        assert EXPORTERS[name].parse_back(altered) == program


@settings(deadline=None, max_examples=100)
@given(formats, programs, st.data())
def test_a_truncated_text_is_refused_or_means_the_same(name, program, data):
    text = EXPORTERS[name].export(program)
    cut = data.draw(st.integers(0, len(text) - 1))
    with _one_short_line_if_refused():
        assert EXPORTERS[name].parse_back(text[:cut]) == program
        assert not text[cut:].strip()


def test_csv_text():
    program = Program.from_bits("0110", chip_ns=1_234_567)
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
    rows = EXPORTERS["csv"].export(Program.from_bits("01", chip_ns=500)).splitlines()[5:]
    assert rows == ["0.500,1", "1.000,0"]


def test_json_fields():
    program = Program.from_bits(RASKAR, chip_ns=200_000)
    manifest = json.loads(EXPORTERS["json"].export(program))
    assert manifest["schema"] == "hw.program/1"
    assert manifest["bits"] == RASKAR
    assert [tuple(edge) for edge in manifest["edges"]] == list(program.edges)
    assert manifest["code_crc32"] == f"0x{program.code_crc32:08x}"


def _csv(*, drop="", replace=("", "")):
    text = EXPORTERS["csv"].export(Program.from_bits("1011", chip_ns=1000))
    return "".join(line for line in text.splitlines(True) if not (drop and drop in line)).replace(*replace)


def _json(**changes):
    manifest = json.loads(EXPORTERS["json"].export(Program.from_bits("1011", chip_ns=1000)))
    return json.dumps({key: value for key, value in (manifest | changes).items() if value is not None})


def _c(old, new):
    text = EXPORTERS["c"].export(Program.from_bits("1011", chip_ns=1000))
    assert old in text
    return text.replace(old, new)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("csv", "", "no '# format:'"),
        ("csv", "\x89PNG\r\n\x1a\n", "column line"),
        ("csv", _csv(drop="chip_ns"), "no '# chip_ns:'"),
        ("csv", _csv(drop="code_crc32"), "no '# code_crc32:'"),
        ("csv", _csv(drop="time_us"), "column line"),
        ("csv", _csv(drop="4.000,0"), "cut short"),
        ("csv", _csv(drop="1.000,0"), "cut short|level"),
        ("csv", _csv(replace=("hw.csv/1", "hw.csv/2")), "hw.csv/2"),
        ("csv", _csv(replace=("1.000,0\n2.000,1", "2.000,1\n1.000,0")), "level|order"),
        ("csv", _csv(replace=("1.000,0\n2.000,1", "2.000,0\n1.000,1")), "out of order"),
        ("csv", _csv(replace=("2.000,1", "2.001,1")), "off the grid"),
        ("csv", _csv(replace=("2.000,1", "nan,1")), "row like"),
        ("csv", _csv(replace=("2.000,1", "3.000,1")), "CRC32"),
        ("csv", _csv(replace=("chips: 4", "chips: 4000000000000000000")), "cut short"),
        ("json", "", "cannot be read"),
        ("json", "[" * 100_000, "cannot be read"),
        ("json", "[]", "holds a list"),
        ("json", _json(schema="hw.program/2"), "hw.program/2"),
        ("json", _json(bits=None), "no field 'bits'"),
        ("json", _json(edges=None), "no field 'edges'"),
        ("json", _json(bits=[1, 0]), "bits is a list"),
        ("json", _json(bits="10x1"), "chip 2"),
        ("json", _json(chip_ns=1000.0), "whole number"),
        ("json", _json(bits="1010"), "CRC32"),
        ("json", _json(code_crc32="0x00000000"), "CRC32"),
        ("json", _json(edges=[[1000, 0], [0, 1]]), "'edges' disagrees"),
        ("json", _json(chips=True), "'chips' disagrees"),
        ("c", "", "does not end with #endif"),
        ("c", "#endif", "0 of SHUTTER_CODE_CHIPS"),
        ("c", _c("0xb0", "0xd0"), "CRC32"),
        ("c", _c("0xb0", "0xb1"), "padding"),
        ("c", _c("0xb0", "0xb"), "bytes like"),
        ("c", _c("0xb0", "0xb0, 0x00"), "SHUTTER_CODE_BYTES"),
        ("c", _c("CHIP_NS 1000", "CHIP_NS 1001"), "CRC32"),
        ("c", _c("CHIPS 4u", "CHIPS 5u"), "CRC32"),
        ("c", _c("#define SHUTTER_CODE_CHIPS 4u\n", ""), "0 of SHUTTER_CODE_CHIPS"),
        ("c", _c("CRC32", "crc"), "CRC32 comment"),
    ],
)
def test_corrupted_texts_get_one_clear_line(name, text, words):
    with pytest.raises(ValueError, match=words) as caught:
        EXPORTERS[name].parse_back(text)
    assert "\n" not in str(caught.value)


def test_unknown_format():
    with pytest.raises(ValueError, match=r"'vhs' is unknown: known are c, csv, json"):
        exporter("vhs")
    assert exporter("csv") is EXPORTERS["csv"]


def test_suffixes():
    assert {name: each.suffix for name, each in EXPORTERS.items()} == {"c": ".h", "csv": ".csv", "json": ".json"}


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed: the C header is not compiled")
@pytest.mark.parametrize(("bits", "chip_ns"), [(RASKAR, 200_000), ("1", 2**63 - 1), ("0" * 100 + "1" * 101, 1)])
def test_c_header_compiles_and_plays(tmp_path, bits, chip_ns):
    program = Program.from_bits(bits, chip_ns=chip_ns)
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
    command = ["gcc", "-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-o", "main", "main.c"]
    built = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert built.returncode == 0, built.stderr
    played = subprocess.run([tmp_path / "main"], capture_output=True, text=True, timeout=10, check=True)
    size = len(program.to_bytes())
    assert played.stdout == f"{chip_ns} {size} {size} {bits}"
