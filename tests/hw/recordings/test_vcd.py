"""Recordings of a logic analyser: read whatever wrote them, and told what the shutter really
played."""

import random
import subprocess

import pytest
from emulators.tools import require_tool
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hw.export import EXPORTERS
from hw.program import Program
from hw.recordings.playback import align
from hw.recordings.recording_file import read_recording
from hw.recordings.traces import Trace
from hw.recordings.vcd import parse_vcd

RASKAR = "1010000111000001010000110011110111010111001001100111"
PROGRAM = Program(RASKAR, 200_000)
MS = 1_000_000

codes = st.text("01", min_size=1, max_size=200).map(lambda middle: f"1{middle}1")


def _trace(*plays, rest=0, end=None, shift=5 * MS):
    """Record plays, each (edges, start): closed at first, recorded from 0 to 5 ms after the last
    edge."""
    edges = [
        (start + time_ns + shift, level ^ rest)
        for edges, start in plays
        for time_ns, level in edges
    ]
    return Trace("D0", rest, tuple(edges), 0.0, edges[-1][0] + 5 * MS if end is None else end)


def _scaled(program, scale):
    return [(time_ns * scale, level) for time_ns, level in program.edges]


def _sampled(edges, rate_hz):
    """Give each edge the time of the first sample that sees it."""
    period = 1e9 / rate_hz
    return [(-(-time_ns // period) * period, level) for time_ns, level in edges]


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


@settings(deadline=None, max_examples=200)
@given(
    codes,
    st.sampled_from([50_000, 200_000, 1_000_000]),
    st.floats(-5000, 5000),
    st.sampled_from([1e6, 24e6]),
    st.booleans(),
    st.randoms(use_true_random=False),
)
def test_a_slow_or_fast_clock_sampled_and_jittering_still_plays_the_code(
    bits, chip_ns, ppm, rate_hz, inverted, rng
):
    program = Program(bits, chip_ns)
    jitter = 0.02 * chip_ns
    edges = [
        (time_ns + rng.uniform(-jitter, jitter), level)
        for time_ns, level in _scaled(program, 1 + ppm * 1e-6)
    ]
    found = _only(_trace((_sampled(edges, rate_hz), 0), rest=int(inverted)), program)
    assert (found.achieved, found.same_bits, found.inverted) == (bits, True, inverted)
    assert (found.missing, found.extra, found.glitches) == (0, 0, 0)
    assert found.missing == found.extra == 0
    assert found.worst_ns <= 4 * (jitter + 1e9 / rate_hz)
    # The jitter leaves that much freedom to the slope of a code of this length.
    assert found.scale_ppm == pytest.approx(
        ppm, abs=1e6 * 4 * (jitter + 1e9 / rate_hz) / (chip_ns * (len(bits) - 1))
    )
    assert all("clock" in problem for problem in found.problems)


def test_least_squares_against_its_closed_form():
    """Openings and closings have one slope and an offset each: the same as a linear fit with an
    indicator column."""
    rng = random.Random(0)
    edges = [
        (1.002021 * at + 9000 * (1 - level) + rng.gauss(0, 300), level)
        for at, level in PROGRAM.edges
    ]
    found = _only(_trace((edges, 0)))
    # normal equations of t = a + b * closing + s * at
    rows = [(1.0, 1.0 - level, float(at)) for at, level in PROGRAM.edges]
    times = [time_ns + 5 * MS for time_ns, _ in edges]
    a, b, s = _solve(
        [[sum(r[i] * r[j] for r in rows) for j in range(3)] for i in range(3)],
        [sum(r[i] * t for r, t in zip(rows, times, strict=True)) for i in range(3)],
    )
    assert found.scale_ppm == pytest.approx((s - 1) * 1e6, rel=1e-6)
    assert found.start_ns == pytest.approx(a, rel=1e-9)
    assert found.widening_ns == pytest.approx(b, rel=1e-6)
    residuals = [t - a - b * r[1] - s * r[2] for r, t in zip(rows, times, strict=True)]
    assert found.jitter_ns == pytest.approx(
        (sum(x * x for x in residuals) / len(rows)) ** 0.5, rel=1e-4
    )
    assert found.worst_ns == pytest.approx(max(map(abs, residuals)), rel=1e-4)


def _solve(matrix, right):
    rows = [[*row, value] for row, value in zip(matrix, right, strict=True)]
    for k in range(3):
        rows[k] = [value / rows[k][k] for value in rows[k]]
        for other in range(3):
            if other != k:
                rows[other] = [
                    x - rows[other][k] * y for x, y in zip(rows[other], rows[k], strict=True)
                ]
    return [row[3] for row in rows]


def test_the_clock_of_a_ceramic_resonator_is_named():
    found = _only(_trace((_scaled(PROGRAM, 1.002021), 0)))
    assert found.same_bits
    assert found.scale_ppm == pytest.approx(2021, abs=0.01)
    assert (
        found.verdict
        == "the code was played: 52 chips, clock +2021.0 ppm, jitter 0.0 ns rms, worst edge 0.0 ns"
    )
    longer = Program(RASKAR * 10, 200_000)
    assert _only(_trace((_scaled(longer, 1.002021), 0)), longer).problems == (
        "the clock is off by +2021 ppm, 1.05 chips over the code: calibrate it",
    )


@pytest.mark.parametrize("factor", [0.125, 0.5, 1.25, 2.0, 8.0])
def test_a_wrong_prescaler_is_a_clock_and_no_other_code(factor):
    found = _only(_trace((_scaled(PROGRAM, factor), 0)))
    assert found.same_bits
    (problem,) = found.problems
    assert f"the clock is off by {(factor - 1) * 1e6:+.0f} ppm" in problem


@pytest.mark.parametrize("which", range(13))
def test_a_missing_pulse_is_missed_wherever_it_is(which):
    kept = [edge for k, edge in enumerate(PROGRAM.edges) if k // 2 != which]
    found = _only(_trace((_scaled(Program.from_edges(kept, chip_ns=200_000, chips=52), 1.001), 0)))
    assert (found.missing, found.extra, found.same_bits) == (1, 0, False)
    begin, end = (time_ns // 200_000 for time_ns, _ in PROGRAM.edges[2 * which : 2 * which + 2])
    assert found.achieved == RASKAR[:begin] + "0" * (end - begin) + RASKAR[end:]
    assert f"{end - begin} of 52 chips differ, first chip {begin}" in found.verdict
    assert "1 of 13 openings are missing and 0 are too many" in found.verdict


def test_an_extra_pulse_and_a_filled_gap():
    extra = Program(RASKAR[:5] + "1" + RASKAR[6:], 200_000)
    found = _only(_trace((extra.edges, 0)))
    assert (found.missing, found.extra, found.achieved) == (0, 1, extra.bits)
    filled = Program("111" + RASKAR[3:], 200_000)
    found = _only(_trace((filled.edges, 0)))
    assert (found.missing, found.extra, found.achieved) == (1, 0, filled.bits)


MUTANTS = {
    "LSB first": "".join(RASKAR.ljust(56, "0")[8 * (k // 8) + 7 - k % 8] for k in range(52)),
    "played backwards": RASKAR[::-1][:-1] + "1",
    "open and closed are swapped": RASKAR.translate(str.maketrans("01", "10")),
    "1 of 52 chips differ, first chip 51": RASKAR[:-1] + "0",
}


@pytest.mark.parametrize("words", MUTANTS)
def test_mistakes_of_firmware_are_recognised(words):
    found = _only(_trace((_scaled(Program(MUTANTS[words], 200_000), 1.0003), 0)))
    assert not found.same_bits
    assert words in found.verdict
    assert found.achieved.strip("0") == MUTANTS[words].strip("0")


def test_a_shutter_that_stays_open_is_told():
    edges = [*PROGRAM.edges[:-1], (PROGRAM.duration_ns + 900_000, 0)]
    found = _only(_trace((edges, 0)))
    assert found.achieved == RASKAR
    assert "the shutter stays open after the last chip" in found.problems
    for_ever = _only(_trace((PROGRAM.edges[:-1], 0)))
    assert "the shutter stays open after the last chip" in for_ever.problems


def test_slow_closing_widens_the_openings_and_is_no_jitter():
    edges = [(time_ns if level else time_ns + 40_000, level) for time_ns, level in PROGRAM.edges]
    found = _only(_trace((edges, 0)))
    assert found.problems == ()
    assert found.widening_ns == pytest.approx(40_000)
    assert found.worst_ns < 1e-3


def test_several_plays_each_have_their_report():
    lost = [edge for k, edge in enumerate(PROGRAM.edges) if k // 2 != 4]
    trace = _trace(
        (PROGRAM.edges, 0),
        (_scaled(PROGRAM, 1.0005), 11 * MS),
        (lost, 300 * MS),
        (PROGRAM.edges, 300.001e9),
    )
    found = align(trace, PROGRAM)
    assert [each.same_bits for each in found] == [True, True, False, True]
    assert [each.start_ns for each in found] == pytest.approx(
        [5 * MS, 16 * MS, 305 * MS, 300.006e9]
    )
    assert [each.missing for each in found] == [0, 0, 1, 0]


def test_triggers_separate_plays_and_show_the_latency():
    late = 205_100
    trace = _trace((PROGRAM.edges, late), (PROGRAM.edges, 50 * MS + late))
    moments = [
        5 * MS,
        25 * MS,
        55 * MS,
        58 * MS,
    ]  # the second plays nothing, the fourth comes during a play
    pulses = tuple(edge for moment in moments for edge in ((moment, 1), (moment + 1000, 0)))
    found = align(trace, PROGRAM, trigger=Trace("D1", 0, pulses, 0.0, trace.end_ns))
    assert [each.same_bits for each in found] == [True, False, True]
    assert [each.latency_ns for each in found] == [pytest.approx(late), None, pytest.approx(late)]
    assert found[1].verdict == "nothing opens after the trigger at 25 ms: was it armed?"


def test_a_trigger_seen_a_sample_late_still_begins_its_play():
    trace = _trace((PROGRAM.edges, 0))
    gate = Trace("D1", 0, ((5 * MS + 42.0, 1), (20 * MS, 0)), 0.0, trace.end_ns)
    found = _only(trace, trigger=gate)
    assert (found.problems, found.latency_ns) == ((), pytest.approx(-42))


def test_a_trigger_while_the_shutter_is_open_plays_nothing():
    long = Program("1" * 5, 200_000)
    trace = _trace((long.edges, 0))
    gate = Trace("D1", 0, ((5.6 * MS, 1), (5.7 * MS, 0)), 0.0, trace.end_ns)
    assert "nothing opens after the trigger at 5.6 ms" in _only(trace, long, trigger=gate).verdict


def test_glitches_are_counted_and_passed_over():
    rng = random.Random(1)
    spikes = []
    for (begin, level), (end, _) in zip(PROGRAM.edges, PROGRAM.edges[1:], strict=False):
        at = rng.uniform(begin + 1000, end - 1000)
        spikes += [(at, 1 - level), (at + 30, level)]
    found = _only(_trace((sorted([*PROGRAM.edges, *spikes]), 0)))
    assert (found.achieved, found.glitches, found.problems) == (RASKAR, 25, ())
    before = _only(_trace((sorted([(-2 * MS, 1), (-2 * MS + 40, 0), *PROGRAM.edges]), 0)))
    assert (before.achieved, before.problems) == (RASKAR, ())


def test_a_cut_recording_is_told():
    whole = _trace((PROGRAM.edges, 0))
    for count in (9, 10):
        cut = Trace("D0", 0, whole.edges[:count], 0.0, whole.edges[count - 1][0] + 1000)
        found = _only(cut)
        assert not found.same_bits
        assert "the recording ends before the code does: record longer" in found.problems
    late = Trace("D0", 1, whole.edges[1:], whole.edges[0][0] + 50_000.0, whole.end_ns)
    found = _only(late)
    assert not found.inverted
    assert (
        found.problems[-1]
        == "the recording begins with the shutter open: start it before the trigger"
    )


@settings(deadline=None, max_examples=100)
@given(codes, st.booleans(), st.sampled_from([0, 50_000]), st.sampled_from([0, 1, 5 * MS]))
def test_a_recording_that_begins_with_the_first_edge_is_read_and_said(
    bits, inverted, late_ns, idle_ns
):
    # No level at rest before the play, nor for long after it: closed is the level by which the
    # code was played.
    program = Program(bits, 200_000)
    assume(program.pulses > 2)  # of fewer edges either level may be the open one
    edges = tuple((time_ns - late_ns, level ^ inverted) for time_ns, level in program.edges[1:])
    found = _only(Trace("D0", 1 ^ inverted, edges, 0.0, edges[-1][0] + idle_ns), program)
    assert (
        "the recording begins with the shutter open: start it before the trigger" in found.problems
    )
    assert not any("another code" in problem for problem in found.problems)
    assert found.achieved == bits
    # A code that is its own complement, read the other way, or of which one is the other's start,
    # is no counterexample.
    assert found.inverted == inverted or bits == bits[::-1]


def test_a_signal_of_glitches_alone_is_no_play():
    for level in (0, 1):
        trace = Trace("D0", level, ((5e6, 1 - level), (5e6 + 1000, level)), 0.0, 1e7)
        with pytest.raises(ValueError, match="only pulses shorter than 20 us"):
            align(trace, PROGRAM)


def test_times_in_another_unit_are_no_clock_error_to_calibrate():
    found = _only(_trace((_scaled(PROGRAM, 1000), 0)))
    assert "the unit of time" in found.problems[0]
    assert "calibrate" not in found.verdict


@settings(deadline=None, max_examples=200)
@given(codes, codes, st.integers(-3000, 3000))
def test_another_code_is_never_taken_for_the_right_one(bits, other, ppm):
    assume(bits != other)
    program = Program(bits, 200_000)
    played = Program(other, 200_000)
    found = align(_trace((_scaled(played, 1 + ppm * 1e-6), 0)), program)
    # A code made of the right one twice is two plays of it.
    assert any(each.problems for each in found) or len(found) > 1


def test_no_edge_is_one_clear_line():
    with pytest.raises(ValueError, match="signal 'D0' has no edge"):
        align(Trace("D0", 1, (), 0.0, 1e9), PROGRAM)
    with pytest.raises(ValueError, match="trigger 'D1' has no edge"):
        align(_trace((PROGRAM.edges, 0)), PROGRAM, trigger=Trace("D1", 1, (), 0.0, 1e9))
    with pytest.raises(ValueError, match="trigger 'D1' never rises"):
        align(_trace((PROGRAM.edges, 0)), PROGRAM, trigger=Trace("D1", 1, ((5.0, 0),), 0.0, 1e9))


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
