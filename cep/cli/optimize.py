"""``cep optimize``: the shutter code for a motion."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cep.cli.bench_options import Cache, Dask, Workers
from cep.cli.console import finish, progress, table
from cep.cli.folders import only_of_folders
from cep.cli.frames import optimize_frames
from cep.cli.optimize_folder import optimize_folder
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
)
from cep.cli.search_options import Wish
from cep.cli.searching import Task, search_of, task_of, unplayable, warnings_of

if TYPE_CHECKING:
    from rich.console import Console

    from motdiff.files import StoredMotion

__all__ = ["optimize"]

_STANDARD_CHIPS = 52


def optimize(
    trajectory: TrajectoryFile = None,
    linear: Linear = None,
    each: Annotated[
        Path | None,
        typer.Option("--each", help="A code for each motion of a folder, FOLDER/*/trajectory.json, as calibrated."),
    ] = None,
    chips: Annotated[int, typer.Option("--chips", "-n", min=1, help="Number of chips.")] = _STANDARD_CHIPS,
    open_chips: Annotated[str | None, typer.Option("--open", help="Open chips: K, or LOW:HIGH.")] = None,
    duty: Annotated[str | None, typer.Option("--duty", help="Open fraction of the time, LOW:HIGH, 0..1.")] = None,
    objective: Annotated[
        str | None,
        typer.Option(
            "--objective",
            help="min-mtf, flatness, noise or mse, or a mix as min-mtf:0.15,noise:1; mse, or min-mtf where straight.",
        ),
    ] = None,
    direction: Annotated[
        str, typer.Option("--direction", help="unknown (both ways count), forward, or auto: as the file says.")
    ] = "auto",
    min_open: Annotated[int, typer.Option("--min-open", min=1, help="Shortest open run, chips.")] = 1,
    max_open: Annotated[int | None, typer.Option("--max-open", min=1, help="Longest open run, chips.")] = None,
    min_closed: Annotated[int, typer.Option("--min-closed", min=1, help="Shortest closed run, chips.")] = 1,
    min_period: Annotated[
        int, typer.Option("--min-period", min=1, help="Fewest chips from one opening to the next.")
    ] = 1,
    max_pulses: Annotated[int | None, typer.Option("--max-pulses", min=1, help="Most open runs.")] = None,
    first_open: Annotated[bool, typer.Option("--first-open", help="The first chip is open.")] = False,
    last_open: Annotated[bool, typer.Option("--last-open", help="The last chip is open.")] = False,
    fixed: Annotated[
        str | None, typer.Option("--fixed", help="A mark per chip: 1 open, 0 closed, ? free, as 1???0?1.")
    ] = None,
    device: Annotated[
        str | None, typer.Option("--device", help="Search what this shutter can play: a name or a .toml file.")
    ] = None,
    chip_ns: Annotated[int, typer.Option("--chip-ns", min=1, help="Chip time, ns.")] = 1_000_000,
    alternatives: Annotated[
        bool, typer.Option("--alternatives", help="Design for the other motions that the file holds as well.")
    ] = False,
    speed: Annotated[
        str | None, typer.Option("--speed", help="Design for these factors of the path's length, as 0.8:1.2.")
    ] = None,
    drift: Annotated[
        float | None, typer.Option("--drift", help="Design for a shutter clock off by so much, as 0.02.")
    ] = None,
    jitter: Annotated[
        float | None, typer.Option("--jitter", help="Design for edges off by so many chips rms, 0..0.15.")
    ] = None,
    rule: Annotated[str, typer.Option("--rule", help="Of several motions: worst, or the weighted mean.")] = "worst",
    camera: CameraFile = None,
    photons: Photons = None,
    read_noise: ReadNoise = None,
    method: Annotated[
        str, typer.Option("--method", help="anneal; or exact, which proves the best min-mtf, to about 40 chips.")
    ] = "anneal",
    effort: Annotated[
        str,
        typer.Option(
            "--bound",
            help="quick; or sdp: half a minute for a tighter bound, and starts drawn from it, along curved motion.",
        ),
    ] = "quick",
    frames: Annotated[
        int, typer.Option("--frames", min=1, help="Exposures restored together, each with its own code: code_1.json")
    ] = 1,
    time_s: Annotated[
        float,
        typer.Option("--time", help="Time limit of a code, s; what it ends differs from run to run. A proof runs on."),
    ] = 60.0,
    steps: Annotated[
        int | None,
        typer.Option(
            "--steps", min=1, help="Moves to try; the same seed and moves give the same code. As suits the motion."
        ),
    ] = None,
    workers: Workers = None,
    dask: Dask = None,
    cache: Cache = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", help="File to write, code.json; of --each a folder, the motions' own when omitted."
        ),
    ] = None,
    force: Force = False,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Search the shutter code whose coded photo restores best along a motion; Ctrl-C keeps the best so far.

    Of the JSON fields, bound says what no code of so much light can exceed: min_chip for a uniform straight motion,
    else min_mtf, or with --objective noise the noise gain that none can fall below. gap says how far off this code is,
    0..1, or in dB for the noise. They are null for other objectives. Noise gains above 100 dB, those of codes with a
    zero, are null too. The certificate proves the minimum; cep audit code.json checks it again. proven says that no
    code is better: over the whole unit circle, or, unless one straight motion is all there is, at the band's samples.

    Example: cep optimize --trajectory motion/trajectory.json --chips 40 --duty 0.4:0.6 -o code.json

    Example: cep optimize --linear 36 --chips 36 --method exact

    Example: cep optimize --linear 52 --open 26 --objective min-mtf:0.15,noise:1

    Example: cep optimize --each shots_motion --chips 40 --duty 0.4:0.6 --time 600
    """
    from dataclasses import replace

    from cep.files import StoredCode, write_code
    from cep.optimize import appraise, report, search
    from cep.outputs import claim
    from cep.search.exhaustive.exact import codes_to_count
    from hw.device import load_profile

    how = search_of(method, effort, steps=steps, time_s=time_s, seed=seed)
    wish = Wish(
        chips=chips, chip_ns=chip_ns, open_chips=open_chips, duty=duty, objective=objective, direction=direction,
        min_open=min_open, max_open=max_open, min_closed=min_closed, min_period=min_period, max_pulses=max_pulses,
        first_open=first_open, last_open=last_open, fixed=fixed, alternatives=alternatives, speed=speed, drift=drift,
        jitter=jitter, rule=rule,
    )  # fmt: skip
    profile = None if device is None else load_profile(device)
    light = load_camera(camera, photons=photons, read_noise=read_noise)

    def task(stored: StoredMotion, path: Path | None) -> Task:
        source = {"trajectory": None if path is None else str(path), "linear_px": linear, "device": device}
        return task_of(wish, stored, how, camera=light, profile=profile, source=source)

    if each is not None:
        if trajectory is not None or linear is not None or frames > 1:
            raise ValueError("--each: takes the place of --trajectory and --linear, and searches one frame for each")
        optimize_folder(
            each, task, how, profile=profile, chip_ns=chip_ns, workers=workers, dask=dask, cache=cache, output=output,
            force=force, as_json=as_json,
        )  # fmt: skip
        return
    only_of_folders("--each", workers, dask, cache)
    if trajectory is not None and trajectory.is_dir():
        raise ValueError(f"{trajectory}: is a folder; --each FOLDER searches a code for each motion in it")
    wanted = task(load_motion(trajectory, linear), trajectory)
    problem, described = wanted.problem, wanted.described
    file = output or Path("code.json")
    if frames > 1:
        if method != "anneal":
            raise ValueError(f"--frames: several codes are searched with --method anneal only, got {method!r}")
        optimize_frames(
            problem, wanted.searched, frames, described=described, profile=profile, chip_ns=chip_ns, steps=steps,
            time_s=time_s, seed=seed, output=file, force=force, as_json=as_json,
        )  # fmt: skip
        return
    claim([file], force=force, inputs=[] if trajectory is None else [trajectory])
    label = f"counting {codes_to_count(wanted.searched):.2g} codes" if method == "exact" else "searching"
    with progress(label) as tick:
        found = search(wanted.searched, how, progress=lambda fraction, best: tick(fraction, f"{best.open_chips} open"))
    code = replace(found.code, chip_ns=chip_ns)
    if reason := unplayable(code.bits, profile, chip_ns):
        raise ValueError(reason)
    described = {**described, "steps": found.steps, "proof": found.proof}
    write_code(file, StoredCode(code, problem=described))  # already: Ctrl-C from here on must not lose it
    worth = appraise(problem, code, along=wanted.along, effort=how.effort, seed=seed, time_s=time_s)
    write_code(file, StoredCode(code, worth.ours.metrics.to_dict(), described, worth.certificate))
    told = report(found, worth)
    result = {
        "file": file,
        **told,
        "seed": seed,
        "warnings": warnings_of(problem, interrupted=found.interrupted, method=method, baselines=told["baselines"]),
    }
    straight = wanted.along is None

    def show(console: Console) -> None:
        from cep.wording import number

        console.print(f"{file}: {code.bits}")
        console.print(f"{code.open_chips} of {chips} chips open, {code.pulses} openings, {found.seconds:.1f} s")
        columns = ("code", "open", "min |P|, chips" if straight else "min MTF", "noise gain, dB", "MSE, dB")
        lowest = "min_chip" if straight else "min_mtf"
        rows = [
            (
                row.name,
                row.code.open_chips,
                *(row.metrics.in_words(name) for name in (lowest, "noise_gain_db", "mse_db")),
            )
            for row in (worth.ours, *worth.others)
        ]
        console.print(table("compared on this motion (worse direction where unknown)", columns, rows))
        console.print(
            f"certified: min {'|P|' if straight else '|H|'} lies within "
            f"{worth.certificate['lower']:.6g}..{worth.certificate['upper']:.6g} ({worth.certificate['method']})"
        )
        if result["proven"] and found.proof is not None:
            console.print(f"proven: no code within the limits is better on {found.proof['domain']}")
        elif worth.bound is not None:
            console.print(f"{worth.figure}: no code with so many open chips can do better than {number(worth.bound)}")

    finish(result, as_json=as_json, show=show)
