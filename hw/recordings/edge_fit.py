"""Matching of recorded edges to a program's, and a fit of the clock."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import fmean

from hw.program import Program

_REACH = 0.45  # of a chip: an edge farther than that from its place is another edge
_STARTS = 8  # openings that may be missing or too many at the beginning


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
    program : Program
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
    scale, open_at, close_at = _clock(pairs)
    refined = [
        (nominal, match_ns, level)
        for nominal, level in program.edges
        for match_ns in [
            _nearest(moments[level], (open_at if level else close_at) + scale * nominal, reach)
        ]
        if match_ns is not None
    ]
    pairs = refined or pairs
    scale, open_at, close_at = _clock(pairs)
    played = _played(edges, open_at, scale * program.chip_ns, program.chips + 1)
    achieved = played[:-1]
    wrong = sum(is_ != want for is_, want in zip(achieved, program.bits, strict=True))
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
