"""Recordings of a logic analyser, read whatever wrote them."""

import subprocess

import pytest
from emulators.tools import require_tool
from hypothesis import given, settings
from hypothesis import strategies as st

from hw.export import EXPORTERS
from hw.program import Program
from hw.recordings.playback import align
from hw.recordings.recording_file import read_recording
from hw.recordings.vcd import parse_vcd

RASKAR = "1010000111000001010000110011110111010111001001100111"
PROGRAM = Program(RASKAR, 200_000)
MS = 1_000_000

codes = st.text("01", min_size=1, max_size=200).map(lambda middle: f"1{middle}1")


def _only(trace, program=PROGRAM, **options):
    (found,) = align(trace, program, **options)
    return found


@settings(deadline=None, max_examples=100)
@given(codes, st.integers(1, 10**12), st.sampled_from([None, "shutter", "program.shutter"]))
def test_our_own_vcd_comes_back(bits, chip_ns, name):
    program = Program(bits, chip_ns)
    recording = parse_vcd(EXPORTERS["vcd"].export(program))
    trace = recording.trace(name)
    assert trace.edges == tuple((float(at + chip_ns), level) for at, level in program.edges)
    found = _only(trace, program, trigger=recording.trace("gate"))
    assert (found.same_bits, found.achieved, found.problems) == (True, bits, ())
    assert found.missing == found.extra == 0
    assert (found.start_ns, found.latency_ns) == (
        pytest.approx(chip_ns),
        pytest.approx(0, abs=1e-6 * chip_ns),
    )
    assert found.scale_ppm == pytest.approx(0, abs=1e-6)
    assert found.worst_ns <= 1e-9 * chip_ns * len(bits)


HEAD = (
    "$timescale 1 us $end $scope module top $end $var wire 1 ! D0 $end $upscope $end"
    " $enddefinitions $end\n"
)


def test_every_dialect_of_vcd_is_read():
    text = """$date today $end $version some analyser $end
$comment
  two lines
$end
$timescale
    100ps
$end
$scope module top $end
$scope begin inner $end
$var wire 1 ! D0 [0] $end
$var reg 1 ab D1 $end
$upscope $end
$var wire 8 # bus [7:0] $end
$var real 64 r temperature $end
$var wire 1 ! same $end
$var logic 1 ( never $end
$upscope $end
$enddefinitions $end
$dumpvars
x! 0ab bxxxxxxxx # r0 r
$end
#0 1ab
#10 1!  b101 #
$comment a remark $end
#15 z!
#20
0!
#25 1! b0 ab #30 b1 ab
#40 0! 1!
r1.5 r
#50
"""
    recording = parse_vcd(text)
    traces = {trace.name: trace for trace in recording.traces}
    assert set(traces) == {"top.inner.D0[0]", "top.inner.D1", "top.same", "top.never"}
    assert traces["top.inner.D0[0]"].edges == ((1.0, 1), (2.0, 0), (2.5, 1))
    assert traces["top.same"].edges == traces["top.inner.D0[0]"].edges
    assert traces["top.inner.D1"].level == 1
    assert traces["top.inner.D1"].edges == ((2.5, 0), (3.0, 1))
    assert traces["top.never"].edges == ()
    assert {trace.end_ns for trace in recording.traces} == {5.0}
    assert recording.trace("same").name == "top.same"
    assert recording.trace().name == "top.inner.D0[0]"


@pytest.mark.parametrize("unit", ["1 s", "10ms", "100 us", "1 ns", "10 ps", "100fs"])
def test_timescales(unit):
    nanoseconds = {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1, "ps": 1e-3, "fs": 1e-6}
    number = int("".join(filter(str.isdigit, unit)))
    text = HEAD.replace("1 us", unit) + "#7 0!\n#19 1!\n#31 0!\n"
    trace = parse_vcd(text).trace("D0")
    factor = number * nanoseconds[unit.lstrip("0123456789 ")]
    assert trace.start_ns == pytest.approx(7 * factor)
    assert [time_ns for time_ns, _ in trace.edges] == pytest.approx([19 * factor, 31 * factor])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is no VCD file"),
        ("hello world", "is no VCD file"),
        ("time_us,level\n0.000,1\n", "is no VCD file"),
        ("$date today", "cut short"),
        ("$timescale 1 ns $end $var wire 1 ! a $end", "is no VCD file"),
        ("$timescale 3 ns $end $enddefinitions $end", "timescale '3 ns'"),
        ("$var wire 1 ! a $end $enddefinitions $end", "no timescale"),
        ("$timescale 1 ns $end $var wire 1 $end $enddefinitions $end", "declares 'wire 1'"),
        ("$timescale 1 ns $end $var wire 8 ! a $end $enddefinitions $end", "no one-bit signal"),
        (HEAD + "#10 1!\n#9 0!\n", "goes back in time at #9"),
        (HEAD + "#10 1?\n", "'1\\?' among its changes"),
        (HEAD + "#10 7!\n", "'7!' among its changes"),
        (HEAD + "#10 1!\n#2", None),
        (HEAD + "#10 b1", "'b1' among its changes"),
        (HEAD + "#1x", "'#1x' among its changes"),
    ],
)
def test_what_is_no_vcd_gets_one_clear_line(tmp_path, text, words):
    path = tmp_path / "capture.vcd"
    path.write_text(text)
    if words is None:
        words = "goes back in time"
    with pytest.raises(ValueError, match=words) as caught:
        read_recording(path)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(str(path))


def test_unreadable_files_get_one_clear_line(tmp_path):
    session = tmp_path / "capture.sr"
    session.write_bytes(b"PK\x03\x04\xff\xfe\x00\x80")
    with pytest.raises(ValueError, match="is no text: save or export the capture as VCD"):
        read_recording(session)
    with pytest.raises(ValueError, match="No such file"):
        read_recording(tmp_path / "missing.vcd")
    with pytest.raises(ValueError, match="cannot be read"):
        read_recording(tmp_path)


def test_signals_are_found_by_name_or_by_being_busy():
    text = HEAD.replace(
        "$upscope", "$var wire 1 @ D1 $end $scope module sub $end $var wire 1 & D1 $end $upscope"
    )
    quiet = parse_vcd(text + "#0 0! 0@ 0&\n#10\n", source="x.vcd")
    with pytest.raises(
        ValueError, match=r"x.vcd has no edges on any signal \(top.D0, top.D1, top.sub.D1\)"
    ):
        quiet.trace()
    with pytest.raises(ValueError, match=r"no signal 'D7': its signals are top.D0"):
        quiet.trace("D7")
    with pytest.raises(ValueError, match="several signals 'D1'"):
        quiet.trace("D1")
    assert quiet.trace("top.D1").name == "top.D1"
    busy = parse_vcd(text + "#0 0! 0@ 0&\n#10 1!\n#20 1@\n#30 0@\n")
    assert busy.trace().name == "top.D1"


@settings(deadline=None, max_examples=500)
@given(st.data())
def test_a_damaged_file_is_refused_or_read_and_never_an_accident(data):
    text = EXPORTERS["vcd"].export(Program("1011", 200_000))
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(text) - 1))
        new = data.draw(st.one_of(st.just(""), st.sampled_from("01xsg#$ \n"), st.characters()))
        text = text[:at] + new + text[at + data.draw(st.sampled_from([0, 1, 20])) :]
    lines = []
    try:
        found = align(parse_vcd(text).trace(), Program("1011", 200_000))
    except ValueError as error:
        lines.append(str(error))
    else:
        assert all(len(each.achieved) == 4 for each in found)
        lines += [each.verdict for each in found]
    assert "\n" not in "".join(lines)


@pytest.mark.parametrize("downsample", [1, 42, 1000])
def test_a_vcd_written_by_sigrok(tmp_path, downsample):
    """At 1 GHz, 23.8 MHz and 1 MHz: the edges are where that analyser would have seen them."""
    require_tool("sigrok-cli")
    (tmp_path / "code.vcd").write_text(EXPORTERS["vcd"].export(PROGRAM))
    command = [
        "sigrok-cli",
        "-I",
        f"vcd:downsample={downsample}",
        "-i",
        "code.vcd",
        "-O",
        "vcd",
        "-o",
        "seen.vcd",
    ]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=60)
    recording = read_recording(tmp_path / "seen.vcd")
    assert [trace.name for trace in recording.traces] == ["libsigrok.shutter", "libsigrok.gate"]
    found = _only(recording.trace("shutter"), trigger=recording.trace("gate"))
    assert (found.achieved, found.problems) == (RASKAR, ())
    assert abs(found.latency_ns) <= downsample
    assert found.worst_ns <= downsample


ENCODINGS = [
    "utf-8",
    "utf-8-sig",
    "utf-16",
    "utf-16-le",
    "utf-16-be",
    "utf-32",
    "cp1252",
    "latin-1",
    "cp1251",
]


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("kind", ["vcd", "csv"])
def test_any_encoding_of_a_capture_is_read(tmp_path, encoding, kind):
    accent = "д" if encoding == "cp1251" else "é"
    if kind == "vcd":
        text = (
            EXPORTERS["vcd"]
            .export(PROGRAM)
            .replace("$comment", f"$date heure d{accent} $end\n$comment", 1)
        )
    else:
        rows = [(0, 0), *((time_ns + MS, level) for time_ns, level in PROGRAM.edges)]
        lines = [f"{time_ns / 1e9:.9f},{level},0" for time_ns, level in rows]
        text = "\r\n".join([f"Time [s],shutter,d{accent}but", *lines, ""])
    path = tmp_path / f"capture.{kind}"
    path.write_bytes(text.encode(encoding))
    recording = read_recording(path)
    assert _only(recording.trace("shutter")).achieved == RASKAR
    if kind == "csv" and encoding != "cp1251":
        assert recording.trace("début").edges == ()


def test_a_capture_cut_in_the_middle_of_a_character_is_told(tmp_path):
    path = tmp_path / "capture.csv"
    path.write_bytes("Time [s],D0\n0,0\n1,1\n2,0\n3,1".encode("utf-16")[:-1])
    with pytest.raises(ValueError, match=r"capture.csv: line 5 has"):
        read_recording(path)


def test_a_vcd_with_the_mark_of_windows_programs(tmp_path):
    text = EXPORTERS["vcd"].export(PROGRAM)
    (tmp_path / "plain.vcd").write_text(text)
    (tmp_path / "marked.vcd").write_text(text, encoding="utf-8-sig")
    assert (
        read_recording(tmp_path / "marked.vcd").traces
        == read_recording(tmp_path / "plain.vcd").traces
    )
