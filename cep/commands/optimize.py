"""``cep optimize``: the shutter code for a motion."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cep.commands.code_options import (
    SEARCH,
    Alternatives,
    ChipTimeInstead,
    Device,
    Direction,
    Drift,
    Duty,
    Each,
    Effort,
    Exposure,
    FirstOpen,
    Fixed,
    Frames,
    Jitter,
    LastOpen,
    MaxOpen,
    MaxPulses,
    Method,
    MinClosed,
    MinOpen,
    MinPeriod,
    Objective,
    OpenChips,
    Rule,
    Speed,
    chips_option,
    exposure_seconds,
)
from cep.commands.commands import in_options
from cep.commands.console import part, progress, table
from cep.commands.frames import optimize_frames
from cep.commands.jobs import Cache, Dask, Workers, finish_folder, only_of_folders
from cep.commands.optimize_class import (
    All,
    ClassName,
    ClassSize,
    PathLength,
    optimize_class,
    refuse_with_class,
)
from cep.commands.options import (
    CameraFile,
    Figures,
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
from cep.commands.search_run import SearchRun
from cep.search.search_options import SearchOptions, Task, ending, openings, task_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rich.console import Console

    from cep.optics.code import ShutterCode
    from cep.search.chip_count import ChipCount
    from cep.search.optimize import Optimum
    from cep.search.recipe import Found
    from motdiff.files.trajectories import StoredMotion


_STANDARD_CHIPS = 52
_CHIP_NS = 1_000_000
_CHOOSING = 0.3  # of the time: the number of chips, where it is not given
_LEAST_LEFT = 0.1  # of the time, for the search
_FEWER = {
    "time": "the time ended the choice of the number of chips: fewer numbers were tried",
    "interrupted": "Ctrl-C ended the choice of the number of chips: fewer numbers were tried",
}
_COLUMNS = {
    "motion": "motion",
    "open": "open",
    "min_mtf": "min MTF",
    "min_chip": "min |P|",
    "noise_gain_db": "noise, dB",
    "mse_db": "MSE, dB",
    "seconds": "s",
    "choice": "advised",
}
"""Heads of the table of a folder."""


def optimize(
    context: typer.Context,
    trajectory: TrajectoryFile = None,
    linear: Linear = None,
    each: Each = None,
    all_motions: All = None,
    motion_class: ClassName = None,
    length: PathLength = None,
    motions: ClassSize = None,
    chips: Annotated[
        int | None,
        chips_option(
            least=1,
            help=(
                "Number of chips; when omitted as many as pay for one code searched by mse, 52"
                " otherwise."
            ),
        ),
    ] = None,
    open_chips: OpenChips = None,
    duty: Duty = None,
    exposure: Exposure = None,
    chip_ns: ChipTimeInstead = None,
    frames: Frames = 1,
    objective: Objective = None,
    direction: Direction = "auto",
    device: Device = None,
    min_open: MinOpen = 1,
    max_open: MaxOpen = None,
    min_closed: MinClosed = 1,
    min_period: MinPeriod = 1,
    max_pulses: MaxPulses = None,
    first_open: FirstOpen = False,
    last_open: LastOpen = False,
    fixed: Fixed = None,
    alternatives: Alternatives = False,
    speed: Speed = None,
    drift: Drift = None,
    jitter: Jitter = None,
    rule: Rule = "worst",
    camera: CameraFile = None,
    photons: Photons = None,
    read_noise: ReadNoise = None,
    method: Method = "anneal",
    time_s: Annotated[
        float | None,
        typer.Option(
            "--time",
            metavar="S",
            rich_help_panel=SEARCH,
            help=(
                "Search each code for so many seconds, however many moves that is: the code"
                " depends on the machine. "
                "The choice of the number of chips is within it."
            ),
        ),
    ] = None,
    steps: Annotated[
        int | None,
        typer.Option(
            "--steps",
            metavar="N",
            min=1,
            rich_help_panel=SEARCH,
            help=(
                "Make so many moves, however long it takes: the same seed and moves give the same"
                " code. With --time "
                "whichever ends first; without either as many as suit the motion, for 60 s at"
                " most."
            ),
        ),
    ] = None,
    effort: Effort = "quick",
    figure: Figures = None,
    workers: Workers = None,
    dask: Dask = None,
    cache: Cache = None,
    output: Annotated[
        Path | None,
        output_option(
            "File to write, code.json when omitted; with --each a folder, the motions' own when"
            " omitted.",
            metavar="PATH",
        ),
    ] = None,
    tables: TableFile = None,
    force: Force = False,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Search the shutter code whose coded photo restores best along a motion; Ctrl-C keeps the
    best so far.

    The code is compared with what would be used instead, and never loses to what of it keeps the
    limits, by the objective. Its minimum is certified, and a bound says how far from the best it
    can be at most. cep audit code.json checks the certificate again.

    Fields of --json that need a word:

    - bound: what no code of so much light can exceed: min_chip for a uniform straight motion, else
      min_mtf. With --objective noise: the noise gain that none can fall below. null for other
      objectives.
    - gap: how far this code is from the bound, 0..1; in dB for the noise.
    - figures, here and of each of baselines: those of --figure, a number, or [forward, backward]
      where the direction is unknown.
    - noise_gain_db: null above 100 dB, as of codes with a zero.
    - stopped: steps (all moves made), time, proven, complete (no other code keeps the limits), or
      interrupted (Ctrl-C).
    - within_limits, of each of baselines: whether it keeps the limits; the search could not return
      the others.
    - verdict: what to do and what it gains, in one or two sentences. choice: open, snapshot (one
      shorter exposure), strobe (even pulses) or code. gains_db: expected gain of the best of each
      over the open shutter; of code this one.
    - other_chips_db, where --chips is omitted: what other numbers of chips would gain over the one
      chosen.
    - motions, mean_db, other_motions, others_db, with --all and --class: the mean of the
      objective's decibels over the motions of the search, and over motions drawn anew, null for a
      folder; behind_db and behind_error_db, of each of baselines: how much worse it is there, and
      the standard error.
    - proven: no code is better, over the whole unit circle; or, unless one straight motion is all
      there is, at the band's samples.

    Example: cep optimize --trajectory motion/trajectory.json --chips 40 --duty 0.4:0.6 -o
    code.json

    Example: cep optimize --linear 36 --chips 36 --method exact

    Example: cep optimize --linear 52 --open 26 --objective min-mtf:0.15,noise:1

    Example: cep optimize --each shots_motion --chips 40 --duty 0.4:0.6 --steps 4000000

    Example: cep optimize --class walks --length 60 --chips 32 --open 16

    Example: cep optimize --all shots_motion --chips 40 --duty 0.4:0.6
    """
    with progress("counting codes" if method == "exact" else "searching") as tick:
        import time
        from dataclasses import asdict, replace
        from functools import partial
        from math import inf

        from cep.files.files import StoredCode, write_code
        from cep.proofs.measure import find_figures
        from cep.search.chip_count import ASSUMED_EXPOSURE_S, choose_chips
        from cep.search.exhaustive.exact import codes_to_count
        from cep.search.limits import RunLimits
        from cep.search.optimize import Search, searched_problem, stored_search
        from cep.search.optimize import optimize as find
        from cep.search.playable import chip_time_ns
        from hw.device import load_profile
        from motdiff.files.outputs import claim
        from motdiff.files.trajectories import stated_uncertainty_px

        how = Search(method=method, effort=effort, steps=steps, time_s=time_s, seed=seed)  # type: ignore[arg-type]
        exposure_s = exposure_seconds(exposure)
        if exposure_s is not None and chip_ns is not None:
            raise ValueError("--exposure and --chip-ns: give one of them")
        profile = None if device is None else load_profile(device)

        def wish_of(count: int, time_s: float | None = exposure_s) -> SearchOptions:
            """Return the options for so many chips in a time."""
            return SearchOptions(
                chips=count,
                chip_ns=chip_ns
                or (_CHIP_NS if time_s is None else chip_time_ns(time_s, count, profile)),
                open_chips=open_chips,
                duty=duty,
                objective=objective,
                direction=direction,
                runs=RunLimits(
                    min_open=min_open,
                    max_open=max_open,
                    min_closed=min_closed,
                    min_period=min_period,
                    max_pulses=max_pulses,
                    fixed=fixed,
                ),
                first_open=first_open,
                last_open=last_open,
                alternatives=alternatives,
                speed=speed,
                drift=drift,
                jitter=jitter,
                rule=rule,
            )

        wish = wish_of(chips or len(fixed or "") or _STANDARD_CHIPS)
        light = load_camera(camera, photons=photons, read_noise=read_noise)
        run = SearchRun(
            how=how,
            profile=profile,
            output=output or Path("code.json"),
            force=force,
            as_json=as_json,
            tables=tables,
            tick=tick,
        )
        own = find_figures(figure or ())
        if own and frames > 1:
            raise ValueError(
                "--figure: not valid with --frames, whose exposures are judged together"
            )

        def task(stored: StoredMotion, path: Path | None, wish: SearchOptions = wish) -> Task:
            source = {"trajectory": None if path is None else str(path), "linear_px": linear}
            try:
                return task_of(wish, stored, how, camera=light, profile=profile, source=source)
            except (
                ValueError
            ) as error:  # of a folder it stands in the table, and never reaches the command's end
                raise ValueError(in_options(str(error), context)) from None

        if (
            all_motions is None
            and motion_class is None
            and (length is not None or motions is not None)
        ):
            raise ValueError(f"{'--motions' if length is None else '--length'}: needs --class")
        if all_motions is not None or motion_class is not None:
            one_for_all = "--class" if all_motions is None else "--all"
            both = all_motions is not None and motion_class is not None
            refuse_with_class(
                one_for_all,
                {
                    "--class": both,
                    "--trajectory": trajectory is not None,
                    "--linear": linear is not None,
                    "--each": each is not None,
                    "--frames": frames > 1,
                    "--alternatives": alternatives,
                    "--speed": speed is not None,
                    "--drift": drift is not None,
                    "--jitter": jitter is not None,
                    "--figure": bool(own),
                    "--bound": effort != "quick",
                    "--rule": rule not in ("worst", "mean"),
                    "--direction": all_motions is None and direction != "auto",
                },
            )
            only_of_folders("--each", workers, dask, cache)
            from cep.search.optimize_class import class_task

            many = class_task(
                wish,
                how,
                camera=light,
                profile=profile,
                folder=all_motions,
                kind=motion_class,
                length_px=length,
                count=motions,
            )
            show: Callable[[], None] = optimize_class(many, run)
        elif each is not None:
            if trajectory is not None or linear is not None or frames > 1:
                raise ValueError(
                    "--each: takes the place of --trajectory and --linear, and searches one frame"
                    " for each"
                )
            from cep.search.optimize_folder import optimize_folder

            outputs = claim(table_files(tables), force=force)
            found = optimize_folder(
                each,
                task,
                how,
                output,
                figures=list(own),
                profile=profile,
                cache=cache,
                workers=workers,
                dask=dask,
                force=force,
                progress=tick,
            )
            show = partial(
                finish_folder,
                {
                    "folder": found.folder,
                    "summary": found.summary,
                    "codes": found.found,
                    "seed": seed,
                },
                {**_COLUMNS, **{name: name for name in own}},
                found,
                title="a code for each motion (worse direction where unknown)",
                noun="motions",
                as_json=as_json,
                outputs=outputs,
                tables=tables,
            )
        else:
            if method == "exact" and cache is not None:
                raise ValueError(
                    "--cache: proofs in blocks moved to the laboratory, in the repository:"
                    f" python -m lab prove --chips {chips or _STANDARD_CHIPS} -o {cache}"
                )
            only_of_folders("--each", workers, dask, cache)
            if trajectory is not None and trajectory.is_dir():
                raise ValueError(
                    f"{trajectory}: is a folder; --each FOLDER searches a code for each motion"
                    " in it"
                )
            stored = load_motion(trajectory, linear)
            if frames > 1:
                show = optimize_frames(task(stored, trajectory), frames, run)
            else:
                outputs = run.outputs(inputs=[] if trajectory is None else [trajectory])
                chosen: ChipCount | None = None
                began = time.monotonic()
                error_px = (
                    0.0 if trajectory is None else stated_uncertainty_px(stored, trajectory) or 0.0
                )
                if (
                    chips is None
                    and fixed is None
                    and method == "anneal"
                    and objective in (None, "mse")
                ):
                    outputs.check()
                    time_of_all_s = ASSUMED_EXPOSURE_S if exposure_s is None else exposure_s
                    chosen = choose_chips(
                        lambda count: (
                            task(stored, trajectory, wish_of(count, time_of_all_s)).problem
                        ),
                        path_error_px=error_px,
                        seed=seed,
                        time_s=inf if time_s is None else _CHOOSING * time_s,
                        progress=part(tick, 0.0, _CHOOSING),
                    )
                    wish = wish_of(chosen.chips, time_of_all_s)
                wanted = task(stored, trajectory, wish)
                outputs.check()

                def alone(code: ShutterCode, found: Found, made: Mapping[Path, Path]) -> None:
                    """Write the code without what it is worth."""
                    write_code(
                        made[run.output],
                        StoredCode(code, problem=stored_search(wanted.described, found)),
                    )

                if method == "exact":
                    count = codes_to_count(searched_problem(wanted.problem))
                    tick(0.0, f"{count:.2g} codes")
                else:
                    tick(0.0, "")
                left_s = time_s
                if chosen is not None and time_s is not None:
                    left_s = max(time_s - (time.monotonic() - began), _LEAST_LEFT * time_s)
                with run.keeping() as keep:
                    best = find(
                        wanted.problem,
                        **(asdict(how) | {"time_s": left_s}),
                        along=wanted.along,
                        path_error_px=error_px,
                        start=[] if chosen is None or chosen.code is None else [chosen.code],
                        interrupted=chosen is not None and chosen.early == "interrupted",
                        figures=own,
                        progress=part(tick, 0.0 if chosen is None else _CHOOSING, 1.0),
                        on_found=lambda code, found: keep([code], partial(alone, code, found)),
                    )
                best = replace(
                    best, how=how
                )  # the limit that a warning names is the one that was given
                others = {} if chosen is None else chosen.gains_db
                fewer = [] if chosen is None or not chosen.early else [_FEWER[chosen.early]]
                result = {
                    "file": run.output,
                    **best.to_dict(),
                    **({} if chosen is None else {"other_chips_db": others}),
                    "warnings": [*best.warnings, *fewer],
                }
                show = run.shown(
                    result,
                    partial(_show, best=best, others=others, file=run.output),
                    outputs=outputs,
                    save=lambda made: best.save(made[run.output], described=wanted.described),
                    codes=[best.code],
                )
    show()


def _show(console: Console, *, best: Optimum, others: Mapping[int, float], file: Path) -> None:
    """Print a search and its comparison for people."""
    from cep.files.formatting import duration, number
    from cep.proofs.measure import figure_head, figure_in_words
    from cep.search.chip_count import in_words_of_chips

    code = best.code
    found = best.found
    straight = best.along is None
    console.print(best.verdict.sentence)
    console.print(f"{file}: {code.bits}")
    chip, whole = (duration(time_ns * 1e-9) for time_ns in (code.chip_ns, code.duration_ns))
    light = (
        f"{code.open_chips} of {code.chips} chips open, {openings(code)}; {chip} a chip, {whole}"
        " in all"
    )
    console.print(f"{light}; {found.seconds:.1f} s, {ending(found.stopped, found.steps)}")
    if others:
        console.print(in_words_of_chips(others))
    heads = (figure_head(*item) for item in best.comparison[0].figures.items())
    columns = (
        "code",
        "open",
        "min |P|, chips" if straight else "min MTF",
        "noise gain, dB",
        "MSE, dB",
        *heads,
    )
    lowest = "min_chip" if straight else "min_mtf"
    rows = [
        (
            row.label,
            row.code.open_chips,
            *(row.metrics.in_words(name) for name in (lowest, "noise_gain_db", "mse_db")),
            *map(figure_in_words, row.figures.values()),
        )
        for row in best.comparison
    ]
    console.print(table("compared on this motion (worse direction where unknown)", columns, rows))
    console.print(
        f"certified: min {'|P|' if straight else '|H|'} lies within "
        f"{best.certificate.lower:.6g}..{best.certificate.upper:.6g} ({best.certificate.method})"
    )
    if found.stopped == "proven" and found.proof is not None:
        proof = f" ({found.proof['file']})" if "file" in found.proof else ""
        console.print(
            f"proven{proof}: no code within the limits is better on {found.proof['domain']}"
        )
    elif best.bound is not None:
        console.print(
            f"{best.figure}: no code with so many open chips can do better than"
            f" {number(best.bound)}"
        )
