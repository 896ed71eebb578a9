"""Ways to expose for a motion: those that are tried, and the restoration expected of each at every
light level.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from cep.optics.band import ACROSS, straight_axis
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.search.annealing.anneal import SearchResult, anneal
from cep.search.expected import WORTH_DB, ExpectedPsnr, collected_e, equal_light_noise, light_noise
from cep.search.light import best_snapshot, best_strobe, evenly_some
from cep.search.limits import RunLimits
from cep.search.objective import Objective, sample_count
from cep.search.problem import SearchProblem

Choice = Literal["open", "snapshot", "strobe", "code"]

PLAIN: tuple[Choice, ...] = ("open", "snapshot")
"""Kinds of a single opening."""

CODED: tuple[Choice, ...] = ("strobe", "code")
"""Kinds of several openings."""

KINDS = (*PLAIN, *CODED)
"""All kinds, the simplest first."""

NONE_POSSIBLE = "limits: none of the ways to expose that were tried keeps them without saturating"
"""Refusal where no way can be advised."""

_OVERSAMPLING = 8  # samples per 1 / extent while snapshots, strobes and codes are searched
# samples of a straight motion, some 250 px long, beyond which fewer do: docs/decisions/search.md
_LONG_COLUMNS = 1_024
_LONG_OVERSAMPLING = 4
_LONG_ACROSS = 6
_SWAPS_WORK = (
    5_000_000  # terms of all swaps of two chips, beyond which a code is polished by flips alone
)
_MOVES = 100_000  # of a search at one light level; four times as many gain less than 0.05 dB
_MOST_RUNS = 1_000  # single exposures that are all judged where every length is asked for
_LENGTHS = 24  # else so many lengths and starts
_STARTS = 16
_ROUNDED = 1e-3  # relative: a camera's figures are stated to three digits


@dataclass(frozen=True)
class Way:
    """A way to expose.

    Attributes
    ----------
    kind : {"open", "snapshot", "strobe", "code"}
    code : ShutterCode
        Chips that are open; a snapshot's are one run.
    psnr_db : float
        Expected of the restored photo, with the light that the chips let in; as if the pixel could
        hold it.
    equal_light_db : float
        The same where a brighter lamp makes up for the closed chips.
    within_limits : bool
        Whether it keeps the problem's limits.
    saturates : bool
        Whether a pixel of value 1 collects more than the camera can record.
    """

    kind: Choice
    code: ShutterCode
    psnr_db: float
    equal_light_db: float
    within_limits: bool = True
    saturates: bool = False

    @property
    def possible(self) -> bool:
        """Whether it can be advised: it keeps the limits and does not saturate."""
        return self.within_limits and not self.saturates

    @property
    def label(self) -> str:
        """Name for tables."""
        name = {
            "open": "open shutter",
            "snapshot": "single exposure",
            "strobe": "even pulses",
            "code": "code",
        }[self.kind]
        notes = [
            note
            for note, applies in (
                ("outside the limits", not self.within_limits),
                ("saturates", self.saturates),
            )
            if applies
        ]
        if not notes:
            return name
        return f"{name} ({', '.join(notes)})"

    def to_dict(self) -> dict[str, Any]:
        """Fields for JSON."""
        return {
            "kind": self.kind,
            "bits": self.code.bits,
            "open": self.code.open_chips,
            "psnr_db": self.psnr_db,
            "equal_light_psnr_db": self.equal_light_db,
            "within_limits": self.within_limits,
            "saturates": self.saturates,
        }


class WayFinder:
    """Search of the ways to expose along a problem's motions, at any light.

    Parameters
    ----------
    problem : SearchProblem
        Its motions, limits and shutter; its objective and camera do not matter.
    """

    def __init__(self, problem: SearchProblem) -> None:
        mse_problem = replace(problem, objective="mse")
        straight = all(
            straight_axis(scenario.trajectory) is not None for scenario in problem.scenarios
        )
        long = straight and sample_count(mse_problem, oversampling=_OVERSAMPLING) > _LONG_COLUMNS
        over = _OVERSAMPLING
        across = ACROSS
        if long:
            over = _LONG_OVERSAMPLING
            across = _LONG_ACROSS
        self._fast = Objective(mse_problem, oversampling=_OVERSAMPLING)
        self._moved = self._fast
        if long:
            self._moved = Objective(mse_problem, oversampling=over, across=across)
        self._judge = Objective(mse_problem, oversampling=over, across=across, dtype=np.float64)
        self._swaps = (
            not long or problem.chips**2 // 4 * self._judge.shares_across.size <= _SWAPS_WORK
        )

    def ordinary(self, camera: Camera, *, every_length: bool = False) -> list[ShutterCode]:
        """Return single exposures and even pulses to judge: the best by the expected error that do
        not saturate.

        Of all, and within the limits. Also the shortest exposures, which may be the best with a
        brighter lamp; or exposures of every length, where they are judged otherwise: for a path
        not known exactly, or several frames.
        """
        problem = replace(self._fast.problem, camera=camera)
        unlimited = replace(problem, open_range=None, runs=RunLimits())
        codes = []
        for best, single in ((best_snapshot, True), (best_strobe, False)):
            for candidate in (unlimited, problem):
                unsaturated = recordable(candidate, single=single)
                if unsaturated is None:
                    continue
                code = best(
                    self._fast.for_problem(unsaturated),
                    within_limits=unsaturated is not unlimited,
                )
                if code is None:
                    continue
                codes.append(code)
                if problem.allows(code):
                    break
        n = problem.chips
        shortest = max(problem.open_limits[0], 1)
        lengths = np.arange(1, n) if every_length else np.unique([1, shortest])
        judge_all = n * (n - 1) // 2 <= _MOST_RUNS
        for length in lengths if judge_all else evenly_some(lengths, _LENGTHS):
            starts = np.arange(n - length + 1)
            runs = starts if judge_all and every_length else evenly_some(starts, _STARTS)
            codes += [
                ShutterCode("0" * i + "1" * int(length) + "0" * (n - int(length) - i))
                for i in map(int, runs)
            ]
        return codes

    def codes(
        self, camera: Camera, starts: Sequence[ShutterCode], *, seed: int, threads: int | None
    ) -> list[ShutterCode]:
        """Return the code that :meth:`search` finds, in a list; an empty one where every code
        would saturate.

        Raises
        ------
        KeyboardInterrupt
            After Ctrl-C.
        """
        outcome = self.search(camera, starts, seed=seed, threads=threads)
        if outcome is None:
            return []
        if outcome.stopped == "interrupted":
            raise KeyboardInterrupt
        return [outcome.code]

    def search(
        self,
        camera: Camera,
        starts: Sequence[ShutterCode],
        *,
        seed: int,
        threads: int | None,
        time_s: float = math.inf,
    ) -> SearchResult | None:
        """Search the code of least expected error within the limits; None where every code would
        saturate.

        A snapshot may have less noise from dark current. It is charged that of a code here, or the
        search would end on it. The time or Ctrl-C ends the search with the best code so far.
        """
        unsaturated = recordable(replace(self._judge.problem, camera=camera), single=False)
        if unsaturated is None:
            return None
        charged = replace(
            unsaturated,
            camera=camera.with_dark_noise(unsaturated.chips * unsaturated.chip_ns * 1e-9),
        )
        return anneal(
            charged,
            rng=np.random.default_rng([seed, 7]),
            steps=_MOVES,
            time_s=time_s,
            start=[code for code in starts if charged.allows(code)],
            threads=threads,
            judge=self._judge.for_problem(charged),
            moved=self._moved.for_problem(charged),
            swaps=self._swaps,
        )


def recordable(problem: SearchProblem, *, single: bool) -> SearchProblem | None:
    """Rule out codes that would saturate, by their open chips: a problem with fewer of them, or
    the same.

    Parameters
    ----------
    problem : SearchProblem
    single : bool
        Whether codes of a single opening are asked for: dark current fills the well for as long as
        it alone.

    Returns
    -------
    SearchProblem or None
        None where no code within the limits is left.
    """
    camera = problem.camera
    n = problem.chips
    chip_s = problem.chip_ns * 1e-9
    counts = np.arange(1, n + 1)
    collected = camera.photons_full_scale * counts / n + camera.dark_e(
        chip_s * (counts if single else n)
    )
    most_open = int(np.count_nonzero(collected <= _full_e(camera)))
    low, high = problem.open_range or (1, n)
    if most_open >= high:
        return problem
    try:
        return replace(problem, open_range=(low, most_open))
    except ValueError:  # the limits ask for more open chips
        return None


def can_record(problem: SearchProblem) -> bool:
    """Whether the camera can record at least the shortest opening within the limits."""
    return any(recordable(problem, single=single) is not None for single in (True, False))


def check_light(problem: SearchProblem) -> None:
    """Refuse a problem without a motion, and a light at which even the shortest opening saturates.

    Raises
    ------
    ValueError
    """
    if not problem.scenarios:
        raise ValueError("scenarios: need a motion to advise on")
    try:
        problem.camera.at(problem.camera.photons_full_scale)
    except ValueError as error:  # no option but the camera's file states such a light
        raise ValueError(
            f"camera: the light level {str(error).removeprefix('photons: ')}"
        ) from None
    if not can_record(problem):
        camera = problem.camera
        shortest = max(problem.open_limits[0], 1) / problem.chips
        raise ValueError(
            f"photons_full_scale: this camera is full at {camera.saturation_e:,.0f} electrons, and"
            f" at a light level of {camera.photons_full_scale:,.0f} the shortest opening,"
            f" {shortest:.2g} of the exposure, collects"
            f" {camera.photons_full_scale * shortest:,.0f}; give less light"
        )


def judged_ways(
    problem: SearchProblem,
    cameras: Sequence[Camera],
    codes: Sequence[ShutterCode],
    *,
    path_error_px: float,
    frames: int = 1,
    expected: ExpectedPsnr | None = None,
) -> list[tuple[Way, ...]]:
    """Judge every code, used in so many frames, at the light of every camera; the open shutter is
    added, and first.

    One that is ``expected`` of this problem and error already need not be made.
    """
    # several searches may find the same code
    distinct = list(
        {
            code.bits: ShutterCode(code.bits, problem.chip_ns)
            for code in [ShutterCode("1" * problem.chips), *codes]
        }.values()
    )
    noise = [
        model(camera, distinct, response=problem.response) / frames
        for camera in cameras
        for model in (light_noise, equal_light_noise)
    ]
    expected = expected or ExpectedPsnr(problem, path_error_px=path_error_px)
    psnr = expected.psnr_db(distinct, noise=noise).reshape(len(distinct), -1, 2)
    allowed = [problem.allows(code) for code in distinct]
    kinds = [_kind(code) for code in distinct]
    judgements = []
    for index, camera in enumerate(cameras):
        full = collected_e(camera, distinct, response=problem.response) > _full_e(camera)
        judgements.append(
            tuple(
                Way(kind, code, float(at_time), float(at_light), allows, bool(saturates))
                for kind, code, (at_time, at_light), allows, saturates in zip(
                    kinds, distinct, psnr[:, index], allowed, full, strict=True
                )
            )
        )
    return judgements


def best_possible(exposures: Sequence[Way]) -> Way:
    """Return the way of the highest expected PSNR that keeps the limits and does not saturate.

    Raises
    ------
    ValueError
        If there is none.
    """
    best = max(
        (exposure for exposure in exposures if exposure.possible),
        key=lambda exposure: exposure.psnr_db,
        default=None,
    )
    if best is None:
        raise ValueError(NONE_POSSIBLE)
    return best


def simplest(exposures: Sequence[Way]) -> Way:
    """Return the best way of the simplest kind that none beats by
    :data:`cep.search.expected.WORTH_DB`.
    """
    highest = max(exposure.psnr_db for exposure in exposures)
    equal = [exposure for exposure in exposures if exposure.psnr_db > highest - WORTH_DB]
    kind = min(KINDS.index(exposure.kind) for exposure in equal)
    return max(
        (exposure for exposure in equal if exposure.kind == KINDS[kind]),
        key=lambda exposure: exposure.psnr_db,
    )


def _full_e(camera: Camera) -> float:
    return camera.saturation_e * (1 + _ROUNDED)


def _kind(code: ShutterCode) -> Choice:
    """Kind of a code by its openings: all, one, even ones, or others."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], code.array, [0]])))
    starts = edges[::2]
    stops = edges[1::2]
    if code.open_chips == code.chips:
        return "open"
    if len(starts) == 1:
        return "snapshot"
    if len(starts) == 2:
        return "code"  # any two equal openings would be even
    even = len(np.unique(np.diff(starts))) == 1 and len(np.unique((stops - starts)[:-1])) == 1
    # the last pulse may be cut off by the end of the exposure
    last_is_alike = stops[-1] - starts[-1] == stops[0] - starts[0] or (
        stops[-1] == code.chips and stops[-1] - starts[-1] < stops[0] - starts[0]
    )
    if even and last_is_alike:
        return "strobe"
    return "code"
