"""``cep pareto``: what minimum, noise and light codes can have together."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cep.cli.code_options import (
    SEARCH,
    ChipTime,
    Direction,
    Duty,
    MaxOpen,
    MaxPulses,
    MinClosed,
    MinOpen,
    MinPeriod,
    OpenChips,
    chips_option,
)  # fmt: skip
from cep.cli.console import finish, progress, table
from cep.cli.options import (
    COMMON,
    CameraFile,
    Force,
    Json,
    Linear,
    Photons,
    ReadNoise,
    Seed,
    TrajectoryFile,
    load_camera,
    load_motion,
    output_option,
)
from cep.workflows.search_options import ending

if TYPE_CHECKING:
    from rich.console import Console

    from cep.search.fronts.front import Front, FrontPoint

__all__ = ["pareto"]


_FIGURES = (".png", ".pdf", ".svg")


def pareto(
    trajectory: TrajectoryFile = None,
    linear: Linear = None,
    chips: Annotated[int, chips_option(least=2)] = 52,
    open_chips: OpenChips = None,
    duty: Duty = None,
    chip_ns: ChipTime = 1_000_000,
    direction: Direction = "auto",
    min_open: MinOpen = 1,
    max_open: MaxOpen = None,
    min_closed: MinClosed = 1,
    min_period: MinPeriod = 1,
    max_pulses: MaxPulses = None,
    camera: CameraFile = None,
    photons: Photons = None,
    read_noise: ReadNoise = None,
    time_s: Annotated[
        float | None,
        typer.Option(
            "--time",
            metavar="S",
            rich_help_panel=SEARCH,
            help="Search for so many seconds, 60 when --steps is omitted too: the front depends on the machine.",
        ),
    ] = None,
    steps: Annotated[
        int | None,
        typer.Option(
            "--steps",
            metavar="N",
            min=0,
            rich_help_panel=SEARCH,
            help="Make so many moves, however long it takes: the same seed and moves give the same front. With --time "
            "whichever ends first.",
        ),
    ] = None,
    output: Annotated[Path, output_option("File to write.")] = Path("front.json"),
    plot: Annotated[
        Path | None,
        typer.Option(
            "--plot",
            metavar="FILE",
            rich_help_panel=COMMON,
            help="Figure to write: .png, .pdf or .svg; named as the output, .png, when omitted.",
        ),
    ] = None,
    force: Force = False,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Search the codes that no other beats in minimum, noise and light together; Ctrl-C keeps what is found so far.

    A code is beaten when another is at least as good in all three and better in one: its smallest |H|, larger is
    better; its noise gain, 10 log10 mean 1/|H|^2, smaller is better; its open chips, more is better. Codes with a zero
    are left out. Both figures are light-true: a darker code pays for its lost light.

    Without a motion the front is for straight motion at any speed: the minimum is that of |P| over the whole unit
    circle, in chips, and the noise that of P alone, without the blur within a chip. Along a straight motion the
    minimum is over the band's continuum, and both include that blur. Along a curved path nearly every code has true
    zeros at single frequencies: the front is then over noise and light alone, noise and minimum are those over the
    samples, and the minimum, which proves nothing, is shown for comparison.

    Example: cep pareto --chips 52 --open 22:40 --time 60 -o front.json --plot front.png
    """
    with progress("searching") as tick:
        import math
        from dataclasses import asdict

        import numpy as np

        from cep.codes.published import for_chips
        from cep.io.files import FRONT_SCHEMA, json_text
        from cep.io.outputs import claim, new_files, write_text
        from cep.plots.canvas import save
        from cep.plots.pareto import pareto_figure
        from cep.search.fronts.front import knees
        from cep.search.fronts.pareto import front_points, pareto_front
        from cep.search.limits import RunLimits
        from cep.search.problem import SearchProblem
        from cep.workflows.optimize import STANDARD_TIME_S
        from cep.workflows.search_options import DIRECTIONS, open_limits

        if direction not in DIRECTIONS:
            raise ValueError(f"--direction: must be one of {', '.join(DIRECTIONS)}, got {direction!r}")
        picture = plot or output.with_suffix(".png")
        if picture.suffix.lower() not in _FIGURES:
            raise ValueError(f"--plot: must end in {', '.join(_FIGURES[:-1])} or {_FIGURES[-1]}, got {picture}")
        if picture == output:
            raise ValueError(f"--plot: must be another file than the output, got {picture}")
        problem = SearchProblem(
            chips=chips,
            scenarios=_scenarios(trajectory, linear, chips),
            open_range=open_limits(chips, open_chips, duty),
            direction=direction,  # type: ignore[arg-type]
            runs=RunLimits(
                min_open=min_open,
                min_closed=min_closed,
                max_pulses=max_pulses,
                max_open=max_open,
                min_period=min_period,
            ),
            camera=load_camera(camera, photons=photons, read_noise=read_noise),
        )
        limit_s = time_s if time_s is not None else STANDARD_TIME_S if steps is None else math.inf
        claim([output, picture], force=force, inputs=[] if trajectory is None else [trajectory])
        front = pareto_front(problem, rng=np.random.default_rng(seed), steps=steps, time_s=limit_s, progress=tick)
        if not front.points:
            raise ValueError("--open: every code found of so many open chips has a zero, allow others or search longer")
        entries = for_chips(chips)
        published = dict(zip((e.name for e in entries), front_points(problem, (e.code for e in entries)), strict=True))
    document = {
        "schema": FRONT_SCHEMA,
        "unit": front.unit,
        "chip_ns": chip_ns,
        "points": [_figures(point) for point in front.points],
        "knees": {name: _figures(point) for name, point in knees(front).items()},
        "curves": {count: [_figures(point) for point in curve] for count, curve in front.curves.items() if curve},
        "published": {name: _figures(point) for name, point in published.items()},
        "problem": {
            "trajectory": trajectory,
            "linear_px": linear,
            "chips": chips,
            "open_range": problem.open_limits,
            "direction": direction,
            **{name: value for name, value in asdict(problem.runs).items() if name != "fixed"},  # it has no such option
            "camera": problem.camera.to_dict(),
            "steps": front.steps,
            "stopped": front.stopped,
            "seed": seed,
        },
    }
    with new_files([output, picture]) as made:
        write_text(made[output], json_text(document))
        save(pareto_figure(front, published), made[picture])
    warnings = []
    if front.stopped == "interrupted":
        warnings.append("the search was stopped early, this is the front so far")
    elif front.stopped == "time" and steps is not None:
        warnings.append(f"--time ended the search before its {steps:,} moves: another run may give another front")
    if front.sampled:
        warnings.append("along a curved path minima over samples prove nothing: the front is over noise and light")
    result = {
        "file": output,
        "plot": picture,
        **{name: document[name] for name in ("unit", "points", "knees", "published")},
        "seconds": front.seconds,
        "steps": front.steps,
        "stopped": front.stopped,
        "interrupted": front.stopped == "interrupted",
        "seed": seed,
        "warnings": warnings,
    }
    finish(result, as_json=as_json, show=lambda console: _show(console, front, published, output, picture))


def _show(console: Console, front: Front, published: dict[str, FrontPoint], output: Path, picture: Path) -> None:
    from cep.optics.mtf import HOPELESS_DB
    from cep.search.fronts.front import knees

    ended = f"{front.seconds:.1f} s, {ending(front.stopped, front.steps)}"
    console.print(f"{output}, {picture}: {len(front.points)} codes that none found beats; {ended}")
    least = {"chips": "min |P|, chips", "light-true": "min MTF"}.get(front.unit, "min MTF, sampled")
    named = knees(front)
    rows = [
        (
            name,
            point.open_chips,
            point.minimum,
            point.noise_db if point.noise_db <= HOPELESS_DB else f"> {HOPELESS_DB:.0f}",
            point.mse_db,
        )
        for name, point in (*named.items(), *((f"published: {name}", point) for name, point in published.items()))
    ]
    columns = ("code", "open", least, "noise gain, dB", "MSE, dB")
    console.print(table(f"{front.problem.chips} chips", columns, rows))
    for name, point in named.items():
        console.print(f"{name}: {point.code.bits}")


def _figures(point: FrontPoint) -> dict[str, Any]:
    """Return a point as JSON has it; the noise of a code with a zero is null."""
    import math

    from cep.optics.mtf import HOPELESS_DB

    code = point.code
    noise_db = point.noise_db if point.noise_db <= HOPELESS_DB else math.inf
    return {
        "bits": code.bits,
        "open": point.open_chips,
        "duty": code.duty,
        "minimum": point.minimum,
        "noise_gain_db": noise_db,
        "dnf_db": noise_db + 20 * math.log10(code.duty),
        "mse_db": point.mse_db,
    }


def _scenarios(trajectory: Path | None, linear: float | None, chips: int) -> tuple[Any, ...]:
    from cep.optics.path_limits import check_frame, check_resolved
    from cep.search.problem import Scenario

    if trajectory is None and linear is None:
        return ()
    motion = load_motion(trajectory, linear).trajectory
    check_frame(motion)
    check_resolved(motion, chips)
    return (Scenario(motion),)
