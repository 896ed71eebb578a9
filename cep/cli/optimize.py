"""``cep optimize``: the shutter code for a motion."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cep.cli.console import finish, progress, table
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

if TYPE_CHECKING:
    from rich.console import Console

    from hw.device import DeviceProfile

__all__ = ["optimize"]

_DIRECTIONS = ("auto", "unknown", "forward")
_STANDARD_CHIPS = 52


def optimize(
    trajectory: TrajectoryFile = None,
    linear: Linear = None,
    chips: Annotated[int, typer.Option("--chips", "-n", min=1, help="Number of chips.")] = _STANDARD_CHIPS,
    open_chips: Annotated[str | None, typer.Option("--open", help="Open chips: K, or LOW:HIGH.")] = None,
    duty: Annotated[str | None, typer.Option("--duty", help="Open fraction of the time, LOW:HIGH, 0..1.")] = None,
    objective: Annotated[
        str | None,
        typer.Option("--objective", help="min-mtf, flatness, noise or mse; mse, or min-mtf for straight motion."),
    ] = None,
    direction: Annotated[
        str, typer.Option("--direction", help="unknown (both ways count), forward, or auto: as the file says.")
    ] = "auto",
    min_open: Annotated[int, typer.Option("--min-open", min=1, help="Shortest open run, chips.")] = 1,
    min_closed: Annotated[int, typer.Option("--min-closed", min=1, help="Shortest closed run, chips.")] = 1,
    max_pulses: Annotated[int | None, typer.Option("--max-pulses", min=1, help="Most open runs.")] = None,
    device: Annotated[
        str | None, typer.Option("--device", help="Search what this shutter can play: a name or a .toml file.")
    ] = None,
    chip_ns: Annotated[int, typer.Option("--chip-ns", min=1, help="Chip time, ns.")] = 1_000_000,
    camera: CameraFile = None,
    photons: Photons = None,
    read_noise: ReadNoise = None,
    method: Annotated[str, typer.Option("--method", help="anneal.")] = "anneal",
    time_s: Annotated[float, typer.Option("--time", help="Time limit of the search, s.")] = 60.0,
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

    With --objective min-mtf, the JSON fields bound and gap say what no code of so much light can exceed, and how far
    below it this one stays, 0..1: of min_chip for a uniform straight motion, of min_mtf for any other. They are null
    for the other objectives. Noise gains above 100 dB, those of codes with a zero, are null too.

    Example: cep optimize --trajectory motion/trajectory.json --chips 40 --duty 0.4:0.6 -o code.json
    """
    from dataclasses import replace

    import numpy as np

    from cep.audit import minimum_along
    from cep.band import uniform_length_px
    from cep.baselines.compare import compare
    from cep.baselines.published import for_chips
    from cep.design import check_frame, check_resolved
    from cep.files import StoredCode, write_code
    from cep.outputs import claim
    from cep.search.anneal import anneal, standard_moves
    from cep.search.bounds import bound
    from cep.search.problem import Scenario, SearchProblem
    from hw.device import load_profile
    from hw.program import Program

    if method != "anneal":
        raise ValueError(f"--method: there is anneal, got {method!r}")
    if direction not in _DIRECTIONS:
        raise ValueError(f"--direction: must be one of {', '.join(_DIRECTIONS)}, got {direction!r}")
    stored = load_motion(trajectory, linear)
    motion = stored.trajectory
    check_frame(motion)
    check_resolved(motion, chips)
    profile = None if device is None else load_profile(device)
    straight = uniform_length_px(motion) is not None
    limits = _limits(chips, open_chips, duty, profile, chip_ns)
    problem = SearchProblem(
        chips=chips,
        scenarios=(Scenario(motion),),
        open_range=limits["open_range"],
        objective=objective or ("min-mtf" if straight else "mse"),
        direction=direction,  # type: ignore[arg-type]
        min_open=max(min_open, limits["min_open"]),
        min_closed=max(min_closed, limits["min_closed"]),
        max_pulses=min((v for v in (max_pulses, limits["max_pulses"]) if v is not None), default=None),
        camera=load_camera(camera, photons=photons, read_noise=read_noise),
    )
    # a straight motion's zeros from the chip itself are no fault of the code: the polynomial is what can be chosen
    searched = replace(problem, scenarios=()) if straight and problem.objective == "min-mtf" else problem
    claim([output], force=force)
    known = [entry.code for entry in for_chips(chips)]
    with progress("searching") as tick:
        found = anneal(
            searched,
            rng=np.random.default_rng(seed),
            steps=steps or standard_moves(searched),
            time_s=time_s,
            start=known,
            progress=lambda fraction, best: tick(fraction, f"{best.open_chips} open"),
        )
    code = replace(found.code, chip_ns=chip_ns)
    problems = profile.check(Program.from_bits(code.bits, chip_ns=chip_ns)) if profile else ()
    if problems:
        raise ValueError(f"no code was found that the device can play: {'; '.join(problems)}")
    described = {
        "trajectory": None if trajectory is None else str(trajectory),
        "linear_px": linear,
        "chips": chips,
        "open_range": problem.open_limits,
        "objective": problem.objective,
        "direction": direction,
        "min_open": problem.min_open,
        "min_closed": problem.min_closed,
        "max_pulses": problem.max_pulses,
        "device": device,
        "camera": problem.camera.to_dict(),
        "method": method,
        "steps": found.steps,
        "seed": seed,
    }
    write_code(output, StoredCode(code, problem=described))  # already: Ctrl-C from here on must not lose it
    ours, *others = compare(problem, code, rng=np.random.default_rng([seed, 1]))
    metrics = ours.metrics
    minimum = minimum_along(code, None if straight else _as_designed(motion, direction))
    limit, reached = None, metrics.min_chip if straight else metrics.min_mtf
    if problem.objective == "min-mtf":
        limit = bound(problem).min_chip if straight else bound(problem).min_mtf
    certificate = {
        "unit": "chips" if straight else "light-true",
        "lower": minimum.lower,
        "upper": minimum.upper,
        "at": minimum.at,
        "method": minimum.method,
    }
    write_code(output, StoredCode(code, metrics.to_dict(), described, certificate))
    warnings = ["the search was stopped early, this is the best code so far"] if found.interrupted else []
    result = {
        "file": output,
        **code_figures(code),
        "chip_ns": chip_ns,
        **metrics.to_dict(),
        "objective": found.objective,
        "certificate": certificate,
        "bound": limit,
        "gap": None if limit is None or reached is None else 1 - reached / limit,
        "seconds": found.seconds,
        "steps": found.steps,
        "interrupted": found.interrupted,
        "baselines": {
            row.name: {"bits": row.code.bits, "open": row.code.open_chips, **row.metrics.to_dict()} for row in others
        },
        "seed": seed,
        "warnings": warnings,
    }

    def show(console: Console) -> None:
        console.print(f"{output}: {code.bits}")
        console.print(f"{code.open_chips} of {chips} chips open, {code.pulses} openings, {found.seconds:.1f} s")
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
        if limit is not None and reached is not None:
            console.print(
                f"no code with so many open chips exceeds {limit:.4g}: this one has {reached / limit:.0%} of it"
            )

    finish(result, as_json=as_json, show=show)


def _limits(
    chips: int, open_chips: str | None, duty: str | None, profile: DeviceProfile | None, chip_ns: int
) -> dict[str, Any]:
    from cep.design import limits_of_device
    from cep.search.problem import open_range_of_duty

    if open_chips is not None and duty is not None:
        raise ValueError("--open and --duty: give one of them")
    low, high = 1, chips
    if open_chips is not None:
        low, high = _whole_range("--open", open_chips)
        if not 1 <= low <= high <= chips:
            raise ValueError(f"--open: must lie within 1..{chips}, got {open_chips}")
    elif duty is not None:
        low, high = open_range_of_duty(chips, *_real_range("--duty", duty))
    if profile is None:
        return {"open_range": (low, high), "min_open": 1, "min_closed": 1, "max_pulses": None}
    limits = dict(limits_of_device(profile, chips=chips, chip_ns=chip_ns))
    most = limits.pop("max_open")
    if most is not None:
        if most < low:
            raise ValueError(
                f"{profile.name}: at most {most} of {chips} chips may be open, at least {low} were asked for"
            )
        high = min(high, most)
    return {"open_range": (low, high), **limits}


def _whole_range(name: str, text: str) -> tuple[int, int]:
    low, _, high = text.partition(":")
    try:
        return int(low), int(high or low)
    except ValueError:
        raise ValueError(f"{name}: must be K or LOW:HIGH in whole chips, got {text!r}") from None


def _real_range(name: str, text: str) -> tuple[float, float]:
    low, _, high = text.partition(":")
    try:
        return float(low), float(high or low)
    except ValueError:
        raise ValueError(f"{name}: must be LOW:HIGH as 0.4:0.6, got {text!r}") from None


def _as_designed(motion: Any, direction: str) -> Any:
    """Return the motion with the direction that the search counted."""
    from dataclasses import replace

    return (
        motion if direction == "auto" else replace(motion, direction="known" if direction == "forward" else "unknown")
    )
