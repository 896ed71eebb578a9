"""Exposures for a motion: open shutter, snapshots, strobes, codes; which are tried, and judged."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any, Literal

import numpy as np

from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.search.annealing.anneal import anneal
from cep.search.baselines import best_snapshot, best_strobe, evenly_some
from cep.search.cost import CodeCost
from cep.search.expected import (
    WORTH_DB,
    ExpectedPsnr,
    collected_e,
    equal_light_noise,
    joint_psnr_db,
    light_noise,
)
from cep.search.limits import RunLimits
from cep.search.problem import SearchProblem
from cep.search.search_result import SearchResult

Choice = Literal["open", "snapshot", "strobe", "code"]

PLAIN: tuple[Choice, ...] = ("open", "snapshot")
"""Kinds of a single opening."""

CODED: tuple[Choice, ...] = ("strobe", "code")
"""Kinds of several openings."""

KINDS = (*PLAIN, *CODED)
"""All kinds, the simplest first."""

NONE_POSSIBLE = "limits: none of the ways to expose that were tried keeps them without saturating"
"""Refusal where no exposure can be advised."""

TRIMMED_FROM = 5
"""Photographs from which the least and the greatest gain are left out of a range."""

_NAMES = {
    "open": "open shutter",
    "snapshot": "single exposure",
    "strobe": "even pulses",
    "code": "code",
}
# The search samples coarsely, what it finds is judged finely: see expected.py. Of straight motions
# beyond some 250 px half of the samples and nodes do as well: docs/decisions/search.md.
_OVERSAMPLING = 8  # samples per 1 / extent while snapshots, strobes and codes are searched
_LONG_COLUMNS = 1_024  # samples from which a motion is long
_LONG_OVERSAMPLING = 4
_LONG_ACROSS = 6  # nodes across it: within 0.03 dB of twelve
_SWAPS_WORK = 5_000_000  # terms of all swaps of two chips; beyond, only single flips polish a code
_MOVES = 100_000  # of a search at one light level; four times as many gain less than 0.05 dB
_MOST_RUNS = 1_000  # single exposures that are all judged where every length is asked for
_LENGTHS = 24  # else so many lengths and starts
_STARTS = 16
_LENGTH_FACTORS = (0.7, 1.5, 2.0)  # of the model's best length, tried on photographs
_ROUNDED = 1e-3  # relative: a camera's figures are stated to three digits


@dataclass(frozen=True)
class Exposure:
    """A way to expose: open all the time, once, in even pulses, or by a code.

    Attributes
    ----------
    kind : {"open", "snapshot", "strobe", "code"}
    code : ShutterCode
        Chips that are open; a snapshot's are one run.
    psnr_db : float
        Of the restored photo, with the light that the chips let in; as if the pixel could hold it.
        Expected by a model, or the mean over photographs.
    equal_light_db : float
        The model's where a brighter lamp makes up for the closed chips.
    within_limits : bool
        Whether it keeps the problem's limits.
    saturates : bool
        Whether a pixel of value 1 collects more than the camera can record.
    photo_psnr_db : tuple of float
        PSNR of each restored photograph; empty where none was measured. One that was left behind
        has those of the first photographs, and ``psnr_db`` relative to the best of its kind.
    """

    kind: Choice
    code: ShutterCode
    psnr_db: float
    equal_light_db: float
    within_limits: bool = True
    saturates: bool = False
    photo_psnr_db: tuple[float, ...] = ()

    @property
    def possible(self) -> bool:
        """Whether it can be advised: it keeps the limits and does not saturate."""
        return self.within_limits and not self.saturates

    @property
    def label(self) -> str:
        """Name for tables."""
        notes = []
        if not self.within_limits:
            notes.append("outside the limits")
        if self.saturates:
            notes.append("saturates")
        note = f" ({', '.join(notes)})" if notes else ""
        return _NAMES[self.kind] + note

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
            "photo_psnr_db": list(self.photo_psnr_db),
        }


class ExposureFinder:
    """Search of the exposures along a problem's motions, at any light.

    Parameters
    ----------
    problem : SearchProblem
        Its motions, limits and shutter; its objective and camera do not matter.
    """

    def __init__(self, problem: SearchProblem) -> None:
        if problem.frames == 2:
            raise ValueError(
                "frames: 2 is for cep.optimize; the exposures of one camera are asked for here"
            )
        problem = replace(problem, objective="mse")
        self._fast = self._coarse = CodeCost(problem, oversampling=_OVERSAMPLING)
        samples: dict[str, Any] = {"oversampling": _OVERSAMPLING}
        long = problem.straight and self._fast.rows.shape[-1] > _LONG_COLUMNS
        if long:
            samples = {"oversampling": _LONG_OVERSAMPLING, "across": _LONG_ACROSS}
            self._coarse = CodeCost(problem, **samples)
        self._judge = CodeCost(problem, **samples, dtype=np.float64)
        work = problem.chips**2 // 4 * self._judge.shares_across.size
        self._swaps = not long or work <= _SWAPS_WORK

    def ordinary(self, camera: Camera, *, every_length: bool = False) -> list[ShutterCode]:
        """Return the best single exposures and even pulses that do not saturate, and others.

        Of all, and within the limits. Also exposures somewhat shorter and longer than the best
        one, which may be better on photographs, and the shortest, which may be the best with a
        brighter lamp; or exposures of every length, where they are judged otherwise: for a path
        not known exactly, or several frames.
        """
        problem = replace(self._fast.problem, camera=camera)
        unlimited = replace(problem, open_range=None, runs=RunLimits())
        codes = []
        for best, single in ((best_snapshot, True), (best_strobe, False)):
            # without limits first, to say what loosening them would gain
            for candidate in (unlimited, problem):
                unsaturated = recordable(candidate, single=single)
                if unsaturated is None:
                    continue
                code_cost = self._fast.for_problem(unsaturated)
                code = best(code_cost, within_limits=unsaturated is not unlimited)
                if code is None:
                    continue
                codes.append(code)
                if problem.allows(code):
                    if single:
                        codes += self._lengths_near(camera, code.open_chips)
                    break  # the best within the limits as well
        return codes + self._short_exposures(every_length)

    def _lengths_near(self, camera: Camera, length: int) -> list[ShutterCode]:
        """List the best single exposures within the limits of lengths near this one."""
        problem = replace(self._fast.problem, camera=camera)
        neighbours = (length - 1, length + 1, length + 2)
        candidates = {*neighbours, *(round(factor * length) for factor in _LENGTH_FACTORS)}
        low, high = problem.open_limits
        lengths = sorted(n for n in candidates if low <= n <= min(high, problem.chips - 1))
        codes = [
            best_snapshot(self._fast.for_problem(limited), within_limits=True)
            for limited in (_with_open(problem, chips, chips) for chips in lengths)
            if limited is not None
        ]
        return [code for code in codes if code is not None]

    def _short_exposures(self, every_length: bool) -> list[ShutterCode]:
        """List the shortest single exposures, or those of every length, in any place."""
        problem = self._fast.problem
        n = problem.chips
        judge_all = n * (n - 1) // 2 <= _MOST_RUNS
        most_lengths = most_starts = n
        lengths = np.arange(1, n)
        if not every_length:
            lengths = np.unique([1, problem.open_limits[0]])
        if not judge_all:
            most_lengths = _LENGTHS
        if not (judge_all and every_length):
            most_starts = _STARTS
        return [
            ShutterCode("0" * first + "1" * length + "0" * (n - length - first))
            for length in evenly_some(lengths, most_lengths).tolist()
            for first in evenly_some(np.arange(n - length + 1), most_starts).tolist()
        ]

    def codes(
        self,
        camera: Camera,
        starts: Sequence[ShutterCode],
        *,
        seed: int,
        threads: int | None,
        swaps: bool = True,
    ) -> list[ShutterCode]:
        """Return the code that :meth:`search` finds, in a list; an empty one for none.

        Raises
        ------
        KeyboardInterrupt
            After Ctrl-C.
        """
        outcome = self.search(camera, starts, seed=seed, threads=threads, swaps=swaps)
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
        swaps: bool = True,
    ) -> SearchResult | None:
        """Search the code of least expected error; None where every code would saturate.

        A snapshot may have less noise from dark current. It is charged that of a code here, or the
        search would end on it. The time or Ctrl-C ends the search with the best code so far.
        Without ``swaps`` it is polished by flips alone.
        """
        unsaturated = recordable(replace(self._judge.problem, camera=camera), single=False)
        if unsaturated is None:
            return None
        exposure_s = unsaturated.chips * unsaturated.chip_ns * 1e-9
        charged = replace(unsaturated, camera=camera.with_dark_noise(exposure_s))
        return anneal(
            charged,
            rng=np.random.default_rng([seed, 7]),  # other draws than a search of the same seed
            steps=_MOVES,
            time_s=time_s,
            start=[code for code in starts if charged.allows(code)],
            threads=threads,
            judge=self._judge.for_problem(charged),
            coarse=self._coarse.for_problem(charged),
            swaps=swaps and self._swaps,
        )


def recordable(problem: SearchProblem, *, single: bool) -> SearchProblem | None:
    """Limit a problem's open chips to those that do not saturate; None where none is left.

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
    integrated_chips = np.full(n, n)
    if single:
        integrated_chips = counts
    dark_e = camera.dark_e(chip_s * integrated_chips)
    electrons = camera.photons_full_scale * counts / n + dark_e
    most_open = int(np.count_nonzero(electrons <= _full_e(camera)))
    low, high = problem.open_range or (1, n)
    if most_open >= high:
        return problem
    return _with_open(problem, low, most_open)


def _with_open(problem: SearchProblem, low: int, high: int) -> SearchProblem | None:
    """Problem with so many open chips; None where its limits leave no code."""
    try:
        return replace(problem, open_range=(low, high))
    except ValueError:
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
    problem = problem.of_one_camera  # of two, each may take a single exposure
    try:
        problem.camera.at(problem.camera.photons_full_scale)
    except ValueError as error:  # no option but the camera's file states such a light
        raise ValueError(
            f"camera: the light level {str(error).removeprefix('photons: ')}"
        ) from None
    if not can_record(problem):
        camera = problem.camera
        shortest = problem.open_limits[0] / problem.chips
        raise ValueError(
            f"photons_full_scale: this camera is full at {camera.saturation_e:,.0f} electrons, and"
            f" at a light level of {camera.photons_full_scale:,.0f} the shortest opening,"
            f" {shortest:.2g} of the exposure, collects"
            f" {camera.photons_full_scale * shortest:,.0f}; give less light"
        )


def judged_exposures(
    problem: SearchProblem,
    cameras: Sequence[Camera],
    codes: Sequence[ShutterCode],
    *,
    path_error_px: float,
    frames: int = 1,
    expected: ExpectedPsnr | None = None,
) -> list[tuple[Exposure, ...]]:
    """Judge the open shutter, first, and every code, at the light of every camera.

    Parameters
    ----------
    problem : SearchProblem
    cameras : sequence of Camera
    codes : sequence of ShutterCode
    path_error_px : float
        Rms error of the path where it is an estimate.
    frames : int
        Photos through the same code that are restored together.
    expected : ExpectedPsnr, optional
        Of this problem and error, where it was made before.

    Returns
    -------
    list of tuple of Exposure
        For each camera, the exposures in the order of the codes without repetitions.
    """
    # several searches may find the same code
    bits = dict.fromkeys(["1" * problem.chips, *(code.bits for code in codes)])
    distinct = [ShutterCode(code_bits, problem.chip_ns) for code_bits in bits]
    # M frames through the same code are as good as one with an Mth of the noise
    noise = [
        model(camera, distinct, response=problem.response, scene=problem.scene) / frames
        for camera in cameras
        for model in (light_noise, equal_light_noise)
    ]
    expected = expected or ExpectedPsnr(problem, path_error_px=path_error_px)
    psnr = expected.psnr_db(distinct, noise=noise).reshape(len(distinct), -1, 2)
    kinds = [kind_of(code) for code in distinct]
    allowed = [problem.allows(code) for code in distinct]
    judgements = []
    for index, camera in enumerate(cameras):
        electrons = collected_e(camera, distinct, response=problem.response)
        saturates = (electrons > _full_e(camera)).tolist()
        psnr_db, equal_light_db = psnr[:, index].T.tolist()
        judgements.append(
            tuple(map(Exposure, kinds, distinct, psnr_db, equal_light_db, allowed, saturates))
        )
    return judgements


def pair_exposures(problem: SearchProblem, codes: Sequence[ShutterCode]) -> tuple[Exposure, ...]:
    """Judge two cameras restored together: alike in their exposure, or by a code and complement.

    Parameters
    ----------
    problem : SearchProblem
        Of two frames, at the light of its camera. Its path counts as known exactly.
    codes : sequence of ShutterCode
        Each played by one camera while the other plays its complement.

    Returns
    -------
    tuple of Exposure
        Both open, first; single exposures, the same in both cameras, of every length; and last,
        of kind "code" however often they open, the pairs.
    """
    camera = problem.camera
    single = problem.of_one_camera
    ordinary = ExposureFinder(single).ordinary(camera, every_length=True)
    (alike,) = judged_exposures(single, [camera], ordinary, path_error_px=0.0, frames=2)
    exposures = [exposure for exposure in alike if exposure.kind in PLAIN]
    for code in codes:
        code = ShutterCode(code.bits, problem.chip_ns)
        pair = [code, code.complement()]
        noise = [
            model(camera, pair, response=problem.response, scene=problem.scene)
            for model in (light_noise, equal_light_noise)
        ]
        psnr_db, equal_light_db = joint_psnr_db(problem, pair, noise=noise).tolist()
        electrons = collected_e(camera, pair, response=problem.response)
        saturates = bool((electrons > _full_e(camera)).any())
        within = problem.allows(code)
        exposures.append(Exposure("code", code, psnr_db, equal_light_db, within, saturates))
    return tuple(exposures)


def best_possible(exposures: Sequence[Exposure]) -> Exposure:
    """Return the exposure of the highest expected PSNR within the limits that does not saturate.

    Raises
    ------
    ValueError
        If there is none.
    """
    possible = [exposure for exposure in exposures if exposure.possible]
    if not possible:
        raise ValueError(NONE_POSSIBLE)
    return max(possible, key=attrgetter("psnr_db"))


def simplest(exposures: Sequence[Exposure]) -> Exposure:
    """Return the best exposure of the simplest kind that none beats by ``WORTH_DB``."""
    highest = max(exposure.psnr_db for exposure in exposures)
    equal = [exposure for exposure in exposures if exposure.psnr_db > highest - WORTH_DB]
    return min(equal, key=lambda exposure: (KINDS.index(exposure.kind), -exposure.psnr_db))


def gain_range_db(exposure: Exposure, alternative: Exposure) -> tuple[float, float] | None:
    """Range of the gain of an exposure over another on photographs, dB; None without any.

    The least and the greatest gain are left out where :data:`TRIMMED_FROM` photographs are.
    """
    pairs = zip(exposure.photo_psnr_db, alternative.photo_psnr_db, strict=False)
    gains = sorted(psnr_db - alternative_db for psnr_db, alternative_db in pairs)
    if len(gains) >= TRIMMED_FROM:
        gains = gains[1:-1]
    return (gains[0], gains[-1]) if gains else None


def _full_e(camera: Camera) -> float:
    return camera.saturation_e * (1 + _ROUNDED)


def kind_of(code: ShutterCode) -> Choice:
    """Return the kind of a code by its openings: all, one, even ones, or others."""
    if code.open_chips == code.chips:
        return "open"
    if code.pulses == 1:
        return "snapshot"
    edges = np.flatnonzero(np.diff(np.concatenate([[0], code.array, [0]])))
    starts = edges[::2]
    widths = edges[1::2] - starts
    if edges[-1] == code.chips and widths[-1] < widths[0]:
        widths = widths[:-1]  # the end of the exposure cuts the last pulse off
    even = np.ptp(np.diff(starts)) == 0 and np.ptp(widths) == 0
    # any two equal openings would be even
    if even and len(starts) > 2:
        return "strobe"
    return "code"
