"""Verification of recorded plays: matched edges, clock error, jitter, widening, wrong chips."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import sqrt
from statistics import fmean

from hw.program import Program
from hw.recordings.recording_file import Trace

_REACH = 0.45  # of a chip: an edge farther than that from its place is another edge
_STARTS = 8  # openings that may be missing or too many at the beginning
_GLITCH = 0.1  # of a chip: what is shorter is noise, not a chip
_SLACK = 1.03  # a play may last that much longer than it should before the next is looked for
_CLOCKS = (0.8, 1.25)  # as much longer or shorter no clock makes a play: a factor is wrong
_DRIFT_CHIPS = 0.25  # over the whole code; more is a visibly other blur


@dataclass(frozen=True, slots=True)
class EdgeFit:
    """Recorded edges in their places, and the clock through them.

    Parameters
    ----------
    program : Program
        Program that the edges were compared with.
    pairs : tuple of (int, float, int)
        Edges found, as (time in the program in ns, recorded time in ns, level).
    scale : float
        Recorded time per time of the program.
    open_at, close_at : float
        Recorded time in ns of the program's beginning, by its openings and by its closings.
    achieved : str
        Chips by majority of the open time of each.
    stays_open : bool
        Whether the chip time behind the last chip is open too.
    wrong : int
        Chips that differ from the program.
    """

    program: Program
    pairs: tuple[tuple[int, float, int], ...]
    scale: float
    open_at: float
    close_at: float
    achieved: str
    stays_open: bool
    wrong: int

    @property
    def residuals(self) -> tuple[float, ...]:
        """Distances in ns of the recorded edges from the fitted clock."""
        return tuple(
            time_ns - (self.open_at if level else self.close_at) - self.scale * at
            for at, time_ns, level in self.pairs
        )


def fit_edges(edges: Sequence[tuple[float, int]], program: Program, /) -> EdgeFit:
    """Find the program's edges among recorded ones.

    Openings may be missing or too many, also at the beginning: all matches of the first openings
    are tried, and the one with the fewest wrong chips is taken, the simplest of equals.

    Parameters
    ----------
    edges : sequence of (float, int)
        Recorded changes of one play as (time_ns, level), in order; at least one opening.
    """
    nominal = program.edges
    openings = [edge for edge in edges if edge[1]]
    nominal_openings = [edge for edge in nominal if edge[1]]
    anchors = [(openings[0], start) for start in nominal_openings[:_STARTS]] + [
        (edge, nominal_openings[0]) for edge in openings[1:_STARTS]
    ]
    # A clock that is far off would lose its edges: where the counts agree, the recording's own
    # length is tried too.
    scales = [1.0]
    if len(edges) == len(nominal) and not edges[-1][1]:
        scales.append((edges[-1][0] - edges[0][0]) / (nominal[-1][0] - nominal[0][0]))
    best: EdgeFit | None = None
    for scale in scales:
        for (time_ns, _), (at, _) in anchors:
            fit = _fitted(edges, program, scale, time_ns, at)
            if best is None or (fit.wrong, -len(fit.pairs)) < (best.wrong, -len(best.pairs)):
                best = fit
            if not fit.wrong and len(fit.pairs) == len(nominal):
                return fit
    assert best is not None
    return best


def _fitted(
    edges: Sequence[tuple[float, int]], program: Program, scale: float, time_ns: float, at: int
) -> EdgeFit:
    moments = {level: [time for time, new in edges if new == level] for level in (0, 1)}
    reach = _REACH * program.chip_ns * scale
    pairs: list[tuple[int, float, int]] = []
    for nominal, level in program.edges:
        # From edge to edge, so that a slow clock is followed however long the code is.
        match_ns = _nearest(moments[level], time_ns + scale * (nominal - at), reach)
        if match_ns is not None:
            pairs.append((nominal, match_ns, level))
            time_ns = match_ns
            at = nominal
    # Once more, now around the fitted line: the first way could follow a wrong edge.
    scale, *starts = _clock(pairs)
    refined = [
        (nominal, match_ns, level)
        for nominal, level in program.edges
        if (match_ns := _nearest(moments[level], starts[1 - level] + scale * nominal, reach))
        is not None
    ]
    pairs = refined or pairs
    scale, open_at, close_at = _clock(pairs)
    played = _played(edges, open_at, scale * program.chip_ns, program.chips + 1)
    achieved = played[:-1]
    wrong = sum(map(str.__ne__, achieved, program.bits))
    return EdgeFit(
        program, tuple(pairs), scale, open_at, close_at, achieved, played[-1] == "1", wrong
    )


def _nearest(moments: Sequence[float], time_ns: float, reach_ns: float) -> float | None:
    index = bisect_left(moments, time_ns)
    nearest = min(
        moments[max(index - 1, 0) : index + 1],
        key=lambda moment: abs(moment - time_ns),
        default=None,
    )
    if nearest is None or abs(nearest - time_ns) > reach_ns:
        return None
    return nearest


def _clock(pairs: Sequence[tuple[int, float, int]]) -> tuple[float, float, float]:
    """Least squares of time = offset(kind of edge) + scale * nominal."""
    kinds = [[(at, time_ns) for at, time_ns, level in pairs if level == kind] for kind in (1, 0)]
    if all(len(kind) < 2 for kind in kinds):
        # A single opening: its length is the clock's.
        kinds = [[(at, time_ns) for at, time_ns, _ in pairs]]
    means = [
        (fmean(at for at, _ in kind), fmean(time for _, time in kind)) if kind else None
        for kind in kinds
    ]
    covariance = variance = 0.0
    for kind, mean in zip(kinds, means, strict=True):
        for at, time_ns in kind:
            assert mean is not None
            covariance += (at - mean[0]) * (time_ns - mean[1])
            variance += (at - mean[0]) ** 2
    scale = covariance / variance if variance and covariance > 0 else 1.0
    offsets = [mean[1] - scale * mean[0] for mean in means if mean is not None] or [0.0]
    return scale, offsets[0], offsets[-1]


def _played(
    edges: Sequence[tuple[float, int]], start_ns: float, chip_ns: float, chips: int
) -> str:
    """Chips by majority of open time."""
    open_ns = [0.0] * chips
    played = [*edges, (start_ns + chips * chip_ns, 0)]
    if not edges[0][1]:  # the first opening is missing: open from the beginning
        played.insert(0, (start_ns, 1))
    for (begin, level), (end, _) in pairwise(played):
        if level:
            first = max(int((begin - start_ns) // chip_ns), 0)
            last = min(int((end - start_ns) // chip_ns), chips - 1)
            for chip in range(first, last + 1):
                low = start_ns + chip * chip_ns
                high = start_ns + (chip + 1) * chip_ns
                open_ns[chip] += max(min(end, high) - max(begin, low), 0.0)
    # By majority: slow ramps and late edges leave a chip partly open.
    return "".join("1" if time > chip_ns / 2 else "0" for time in open_ns)


@dataclass(frozen=True, slots=True, kw_only=True)
class Verification:
    """One recorded play of a program.

    Parameters
    ----------
    start_ns : float
        Moment of the first chip in the recording.
    achieved : str
        Chips as played, by majority of the open time of each at the fitted clock.
    same_bits : bool
        Whether these are the program's chips.
    inverted : bool
        Whether the signal rests high, hence is open when low.
    scale_ppm : float
        Clock error: how much longer than commanded the play lasts, parts per million.
    jitter_ns, worst_ns : float
        Root mean square and largest distance of an edge from the fitted clock.
    widening_ns : float
        How much longer than by the fitted clock the openings last: slow closing, or a bias of the
        device.
    missing, extra : int
        Openings of the program not found, and openings found that it has not.
    glitches : int
        Pulses too short to be chips, passed over.
    latency_ns : float or None
        From the trigger to the first chip, if a trigger was recorded.
    problems : tuple of str
        Deviations, each in one sentence; empty when the program was played.
    """

    start_ns: float
    achieved: str
    same_bits: bool
    inverted: bool
    scale_ppm: float = 0.0
    jitter_ns: float = 0.0
    worst_ns: float = 0.0
    widening_ns: float = 0.0
    missing: int
    extra: int = 0
    glitches: int
    latency_ns: float | None = None
    problems: tuple[str, ...]

    @property
    def verdict(self) -> str:
        """Summary in one line."""
        if self.problems:
            return "; ".join(self.problems)
        inversion = ", signal inverted" if self.inverted else ""
        return (
            f"the code was played: {len(self.achieved)} chips, clock {self.scale_ppm:+.1f} ppm,"
            f" jitter {self.jitter_ns:.1f} ns rms, worst edge {self.worst_ns:.1f} ns{inversion}"
        )


def align(
    trace: Trace, program: Program, *, trigger: Trace | None = None
) -> tuple[Verification, ...]:
    """Compare a recorded signal with the program.

    Parameters
    ----------
    trace : Trace
        The shutter's signal; its level at rest counts as closed, whichever it is.
    trigger : Trace or None
        A signal that rises at or shortly before every play; without one, a play begins with its
        first opening.

    Returns
    -------
    tuple of Verification
        One for each play in the recording.

    Raises
    ------
    ValueError
        If the signal has no edge or only pulses too short to be chips, or the trigger has no
        rising edge.
    """
    for signal, kind in ((trace, "signal"), (trigger, "trigger")):
        if signal is not None and not signal.edges:
            raise ValueError(
                f"{kind} {signal.name!r} has no edge in this recording: nothing was played into it"
            )
    if trigger is not None and not any(level for _, level in trigger.edges):
        raise ValueError(
            f"trigger {trigger.name!r} never rises in this recording: start it before the trigger"
        )
    # Where both levels may be the closed one, the reading nearer to the program is taken.
    readings = [
        plays
        for closed_level in _closed_levels(trace)
        if (plays := _closed_at(trace, program, trigger, closed_level=closed_level))
    ]
    if not readings:
        raise ValueError(
            f"signal {trace.name!r} has only pulses shorter than"
            f" {_GLITCH * program.chip_ns / 1000:g} us in this recording: nothing was played into"
            " it, or the chip time is wrong"
        )
    return min(readings, key=_differing)


def _closed_at(
    trace: Trace, program: Program, trigger: Trace | None, *, closed_level: int
) -> tuple[Verification, ...]:
    """Compare a signal that is closed at the level ``closed_level`` with the program."""
    level = trace.level ^ closed_level
    raw = [(time_ns, new_level ^ closed_level) for time_ns, new_level in trace.edges]
    if level:
        raw.insert(0, (trace.start_ns, 1))
    edges, glitch_times = _without_glitches(raw, _GLITCH * program.chip_ns)
    verifications = []
    for begin, end, trigger_ns in _plays(edges, program, trigger):
        play_edges = edges[bisect_left(edges, (begin, 0)) : bisect_left(edges, (end, 0))]
        glitches = sum(begin <= time_ns < end for time_ns in glitch_times)
        verifications.append(
            _verification(
                play_edges, program, trace.end_ns, bool(closed_level), glitches, trigger_ns
            )
        )
    if level and verifications:
        cut = ("the recording begins with the shutter open: start it before the trigger",)
        verifications[0] = replace(verifications[0], problems=(*verifications[0].problems, *cut))
    return tuple(verifications)


def _closed_levels(trace: Trace) -> tuple[int, ...]:
    """Levels at which the signal may be closed, the likelier first: those beyond its edges.

    A recording that begins or ends at an edge has two of them.
    """
    last = trace.edges[-1][1]
    if trace.level == last:
        return (last,)
    before = trace.edges[0][0] - trace.start_ns
    after = trace.end_ns - trace.edges[-1][0]
    return (trace.level, last) if before >= after else (last, trace.level)


def _differing(plays: tuple[Verification, ...]) -> tuple[int, int, int]:
    """Plays with wrong chips, openings lost or added, and other problems."""
    return (
        sum(not play.same_bits for play in plays),
        sum(play.missing + play.extra for play in plays),
        sum(len(play.problems) for play in plays),
    )


def _without_glitches(
    edges: Sequence[tuple[float, int]], shortest_ns: float
) -> tuple[list[tuple[float, int]], list[float]]:
    """Drop pulses of either level that are too short; return the rest, and their moments."""
    clean: list[tuple[float, int]] = []
    glitch_times: list[float] = []
    for edge in edges:
        if clean and edge[0] - clean[-1][0] < shortest_ns:
            glitch_times.append(clean.pop()[0])
        else:
            clean.append(edge)
    return clean, glitch_times


def _plays(
    edges: Sequence[tuple[float, int]], program: Program, trigger: Trace | None
) -> Iterator[tuple[float, float, float | None]]:
    """Yield (begin, end, trigger time) of each stretch that holds one play."""
    nominal = program.edges
    lasts = (nominal[-1][0] - nominal[0][0]) * _SLACK + program.chip_ns / 2
    if trigger is not None:
        moments: list[float] = []
        for time_ns, level in trigger.edges:
            # Bounces of the trigger, and triggers within a play, start nothing.
            if level and (not moments or time_ns >= moments[-1] + program.duration_ns / _SLACK):
                moments.append(time_ns)
        # An analyser may see a simultaneous opening a sample earlier.
        early = program.chip_ns / 2
        for moment, following in pairwise([*moments, float("inf")]):
            yield moment - early, following - early, moment
        return
    if len(edges) == len(nominal):  # one play, even if its clock is badly wrong
        yield edges[0][0], float("inf"), None
        return
    begin: float | None = None
    for time_ns, level in edges:
        if level and (begin is None or time_ns > begin + lasts):
            if begin is not None:
                yield begin, begin + lasts, None
            begin = time_ns
    if begin is not None:
        yield begin, float("inf"), None


def _verification(
    edges: Sequence[tuple[float, int]],
    program: Program,
    end_ns: float,
    inverted: bool,
    glitches: int,
    trigger_ns: float | None,
) -> Verification:
    if not any(level for _, level in edges):
        return _nothing(program, inverted, glitches, trigger_ns or 0.0)
    fit = fit_edges(edges, program)
    problems = []
    if fit.wrong:
        fit, deviation = _explained(fit, edges, program)
        problems.append(deviation)
    openings = sum(level for _, _, level in fit.pairs)
    missing = fit.program.pulses - openings
    extra = sum(level for _, level in edges) - openings
    if missing or extra:
        problems.append(
            f"{missing} of {program.pulses} openings are missing and {extra} are too many"
        )
    if fit.stays_open:
        problems.append("the shutter stays open after the last chip")
    # half a chip: an edge that is a little late is not cut off
    if fit.open_at + fit.scale * program.edges[-1][0] > end_ns + program.chip_ns / 2:
        problems.append("the recording ends before the code does: record longer")
    scale_ppm = (fit.scale - 1) * 1e6
    drift = abs(fit.scale - 1) * program.chips
    if drift > _DRIFT_CHIPS:
        remedy = "is the chip time right, and the unit of time?"
        if _CLOCKS[0] < fit.scale < _CLOCKS[1]:
            remedy = "calibrate it"
        problems.append(
            f"the clock is off by {scale_ppm:+.0f} ppm, {drift:.2f} chips over the code: {remedy}"
        )
    return Verification(
        start_ns=fit.open_at,
        achieved=fit.achieved,
        same_bits=fit.achieved == program.bits,
        inverted=inverted,
        scale_ppm=scale_ppm,
        jitter_ns=sqrt(fmean(x * x for x in fit.residuals)),
        worst_ns=max(abs(x) for x in fit.residuals),
        widening_ns=fit.close_at - fit.open_at,
        missing=missing,
        extra=extra,
        glitches=glitches,
        latency_ns=None if trigger_ns is None else fit.open_at - trigger_ns,
        problems=tuple(problems),
    )


def _nothing(program: Program, inverted: bool, glitches: int, trigger_ns: float) -> Verification:
    return Verification(
        start_ns=trigger_ns,
        achieved="0" * program.chips,
        same_bits=False,
        inverted=inverted,
        missing=program.pulses,
        glitches=glitches,
        problems=(f"nothing opens after the trigger at {trigger_ns / 1e6:.6g} ms: was it armed?",),
    )


def _explained(
    fit: EdgeFit, edges: Sequence[tuple[float, int]], program: Program
) -> tuple[EdgeFit, str]:
    """Describe how a wrong code differs, by a known firmware error where one explains it."""
    # A likely error of one's own firmware: bytes played last bit first.
    padded = program.bits.ljust(-(-program.chips // 8) * 8, "0")
    swapped = "".join(padded[8 * (k // 8) + 7 - k % 8] for k in range(program.chips))
    mistakes = {
        swapped: "the bits of each byte are played last first (LSB first)",
        program.bits[::-1]: "the code is played backwards",
        program.bits.translate(str.maketrans("01", "10")): "open and closed are swapped",
    }
    for bits, mistake in mistakes.items():
        mistaken = Program(bits, program.chip_ns) if "1" in bits else program
        if len(mistaken.edges) == len(edges) and mistaken != program:
            swapped_fit = fit_edges(edges, mistaken)
            if not swapped_fit.wrong and len(swapped_fit.pairs) == len(edges):
                return swapped_fit, f"another code was played: {mistake}"
    first = next(k for k in range(program.chips) if fit.achieved[k] != program.bits[k])
    differing = f"{fit.wrong} of {program.chips} chips differ, first chip {first}"
    return fit, f"another code was played: {differing}"
