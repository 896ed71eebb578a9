"""``cep advise``: whether to code an exposure at all."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cep.cli.code_options import Device, Direction, Exposure, exposure_seconds
from cep.cli.console import finish, part, progress, table
from cep.cli.options import (
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

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rich.console import Console

    from cep.workflows.advise import Advice, Choice

__all__ = ["advise"]

_KINDS: tuple[Choice, ...] = ("open", "snapshot", "strobe", "code")


def advise(
    trajectory: TrajectoryFile = None,
    linear: Linear = None,
    chips: Annotated[
        int | None,
        typer.Option("--chips", "-n", metavar="N", min=2, help="Number of chips; as many as pay when omitted."),
    ] = None,
    exposure: Exposure = None,
    code: Annotated[
        list[str] | None,
        typer.Option(
            "--code", metavar="CODE", help="A code to judge as well: bits, code.json or a name; may be repeated."
        ),
    ] = None,
    direction: Direction = "auto",
    device: Device = None,
    path_error: Annotated[
        float | None,
        typer.Option(
            "--path-error",
            metavar="PX",
            min=0,
            help="Error of the trajectory, px rms; as its file states it when omitted, else none.",
        ),
    ] = None,
    camera: CameraFile = None,
    photons: Photons = None,
    read_noise: ReadNoise = None,
    output: Annotated[Path, output_option("Figure to write: .png, .pdf or .svg.")] = Path("advice.png"),
    force: Force = False,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Say whether to leave the shutter open, expose for a shorter time, pulse it evenly or code it.

    Each way may be open for any part of the exposure that the shutter's limits allow, and the scene is as bright for
    all. What counts is the expected error of the restored photo, with the camera's photon and read noise. A code is
    searched at each light level.

    Fields of --json that need a word:

    - choice: open, snapshot (one shorter exposure), strobe (even pulses) or code, at the camera's light.
    - gains_db: of the best of each kind over the open shutter; of code: even pulses included.
    - equal_light_gains_db: the same where a brighter lamp makes up for the closed time.
    - crossover: ranges of light, photo-electrons at full scale, in which a code gains 0.1 dB or more; null at an end
      that lies beyond the levels tried.
    - outside_limits: a better way that the shutter's limits rule out, or null.

    Example: cep advise --linear 40 --exposure 1/30 --photons 3000 --read-noise 10

    Example: cep advise --trajectory motion/trajectory.json --device sony-pregius --exposure 0.004
    """
    with progress("comparing") as tick:
        from cep.codes.sources import load_code
        from cep.io.outputs import claim
        from cep.plots import check_figure_name, save
        from cep.plots.advice import advice_figure
        from cep.search.problem import SearchProblem
        from cep.workflows.advise import advise as compare_ways
        from cep.workflows.advise import suited_chips
        from hw.device import load_profile
        from motdiff.io.trajectories import stated_uncertainty_px

        check_figure_name(output)
        own = [load_code(source) for source in code or ()]
        if len({one.chips for one in own} | ({chips} if chips else set())) > 1:
            raise ValueError("--code: every code must have as many chips, those of --chips")
        motion = load_motion(trajectory, linear)
        if path_error is None and trajectory is not None:
            path_error = stated_uncertainty_px(motion, trajectory)
        count = own[0].chips if own else chips
        profile = None if device is None else load_profile(device)
        seen_by, exposure_s = load_camera(camera, photons=photons, read_noise=read_noise), exposure_seconds(exposure)

        def problem_of(count: int) -> SearchProblem:
            return SearchProblem.along(
                motion.trajectory, chips=count, exposure_s=exposure_s, device=profile, direction=direction,
                camera=seen_by,
            )  # fmt: skip

        error_px = path_error or 0.0
        gains: dict[int, float] = {}
        problem = None if count is None else problem_of(count)
        claim([output], force=force, inputs=[] if trajectory is None else [trajectory])
        if problem is None:
            count, gains = suited_chips(problem_of, path_error_px=error_px, seed=seed, progress=part(tick, 0.0, 0.4))
            problem = problem_of(count)
        advice = compare_ways(problem, *own, path_error_px=error_px, seed=seed, progress=part(tick, 0.4, 1.0))
        save(advice_figure(advice), output)
    result = {**advice.to_dict(), "other_chips_db": gains, "plot": output, "seed": seed}
    finish(result, as_json=as_json, show=lambda console: _show(console, advice, gains, output))


def _show(console: Console, advice: Advice, other_chips_db: Mapping[int, float], plot: Path) -> None:
    from cep.io.formatting import duration
    from cep.workflows.advise import in_words_of_chips

    here, problem = advice.here, advice.problem
    console.print(here.sentence)
    console.print(advice.where)
    gains, at_equal_light = here.gains_db, here.equal_light_gains_db
    rows = []
    for kind in (kind for kind in _KINDS if kind in gains):
        way = here.best(kind)
        assert way is not None  # each gain is of one
        if way.kind == kind:  # the best code may be the even pulses above
            rows.append((way.label, way.code.open_chips, f"{gains[kind]:+.2f}", f"{at_equal_light[kind]:+.2f}"))
    columns = ("", f"open, of {problem.chips}", "gain, dB", "at equal light, dB")
    console.print(table("over the open shutter, worse direction where unknown", columns, rows))
    levels = [
        (
            f"{one.camera.photons_full_scale:,.0f}",
            *(one.gains_db.get(kind) for kind in ("snapshot", "code")),
            one.choice,
        )
        for one in advice.levels
    ]
    console.print(table("over the light", ("photo-electrons", "single exposure, dB", "code, dB", "advised"), levels))
    others = in_words_of_chips(other_chips_db)
    console.print(f"{problem.chips} chips of {duration(problem.chip_ns * 1e-9)}{f'; {others}' if others else ''}")
    console.print(f"{plot}: gains over the light")
