"""What ``cep optimize`` searches along one motion, made of its options."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

from cep.cli.search_options import Wish, on_the_circle, problem_of

if TYPE_CHECKING:
    from cep.camera import Camera
    from cep.optimize import Search
    from cep.search.problem import SearchProblem
    from hw.device import DeviceProfile
    from motdiff.files import StoredMotion
    from motdiff.trajectory import Trajectory

__all__ = ["Task", "ending", "search_of", "task_of", "unplayable", "warnings_of"]


@dataclass(frozen=True)
class Task:
    """A search along one motion.

    Attributes
    ----------
    problem : SearchProblem
        To measure on.
    searched : SearchProblem
        To search: the unit circle where only the code's polynomial matters.
    along : Trajectory or None
        What the certificate is for, None on the unit circle.
    described : mapping
        What the code file says of the problem.
    """

    problem: SearchProblem
    searched: SearchProblem
    along: Trajectory | None
    described: Mapping[str, Any]


def search_of(method: str, effort: str, *, steps: int | None, time_s: float | None, seed: int) -> Search:
    """Check the options that say how to search."""
    from cep.optimize import Search

    if method not in ("anneal", "exact"):
        raise ValueError(f"--method: must be anneal or exact, got {method!r}")
    if effort not in ("quick", "sdp"):
        raise ValueError(f"--bound: must be quick or sdp, got {effort!r}")
    return Search(method=method, effort=effort, steps=steps, time_s=time_s, seed=seed)  # type: ignore[arg-type]


def task_of(
    wish: Wish,
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
        ``trajectory``, ``linear_px`` and ``device`` as they were given, for the code file.

    Raises
    ------
    ValueError
        If the path is too wide or too short, or the options are malformed or conflict.
    """
    import numpy as np

    from cep.design import check_frame, check_resolved

    motion = stored.trajectory
    for path in (motion, *(path for _, path in stored.alternatives if wish.alternatives)):
        check_frame(path)
    check_resolved(motion, wish.chips)
    problem = problem_of(wish, stored, camera=camera, profile=profile, rng=np.random.default_rng([how.seed, 2]))
    straight = on_the_circle(problem)
    described = {
        **{name: value for name, value in asdict(wish).items() if name not in ("open_chips", "duty", "chip_ns")},
        **source,
        "open_range": problem.open_limits,
        "objective": problem.objective,
        "min_open": problem.min_open,
        "max_open": problem.max_open,
        "min_closed": problem.min_closed,
        "min_period": problem.min_period,
        "max_pulses": problem.max_pulses,
        "fixed": problem.fixed,
        "camera": problem.camera.to_dict(),
        "method": how.method,
        "seed": how.seed,
    }
    searched = replace(problem, scenarios=()) if straight and problem.objective == "min-mtf" else problem
    return Task(problem, searched, None if straight else _as_designed(motion, wish.direction), described)


def unplayable(bits: str, profile: DeviceProfile | None, chip_ns: int) -> str:
    """Say why the device cannot play a code; empty where it can, or none was named."""
    from hw.program import Program

    problems = profile.check(Program.from_bits(bits, chip_ns=chip_ns)) if profile else ()
    return f"no code was found that the device can play: {'; '.join(problems)}" if problems else ""


def ending(stopped: str, steps: int) -> str:
    """Say in words what ended a search after so many moves, or codes counted."""
    return {
        "steps": f"all {steps:,} moves made",
        "time": f"stopped by the time, {steps:,} moves made",
        "interrupted": "stopped by Ctrl-C",
        "complete": "no other code keeps the limits",
        "proven": f"all {steps:.2g} codes counted",
    }[stopped]


def warnings_of(task: Task, how: Search, *, stopped: str, baselines: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Say what the user should know of the result, and of its baselines as reported, besides their figures."""
    problem, told = task.problem, []
    if stopped == "interrupted":
        what = "the proof was stopped early" if how.method == "exact" else "the search was stopped early"
        told.append(f"{what}, this is the best code so far")
    moves = how.moves(task.searched)
    if stopped == "time" and moves is not None:
        limit = "--time" if how.time_s is not None else f"the limit of {how.limit_s:g} s"
        told.append(f"{limit} ended the search before its {moves:,} moves: another run may give another code")
    told += [
        f"the search of the {name} was stopped early, by --time or Ctrl-C: another run may give another"
        for name, figures in baselines.items()
        if figures["stopped_early"]
    ]
    if problem.response is not None or len(problem.scenarios) > 1 or problem.scenarios[0].edges is not None:
        told.append("the certificate is for a shutter that opens at once and on time, along the motion as it was given")
    return told


def _as_designed(motion: Trajectory, direction: str) -> Trajectory:
    """Return the motion with the direction that the search counted."""
    return (
        motion if direction == "auto" else replace(motion, direction="known" if direction == "forward" else "unknown")
    )
