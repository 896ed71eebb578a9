"""Options of ``cep optimize`` that say what to search for, and the problem that they make."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

    from cep.camera import Camera
    from cep.search.problem import Scenario, SearchProblem
    from hw.device import DeviceProfile
    from motdiff.files import StoredMotion

__all__ = ["DIRECTIONS", "Wish", "on_the_circle", "open_limits", "problem_of"]

DIRECTIONS = ("auto", "unknown", "forward")
_SPEEDS = 5
_JITTERS = 6


@dataclass(frozen=True, kw_only=True)
class Wish:
    """The options as they were given; see the command's help."""

    chips: int
    chip_ns: int
    open_chips: str | None
    duty: str | None
    objective: str | None
    direction: str
    min_open: int
    max_open: int | None
    min_closed: int
    min_period: int
    max_pulses: int | None
    first_open: bool
    last_open: bool
    fixed: str | None
    alternatives: bool
    speed: str | None
    drift: float | None
    jitter: float | None
    rule: str


def problem_of(
    wish: Wish, stored: StoredMotion, *, camera: Camera, profile: DeviceProfile | None, rng: np.random.Generator
) -> SearchProblem:
    """Make the search problem that the options describe.

    Raises
    ------
    ValueError
        If an option is malformed or they conflict; the line says which.
    """
    from cep.band import uniform_length_px
    from cep.design import limits_of_device, response_of_device
    from cep.search.problem import SearchProblem
    from hw.device import DeviceProfile

    if wish.direction not in DIRECTIONS:
        raise ValueError(f"--direction: must be one of {', '.join(DIRECTIONS)}, got {wish.direction!r}")
    low, high = open_limits(wish.chips, wish.open_chips, wish.duty)
    shutter = profile or DeviceProfile(name="any")
    device: Mapping[str, Any] = limits_of_device(shutter, chips=wish.chips, chip_ns=wish.chip_ns)
    most = device["most_open_chips"]
    if most is not None:
        if most < low:
            raise ValueError(
                f"{shutter.name}: at most {most} of {wish.chips} chips may be open, at least {low} were asked for"
            )
        high = min(high, most)
    straight = uniform_length_px(stored.trajectory) is not None
    return SearchProblem(
        chips=wish.chips,
        scenarios=_scenarios(wish, stored, rng),
        open_range=(low, high),
        objective=_objective(wish.objective) if wish.objective else ("min-mtf" if straight else "mse"),
        direction=wish.direction,  # type: ignore[arg-type]
        rule=wish.rule,  # type: ignore[arg-type]
        min_open=max(wish.min_open, device["min_open"]),
        min_closed=max(wish.min_closed, device["min_closed"]),
        max_pulses=_smallest(wish.max_pulses, device["max_pulses"]),
        max_open=_smallest(wish.max_open, device["max_open"]),
        min_period=max(wish.min_period, device["min_period"]),
        camera=camera,
        fixed=_mask(wish),
        response=None if profile is None else response_of_device(profile, wish.chip_ns),
    )


def on_the_circle(problem: SearchProblem) -> bool:
    """Whether only the code's polynomial matters: one straight uniform motion, chips on time, a shutter without ramps.

    Its zeros from the chip itself are no fault of the code.
    """
    from cep.band import uniform_length_px

    if len(problem.scenarios) != 1 or problem.response is not None:
        return False
    scenario = problem.scenarios[0]
    return scenario.edges is None and uniform_length_px(scenario.trajectory) is not None


def open_limits(chips: int, open_chips: str | None, duty: str | None) -> tuple[int, int]:
    """Fewest and most open chips of ``--open`` or ``--duty``."""
    from cep.search.problem import open_range_of_duty

    if open_chips is not None and duty is not None:
        raise ValueError("--open and --duty: give one of them")
    if duty is not None:
        return open_range_of_duty(chips, *_numbers("--duty", duty, "0.4:0.6"))
    if open_chips is None:
        return 1, chips
    low, _, high = open_chips.partition(":")
    try:
        least, most = int(low), int(high or low)
    except ValueError:
        raise ValueError(f"--open: must be K or LOW:HIGH in whole chips, got {open_chips!r}") from None
    if not 1 <= least <= most <= chips:
        raise ValueError(f"--open: must lie within 1..{chips}, got {open_chips}")
    return least, most


def _smallest(*limits: int | None) -> int | None:
    return min((limit for limit in limits if limit is not None), default=None)


def _objective(text: str) -> str | tuple[tuple[str, float], ...]:
    if ":" not in text and "," not in text:
        return text
    mix = []
    for part in text.split(","):
        name, _, weight = part.partition(":")
        try:
            mix.append((name.strip(), float(weight or 1)))
        except ValueError:
            raise ValueError(f"--objective: must be a name or a mix as min-mtf:0.15,noise:1, got {text!r}") from None
    if len({name for name, _ in mix}) < len(mix):
        raise ValueError(f"--objective: names one objective twice, got {text!r}")
    return tuple(mix)


def _scenarios(wish: Wish, stored: StoredMotion, rng: np.random.Generator) -> tuple[Scenario, ...]:
    from cep.search.scenarios import LARGEST_JITTER, Scenario, alternatives, drifted, jittered, speed_range

    made = alternatives(stored) if wish.alternatives else (Scenario(stored.trajectory),)
    if wish.speed is not None:
        low, high = _numbers("--speed", wish.speed, "0.8:1.2")
        made = speed_range(made, low, high, _SPEEDS if low < high else 1)
    if wish.drift is not None:
        if not abs(wish.drift) <= 0.5:
            raise ValueError(f"--drift: must lie within -0.5..0.5, got {wish.drift:g}")
        made = drifted(made, wish.chips, (-abs(wish.drift), 0.0, abs(wish.drift)))
    if wish.jitter is not None:
        if not 0 <= wish.jitter <= LARGEST_JITTER:
            raise ValueError(f"--jitter: must lie within 0..{LARGEST_JITTER:g} chips, got {wish.jitter:g}")
        made = jittered(made, wish.chips, wish.jitter, _JITTERS, rng=rng)
    return made


def _mask(wish: Wish) -> str | None:
    from cep.search.limits import fixed_mask

    if wish.fixed is None and not (wish.first_open or wish.last_open):
        return None
    marks = wish.fixed or "?" * wish.chips
    for asked, name, place in ((wish.first_open, "--first-open", 0), (wish.last_open, "--last-open", -1)):
        if asked and marks[place : place + 1 or None] == "0":
            raise ValueError(f"{name}: --fixed closes that chip")
    if len(marks) != wish.chips or set(marks) - set("01?"):
        raise ValueError(f"--fixed: must be {wish.chips} characters of 1, 0 and ?, got {wish.fixed!r}")
    return fixed_mask(
        wish.chips,
        first_open=wish.first_open,
        last_open=wish.last_open,
        forced_open=[place for place, mark in enumerate(marks) if mark == "1"],
        forced_closed=[place for place, mark in enumerate(marks) if mark == "0"],
    )


def _numbers(name: str, text: str, example: str) -> tuple[float, float]:
    low, _, high = text.partition(":")
    try:
        return float(low), float(high or low)
    except ValueError:
        raise ValueError(f"{name}: must be LOW:HIGH as {example}, got {text!r}") from None
