"""``cep audit`` and ``cep mtf``: what codes are worth along a motion."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cep.cli.console import finish, progress, table
from cep.cli.options import (
    CameraFile,
    ChipNs,
    CodeSource,
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
    output_option,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rich.console import Console

    from cep.proofs.verify.certificates import Verdict

__all__ = ["audit", "mtf"]

_LONG_CHIPS = 256  # beyond it three flips take minutes
_SHOWN = 12  # zeros listed for people


def audit(
    code: CodeSource,
    trajectory: TrajectoryFile = None,
    linear: Linear = None,
    flips: Annotated[
        int | None,
        typer.Option(
            "--flips",
            metavar="N",
            min=0,
            max=3,
            help="Look for better codes up to this many flips away; 3 when omitted, for more than 256 chips 2.",
        ),
    ] = None,
    chip_ns: ChipNs = None,
    camera: CameraFile = None,
    photons: Photons = None,
    read_noise: ReadNoise = None,
    output: Annotated[Path | None, output_option("Also write the result as JSON.")] = None,
    force: Force = False,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Measure a code: its proven minimum and true zeros, the grids that hide them, and better codes a few flips away.

    Without a motion the figures are those of a straight one of 1 px a chip. A code.json's certificate is checked by a
    second, separate program: verified says whether it holds and why, null where there is none. Noise gains above 100
    dB, those of codes with a zero, are null in JSON.

    Example: cep audit 1010000111000001010000110011110111010111001001100111

    Example: cep audit code.json --trajectory trajectory.json --json
    """
    from cep.codes.sources import find_code
    from cep.io.files import json_text
    from cep.io.outputs import claim, write_text
    from cep.proofs.audit import better_neighbours, grid_claims, null_threshold, zeros_by_direction
    from cep.proofs.certify.certificate import certify
    from cep.proofs.verify.certificates import verify
    from cep.workflows.compare import check_frame, check_resolved, judge
    from motdiff.trajectory import Trajectory

    stored = find_code(code, chip_ns=chip_ns)
    shutter = stored.code
    noise = load_camera(camera, photons=photons, read_noise=read_noise)
    stated = trajectory is not None or linear is not None
    motion = load_motion(trajectory, linear).trajectory if stated else Trajectory.straight(float(shutter.chips))
    check_frame(motion)
    check_resolved(motion, shutter.chips)
    claim([output] if output else [], force=force)
    metrics = judge(motion, shutter, camera=noise)
    # straight motion of constant speed: the code's polynomial decides, whatever the length
    where = None if metrics.min_chip is not None else motion
    far = flips if flips is not None else 3 if shutter.chips <= _LONG_CHIPS else 2
    with progress("proving the minimum"):
        minimum = certify(shutter, where)
        zeros = zeros_by_direction(shutter, where)
        grids = grid_claims(shutter, where, minimum.upper)
    with progress("looking at neighbours"):
        neighbours = better_neighbours(shutter, where, flips=far)
    verdict = None
    if stored.certificate:
        path = (motion.t.tolist(), motion.xy.tolist()) if stated else None
        verdict = verify(stored.certificate, bits=shutter.bits, path=path)
    is_null = minimum.upper < null_threshold(shutter, where)
    has = "has" if minimum.upper == 0 else "nearly has"
    warnings = [f"the code {has} a zero at {_place(minimum.at, where is None)}"] if is_null else []
    if verdict is not None and not verdict.holds:
        warnings.append(f"{code}: its certificate is not confirmed: {verdict.reasons[-1]}")
    elif verdict is not None and where is not None and not _covers(stored.certificate, minimum.directions):
        warnings.append(f"{code}: its certificate does not cover this motion, {' and '.join(minimum.directions)}")
    result = {
        **code_figures(shutter),
        **metrics.to_dict(),
        "motion": {"length_px": motion.length_px, "direction": motion.direction},
        # the path is the one that was asked for
        "certificate": {name: value for name, value in minimum.to_dict().items() if name != "trajectory"},
        "lowest_at": minimum.at,
        "null": is_null,
        "zeros": [
            {"direction": way, **zero.to_dict(), "method": zero.method}
            for way, them in zeros.items()
            for zero in them.found
        ],
        "zeros_complete": all(them.complete for them in zeros.values()),
        "grids": grids,
        "neighbours": [{"flips": n.flips, "bits": n.code.bits, "minimum": n.minimum} for n in neighbours],
        "verified": verdict,
        "seed": seed,
        "warnings": warnings,
    }
    if output:
        write_text(output, json_text(result))

    def show(console: Console) -> None:
        console.print(f"{shutter.chips} chips, {shutter.open_chips} open, {shutter.pulses} openings: {shutter.bits}")
        console.print(
            f"motion: {motion.length_px:.1f} px, direction {motion.direction}" + ("" if stated else " (1 px a chip)")
        )
        rows = [(name, metrics.in_words(name)) for name in metrics.to_dict()]
        console.print(table("", ("figure", "value"), rows))
        what, place = ("|P|", "chips") if where is None else ("|H|", "light-true"), _place(minimum.at, where is None)
        # as they are: an upper bound of 1e-13 is no proven zero
        console.print(f"smallest {what[0]}: {minimum.lower:.6g} .. {minimum.upper:.6g} ({what[1]}) at {place}")
        console.print(f"proof: {minimum.method}" + ("" if verdict is None else _in_words(verdict)))
        for way, them in zeros.items():
            known = "" if them.complete else " or more"
            console.print(f"true zeros{'' if way == 'both' else ' ' + way}: {len(them.found)}{known}")
            for zero in them.found[:_SHOWN]:
                console.print(f"  {_place(zero.at, where is None)}, {zero.method}")
            if len(them.found) > _SHOWN:
                console.print(f"  and {len(them.found) - _SHOWN} more: --json lists them")
        console.print(table("what grids say", ("grid", "minimum", ""), [(g.name, g.minimum, g.verdict) for g in grids]))
        rows_near = [(", ".join(map(str, n.flips)), n.minimum, n.code.bits) for n in neighbours]
        if rows_near:
            console.print(table("better codes nearby", ("flip chips", "minimum", "bits"), rows_near))
        else:
            console.print(f"no better code was found within {far} flips")

    finish(result, as_json=as_json, show=show)


def mtf(
    trajectory: TrajectoryFile = None,
    linear: Linear = None,
    codes: Annotated[
        list[str] | None,
        typer.Option("--code", metavar="CODE", help="Code to draw: bits, code.json or a name; may be repeated."),
    ] = None,
    output: Annotated[Path, output_option("Figure to write: .png, .pdf or .svg.")] = Path("mtf.png"),
    force: Force = False,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Draw the MTFs of codes along a motion, in one and two dimensions, beside the open shutter's.

    Example: cep mtf --trajectory trajectory.json --code code.json --code raskar-52 -o mtf.png
    """
    from cep.codes.sources import code_label, load_code
    from cep.io.outputs import claim
    from cep.optics.code import ShutterCode
    from cep.plots import check_figure_name, mtf_curve, mtf_figure, save
    from cep.workflows.compare import check_frame, check_resolved, judge

    check_figure_name(output)
    motion = load_motion(trajectory, linear).trajectory
    check_frame(motion)
    shutters: dict[str, ShutterCode | None] = {"open shutter": None}
    for source in codes or []:
        label = code_label(source)
        while label in shutters:
            label += "'"
        shutters[label] = load_code(source)
        check_resolved(motion, load_code(source).chips)
    claim([output], force=force)
    with progress("drawing"):
        save(mtf_figure(motion, shutters), output)
    curves, rows = {}, []
    for label, shutter in shutters.items():
        freq_cy_px, values = mtf_curve(motion, shutter)
        metrics = judge(motion, shutter or ShutterCode("1"))
        rows.append((label, *(metrics.in_words(name) for name in ("min_mtf", "noise_gain_db", "mse_db"))))
        curves[label] = {
            "bits": None if shutter is None else shutter.bits,
            "freq_cy_px": freq_cy_px,
            "mtf": values,
            **metrics.to_dict(),
        }

    def show(console: Console) -> None:
        console.print(table(str(output), ("code", "min MTF", "noise gain, dB", "MSE, dB"), rows))

    finish({"image": output, "curves": curves, "seed": seed}, as_json=as_json, show=show)


def _place(at: tuple[float, ...], in_chips: bool) -> str:
    where = ", ".join(f"{value:.5f}" for value in at)
    return f"{where} cycles per chip" if in_chips else f"({where}) cycles/px"


def _covers(certificate: Mapping[str, Any], directions: tuple[str, ...]) -> bool:
    """Whether a certificate of |H| is about all these ways along its path."""
    return certificate["unit"] == "light-true" and set(directions) <= set(certificate.get("directions", directions))


def _in_words(verdict: Verdict) -> str:
    return "; the file's certificate is " + ("confirmed" if verdict.holds else f"refused: {verdict.reasons[-1]}")
