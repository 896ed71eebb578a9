"""``cep advise``: whether to code an exposure at all."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cep.commands.code_options import Device, Direction, Exposure, chips_option, exposure_seconds
from cep.commands.console import finish, part, progress, table
from cep.commands.options import (
    CameraFile,
    Force,
    Json,
    Linear,
    Photons,
    ReadNoise,
    Seed,
    TableFile,
    TrajectoryFile,
    load_camera,
    load_motion,
    output_option,
    table_files,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rich.console import Console

    from cep.search.advise import Advice
    from cep.search.ways import Way

_SAME_TIME = 0.01  # relative: a device's ticks round the chip times


def advise(
    trajectory: TrajectoryFile = None,
    linear: Linear = None,
    chips: Annotated[
        int | None, chips_option(least=2, help="Number of chips; as many as pay when omitted.")
    ] = None,
    exposure: Exposure = None,
    code: Annotated[
        list[str] | None,
        typer.Option(
            "--code",
            metavar="CODE",
            help=(
                "A code to judge as well: bits, code.json or a name; may be repeated. A file's"
                " chip time sets the "
                "exposure."
            ),
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
    output: Annotated[
        Path | None, output_option("Also draw the gains over the light: .png, .pdf or .svg.")
    ] = None,
    tables: TableFile = None,
    force: Force = False,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Say whether to leave the shutter open, expose for a shorter time, pulse it evenly or code
    it.

    Each way may be open for any part of the exposure that the shutter's limits allow, and the
    scene is as bright for all. What counts is the expected error of the restored photo, with the
    camera's photon and read noise. A code is searched at each light level.

    Fields of --json that need a word:

    - choice: open, snapshot (one shorter exposure), strobe (even pulses) or code, at the camera's
      light.
    - gains_db: of the best of each kind over the open shutter; of code: even pulses included.
    - open_saturates: whether the open shutter collects more than the camera can record. Its
      figures, which gains_db compares with, are then as if it could; ways that saturate are never
      advised.
    - equal_light_gains_db: the same where a brighter lamp makes up for the closed time, of the
      best of each kind there.
    - codes: those of --code.
    - crossover: ranges of light, photo-electrons at full scale, in which a code gains 0.1 dB or
      more; null at an end that lies beyond the levels tried.
    - outside_limits: a better way that the shutter's limits rule out, or null.

    Example: cep advise --linear 40 --exposure 1/30 --photons 3000 --read-noise 10

    Example: cep advise --trajectory motion/trajectory.json --device sony-pregius --exposure 0.004
    """
    with progress("comparing") as tick:
        from cep.codes.sources import load_code, stated_chip_ns
        from cep.plots import check_figure_name, save
        from cep.plots.advice import advice_figure
        from cep.search.advise import advise as compare_ways
        from cep.search.chip_count import ASSUMED_EXPOSURE_S, suited_chips
        from cep.search.problem import SearchProblem
        from hw.device import load_profile
        from motdiff.files.outputs import claim
        from motdiff.files.trajectories import stated_uncertainty_px

        if output is not None:
            check_figure_name(output)
        own = [load_code(source) for source in code or ()]
        if len({one.chips for one in own} | ({chips} if chips else set())) > 1:
            raise ValueError("--code: every code must have as many chips, those of --chips")
        motion = load_motion(trajectory, linear)
        if path_error is None and trajectory is not None:
            path_error = stated_uncertainty_px(motion, trajectory)
        count = own[0].chips if own else chips
        profile = None if device is None else load_profile(device)
        seen_by = load_camera(camera, photons=photons, read_noise=read_noise)
        exposure_s = exposure_seconds(exposure)
        stated = {
            stated_chip_ns(source, one) for source, one in zip(code or (), own, strict=True)
        } - {None}
        chip_ns = _chip_time_ns(stated, count, exposure_s)

        def problem_of(count: int) -> SearchProblem:
            whole_s = ASSUMED_EXPOSURE_S if exposure_s is None else exposure_s
            time = {"exposure_s": whole_s} if chip_ns is None else {"chip_ns": chip_ns}
            return SearchProblem.along(
                motion.trajectory,
                chips=count,
                device=profile,
                direction=direction,
                camera=seen_by,
                **time,
            )

        error_px = path_error or 0.0
        gains: Mapping[int, float] = {}
        problem = None if count is None else problem_of(count)
        figures = [] if output is None else [output]
        read = [] if trajectory is None else [trajectory]
        outputs = claim([*figures, *table_files(tables)], force=force, inputs=read)
        if problem is None:
            count, gains = suited_chips(
                problem_of, path_error_px=error_px, seed=seed, progress=part(tick, 0.0, 0.4)
            )
            problem = problem_of(count)
        advice = compare_ways(
            problem, *own, path_error_px=error_px, seed=seed, progress=part(tick, 0.4, 1.0)
        )
    judged = [way for one in own for way in advice.here.ways if way.code.bits == one.bits]
    known = exposure is not None or chip_ns is not None
    warnings = [] if known else ["the exposure is taken as 50 ms; --exposure says how long it is"]
    result = {
        **advice.to_dict(),
        "codes": [way.to_dict() for way in judged],
        "other_chips_db": gains,
        "plot": output,
        "seed": seed,
        "warnings": warnings,
    }

    def draw(made: Mapping[Path, Path]) -> None:
        if output is not None:
            save(advice_figure(advice), made[output])

    finish(
        result,
        as_json=as_json,
        show=lambda console: _show(console, advice, judged, gains, output),
        outputs=outputs,
        save=draw,
        tables=tables,
        summary=advice.here.sentence,
    )


def _chip_time_ns(
    stated: set[int | None], chips: int | None, exposure_s: float | None
) -> int | None:
    """Chip time that the files of --code state, ns; None where none does."""
    from cep.files.formatting import duration

    times_ns = sorted(time_ns for time_ns in stated if time_ns is not None)
    if len(times_ns) > 1:
        raise ValueError(
            "--code: the files state chips of"
            f" {' and '.join(duration(t * 1e-9) for t in times_ns)}"
        )
    if not times_ns or chips is None:
        return None
    whole_s = chips * times_ns[0] * 1e-9
    if exposure_s is not None and abs(whole_s - exposure_s) > _SAME_TIME * exposure_s:
        raise ValueError(
            f"--exposure: {duration(exposure_s)} contradicts the file of --code, whose {chips}"
            f" chips of {duration(times_ns[0] * 1e-9)} take {duration(whole_s)}; leave"
            " --exposure out"
        )
    return times_ns[0]


def _show(
    console: Console,
    advice: Advice,
    own: Sequence[Way],
    other_chips_db: Mapping[int, float],
    plot: Path | None,
) -> None:
    from cep.files.formatting import duration
    from cep.search.chip_count import in_words_of_chips

    here = advice.here
    problem = advice.problem
    console.print(here.sentence)
    console.print(advice.where)
    best = {way.label: way for kind in here.gains_db if (way := here.best(kind)) is not None}
    shown = {**best, **{f"your {way.label}, {way.code.bits}": way for way in own}}
    opened = here.ways[0]
    rows = [
        (
            name,
            way.code.open_chips,
            f"{way.psnr_db - opened.psnr_db:+.2f}",
            None if here.open_saturates else f"{way.equal_light_db - opened.equal_light_db:+.2f}",
        )
        for name, way in {opened.label: opened, **shown}.items()
    ]
    columns = ("", f"open, of {problem.chips}", "gain, dB", "at equal light, dB")
    console.print(table("over the open shutter, worse direction where unknown", columns, rows))
    levels = [
        (
            f"{one.camera.photons_full_scale:,.0f}",
            *(
                f"{gain:+.2f}" if (gain := one.gains_db.get(kind)) is not None else None
                for kind in ("snapshot", "code")
            ),
            one.choice,
        )
        for one in advice.levels
    ]
    console.print(
        table(
            "over the light",
            ("photo-electrons", "single exposure, dB", "code, dB", "advised"),
            levels,
        )
    )
    others = in_words_of_chips(other_chips_db)
    chip, whole = (
        duration(time_ns * 1e-9) for time_ns in (problem.chip_ns, problem.chips * problem.chip_ns)
    )
    console.print(
        f"{problem.chips} chips of {chip}, {whole} in all{f'; {others}' if others else ''}"
    )
    if plot is not None:
        console.print(f"{plot}: gains over the light")
