"""Verdict on the exposures at one level of light: which to take, and what it gains."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any, Literal

from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.scene import PHOTO, Scene
from cep.search.expected import WORTH_DB
from cep.search.exposures import (
    CODED,
    KINDS,
    PLAIN,
    Choice,
    Exposure,
    ExposureFinder,
    best_possible,
    check_light,
    gain_range_db,
    judged_exposures,
    kind_of,
    pair_exposures,
    simplest,
)
from cep.search.measured import corrected, is_measured, measured_exposures, shifts_db
from cep.search.problem import SearchProblem
from cep.search.verdict_text import conditions, recommendation
from motdiff.types import FloatArray

Figure = Literal["psnr_db", "equal_light_db"]
"""Figure of an :class:`Exposure` by which the best one is chosen."""


@dataclass(frozen=True)
class Verdict:
    """Exposures at one light level, and which of them to take.

    Attributes
    ----------
    camera : Camera
    exposures : tuple of Exposure
        The open shutter first, then every other that was tried; at least one is possible.
    code_name : str
        Name in the sentence of the code that a single exposure is compared with; empty where no
        code of the user's is.
    user_code : Exposure or None
        That code, where it is the user's; else the best one is compared with.
    path_error_px : float
        Rms error that the path was taken to have.
    frames : int
        Photos restored together, each exposed in the same way but for a code.
    is_pair : bool
        Whether they are those of two cameras in one exposure: the code's complement is in the
        second.
    scene : Scene
        What is photographed.
    """

    camera: Camera
    exposures: tuple[Exposure, ...]
    code_name: str = "the best code found"
    user_code: Exposure | None = None
    path_error_px: float = 0.0
    frames: int = 1
    scene: Scene = PHOTO
    is_pair: bool = False

    def __post_init__(self) -> None:
        if not self.exposures or self.exposures[0].kind != "open":
            raise ValueError("exposures: must begin with the open shutter")

    @property
    def open_shutter(self) -> Exposure:
        """The open shutter, possible or not: gains are over it."""
        return self.exposures[0]

    @property
    def possible(self) -> tuple[Exposure, ...]:
        """Exposures that can be advised: they keep the limits and do not saturate."""
        return tuple(exposure for exposure in self.exposures if exposure.possible)

    @property
    def photographs(self) -> int:
        """Photographs on which the gains were measured; 0 where they are a model's."""
        return len(self.open_shutter.photo_psnr_db)

    @property
    def open_saturates(self) -> bool:
        """Whether the open shutter collects more than the camera can record."""
        return self.open_shutter.saturates

    def best(self, kind: Choice, *, by: Figure = "psnr_db") -> Exposure | None:
        """Best possible exposure of a kind, if any; even pulses are a code as well."""
        kinds = {"code": CODED}.get(kind, (kind,))
        candidates = (exposure for exposure in self.possible if exposure.kind in kinds)
        return max(candidates, key=attrgetter(by), default=None)

    @property
    def advised(self) -> Exposure:
        """The exposure to take: the simplest possible one that no other beats by ``WORTH_DB``."""
        return simplest(self.possible)

    @property
    def choice(self) -> Choice:
        """Kind of the exposure to take."""
        return self.advised.kind

    @property
    def compared_code(self) -> Exposure | None:
        """Code that a single exposure is compared with."""
        return self.user_code or self.best("code")

    @property
    def outside(self) -> Exposure | None:
        """Exposure to take if the limits could be loosened, where it is better by ``WORTH_DB``."""
        # a pixel that saturates does so without limits as well
        best = simplest([exposure for exposure in self.exposures if not exposure.saturates])
        if best.psnr_db > self.advised.psnr_db + WORTH_DB:
            return best
        return None

    @property
    def gains_db(self) -> dict[Choice, float]:
        """Gain of the best possible exposure of each kind over the open shutter, dB.

        An open shutter that saturates counts as if the pixel could hold its light.
        """
        return self._gains_db("psnr_db")

    @property
    def equal_light_gains_db(self) -> dict[Choice, float]:
        """The same where a brighter lamp makes up for the closed chips.

        The best exposures may be others there. Empty where the open shutter saturates.
        """
        if self.open_saturates:
            return {}  # with as much light every other exposure would saturate as well
        return self._gains_db("equal_light_db")

    @property
    def code_gain_db(self) -> float | None:
        """Gain of the best code over the better of open shutter and best snapshot, dB.

        Of possible exposures. None where no code is possible, infinite where nothing else is.
        """
        code = self.best("code")
        if code is None:
            return None
        plain_db = [exposure.psnr_db for exposure in self.possible if exposure.kind in PLAIN]
        return code.psnr_db - max(plain_db, default=-math.inf)

    @property
    def code_gain_range_db(self) -> tuple[float, float] | None:
        """That gain's range over the photographs, as of :func:`gain_range_db`; None without."""
        code = self.best("code")
        plain = [exposure for exposure in self.possible if exposure.kind in PLAIN]
        if code is None or not plain:
            return None
        return gain_range_db(code, max(plain, key=attrgetter("psnr_db")))

    def shifted(self, shifts: dict[Choice, float], share: float = 1.0) -> Verdict:
        """Return a model's verdict, shifted by a share of what photographs showed of each kind."""
        return replace(
            self,
            exposures=tuple(corrected(exposure, shifts, share) for exposure in self.exposures),
            user_code=self.user_code and corrected(self.user_code, shifts, share),
        )

    @property
    def sentence(self) -> str:
        """What to do and what it gains, then under which conditions."""
        return f"{recommendation(self)}. {conditions(self)}"

    def to_dict(self) -> dict[str, Any]:
        """Fields for JSON."""
        outside = self.outside
        return {
            "choice": self.choice,
            "photons": self.camera.photons_full_scale,
            "open_saturates": self.open_saturates,
            "scene": self.scene.name,
            "photographs": self.photographs,
            "gains_db": self.gains_db,
            "code_gain_db": self.code_gain_db if math.isfinite(self.code_gain_db or 0) else None,
            "code_gain_range_db": self.code_gain_range_db,
            "equal_light_gains_db": self.equal_light_gains_db,
            "ways": {
                kind: best.to_dict() for kind, best in self._best_exposures("psnr_db").items()
            },
            "outside_limits": outside and outside.to_dict(),
        }

    def _best_exposures(self, by: Figure) -> dict[Choice, Exposure]:
        return {kind: best for kind in KINDS if (best := self.best(kind, by=by))}

    def _gains_db(self, by: Figure) -> dict[Choice, float]:
        figure = attrgetter(by)
        open_db = figure(self.open_shutter)
        return {kind: figure(best) - open_db for kind, best in self._best_exposures(by).items()}


def verdict(
    problem: SearchProblem,
    *codes: ShutterCode,
    rivals: Sequence[ShutterCode] = (),
    path_error_px: float = 0.0,
    photographs: Sequence[FloatArray] | None = None,
    announce: Callable[[str], None] = lambda _text: None,
    progress: Callable[[float], None] = lambda _share: None,
) -> Verdict:
    """Judge codes beside open shutter, best snapshot and best strobe, by their restoration.

    Parameters
    ----------
    problem : SearchProblem
        Its objective does not matter: the error of the restored photo with its camera does. Of two
        frames, two cameras that play a code and its complement are compared with two that stand
        open and two that take the same snapshot.
    *codes : ShutterCode
        Those of a single opening count as snapshots, but for two cameras.
    rivals : sequence of ShutterCode
        Of one code: the best of all on photographs takes its place, that of a single exposure
        only where a code is advised.
    path_error_px, photographs, announce
        As of :func:`cep.search.advise.advise`.
    progress : callable, optional
        Called with the finished share, 0..1.

    Raises
    ------
    ValueError
        If the problem has no motion, even the shortest opening saturates at its light, or a code
        has another number of chips.
    """
    check_light(problem)
    check_codes(problem, codes)  # here, before seconds of work
    is_measurable = is_measured(problem, photographs)
    if problem.frames == 2:
        modelled = pair_exposures(problem, [*codes, *rivals])
        if not is_measurable:
            path_error_px = 0.0  # which the model of a pair does not count
    else:
        finder = ExposureFinder(problem)
        ordinary = finder.ordinary(problem.camera, every_length=path_error_px > 0)
        (modelled,) = judged_exposures(
            problem, [problem.camera], [*ordinary, *codes, *rivals], path_error_px=path_error_px
        )
    bits = {code.bits for code in (*codes, *rivals)}

    def competing(exposures: Sequence[Exposure]) -> list[Exposure]:
        return [
            exposure
            for exposure in exposures
            if exposure.code.bits in bits and exposure.kind == "code" and exposure.possible
        ]

    compete = bool(rivals) and bool(competing(modelled))
    # which gives way to a code that is advised, and to no other
    single = problem.frames == 1 and bool(codes) and kind_of(codes[0]) in PLAIN
    if is_measurable and problem.frames == 1:  # the table behind it is of one camera
        announce(expectation(problem, verdict_of(problem, modelled, codes)))
    exposures = measured_exposures(
        problem,
        modelled,
        own_codes=() if compete and not single else codes,
        path_error_px=path_error_px,
        photographs=photographs,
        progress=progress,
    )
    measured = bool(exposures[0].photo_psnr_db)
    if compete and measured:
        best = max(competing(exposures), key=attrgetter("psnr_db")).code
        of_best = verdict_of(problem, exposures, (best,), path_error_px=path_error_px)
        if of_best.choice == "code" or not single:
            return of_best
    return verdict_of(problem, exposures, codes, path_error_px=path_error_px)


def expectation(problem: SearchProblem, modelled: Verdict) -> str:
    """Say what to expect of a measurement: a model's verdict, shifted by table."""
    shifts = shifts_db(problem.scenarios[0].trajectory, modelled.camera)
    text = recommendation(modelled.shifted(shifts))
    return f"expected, before it is measured: {text[:1].lower()}{text[1:]}"


def verdict_of(
    problem: SearchProblem,
    exposures: tuple[Exposure, ...],
    codes: Sequence[ShutterCode],
    *,
    path_error_px: float = 0.0,
) -> Verdict:
    """Return the verdict of exposures that were judged already; see :func:`verdict`."""
    best_possible(exposures)  # refuses where there is none
    unnamed = Verdict(
        problem.camera,
        exposures,
        "",
        path_error_px=path_error_px,
        frames=problem.frames,
        scene=problem.scene,
        is_pair=problem.frames == 2,
    )
    # by their bits: the codes judged carry the problem's chip time, the given ones may not
    bits = {code.bits for code in codes}
    user_exposures = [
        exposure
        for exposure in unnamed.possible
        if exposure.kind in CODED and exposure.code.bits in bits
    ]
    if not user_exposures:
        return unnamed
    name = "this code"
    if problem.frames == 2:
        name = "this code and its complement"
    elif len(codes) > 1:
        name = "the best of these codes"
    return replace(unnamed, code_name=name, user_code=best_possible(user_exposures))


def check_codes(problem: SearchProblem, codes: Sequence[ShutterCode]) -> None:
    """Refuse codes with another number of chips than the problem's."""
    if any(code.chips != problem.chips for code in codes):
        raise ValueError(f"codes: must have {problem.chips} chips")
