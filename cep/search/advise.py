"""Whether to code an exposure: open shutter, best snapshot, best strobe and best code, over the
light.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

import numpy as np

from cep.files.formatting import duration
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.path_limits import check_frame, check_resolved
from cep.search.expected import WORTH_DB
from cep.search.problem import SearchProblem
from cep.search.ways import (
    CODED,
    KINDS,
    NONE_POSSIBLE,
    PLAIN,
    Choice,
    Way,
    WayFinder,
    best_possible,
    can_record,
    check_light,
    judged_ways,
    simplest,
)

LEVELS = (100.0, 300.0, 1_000.0, 3_000.0, 10_000.0, 30_000.0, 100_000.0)
"""Photo-electrons at full scale at which the ways to expose are compared: from starlight to
studio."""

_LEAST_LEVEL = 1.0
_MOST_LEVEL = 1e7


@dataclass(frozen=True)
class Verdict:
    """Ways to expose at one light level, and which of them to take.

    Attributes
    ----------
    camera : Camera
    ways : tuple of Way
        The open shutter first, then every other that was tried; at least one is possible.
    code_name : str
        Name in the sentence of the code that a single exposure is compared with; empty where no
        code of the user's is.
    user_code : Way or None
        That code, where it is the user's; else the best one is compared with.
    path_error_px : float
        Rms error that the path was taken to have.
    frames : int
        Photos of the motion that are restored together, each exposed in the same way but for a
        code.
    """

    camera: Camera
    ways: tuple[Way, ...]
    code_name: str = "the best code found"
    user_code: Way | None = None
    path_error_px: float = 0.0
    frames: int = 1

    @property
    def possible(self) -> tuple[Way, ...]:
        """Ways that can be advised: they keep the limits and do not saturate."""
        return tuple(exposure for exposure in self.ways if exposure.possible)

    @property
    def open_saturates(self) -> bool:
        """Whether the open shutter collects more than the camera can record."""
        return self.ways[0].saturates

    def best(self, kind: Choice, *, equal_light: bool = False) -> Way | None:
        """Return the best possible way of a kind, None where there is none; even pulses are a code
        as well.
        """
        kinds = CODED if kind == "code" else (kind,)
        candidates = [exposure for exposure in self.possible if exposure.kind in kinds]
        figure = attrgetter("equal_light_db" if equal_light else "psnr_db")
        return max(candidates, key=figure, default=None)

    @property
    def advised(self) -> Way:
        """The way to take: the simplest possible one that no other beats by ``WORTH_DB``."""
        return simplest(self.possible)

    @property
    def choice(self) -> Choice:
        """Kind of the way to take."""
        return self.advised.kind

    @property
    def outside(self) -> Way | None:
        """The way to take without the limits, where it is better by
        :data:`cep.search.expected.WORTH_DB`; else None.
        """
        best = simplest([exposure for exposure in self.ways if not exposure.saturates])
        if best.psnr_db > self.advised.psnr_db + WORTH_DB:
            return best
        return None

    @property
    def gains_db(self) -> dict[Choice, float]:
        """Expected gain of the best possible way of each kind over the open shutter, dB.

        An open shutter that saturates counts as if the pixel could hold its light.
        """
        best = {kind: self.best(kind) for kind in KINDS}
        return {
            kind: exposure.psnr_db - self.ways[0].psnr_db
            for kind, exposure in best.items()
            if exposure is not None
        }

    @property
    def equal_light_gains_db(self) -> dict[Choice, float]:
        """The same where a brighter lamp makes up for the closed chips; the best ways may be
        others there.

        Empty where the open shutter saturates: with as much light every way does.
        """
        if self.open_saturates:
            return {}
        best = {kind: self.best(kind, equal_light=True) for kind in KINDS}
        return {
            kind: exposure.equal_light_db - self.ways[0].equal_light_db
            for kind, exposure in best.items()
            if exposure is not None
        }

    @property
    def code_gain_db(self) -> float | None:
        """Gain of the best code over the better of open shutter and best snapshot, of those that
        are possible.

        None where no code is possible, infinite where nothing else is.
        """
        code = self.best("code")
        plain = [exposure.psnr_db for kind in PLAIN if (exposure := self.best(kind)) is not None]
        if code is None:
            return None
        return code.psnr_db - max(plain, default=-math.inf)

    @property
    def sentence(self) -> str:
        """What to do and what it gains, then under which conditions."""
        advised = self.advised
        snapshot = self.best("snapshot")
        code = self.user_code or self.best("code")
        gains = []
        if not self.open_saturates:
            gains.append(_gain(advised.psnr_db - self.ways[0].psnr_db, "the open shutter"))
        if advised.kind == "open":
            text = (
                "Leave the shutter open: no shorter exposure and no code found gains"
                f" {WORTH_DB:g} dB"
            )
        elif advised.kind == "snapshot":
            text = f"Coding does not pay here: expose {_share(advised.code)}"
            if code is not None and self.code_name:
                gains.append(_gain(advised.psnr_db - code.psnr_db, self.code_name))
            text += _joined(", which ", gains)
            if not self.code_name:
                text += "; no code that was tried is better"
        else:
            do = "Code this exposure"
            if advised.kind == "strobe":
                do = f"Pulse the shutter evenly, {_pulses(advised.code)}"
            beats_user_code = self.user_code is not None and self.user_code is not advised
            if advised.kind == "code" and beats_user_code:
                do += f" by {advised.code.bits}"
            if snapshot is not None:
                gains.append(
                    _gain(
                        advised.psnr_db - snapshot.psnr_db,
                        f"the best single exposure, {_share(snapshot.code)}",
                    )
                )
            if self.user_code is not None and self.user_code is not advised:
                gains.append(_gain(advised.psnr_db - self.user_code.psnr_db, self.code_name))
            text = do + _joined(": that ", gains)
        text += f". Gains are those expected of the restored photo, {self._conditions}."
        if code is None:
            text += " No code is possible."
        if self.open_saturates:
            text += " The open shutter saturates at this light."
        if (unlimited := self.outside) is not None:
            text += (
                f" If the limits can be loosened, {_run(unlimited)} gains"
                f" {_amount(unlimited.psnr_db - advised.psnr_db)} more."
            )
        return text

    @property
    def _conditions(self) -> str:
        """Light, noise and the error of the path, in words."""
        camera = self.camera
        noise = [f"{camera.read_noise_e:.3g} e- of read noise"]
        if camera.dark_current_e_s:
            noise.append(f"{camera.dark_current_e_s:.3g} e-/s of dark current")
        if self.path_error_px:
            noise.append(f"a path known to {self.path_error_px:.2g} px")
        light = f"at {camera.photons_full_scale:,.0f} photo-electrons at full scale"
        if self.frames > 1:
            light += f" in each of {self.frames} frames"
        return f"{', '.join([light, *noise[:-1]])} and {noise[-1]}"

    def to_dict(self) -> dict[str, Any]:
        """Fields for JSON."""
        best = {kind: exposure for kind in KINDS if (exposure := self.best(kind)) is not None}
        return {
            "choice": self.choice,
            "photons": self.camera.photons_full_scale,
            "open_saturates": self.open_saturates,
            "gains_db": self.gains_db,
            "equal_light_gains_db": self.equal_light_gains_db,
            "ways": {kind: exposure.to_dict() for kind, exposure in best.items()},
            "outside_limits": None if self.outside is None else self.outside.to_dict(),
        }


@dataclass(frozen=True)
class Advice:
    """Verdict at the camera's light, and at other light levels.

    Attributes
    ----------
    problem : SearchProblem
    here : Verdict
    levels : tuple of Verdict
        By rising light, the camera's own among them.
    path_error_px : float
        Rms error that the path was taken to have.
    """

    problem: SearchProblem
    here: Verdict
    levels: tuple[Verdict, ...]
    path_error_px: float = 0.0

    @property
    def choice(self) -> Choice:
        """Kind of the way to take at the camera's light."""
        return self.here.choice

    @property
    def gains_db(self) -> dict[Choice, float]:
        """As :attr:`Verdict.gains_db`, at the camera's light."""
        return self.here.gains_db

    @property
    def crossover(self) -> tuple[tuple[float | None, float | None], ...]:
        """Ranges of light, photo-electrons at full scale, in which coding gains
        :data:`cep.search.expected.WORTH_DB`.

        Even pulses count as a code; the gain is that over the better of open shutter and best
        snapshot.

        Between the levels the gain is interpolated over the logarithm of the light; None where a
        range goes on beyond the levels.
        """
        gains_db = [level.code_gain_db for level in self.levels]
        gains = np.array([-np.inf if gain is None else gain for gain in gains_db]) - WORTH_DB
        light = np.log10([level.camera.photons_full_scale for level in self.levels])
        ranges: list[tuple[float | None, float | None]] = []
        low_light: float | None = None
        inside = bool(gains[0] > 0)
        for i in range(1, len(gains)):
            if (gains[i] > 0) == inside:
                continue
            share = 0.5  # where no code is possible at one of the levels: the middle
            if np.isfinite(gains[i - 1] - gains[i]):
                share = gains[i - 1] / (gains[i - 1] - gains[i])
            light_at_zero = float(10 ** (light[i - 1] + share * (light[i] - light[i - 1])))
            if inside:
                ranges.append((low_light, light_at_zero))
            low_light = light_at_zero
            inside = not inside
        if inside:
            ranges.append((low_light, None))
        return tuple(ranges)

    @property
    def sentence(self) -> str:
        """What to do at the camera's light, then at which light coding pays."""
        return f"{self.here.sentence} {self.where}"

    @property
    def where(self) -> str:
        """At which light coding pays: one sentence."""
        levels = [level.camera.photons_full_scale for level in self.levels]
        if all(level.code_gain_db == math.inf for level in self.levels):
            return "Only codes keep these limits, at any light."
        if len(levels) == 1:
            return "No other light was tried."
        span = f"between {levels[0]:,.0f} and {levels[-1]:,.0f} photo-electrons at full scale"
        if not self.crossover:
            return f"With this camera and motion coding pays at no light {span}."
        gains = {
            level.camera.photons_full_scale: level.code_gain_db or 0.0 for level in self.levels
        }
        best_level = max(
            (light for light in gains if math.isfinite(gains[light])), key=gains.__getitem__
        )
        if self.crossover == ((None, None),):
            where = f"at any light {span}"
        else:
            ranges = " and ".join(_range(low, high) for low, high in self.crossover)
            where = f"{ranges} photo-electrons at full scale"
        return (
            f"Coding pays {where}, by {gains[best_level]:.2g} dB at most (at {best_level:,.0f})."
        )

    def to_dict(self) -> dict[str, Any]:
        """Fields for JSON, as ``cep advise --json`` prints them."""
        return {
            "verdict": self.sentence,
            **self.here.to_dict(),
            "crossover": self.crossover,
            "path_error_px": self.path_error_px,
            "chips": self.problem.chips,
            "chip_ns": self.problem.chip_ns,
            "exposure_s": self.problem.chips * self.problem.chip_ns * 1e-9,
            "levels": [level.to_dict() for level in self.levels],
        }

    def __repr__(self) -> str:
        return self.sentence

    def _repr_png_(self) -> bytes:
        from cep.plots import png_bytes
        from cep.plots.advice import advice_figure

        return png_bytes(advice_figure(self))


def verdict(problem: SearchProblem, *codes: ShutterCode, path_error_px: float = 0.0) -> Verdict:
    """Judge codes beside the open shutter, the best snapshot and the best strobe, by the expected
    restoration.

    Parameters
    ----------
    problem : SearchProblem
        Its objective does not matter: the expected error with its camera does.
    *codes : ShutterCode
        Those of a single opening count as snapshots.
    path_error_px : float
        As of :func:`advise`.

    Raises
    ------
    ValueError
        If the problem has no motion, even the shortest opening saturates at its light, or a code
        has another number of chips.
    """
    check_light(problem)
    _check_codes(problem, codes)  # before the work
    ordinary = WayFinder(problem).ordinary(problem.camera, every_length=path_error_px > 0)
    exposures = judged_ways(
        problem, [problem.camera], [*ordinary, *codes], path_error_px=path_error_px
    )[0]
    return verdict_of(problem, exposures, codes, path_error_px=path_error_px)


def verdict_of(
    problem: SearchProblem,
    exposures: tuple[Way, ...],
    codes: Sequence[ShutterCode],
    *,
    path_error_px: float = 0.0,
) -> Verdict:
    """Return the verdict of ways that were judged already, the codes among them; see
    :func:`verdict`.
    """
    best_possible(exposures)
    unnamed = Verdict(problem.camera, exposures, "", path_error_px=path_error_px)
    # by their bits: the codes judged carry the problem's chip time, the given ones may not
    bits = {code.bits for code in codes}
    user_exposures = [
        exposure
        for exposure in unnamed.possible
        if exposure.kind in CODED and exposure.code.bits in bits
    ]
    if not user_exposures:
        return unnamed
    name = "the best of these codes"
    if len(codes) == 1:
        name = "this code"
    return replace(
        unnamed, code_name=name, user_code=max(user_exposures, key=attrgetter("psnr_db"))
    )


def advise(
    problem: SearchProblem,
    *codes: ShutterCode,
    levels: Sequence[float] = LEVELS,
    path_error_px: float = 0.0,
    seed: int = 0,
    threads: int | None = None,
    progress: Callable[[float, str], None] = lambda _share, _note: None,
) -> Advice:
    """Compare open shutter, best snapshot, best strobe and best code, at the camera's light and at
    other levels.

    Each way may be open for any part of the exposure within the problem's limits; the scene is as
    bright for all. A code is searched at each level. Its gain is what the best linear restoration
    of the reference scene is expected to gain (:func:`cep.search.expected.expected_psnr_db`).

    Parameters
    ----------
    problem : SearchProblem
        Motions, camera and limits; its objective does not matter.
    *codes : ShutterCode
        Codes of the user's own to judge as well.
    levels : sequence of float
        Photo-electrons at full scale, 1..1e7. Those at which even the shortest opening saturates
        are left out.
    path_error_px : float
        Rms error of the path where it is an estimate. Every way is judged with it, the codes are
        searched without.
    seed : int
    threads : int, optional
        As many as there are cores when omitted; the outcome does not depend on it.
    progress : callable, optional
        Called with the finished share, 0..1, and a note.

    Raises
    ------
    ValueError
        If the problem has no motion or it cannot be resolved, or a level or the camera's own light
        is out of range.

    Examples
    --------
    >>> from motdiff.trajectory import Trajectory
    >>> path = Trajectory.straight(40.0)
    >>> camera = Camera(photons_full_scale=3_000, read_noise_e=2)
    >>> problem = SearchProblem.along(path, chips=40, camera=camera)
    >>> advise(problem, levels=[300, 30_000]).choice
    'snapshot'
    """
    wrong = [level for level in levels if not _LEAST_LEVEL <= level <= _MOST_LEVEL]
    if wrong:
        raise ValueError(
            f"levels: must lie within 1..1e7 photo-electrons at full scale, got {wrong[0]:g}"
        )
    check_light(problem)
    _check_codes(problem, codes)
    for scenario in problem.scenarios:
        check_frame(scenario.trajectory)
        check_resolved(scenario.trajectory, problem.chips)
    camera_light = problem.camera.photons_full_scale
    lights = sorted({*map(float, levels), camera_light})
    cameras = [problem.camera.at(light) for light in lights]
    cameras = [camera for camera in cameras if can_record(replace(problem, camera=camera))]
    finder = WayFinder(problem)
    pool = list(codes)
    parts = len(cameras) + 1
    for index, camera in enumerate(cameras):
        progress(index / parts, f"{camera.photons_full_scale:,.0f} photo-electrons")
        ordinary = finder.ordinary(camera, every_length=path_error_px > 0 and index == 0)
        pool += [*ordinary, *finder.codes(camera, [*ordinary, *pool], seed=seed, threads=threads)]
    progress(len(cameras) / parts, "judging")
    judged_exposures = judged_ways(problem, cameras, pool, path_error_px=path_error_px)
    verdicts = tuple(
        Verdict(camera, exposures, path_error_px=path_error_px)
        for camera, exposures in zip(cameras, judged_exposures, strict=True)
        if any(exposure.possible for exposure in exposures)
    )
    own_level = [level for level in verdicts if level.camera.photons_full_scale == camera_light]
    if not own_level:
        raise ValueError(NONE_POSSIBLE)
    progress(1.0, "")
    return Advice(problem, own_level[0], verdicts, path_error_px)


def _check_codes(problem: SearchProblem, codes: Sequence[ShutterCode]) -> None:
    """Refuse codes that do not suit the problem."""
    if any(code.chips != problem.chips for code in codes):
        raise ValueError(f"codes: must have {problem.chips} chips")


def _joined(opening: str, gains: Sequence[str]) -> str:
    """Gains as one clause, empty without any; the verb stands once where it is the same."""
    if not gains:
        return ""
    # "gains 2 dB over A and 1 dB over B"
    verb = gains[0].split()[0] + " "
    return opening + " and ".join([gains[0], *(gain.removeprefix(verb) for gain in gains[1:])])


def _gain(gain_db: float, over: str) -> str:
    """Say what is gained over another exposure, or lost to it."""
    if abs(gain_db) < WORTH_DB:
        return f"restores as well as {over}"
    if gain_db > 0:
        return f"gains {_amount(gain_db)} over {over}"
    return f"loses {_amount(gain_db)} to {over}"


def _amount(gain_db: float) -> str:
    decimals = 1 if abs(gain_db) >= 0.95 else 2  # two digits that count
    return f"{abs(gain_db):.{decimals}f} dB"


def _run(exposure: Way) -> str:
    if exposure.kind == "open":
        return "the open shutter"
    if exposure.kind == "snapshot":
        return f"a single exposure of {_share(exposure.code)}"
    if exposure.kind == "code":
        return "a code"
    return _pulses(exposure.code)


def _pulses(code: ShutterCode) -> str:
    """Even pulses in words."""
    first_open = code.bits.index("1")
    first_closed = code.bits.index("0", first_open)
    period = code.bits.find("1", first_closed) - first_open
    return f"{code.pulses} pulses of {first_closed - first_open} chips, one every {period} chips"


def _share(code: ShutterCode) -> str:
    """Open part of the exposure in words, with its time."""
    ratio = code.chips / code.open_chips
    share = f"1/{float(f'{ratio:.2g}'):g}" if ratio >= 2 else f"{100 / ratio:.0f} %"
    open_s, exposure_s = (count * code.chip_ns * 1e-9 for count in (code.open_chips, code.chips))
    return f"{share} of the time ({duration(open_s)} of {duration(exposure_s)})"


def _range(low: float | None, high: float | None) -> str:
    """Range of light in words, its ends to two digits."""
    numbers = [f"{float(f'{end:.2g}'):,.0f}" for end in (low, high) if end is not None]
    if low is None:
        return f"up to {numbers[0]}"
    if high is None:
        return f"from {numbers[0]} on"
    return f"from {numbers[0]} to {numbers[1]}"
