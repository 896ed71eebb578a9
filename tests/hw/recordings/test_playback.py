"""What a recording shows that the shutter really played."""

import random

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hw.program import Program
from hw.recordings.playback import align
from hw.recordings.recording_file import Trace

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
