"""Whether to code an exposure: open shutter, snapshot, strobe and code, over the light."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cep.optics.camera import LIGHT_RANGE
from cep.optics.code import ShutterCode
from cep.optics.path_limits import check_frame, check_resolved
from cep.search.expected import WORTH_DB
from cep.search.exposures import (
    NONE_POSSIBLE,
    Choice,
    ExposureFinder,
    can_record,
    check_light,
    judged_exposures,
)
from cep.search.frame_error import codes_of_a_frame, is_framed
from cep.search.measured import corrections_db, is_measured, measured_exposures, shifts_db
from cep.search.problem import SearchProblem
from cep.search.verdict import Verdict, check_codes, expectation
from motdiff.types import FloatArray

LEVELS = (100.0, 300.0, 1_000.0, 3_000.0, 10_000.0, 30_000.0, 100_000.0)
"""Photo-electrons at full scale at which exposures are compared: starlight to studio."""

_MODELLED_SHARE = 0.3  # of the time: then it is measured


@dataclass(frozen=True)
class Advice:
    """Verdict at the camera's light, and at other light levels.

    Attributes
    ----------
    problem : SearchProblem
    here : Verdict
    levels : tuple of Verdict
        By rising light, the camera's own among them.
    """

    problem: SearchProblem
    here: Verdict
    levels: tuple[Verdict, ...]

    @property
    def choice(self) -> Choice:
        """Kind of the exposure to take at the camera's light."""
        return self.here.choice

    @property
    def gains_db(self) -> dict[Choice, float]:
        """As :attr:`cep.search.verdict.Verdict.gains_db`, at the camera's light."""
        return self.here.gains_db

    @property
    def crossover(self) -> tuple[tuple[float | None, float | None], ...]:
        """Ranges of light, photo-electrons at full scale, in which coding gains ``WORTH_DB``.

        Even pulses count as a code; the gain is that over the better of open shutter and best
        snapshot. Between the levels it is interpolated over the logarithm of the light. None where
        a range goes on beyond the levels.
        """
        gains_db = [level.code_gain_db for level in self.levels]
        # of an infinite gain, where only codes are possible, the sign alone counts
        excess = np.array([-np.inf if gain is None else gain for gain in gains_db]) - WORTH_DB
        log_light = np.log10([level.camera.photons_full_scale for level in self.levels])
        pays = excess > 0
        bounds: list[float | None] = [None] * int(pays[0])
        for i in np.flatnonzero(pays[1:] != pays[:-1]):
            share = 0.5  # where no code is possible at one of the levels: the middle
            if np.isfinite(excess[i] - excess[i + 1]):
                share = excess[i] / (excess[i] - excess[i + 1])
            bounds.append(float(10 ** (log_light[i] + share * (log_light[i + 1] - log_light[i]))))
        bounds += [None] * int(pays[-1])
        return tuple(zip(bounds[::2], bounds[1::2], strict=True))

    @property
    def sentence(self) -> str:
        """What to do at the camera's light, then at which light coding pays."""
        return f"{self.here.sentence} {self.where}"

    @property
    def where(self) -> str:
        """At which light coding pays: one sentence."""
        gains_db = {level.camera.photons_full_scale: level.code_gain_db for level in self.levels}
        lights = list(gains_db)
        if all(gain_db == math.inf for gain_db in gains_db.values()):
            return "Only codes keep these limits, at any light."
        if len(lights) == 1:
            return "No other light was tried."
        span = f"between {lights[0]:,.0f} and {lights[-1]:,.0f} photo-electrons at full scale"
        crossover = self.crossover
        if not crossover:
            return f"With this camera and motion coding pays at no light {span}."
        if crossover == ((None, None),):
            where = f"at any light {span}"
        else:
            ranges = " and ".join(_range(low, high) for low, high in crossover)
            where = f"{ranges} photo-electrons at full scale"
        finite = {light: gain_db or 0.0 for light, gain_db in gains_db.items()}
        finite = {light: gain_db for light, gain_db in finite.items() if math.isfinite(gain_db)}
        best_light = max(finite, key=finite.__getitem__)
        gain = f"{finite[best_light]:.2g} dB at most (at {best_light:,.0f})"
        return f"Coding pays {where}, by about {gain}."

    def to_dict(self) -> dict[str, Any]:
        """Fields for JSON, as ``cep advise --json`` prints them."""
        return {
            "verdict": self.sentence,
            **self.here.to_dict(),
            "crossover": self.crossover,
            "path_error_px": self.here.path_error_px,
            "chips": self.problem.chips,
            "chip_ns": self.problem.chip_ns,
            "exposure_s": self.problem.chips * self.problem.chip_ns * 1e-9,
            "levels": [level.to_dict() for level in self.levels],
        }

    def __repr__(self) -> str:
        return self.sentence

    def _repr_png_(self) -> bytes:
        from cep.plots.advice import advice_figure
        from cep.plots.canvas import png_bytes

        return png_bytes(advice_figure(self))


def advise(
    problem: SearchProblem,
    *codes: ShutterCode,
    levels: Sequence[float] = LEVELS,
    path_error_px: float = 0.0,
    photographs: Sequence[FloatArray] | None = None,
    seed: int = 0,
    threads: int | None = None,
    announce: Callable[[str], None] = lambda _text: None,
    progress: Callable[[float, str], None] = lambda _share, _note: None,
) -> Advice:
    """Compare open shutter, best snapshot, best strobe and best code, over levels of light.

    Each exposure may be open for any part of its time within the problem's limits; the scene is as
    bright for all. A code is searched at each level. At the camera's light the gains are those
    that photographs show, simulated and restored (:mod:`cep.search.measured`). At other levels
    they are about those of a model of photographs (:class:`cep.search.expected.ExpectedPsnr`),
    shifted towards what was measured.

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
        Rms error of the path where it is an estimate. Exposures are judged with it, the codes are
        searched without.
    photographs : sequence of (H, W) float ndarrays, linear light, optional
        On which the gains are measured: pictures of the problem's scene. When omitted the twelve
        of :mod:`cep.photographs` for scenes that are photographs, else none. With none at all
        every gain is the model's.
    seed : int
    threads : int, optional
        As many as there are cores when omitted; the outcome does not depend on it.
    announce : callable, optional
        Called with a sentence before the measurement: what to expect of it.
    progress : callable, optional
        Called with the finished share, 0..1, and a note.

    Raises
    ------
    ValueError
        If the problem has no motion or it cannot be resolved, or a level or the camera's own light
        is out of range.

    Examples
    --------
    >>> from cep.optics.camera import Camera
    >>> from motdiff.trajectory import Trajectory
    >>> path = Trajectory.straight(40.0)
    >>> camera = Camera(photons_full_scale=3_000, read_noise_e=2)
    >>> problem = SearchProblem.along(path, chips=40, camera=camera)
    >>> advise(problem, levels=[300, 30_000]).choice
    'snapshot'
    """
    lowest, highest = LIGHT_RANGE
    wrong = [level for level in levels if not lowest <= level <= highest]
    if wrong:
        raise ValueError(
            f"levels: must lie within 1..1e7 photo-electrons at full scale, got {wrong[0]:g}"
        )
    check_light(problem)
    check_codes(problem, codes)
    # a path that is too long or too short for its chips is refused before minutes of work
    for scenario in problem.scenarios:
        check_frame(scenario.trajectory)
        check_resolved(scenario.trajectory, problem.chips)
    camera_light = problem.camera.photons_full_scale
    lights = sorted({*map(float, levels), camera_light})
    cameras = [problem.camera.at(light) for light in lights]
    cameras = [camera for camera in cameras if can_record(replace(problem, camera=camera))]
    finder = ExposureFinder(problem)
    pool = list(codes)
    parts = (len(cameras) + 1) / _MODELLED_SHARE
    for index, camera in enumerate(cameras):
        progress(index / parts, f"{camera.photons_full_scale:,.0f} photo-electrons")
        # exposures of every length do not depend on the light: once is enough
        ordinary = finder.ordinary(camera, every_length=path_error_px > 0 and index == 0)
        # a search starts from the codes of the darker levels as well
        pool += [*ordinary, *finder.codes(camera, [*ordinary, *pool], seed=seed, threads=threads)]
    if is_framed(problem) and is_measured(problem, photographs):
        pool += codes_of_a_frame(
            problem,
            pool,
            seed=seed,
            threads=threads,
            progress=lambda share: progress(
                (len(cameras) + share) / parts, "searching for photos with borders"
            ),
        )
    progress(_MODELLED_SHARE, "judging")
    # every code is judged at every level: one found for another light may be better here
    judgements = judged_exposures(problem, cameras, pool, path_error_px=path_error_px)
    modelled = {
        camera.photons_full_scale: Verdict(
            camera, exposures, path_error_px=path_error_px, scene=problem.scene
        )
        for camera, exposures in zip(cameras, judgements, strict=True)
        if any(exposure.possible for exposure in exposures)
    }
    if camera_light not in modelled:
        raise ValueError(NONE_POSSIBLE)
    at_camera = modelled[camera_light]
    if is_measured(problem, photographs):
        announce(expectation(problem, at_camera))
    exposures = measured_exposures(
        problem,
        at_camera.exposures,
        photographs=photographs,
        own_codes=codes,
        path_error_px=path_error_px,
        seed=seed,
        progress=lambda share: progress(
            _MODELLED_SHARE + (1 - _MODELLED_SHARE) * share, "measuring on photographs"
        ),
    )
    shifts = corrections_db(at_camera.exposures, exposures)
    measured = replace(at_camera, exposures=exposures)
    levels_stated = tuple(
        # what the model lacks grows with the light: nearby it is as where it was measured
        measured
        if light == camera_light
        else at_level.shifted(shifts, math.exp(-abs(math.log10(light / camera_light))))
        for light, at_level in modelled.items()
    )
    progress(1.0, "")
    return Advice(problem, measured, levels_stated)


def shifted(advice: Advice) -> Advice:
    """Shift an advice of the model by what photographs showed of such cases."""
    path = advice.problem.scenarios[0].trajectory
    levels = [level.shifted(shifts_db(path, level.camera)) for level in advice.levels]
    at_camera = levels[advice.levels.index(advice.here)]
    return replace(advice, here=at_camera, levels=tuple(levels))


def _range(low: float | None, high: float | None) -> str:
    """Range of light in words, its ends to two digits."""
    numbers = [f"{float(f'{end:.2g}'):,.0f}" for end in (low, high) if end is not None]
    if low is None:
        return f"up to about {numbers[0]}"
    if high is None:
        return f"from about {numbers[0]} on"
    return f"from about {numbers[0]} to {numbers[1]}"
