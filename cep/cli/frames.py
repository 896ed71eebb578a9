"""``cep optimize --frames``: codes of several exposures of one motion, restored together."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cep.cli.console import finish, part, table
from cep.workflows.search_options import Task, ending

if TYPE_CHECKING:
    from rich.console import Console

    from cep.cli.console import Tick
    from cep.optics.code import ShutterCode
    from cep.search.annealing.anneal import Stopped
    from cep.search.annealing.frames import FramesResult
    from cep.search.annealing.joint import JointFigures
    from cep.search.problem import SearchProblem
    from cep.workflows.optimize import Search
    from hw.device import DeviceProfile

__all__ = ["optimize_frames"]


def optimize_frames(
    task: Task,
    how: Search,
    frames: int,
    tick: Tick,
    *,
    profile: DeviceProfile | None,
    output: Path,
    force: bool,
    as_json: bool,
) -> Callable[[], None]:
    """Search and write the codes of several frames, beside the best single code played in every frame.

    Parameters
    ----------
    task : Task
    how : Search
        Half the time at most goes to the single code; both searches make as many moves.
    frames : int
    tick : Tick
    profile : DeviceProfile, optional
        That must be able to play every code.
    output, force, as_json
        As the command's options.

    Returns
    -------
    function that prints what was found

    Raises
    ------
    ValueError
        If an output is in the way or the device cannot play a code.
    """
    from dataclasses import replace
    from functools import partial

    from cep.io.files import StoredCode, write_code
    from cep.io.outputs import claim, new_files
    from cep.search.annealing.joint import joint_figures
    from cep.search.playable import unplayable
    from cep.search.recipe import mean_length_px
    from cep.workflows.optimize import certificate_warnings, ended_early, searched_problem

    files = [output.with_name(f"{output.stem}_{number}{output.suffix}") for number in range(1, frames + 1)]
    claim(files, force=force)
    problem = task.problem
    single, found, stopped = _search(searched_problem(problem), frames, how, tick, length_px=mean_length_px(problem))
    codes = [replace(code, chip_ns=problem.chip_ns) for code in found.codes]
    for code in codes:
        if reason := unplayable(code.bits, profile, code.chip_ns):
            raise ValueError(reason)
    bits = [code.bits for code in codes]
    described = {**task.described, "frames": frames, "bits_of_frames": bits, "steps": found.steps, "stopped": stopped}
    with new_files(files) as made:  # already: Ctrl-C from here on must not lose them
        for number, (file, code) in enumerate(zip(files, codes, strict=True), 1):
            write_code(made[file], StoredCode(code, problem={**described, "frame": number}))
    circle = replace(problem, scenarios=()) if problem.on_circle else None

    def together(choice: list[ShutterCode]) -> dict[str, Any]:
        on_circle = None if circle is None else problem.chips * joint_figures(circle, choice).minimum
        return _figures(joint_figures(problem, choice), on_circle)

    joint, repeated = together(codes), together([single] * frames)
    each = [problem.measure(code) for code in codes]
    with new_files(files) as made:
        for number, (file, code, metrics) in enumerate(zip(files, codes, each, strict=True), 1):
            write_code(made[file], StoredCode(code, metrics.to_dict(), {**described, "frame": number, "joint": joint}))
    result = {
        "files": files,
        "bits": bits,
        "frames": frames,
        "chips": problem.chips,
        "open": [code.open_chips for code in codes],
        "chip_ns": problem.chip_ns,
        **joint,
        "objective": found.objective,
        "each": [metrics.to_dict() for metrics in each],
        "single": {"bits": single.bits, "open": single.open_chips, **repeated},
        "seconds": found.seconds,
        "steps": found.steps,
        "stopped": stopped,
        "interrupted": stopped == "interrupted",
        "seed": how.seed,
        "warnings": [
            *ended_early(how, stopped, how.moves(searched_problem(problem))),
            *certificate_warnings(problem),
        ],
    }

    def show(console: Console) -> None:
        for file, code in zip(files, codes, strict=True):
            console.print(f"{file}: {code.bits}")
        lowest = "min_mtf" if circle is None else "min_chip"
        columns = ("frames", "open", "min MTF" if circle is None else "min |P|, chips", "noise gain, dB")
        rows = [
            (file.stem, code.open_chips, metrics.in_words(lowest), metrics.in_words("noise_gain_db"))
            for file, code, metrics in zip(files, codes, each, strict=True)
        ]
        for name, light, figures in (
            ("together", sum(code.open_chips for code in codes), joint),
            (f"best single code, {frames} times", frames * single.open_chips, repeated),
        ):
            noise = figures["noise_gain_db"]
            rows.append((name, light, figures[lowest], "> 100" if noise is None else noise))
        console.print(table("on this motion (worse direction where unknown)", columns, rows))
        console.print("together: root of the sum of |H|^2, its minimum as sampled")
        console.print(f"{found.seconds:.1f} s, {ending(stopped, found.steps)}")

    return partial(finish, result, as_json=as_json, show=show)


def _search(
    problem: SearchProblem, frames: int, how: Search, tick: Tick, *, length_px: float
) -> tuple[ShutterCode, FramesResult, Stopped]:
    """Search the best single code, then all frames' from it; and what ended them."""
    import numpy as np

    from cep.search.annealing.frames import anneal_frames
    from cep.search.recipe import search_code

    moves, time_s = how.moves(problem), how.limit_s
    alone, together = part(tick, 0.0, 0.5), part(tick, 0.5, 1.0)
    tick(0.0, "a single code")
    single = search_code(
        problem,
        rng=np.random.default_rng(how.seed),
        steps=moves,
        time_s=time_s / 2,
        length_px=length_px,
        progress=lambda fraction, best: alone(fraction, f"a single code, {best.open_chips} open"),
    )
    found = anneal_frames(
        problem,
        frames,
        rng=np.random.default_rng([how.seed, 3]),
        steps=moves,
        # Ctrl-C ends both searches; a time limit only the one
        time_s=1e-9 if single.stopped == "interrupted" else max(time_s / 2, time_s - single.seconds),
        start=[[single.code] * frames],
        progress=lambda fraction, best: together(fraction, f"{'+'.join(str(code.open_chips) for code in best)} open"),
    )
    worst: list[Stopped] = ["interrupted", "time", "steps", "complete"]
    return single.code, found, min(single.stopped, found.stopped, key=worst.index)


def _figures(joint: JointFigures, min_chip: float | None) -> dict[str, float | None]:
    """Joint figures as every command's JSON names a code's; a hopeless noise gain is None."""
    from cep.optics.mtf import HOPELESS_DB

    noise = joint.noise_gain_db if joint.noise_gain_db <= HOPELESS_DB else None
    return {"min_mtf": joint.minimum, "min_chip": min_chip, "noise_gain_db": noise}
