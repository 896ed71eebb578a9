"""``cep audit`` and ``cep mtf``: what codes are worth along a motion."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cep.commands.console import finish, progress, table
from cep.commands.options import (
    CameraFile,
    ChipNs,
    CodeSource,
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

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rich.console import Console

    from cep.files.files import StoredCode
    from cep.optics.camera import Camera
    from cep.optics.code import ShutterCode
    from cep.proofs.audit import Audit
    from cep.proofs.verify.certificates import Verdict

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
            help=(
                "Look for better codes up to this many flips away; 3 when omitted, for more than"
                " 256 chips 2."
            ),
        ),
    ] = None,
    chip_ns: ChipNs = None,
    camera: CameraFile = None,
    photons: Photons = None,
    read_noise: ReadNoise = None,
    figure: Figures = None,
    output: Annotated[Path | None, output_option("Also write the result as JSON.")] = None,
    tables: TableFile = None,
    force: Force = False,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Measure a code: its proven minimum and true zeros, the grids that hide them, and better
    codes a few flips away.

    Along a motion it is said first whether the code is the exposure to take with this camera:
    verdict, choice and gains_db of --json, as of cep advise. Without a motion these are null, and
    the figures are those of a straight one of 1 px a chip. A code.json's certificate is checked by
    a second, separate program: verified says whether it holds and why, null where there is none.
    Noise gains above 100 dB, and the infinite ones of codes with a zero, are null in JSON. The
    camera is that of code.json when --camera is omitted. figures has those of --figure: a number,
    or [forward, backward] where the direction is unknown.

    Example: cep audit 1010000111000001010000110011110111010111001001100111

    Example: cep audit code.json --trajectory trajectory.json --json

    Example: cep audit code.json --linear 40 --figure mymodule:my_figure
    """
    from functools import partial

    from cep.codes.sources import find_code
    from cep.proofs.audit import audit as audited
    from cep.proofs.measure import find_figures
    from cep.proofs.verify.certificates import verify
    from cep.search.advise import verdict as judge
    from cep.search.problem import SearchProblem
    from motdiff.files.outputs import Outputs
    from motdiff.files.trajectories import stated_uncertainty_px

    if code.endswith(".jsonl"):
        raise ValueError(
            f"{code}: proofs are checked in the laboratory, in the repository: python -m lab prove"
            f" --check {code}"
        )
    stored = find_code(code, chip_ns=chip_ns)
    known = None if camera is not None else _searched_with(stored, code)
    noise = load_camera(camera, photons=photons, read_noise=read_noise, standard=known)
    stated = trajectory is not None or linear is not None
    moved = load_motion(trajectory, linear) if stated else None
    error_px = (
        None if moved is None or trajectory is None else stated_uncertainty_px(moved, trajectory)
    )
    motion = None if moved is None else moved.trajectory
    own = find_figures(figure or ())
    outputs = Outputs((*([output] if output else []), *table_files(tables)), force)
    with progress("auditing") as tick:
        found = audited(
            stored.code,
            motion,
            camera=noise,
            flips=flips,
            figures=own,
            progress=tick,
            on_checked=outputs.check,
        )
        judged = None
        if motion is not None:
            problem = SearchProblem.along(
                motion, chips=stored.code.chips, chip_ns=stored.code.chip_ns, camera=noise
            )
            judged = judge(problem, stored.code, path_error_px=error_px or 0.0)
    verdict = None
    if stored.certificate:
        path = None if motion is None else (motion.t.tolist(), motion.xy.tolist())
        verdict = verify(stored.certificate, bits=stored.code.bits, path=path)
    minimum = found.certificate
    straight = found.along is None
    has = "has" if minimum.upper == 0 else "nearly has"
    warnings = [f"the code {has} a zero at {_place(minimum.at, straight)}"] if found.null else []
    if verdict is not None and not verdict.holds:
        warnings.append(f"{code}: its certificate is not confirmed: {verdict.reasons[-1]}")
    elif (
        verdict is not None
        and not straight
        and not _covers(stored.certificate, minimum.directions)
    ):
        warnings.append(
            f"{code}: its certificate does not cover this motion,"
            f" {' and '.join(minimum.directions)}"
        )
    said = None if judged is None else judged.sentence
    advised = {
        "verdict": said,
        "choice": None if judged is None else judged.choice,
        "gains_db": None if judged is None else judged.gains_db,
    }
    result = {
        **advised,
        **found.to_dict(),
        "verified": verdict,
        "seed": seed,
        "warnings": warnings,
    }
    finish(
        result,
        as_json=as_json,
        tables=tables,
        show=lambda console: _show(console, found, verdict, said=said),
        outputs=outputs,
        save=partial(_write, output, result),
    )


def _searched_with(stored: StoredCode, name: str) -> Camera | None:
    """Return the camera that a code.json was searched with; None where it names none."""
    from cep.optics.camera import Camera

    document = stored.problem.get("camera")
    if document is None:
        return None
    try:
        if not isinstance(document, dict):
            raise ValueError(f"must be an object, got {type(document).__name__}")
        return Camera.from_dict(document)
    except ValueError as error:
        raise ValueError(f"{name}: problem.camera: {error}; --camera names another") from None


def _write(output: Path | None, result: Mapping[str, object], made: Mapping[Path, Path]) -> None:
    """Write a result as JSON, where a file is named."""
    from motdiff.files.json_files import json_text
    from motdiff.files.outputs import write_text

    if output is not None:
        write_text(made[output], json_text(result))


def _show(console: Console, found: Audit, verdict: Verdict | None, *, said: str | None) -> None:
    """Print an audit for people; what is said first stands for a stated motion."""
    from cep.proofs.measure import figure_head, figure_in_words

    if said is not None:
        console.print(said)

    shutter = found.code
    motion = found.trajectory
    minimum = found.certificate
    straight = found.along is None
    console.print(
        f"{shutter.chips} chips, {shutter.open_chips} open, {shutter.pulses} openings:"
        f" {shutter.bits}"
    )
    console.print(
        f"motion: {motion.length_px:.1f} px, direction {motion.direction}"
        + ("" if said is not None else " (1 px a chip)")
    )
    hopeless = ("noise_gain_db", "dnf_db") if found.no_inverse else ()
    rows = [
        (name, "infinite" if name in hopeless else found.metrics.in_words(name))
        for name in found.metrics.to_dict()
    ]
    rows += [(figure_head(*item), figure_in_words(item[1])) for item in found.figures.items()]
    console.print(table("figures", ("figure", "value"), rows))
    what, unit = ("|P|", "chips") if straight else ("|H|", "light-true")
    # as they are: an upper bound of 1e-13 is no proven zero
    place = _place(minimum.at, straight)
    console.print(
        f"smallest {what}: {minimum.lower:.6g} .. {minimum.upper:.6g} ({unit}) at {place}"
    )
    console.print(f"proof: {minimum.method}" + ("" if verdict is None else _in_words(verdict)))
    for way, zeros in found.zeros.items():
        known = "" if zeros.complete else " or more"
        console.print(f"true zeros{'' if way == 'both' else ' ' + way}: {len(zeros.found)}{known}")
        for zero in zeros.found[:_SHOWN]:
            console.print(f"  {_place(zero.at, straight)}, {zero.method}")
        if len(zeros.found) > _SHOWN:
            console.print(f"  and {len(zeros.found) - _SHOWN} more: --json lists them")
    grids = [(claim.name, claim.minimum, claim.verdict) for claim in found.grids]
    console.print(table("what grids say", ("grid", "minimum", "verdict"), grids))
    near = [
        (", ".join(map(str, one.flips)), one.minimum, one.code.bits) for one in found.neighbours
    ]
    if near:
        console.print(table("better codes nearby", ("flip chips", "minimum", "bits"), near))
    else:
        console.print(f"no better code was found within {found.flips} flips")


def mtf(
    trajectory: TrajectoryFile = None,
    linear: Linear = None,
    codes: Annotated[
        list[str] | None,
        typer.Option(
            "--code",
            metavar="CODE",
            help="Code to draw: bits, code.json or a name; may be repeated.",
        ),
    ] = None,
    figure: Figures = None,
    output: Annotated[Path, output_option("Figure to write: .png, .pdf or .svg.")] = Path(
        "mtf.png"
    ),
    tables: TableFile = None,
    force: Force = False,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Draw the MTFs of codes along a motion, in one and two dimensions, beside the open shutter's.

    Example: cep mtf --trajectory trajectory.json --code code.json --code raskar-52 -o mtf.png
    """
    from cep.codes.sources import code_label, load_code
    from cep.plots import check_figure_name
    from cep.plots.mtf_curves import OPEN, compare_mtfs
    from cep.proofs.measure import figure_head, figure_in_words, find_figures
    from motdiff.files.outputs import Outputs

    check_figure_name(output)
    motion = load_motion(trajectory, linear).trajectory
    own = find_figures(figure or ())
    shutters: dict[str, ShutterCode] = {}
    for source in codes or []:
        label = code_label(source)
        while label in (OPEN, *shutters):
            label += "'"
        shutters[label] = load_code(source)
    outputs = Outputs((output, *table_files(tables)), force)
    with progress("drawing"):
        found = compare_mtfs(motion, shutters, figures=own, on_checked=outputs.check)

    def show(console: Console) -> None:
        heads = (figure_head(*item) for item in found.rows[OPEN].figures.items())
        rows = [
            (
                name,
                *(
                    row.metrics.in_words(figure)
                    for figure in ("min_mtf", "noise_gain_db", "mse_db")
                ),
                *map(figure_in_words, row.figures.values()),
            )
            for name, row in found.rows.items()
        ]
        console.print(
            table(str(output), ("code", "min MTF", "noise gain, dB", "MSE, dB", *heads), rows)
        )

    finish(
        {"image": output, "curves": found.to_dict(), "seed": seed},
        as_json=as_json,
        show=show,
        outputs=outputs,
        save=lambda made: found.save(made[output]),
        tables=tables,
    )


def _place(at: tuple[float, ...], in_chips: bool) -> str:
    where = ", ".join(f"{value:.5f}" for value in at)
    return f"{where} cycles per chip" if in_chips else f"({where}) cycles/px"


def _covers(certificate: Mapping[str, Any], directions: tuple[str, ...]) -> bool:
    """Whether a certificate of |H| is about all these ways along its path."""
    return certificate["unit"] == "light-true" and set(directions) <= set(
        certificate.get("directions", directions)
    )


def _in_words(verdict: Verdict) -> str:
    return "; the file's certificate is " + (
        "confirmed" if verdict.holds else f"refused: {verdict.reasons[-1]}"
    )
