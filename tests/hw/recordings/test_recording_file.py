"""Reading recordings of logic analysers, whatever wrote them: VCD, and CSV of Saleae Logic."""

import subprocess
from datetime import UTC, datetime, timedelta, timezone

import pytest
from emulators.tools import require_tool
from hypothesis import given, settings
from hypothesis import strategies as st

from hw.export import EXPORTERS
from hw.program import Program
from hw.recordings.playback import align
from hw.recordings.recording_file import parse_saleae, parse_vcd, read_recording

RASKAR = "1010000111000001010000110011110111010111001001100111"
PROGRAM = Program(RASKAR, 200_000)
MS = 1_000_000

LEAD_NS = 1_234_567

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


def seconds(time_ns, digits=9):
    """Write a time as Logic 2 does."""
    sign = "-" * (time_ns < 0)
    size = abs(time_ns)
    return f"{sign}{size // 10**9}.{size % 10**9:09d}" + "0" * (digits - 9)


def iso(time_ns, offset="+00:00"):
    """Write nanoseconds since 1970 as ISO 8601 with nine digits of the second."""
    hours = int(offset[:3])
    minutes = int(offset[0] + offset[4:])
    zone = timezone(timedelta(hours=hours, minutes=minutes))
    moment = datetime.fromtimestamp(time_ns // 10**9, UTC).astimezone(zone)
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{time_ns % 10**9:09d}{offset}"


def export(program, start_ns, *, write=seconds, header="Time [s],Channel 0", separator=","):
    """Write a play that begins at `start_ns` as Logic does: a row for the level at first, and one
    for each change."""
    rows = [(start_ns - LEAD_NS, 0), *((start_ns + at, level) for at, level in program.edges)]
    return "\n".join([header, *(f"{write(at)}{separator}{level}" for at, level in rows)]) + "\n"


def intervals(edges):
    return [(time_ns - edges[0][0], level) for time_ns, level in edges]


@settings(deadline=None, max_examples=100)
@given(codes, st.integers(1, 10**10), st.integers(-(10**10), 10**12))
def test_a_code_comes_back_to_the_nanosecond(bits, chip_ns, start_ns):
    program = Program(bits, chip_ns)
    trace = parse_saleae(export(program, start_ns)).trace()
    assert trace.edges == tuple((start_ns + at, level) for at, level in program.edges)
    assert (trace.name, trace.level, trace.start_ns) == ("Channel 0", 0, start_ns - LEAD_NS)
    (found,) = align(trace, program)
    assert (found.achieved, found.problems) == (bits, ())
    assert found.worst_ns <= 1e-9 * (chip_ns * len(bits) + abs(start_ns))


@pytest.mark.parametrize(
    ("written", "time_ns"),
    [
        ("0.000000001", 1),
        (
            "123456.123456789",
            123_456_123_456_789,
        ),  # a float has no room for this many digits at 1e6 s
        ("4503599.627370495", 4_503_599_627_370_495),
        ("-0.000000001", -1),
        ("+2", 2_000_000_000),
        ("7.642110550000000", 7_642_110_550),
        ("1.5e-06", 1500),
        ("0.0000000416666667", 41.6666667),
    ],
)
def test_times_are_read_as_decimals(written, time_ns):
    trace = parse_saleae(f"Time [s],Channel 0\n-9,0\n{written},1\n").trace()
    assert trace.edges == (
        (time_ns if isinstance(time_ns, int) else pytest.approx(time_ns, rel=1e-15), 1),
    )
    assert trace.start_ns == -9 * 10**9


@settings(deadline=None, max_examples=50)
@given(codes, st.integers(0, 4 * 10**18), st.sampled_from(["+00:00", "+05:30", "-08:00"]))
def test_absolute_times_keep_every_nanosecond(bits, start_ns, offset):
    program = Program(bits, 200_000)
    start_ns += LEAD_NS
    for text in (
        export(program, start_ns, write=lambda at: iso(at, offset)),
        export(program, start_ns, write=lambda at: iso(at, "+00:00").replace("+00:00", "Z")),
        export(program, start_ns),  # since 1970, too
    ):
        trace = parse_saleae(text).trace()
        assert intervals(trace.edges) == intervals(program.edges)
        assert trace.edges[0][0] - trace.start_ns == LEAD_NS
        (found,) = align(trace, program)
        assert (found.achieved, found.problems) == (bits, ())
        assert found.worst_ns < 1


def test_iso_times_without_a_fraction_or_zone_across_a_leap_day():
    rows = ["2024-02-28T23:59:59,0", "2024-02-29T00:00:00.5,1", "2024-03-01T00:00:00.000000001,0"]
    trace = parse_saleae("\n".join(["Time [s],a", *rows])).trace()
    assert intervals(trace.edges) == [(0, 1), (86_399_500_000_001, 0)]


@pytest.mark.parametrize(
    ("header", "separator", "digits"),
    [
        ("Time [s],Channel 0", ",", 9),
        ("Time[s], Channel 0", ", ", 15),
        ("Time [s]\tChannel 0", "\t", 9),
        ("time [s],Channel 0", ",", 9),
        ("Time,Channel 0", ",", 9),
        ('"Time [s]","Channel 0"', ",", 9),
    ],
)
def test_every_version_of_the_header(tmp_path, header, separator, digits):
    text = export(
        PROGRAM, 10**7, write=lambda at: seconds(at, digits), header=header, separator=separator
    )
    wanted = parse_saleae(export(PROGRAM, 10**7)).trace().edges
    for name, written in [
        ("unix.csv", text),
        ("windows.csv", "\ufeff" + text.replace("\n", "\r\n")),
        ("no_suffix", text),
    ]:
        (tmp_path / name).write_text(written, encoding="utf-8", newline="")
        trace = read_recording(tmp_path / name).trace("Channel 0")
        assert trace.edges == wanted


def test_channels_are_found_by_name_and_a_trigger_beside_the_shutter():
    rows = [(0, 0, 0, 1), (1000, 1, 0, 1)]
    for at, level in PROGRAM.edges:
        rows.append((20_000 + at, 1, level, 1))
    text = 'Time [s],gate,"LC, left",idle\n' + "".join(
        f"{seconds(at)},{a},{b},{c}\n" for at, a, b, c in rows
    )
    recording = parse_saleae(text, source="digital.csv")
    assert [trace.name for trace in recording.traces] == ["gate", "LC, left", "idle"]
    assert recording.trace() == recording.trace("LC, left")
    assert recording.trace("idle").level == 1
    (found,) = align(recording.trace("LC, left"), PROGRAM, trigger=recording.trace("gate"))
    assert (found.achieved, found.latency_ns) == (RASKAR, pytest.approx(19_000, abs=1e-3))
    with pytest.raises(
        ValueError, match=r"digital.csv has no signal 'D7': its signals are gate, LC, left, idle"
    ):
        recording.trace("D7")


def test_a_gap_keeps_the_last_level_and_ends_the_recording():
    trace = parse_saleae("Time [s],a,b\n0,0,X\n1,1,X\n2,X,0\n3,1,1\n4,0,1\n5,X,X\n").trace("a")
    assert trace.edges == ((10**9, 1), (4 * 10**9, 0))
    assert trace.end_ns == 5 * 10**9


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty"),
        ("time_us,level\n0,1\n", "begins with 'time_us'"),
        ("name,type,start_time\nI2C,start,0\n", "begins with 'name'"),
        ("Trigger [s],Time [s],Ch0\n0,0,1.2\n", "begins with 'Trigger"),
        ("Time [s]\n0\n", "no channel"),
        ("Time [s],Channel 0\n", "no rows"),
        ("Time [s],Channel 0\n0,0\n1\n", "line 3 has 0 levels: 1 are needed"),
        ("Time [s],Channel 0\n0,0\n1,1,1\n", "line 3 has 2 levels: 1 are needed"),
        ("Time [s],Channel 0\n0,0\n0.5,3.3\n", "line 3 has '3.3' for Channel 0: 0 or 1"),
        ("Time [s],Channel 0\n0,0\n0.5,\n", "line 3 has '' for Channel 0: 0 or 1"),
        ("Time [s],Channel 0\n0,0\nnoon,1\n", "line 3 has time 'noon'"),
        ("Time [s],Channel 0\n0,0\nnan,1\n", "line 3 has time 'nan'"),
        ("Time [s],Channel 0\n0,0\n1e99,1\n", "line 3 has time '1e99'"),
        ("Time [s],Channel 0\n0,0\n0.2,1\n0.1,0\n", "goes back in time at line 4"),
        ("Time [s],Channel 0\n0,0\n2024-01-01T00:00:00,1\n", "line 3 has time '2024"),
        ("Time [s],Channel 0\n2024-01-01T00:00:00,0\n1.5,1\n", "line 3 has time '1.5'"),
        ("Time [s],Channel 0\n2024-13-01T00:00:00,0\n", "line 2 has time '2024-13"),
        ("Time [s],Channel 0\n2024-01-01T00:00:00+99:00,0\n", "line 2 has time '2024"),
        ('Time [s],"Channel 0\n0,0\n', "no rows"),
        ("Time [s],Channel 0\n0,0\n1,1\0\n", "line 3"),
    ],
)
def test_what_is_no_digital_export_gets_one_clear_line(tmp_path, text, words):
    path = tmp_path / "digital.csv"
    path.write_text(text, newline="")
    with pytest.raises(ValueError, match=words) as caught:
        read_recording(path)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(str(path))


def test_a_vcd_is_a_vcd_whatever_its_name(tmp_path):
    (tmp_path / "capture.txt").write_text(EXPORTERS["vcd"].export(PROGRAM))
    assert len(read_recording(tmp_path / "capture.txt").trace("shutter").edges) == len(
        PROGRAM.edges
    )


@settings(deadline=None, max_examples=300)
@given(st.data())
def test_a_damaged_csv_is_refused_or_read_and_never_an_accident(data):
    text = export(
        Program("1011", 200_000), 10**7, write=data.draw(st.sampled_from([seconds, iso]))
    )
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(text) - 1))
        new = data.draw(
            st.one_of(st.just(""), st.sampled_from('01,.-+eTZX"\t \n'), st.characters())
        )
        text = text[:at] + new + text[at + data.draw(st.sampled_from([0, 1, 20])) :]
    lines = []
    try:
        found = align(parse_saleae(text).trace(), Program("1011", 200_000))
    except ValueError as error:
        lines.append(str(error))
    else:
        assert all(len(each.achieved) == 4 for each in found)
        lines += [each.verdict for each in found]
    assert "\n" not in "".join(lines)
