"""Verdict on the ways to expose at one level of light: which to take, and what it gains."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any, Literal

from cep.files.formatting import duration
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.scene import PHOTO, Scene
from cep.search.expected import WORTH_DB
from cep.search.measured import corrected, is_measured, measured_ways, shifts_db
from cep.search.problem import SearchProblem
from cep.search.ways import (
    CODED,
    KINDS,
    PLAIN,
    Choice,
    Way,
    WayFinder,
    best_possible,
    check_light,
    judged_ways,
    simplest,
)
from motdiff.types import FloatArray

_ENOUGH = 5  # photographs from which the least and the greatest gain are left out of a range

Figure = Literal["psnr_db", "equal_light_db"]
"""Figure of a :class:`Way` by which the best one is chosen."""


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
        Photos restored together, each exposed in the same way but for a code.
    scene : Scene
        What is photographed.
    """

    camera: Camera
    ways: tuple[Way, ...]
    code_name: str = "the best code found"
    user_code: Way | None = None
    path_error_px: float = 0.0
    frames: int = 1
    scene: Scene = PHOTO

    @property
    def possible(self) -> tuple[Way, ...]:
        """Ways that can be advised: they keep the limits and do not saturate."""
        return tuple(exposure for exposure in self.ways if exposure.possible)

    @property
    def photographs(self) -> int:
        """Photographs on which the gains were measured; 0 where they are a model's."""
        return len(self.ways[0].photo_psnr_db)

    @property
    def open_saturates(self) -> bool:
        """Whether the open shutter collects more than the camera can record."""
        return self.ways[0].saturates

    def best(self, kind: Choice, *, by: Figure = "psnr_db") -> Way | None:
        """Best possible way of a kind, if any; even pulses are a code as well."""
        kinds = {"code": CODED}.get(kind, (kind,))
        candidates = (exposure for exposure in self.possible if exposure.kind in kinds)
        return max(candidates, key=attrgetter(by), default=None)

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
        """Way to take if the limits could be loosened, where it is better by ``WORTH_DB``."""
        # a pixel that saturates does so without limits as well
        best = simplest([exposure for exposure in self.ways if not exposure.saturates])
        if best.psnr_db > self.advised.psnr_db + WORTH_DB:
            return best
        return None

    @property
    def gains_db(self) -> dict[Choice, float]:
        """Gain of the best possible way of each kind over the open shutter, dB.

        An open shutter that saturates counts as if the pixel could hold its light.
        """
        return self._gains_db("psnr_db")

    @property
    def equal_light_gains_db(self) -> dict[Choice, float]:
        """The same where a brighter lamp makes up for the closed chips.

        The best ways may be others there. Empty where the open shutter saturates.
        """
        if self.open_saturates:
            return {}  # with as much light every other way would saturate as well
        return self._gains_db("equal_light_db")

    @property
    def code_gain_db(self) -> float | None:
        """Gain of the best code over the better of open shutter and best snapshot, dB.

        Of possible ways. None where no code is possible, infinite where nothing else is.
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
            ways=tuple(corrected(exposure, shifts, share) for exposure in self.ways),
            user_code=self.user_code and corrected(self.user_code, shifts, share),
        )

    @property
    def sentence(self) -> str:
        """What to do and what it gains, then under which conditions."""
        sentences = [
            f"{self.recommendation}.",
            f"{self._meaning} {self._conditions}.",
        ]
        if self._code is None:
            sentences.append("No code is possible.")
        if self.open_saturates:
            sentences.append("The open shutter saturates at this light.")
        if outside := self.outside:
            more = _amount(outside.psnr_db - self.advised.psnr_db, self.photographs)
            sentences.append(
                f"If the limits can be loosened, {_exposure_in_words(outside)} gains {more} more."
            )
        return " ".join(sentences)

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
            "ways": {kind: best.to_dict() for kind, best in self._best_ways("psnr_db").items()},
            "outside_limits": outside and outside.to_dict(),
        }

    @property
    def _code(self) -> Way | None:
        """Code that a single exposure is compared with."""
        return self.user_code or self.best("code")

    def _best_ways(self, by: Figure) -> dict[Choice, Way]:
        return {kind: best for kind in KINDS if (best := self.best(kind, by=by))}

    def _gains_db(self, by: Figure) -> dict[Choice, float]:
        # the open shutter is first: gains are relative to it
        figure = attrgetter(by)
        open_db = figure(self.ways[0])
        return {kind: figure(best) - open_db for kind, best in self._best_ways(by).items()}

    @property
    def _meaning(self) -> str:
        """What the gains are."""
        if not self.photographs:
            return f"Gains are about those that a model of {self.scene.name} expects"
        spread = ""
        if self.photographs >= _ENOUGH:
            spread = " (in brackets: without the least and the greatest)"
        return f"Gains are means over {self.scene.counted(self.photographs)}{spread}, restored"

    @property
    def recommendation(self) -> str:
        """What to do and what it gains."""
        advised = self.advised
        gains = []
        if not self.open_saturates:  # a gain over what cannot be recorded says nothing
            gains.append(self._gain(self.ways[0], "the open shutter"))
        if advised.kind == "open":
            return (
                "Leave the shutter open: no shorter exposure and no code found gains"
                f" {WORTH_DB:g} dB"
            )
        if advised.kind == "snapshot":
            text = f"Coding does not pay here: expose {_share(advised.code)}"
            if not self.code_name:
                return f"{text}{_joined(', which ', gains)}; no code that was tried is better"
            if self._code:
                gains.append(self._gain(self._code, self.code_name, ranged=True))
            return text + _joined(", which ", gains)
        user_code = self.user_code
        if user_code == advised:
            user_code = None  # the code to take is not compared with itself
        action = "Code this exposure"
        if advised.kind == "strobe":
            action = f"Pulse the shutter evenly, {_pulses(advised.code)}"
        elif user_code:
            action += f" by {advised.code.bits}"
        if snapshot := self.best("snapshot"):
            over = self._gain(snapshot, "the best single exposure", ranged=True)
            gains.append(f"{over}, {_share(snapshot.code)}")
        if user_code:
            gains.append(self._gain(user_code, self.code_name))
        return action + _joined(": that ", gains)

    def _gain(self, alternative: Way, name: str, *, ranged: bool = False) -> str:
        """Say what the advised way gains over another, or loses to it."""
        advised = self.advised
        gain_db = advised.psnr_db - alternative.psnr_db
        photographs = min(len(advised.photo_psnr_db), len(alternative.photo_psnr_db))
        if abs(gain_db) < WORTH_DB:
            text = f"restores as well as {name}"
        elif gain_db > 0:
            text = f"gains {_amount(gain_db, photographs)} over {name}"
        else:
            text = f"loses {_amount(gain_db, photographs)} to {name}"
        # a loss is stated by its size
        pair = (alternative, advised) if gain_db <= -WORTH_DB else (advised, alternative)
        limits_db = gain_range_db(*pair)
        if not ranged or limits_db is None:
            return text
        low, high = (round(limit_db, 1) + 0.0 for limit_db in limits_db)  # no -0.0
        return f"{text} ({low:.1f} to {high:.1f} on {self.scene.counted(photographs)})"

    @property
    def _conditions(self) -> str:
        """Light, noise and the error of the path, in words."""
        camera = self.camera
        light = f"at {camera.photons_full_scale:,.0f} photo-electrons at full scale"
        if self.frames > 1:
            light += f" in each of {self.frames} frames"
        noise = [f"{camera.read_noise_e:.3g} e- of read noise"]
        if camera.dark_current_e_s:
            noise.append(f"{camera.dark_current_e_s:.3g} e-/s of dark current")
        if self.path_error_px:
            noise.append(f"a path known to {self.path_error_px:.2g} px")
        return f"{', '.join([light, *noise[:-1]])} and {noise[-1]}"


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
        Its objective does not matter: the error of the restored photo with its camera does.
    *codes : ShutterCode
        Those of a single opening count as snapshots.
    rivals : sequence of ShutterCode
        Of one code: the best of all on photographs takes its place.
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
    finder = WayFinder(problem)
    ordinary = finder.ordinary(problem.camera, every_length=path_error_px > 0)
    (modelled,) = judged_ways(
        problem, [problem.camera], [*ordinary, *codes, *rivals], path_error_px=path_error_px
    )
    bits = {code.bits for code in (*codes, *rivals)}

    def competing(exposures: Sequence[Way]) -> list[Way]:
        return [
            exposure
            for exposure in exposures
            if exposure.code.bits in bits and exposure.kind == "code" and exposure.possible
        ]

    compete = bool(rivals) and bool(competing(modelled))
    if is_measured(problem, photographs):
        announce(expectation(problem, verdict_of(problem, modelled, codes)))
    exposures = measured_ways(
        problem,
        modelled,
        own_codes=() if compete else codes,
        path_error_px=path_error_px,
        photographs=photographs,
        progress=progress,
    )
    measured = bool(exposures[0].photo_psnr_db)
    if compete and measured:
        codes = (max(competing(exposures), key=attrgetter("psnr_db")).code,)
    return verdict_of(problem, exposures, codes, path_error_px=path_error_px)


def expectation(problem: SearchProblem, modelled: Verdict) -> str:
    """Say what to expect of a measurement: a model's verdict, shifted by table."""
    shifts = shifts_db(problem.scenarios[0].trajectory, modelled.camera)
    text = modelled.shifted(shifts).recommendation
    return f"expected, before it is measured: {text[:1].lower()}{text[1:]}"


def verdict_of(
    problem: SearchProblem,
    exposures: tuple[Way, ...],
    codes: Sequence[ShutterCode],
    *,
    path_error_px: float = 0.0,
) -> Verdict:
    """Return the verdict of ways that were judged already; see :func:`verdict`."""
    best_possible(exposures)  # refuses where there is none
    unnamed = Verdict(
        problem.camera, exposures, "", path_error_px=path_error_px, scene=problem.scene
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
    if len(codes) > 1:
        name = "the best of these codes"
    return replace(unnamed, code_name=name, user_code=best_possible(user_exposures))


def check_codes(problem: SearchProblem, codes: Sequence[ShutterCode]) -> None:
    """Refuse codes with another number of chips than the problem's."""
    if any(code.chips != problem.chips for code in codes):
        raise ValueError(f"codes: must have {problem.chips} chips")


def _joined(opening: str, gains: Sequence[str]) -> str:
    """Gains as one clause, empty without any; the verb stands once where it is the same."""
    if not gains:
        return ""
    verb = gains[0].split()[0] + " "  # "gains 2 dB over A and 1 dB over B"
    return opening + " and ".join([gains[0], *(gain.removeprefix(verb) for gain in gains[1:])])


def gain_range_db(exposure: Way, alternative: Way) -> tuple[float, float] | None:
    """Range of the gain of a way over another on photographs, dB; None where none was measured.

    The least and the greatest gain are left out where there are five photographs or more.
    """
    pairs = zip(exposure.photo_psnr_db, alternative.photo_psnr_db, strict=False)
    gains = sorted(psnr_db - alternative_db for psnr_db, alternative_db in pairs)
    if len(gains) >= _ENOUGH:
        gains = gains[1:-1]
    return (gains[0], gains[-1]) if gains else None


def _amount(gain_db: float, photographs: int) -> str:
    decimals = 1 if abs(gain_db) >= 0.95 else 2  # two digits that count
    about = "" if photographs else "about "
    return f"{about}{abs(gain_db):.{decimals}f} dB"


def _exposure_in_words(exposure: Way) -> str:
    if exposure.kind == "strobe":
        return _pulses(exposure.code)
    if exposure.kind == "snapshot":
        return f"a single exposure of {_share(exposure.code)}"
    return {"open": "the open shutter", "code": "a code"}[exposure.kind]


def _pulses(code: ShutterCode) -> str:
    """Even pulses in words."""
    first_open = code.bits.index("1")
    first_closed = code.bits.index("0", first_open)
    period = code.bits.find("1", first_closed) - first_open  # from start to start
    return f"{code.pulses} pulses of {first_closed - first_open} chips, one every {period} chips"


def _share(code: ShutterCode) -> str:
    """Open part of the exposure in words, with its time."""
    # 1/4 rather than 25 %, as shutter speeds are written
    ratio = code.chips / code.open_chips
    share = f"1/{float(f'{ratio:.2g}'):g}" if ratio >= 2 else f"{100 / ratio:.0f} %"
    open_s, exposure_s = (count * code.chip_ns * 1e-9 for count in (code.open_chips, code.chips))
    return f"{share} of the time ({duration(open_s)} of {duration(exposure_s)})"
