"""Options of ``cep optimize`` that say what to search for, and the problem that they make."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

    from cep.optics.camera import Camera
    from cep.optics.code import ShutterCode
    from cep.search.limits import RunLimits
    from cep.search.optimize import Search
    from cep.search.problem import SearchProblem
    from cep.search.scenarios import Scenario
    from hw.device import DeviceProfile
    from motdiff.files.trajectories import StoredMotion
    from motdiff.trajectory import Trajectory


_SPEEDS = 5
_JITTERS = 6


@dataclass(frozen=True, kw_only=True)
class SearchOptions:
    """The options as they were given; see the command's help."""

    chips: int
    chip_ns: int
    open_chips: str | None
    duty: str | None
    objective: str | None
    direction: str
    runs: RunLimits
    first_open: bool
    last_open: bool
    alternatives: bool
    speed: str | None
    drift: float | None
    jitter: float | None
    rule: str


def problem_of(
    wish: SearchOptions,
    stored: StoredMotion,
    *,
    camera: Camera,
    profile: DeviceProfile | None,
    rng: np.random.Generator,
) -> SearchProblem:
    """Make the search problem that the options describe.

    Raises
    ------
    ValueError
        If an option is malformed or they conflict; the line says which.
    """
    from cep.search.playable import Playable, within_camera, within_device
    from cep.search.problem import SearchProblem

    open_range = open_limits(wish.chips, wish.open_chips, wish.duty)
    runs = replace(wish.runs, fixed=_mask(wish))
    if profile is None:
        played = Playable(
            within_camera(camera, chips=wish.chips, chip_ns=wish.chip_ns, runs=runs),
            open_range,
            None,
        )
    else:
        played = within_device(
            profile, chips=wish.chips, chip_ns=wish.chip_ns, open_range=open_range, runs=runs
        )
    return SearchProblem(
        chips=wish.chips,
        scenarios=_scenarios(wish, stored, rng),
        open_range=played.open_range,
        objective=_objective(wish.objective or "mse"),
        direction=wish.direction,  # type: ignore[arg-type]
        rule=wish.rule,  # type: ignore[arg-type]
        runs=played.runs,
        camera=camera,
        response=played.response,
        chip_ns=wish.chip_ns,
        device=profile,
    )


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
        least = int(low)
        most = int(high or low)
    except ValueError:
        raise ValueError(
            f"--open: must be K or LOW:HIGH in whole chips, got {open_chips!r}"
        ) from None
    if not 1 <= least <= most <= chips:
        raise ValueError(f"--open: must lie within 1..{chips}, got {open_chips}")
    return least, most


def _objective(text: str) -> str | tuple[tuple[str, float], ...]:
    if ":" not in text and "," not in text:
        return text
    mix = []
    for part in text.split(","):
        name, _, weight = part.partition(":")
        try:
            mix.append((name.strip(), float(weight or 1)))
        except ValueError:
            raise ValueError(
                f"--objective: must be a name or a mix as min-mtf:0.15,noise:1, got {text!r}"
            ) from None
    if len({name for name, _ in mix}) < len(mix):
        raise ValueError(f"--objective: names one objective twice, got {text!r}")
    return tuple(mix)


def _scenarios(
    wish: SearchOptions, stored: StoredMotion, rng: np.random.Generator
) -> tuple[Scenario, ...]:
    from cep.search.scenarios import (
        LARGEST_JITTER,
        Scenario,
        alternatives,
        drifted,
        jittered,
        speed_range,
    )

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
            raise ValueError(
                f"--jitter: must lie within 0..{LARGEST_JITTER:g} chips, got {wish.jitter:g}"
            )
        made = jittered(made, wish.chips, wish.jitter, _JITTERS, rng=rng)
    return made


def _mask(wish: SearchOptions) -> str | None:
    from cep.search.limits import fixed_mask

    fixed = wish.runs.fixed
    if fixed is None and not (wish.first_open or wish.last_open):
        return None
    marks = fixed or "?" * wish.chips
    for asked, name, place in (
        (wish.first_open, "--first-open", 0),
        (wish.last_open, "--last-open", -1),
    ):
        if asked and marks[place : place + 1 or None] == "0":
            raise ValueError(f"{name}: --fixed closes that chip")
    if len(marks) != wish.chips or set(marks) - set("01?"):
        raise ValueError(f"--fixed: must be {wish.chips} characters of 1, 0 and ?, got {fixed!r}")
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


@dataclass(frozen=True)
class Task:
    """A search along one motion.

    Attributes
    ----------
    problem : SearchProblem
    along : Trajectory
        What the certificate is for: the motion as it was given.
    described : mapping
        What the code file says of the problem.
    """

    problem: SearchProblem
    along: Trajectory
    described: Mapping[str, Any]


def task_of(
    wish: SearchOptions,
    stored: StoredMotion,
    how: Search,
    *,
    camera: Camera,
    profile: DeviceProfile | None,
    source: Mapping[str, object],
) -> Task:
    """Make the search of the options along a motion.

    Parameters
    ----------
    wish, how, camera, profile
        The options.
    stored : StoredMotion
    source : mapping
        ``trajectory`` and ``linear_px`` as they were given, for the code file.

    Raises
    ------
    ValueError
        If the path is too wide or too short, or the options are malformed or conflict.
    """
    import numpy as np

    from cep.optics.band import uniform_length_px
    from cep.optics.path_limits import check_frame, check_resolved
    from cep.search.optimize import described_search

    motion = stored.trajectory
    for path in (motion, *(path for _, path in stored.alternatives if wish.alternatives)):
        check_frame(path)
    check_resolved(motion, wish.chips)
    if wish.objective is None and how.method == "exact" and uniform_length_px(motion) is not None:
        wish = replace(wish, objective="min-mtf")  # what a proof is for
    problem = problem_of(
        wish, stored, camera=camera, profile=profile, rng=np.random.default_rng([how.seed, 2])
    )
    described = {
        **{
            name: value
            for name, value in asdict(wish).items()
            if name not in ("open_chips", "duty", "chip_ns", "runs")
        },
        **source,
        **described_search(problem, how),
    }
    return Task(problem, motion, described)


def openings(code: ShutterCode) -> str:
    """Say in words how often a code opens."""
    return f"{code.pulses} opening{'' if code.pulses == 1 else 's'}"


def ending(stopped: str, steps: int) -> str:
    """Say in words what ended a search after so many moves, or codes counted."""
    return {
        "steps": f"all {steps:,} moves made",
        "time": f"stopped by the time, {steps:,} moves made",
        "interrupted": "stopped by Ctrl-C",
        "complete": "no other code keeps the limits",
        "proven": f"all {steps:.2g} codes counted" if steps else "proven before",
    }[stopped]
