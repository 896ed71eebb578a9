"""``cep optimize``: the shutter code for a motion."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cep.cli.console import finish, table
from cep.cli.frames import optimize_frames
from cep.cli.options import (
    CameraFile,
    Force,
    Json,
    Linear,
    Photons,
    ReadNoise,
    Seed,
    TrajectoryFile,
    code_figures,
    load_camera,
    load_motion,
)
from cep.cli.search_options import Wish, on_the_circle, problem_of
from cep.cli.searching import bounded, search, warnings_of

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["optimize"]

_STANDARD_CHIPS = 52


def optimize(
    trajectory: TrajectoryFile = None,
    linear: Linear = None,
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
    time_s: Annotated[float, typer.Option("--time", help="Time limit, s; a proof runs to its end.")] = 60.0,
    steps: Annotated[
        int | None,
        typer.Option(
            "--steps", min=1, help="Moves to try; the same seed and moves give the same code. As suits the motion."
        ),
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="File to write.")] = Path("code.json"),
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
    """
    from dataclasses import asdict, replace

    import numpy as np

    from cep.baselines.compare import compare
    from cep.certify.certificate import certify
    from cep.design import check_frame, check_resolved
    from cep.files import StoredCode, write_code
    from cep.outputs import claim
    from hw.device import load_profile
    from hw.program import Program

    if method not in ("anneal", "exact"):
        raise ValueError(f"--method: must be anneal or exact, got {method!r}")
    if effort not in ("quick", "sdp"):
        raise ValueError(f"--bound: must be quick or sdp, got {effort!r}")
    wish = Wish(
        chips=chips, chip_ns=chip_ns, open_chips=open_chips, duty=duty, objective=objective, direction=direction,
        min_open=min_open, max_open=max_open, min_closed=min_closed, min_period=min_period, max_pulses=max_pulses,
        first_open=first_open, last_open=last_open, fixed=fixed, alternatives=alternatives, speed=speed, drift=drift,
        jitter=jitter, rule=rule,
    )  # fmt: skip
    stored = load_motion(trajectory, linear)
    motion = stored.trajectory
    check_frame(motion)
    check_resolved(motion, chips)
    profile = None if device is None else load_profile(device)
    problem = problem_of(
        wish,
        stored,
        camera=load_camera(camera, photons=photons, read_noise=read_noise),
        profile=profile,
        rng=np.random.default_rng([seed, 2]),
    )
    straight = on_the_circle(problem)
    searched = replace(problem, scenarios=()) if straight and problem.objective == "min-mtf" else problem
    described = {
        **{name: value for name, value in asdict(wish).items() if name not in ("open_chips", "duty", "chip_ns")},
        "trajectory": None if trajectory is None else str(trajectory),
        "linear_px": linear,
        "open_range": problem.open_limits,
        "objective": problem.objective,
        "min_open": problem.min_open,
        "max_open": problem.max_open,
        "min_closed": problem.min_closed,
        "min_period": problem.min_period,
        "max_pulses": problem.max_pulses,
        "fixed": problem.fixed,
        "device": device,
        "camera": problem.camera.to_dict(),
        "method": method,
        "seed": seed,
    }
    if frames > 1:
        if method != "anneal":
            raise ValueError(f"--frames: several codes are searched with --method anneal only, got {method!r}")
        optimize_frames(
            problem, searched, frames, described=described, profile=profile, chip_ns=chip_ns, steps=steps,
            time_s=time_s, seed=seed, output=output, force=force, as_json=as_json,
        )  # fmt: skip
        return
    claim([output], force=force)
    found = search(searched, method=method, effort=effort, steps=steps, time_s=time_s, seed=seed)
    code = replace(found["code"], chip_ns=chip_ns)
    problems = profile.check(Program.from_bits(code.bits, chip_ns=chip_ns)) if profile else ()
    if problems:
        raise ValueError(f"no code was found that the device can play: {'; '.join(problems)}")
    described |= {"steps": found["steps"], "proof": found["proof"]}
    write_code(output, StoredCode(code, problem=described))  # already: Ctrl-C from here on must not lose it
    ours, *others = compare(problem, code, rng=np.random.default_rng([seed, 1]))
    metrics = ours.metrics
    certificate = certify(code, None if straight else _as_designed(motion, direction)).to_dict()
    figure, limit, gap = bounded(problem, metrics, straight=straight, effort=effort)
    write_code(output, StoredCode(code, metrics.to_dict(), described, certificate))
    warnings = warnings_of(problem, interrupted=found["interrupted"], method=method)
    result = {
        "file": output,
        **code_figures(code),
        "chip_ns": chip_ns,
        **metrics.to_dict(),
        "objective": found["objective"],
        "proven": found["proof"] is not None and not found["interrupted"],
        "certificate": certificate,
        "bound": limit,
        "gap": gap,
        "seconds": found["seconds"],
        "steps": found["steps"],
        "interrupted": found["interrupted"],
        "baselines": {
            row.name: {"bits": row.code.bits, "open": row.code.open_chips, **row.metrics.to_dict()} for row in others
        },
        "seed": seed,
        "warnings": warnings,
    }

    def show(console: Console) -> None:
        console.print(f"{output}: {code.bits}")
        console.print(f"{code.open_chips} of {chips} chips open, {code.pulses} openings, {found['seconds']:.1f} s")
        columns = ("code", "open", "min |P|, chips" if straight else "min MTF", "noise gain, dB", "MSE, dB")
        lowest = "min_chip" if straight else "min_mtf"
        rows = [
            (
                row.name,
                row.code.open_chips,
                *(row.metrics.in_words(name) for name in (lowest, "noise_gain_db", "mse_db")),
            )
            for row in (ours, *others)
        ]
        console.print(table("compared on this motion (worse direction where unknown)", columns, rows))
        console.print(
            f"certified: min {'|P|' if straight else '|H|'} lies within "
            f"{certificate['lower']:.6g}..{certificate['upper']:.6g} ({certificate['method']})"
        )
        if result["proven"]:
            console.print(f"proven: no code within the limits is better on {found['proof']['domain']}")
        elif limit is not None:
            console.print(f"{figure}: no code with so many open chips can do better than {limit:.4g}")

    finish(result, as_json=as_json, show=show)


def _as_designed(motion: Any, direction: str) -> Any:
    """Return the motion with the direction that the search counted."""
    from dataclasses import replace

    return (
        motion if direction == "auto" else replace(motion, direction="known" if direction == "forward" else "unknown")
    )
