"""``cep audit``: figures of a code along a motion, and the proof of its minimum."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cep.commands.console import Page, Table, finish, progress
from cep.commands.options import (
    CameraOptions,
    ChipNs,
    CodeSource,
    FigureOptions,
    command,
    option,
    output_option,
)

if TYPE_CHECKING:
    from cep.files.code_files import StoredCode
    from cep.proofs.audit import Audit
    from cep.proofs.verify import Verdict
    from motdiff.trajectory import Trajectory

_LISTED_ZEROS = 12  # for people; --json has all
_NO_ADVICE = {"verdict": None, "choice": None, "gains_db": None}  # where no motion is named
_INVERSE = ("noise_gain_db", "dnf_db")  # infinite for a code with a zero


@dataclass(frozen=True, kw_only=True)
class AuditOptions(FigureOptions, CameraOptions):
    """Options of ``cep audit``."""

    code: CodeSource
    flips: int | None = option(
        "--flips",
        "N",
        "Look for better codes up to this many flips away; 3 when omitted, for more than"
        " 256 chips 2.",
        min=0,
        max=3,
    )
    chip_ns: ChipNs = None
    output: Path | None = output_option("Also write the result as JSON.")


@command(AuditOptions)
def audit(options: AuditOptions) -> None:
    """Measure a code: proven minimum, true zeros, what grids hide, better codes a few flips away.

    Along a motion it is said first whether the code is the exposure to take with this camera:
    verdict, choice and gains_db of --json, as of cep advise. Without a motion these are null, and
    the figures are those of a straight one of 1 px a chip. A code.json's certificate is checked by
    a second, separate program: verified says whether it holds and why, null where there is none.
    Noise gains above 100 dB, and the infinite ones of codes with a zero, are null in JSON. The
    camera is that of code.json when --camera is omitted, and so is the scene; gains are a model's
    for a photo of --scene. figures has those of --figure: a number,
    or [forward, backward] where the direction is unknown.

    Example: cep audit 1010000111000001010000110011110111010111001001100111

    Example: cep audit code.json --trajectory trajectory.json --json

    Example: cep audit code.json --linear 40 --figure mymodule:my_figure
    """
    from cep.codes.sources import find_code
    from cep.files.code_files import stored_camera, stored_scene
    from cep.proofs.audit import audit as audit_code
    from cep.search.problem import SearchProblem
    from cep.search.verdict import verdict
    from motdiff.files.json_files import json_text
    from motdiff.files.outputs import write_text

    if options.code.endswith(".jsonl"):
        raise ValueError(
            f"{options.code}: proofs are checked in the laboratory, in the repository: python -m"
            f" lab prove --check {options.code}"
        )
    stored = find_code(options.code, chip_ns=options.chip_ns)
    searched_camera = None
    if options.camera is None:
        searched_camera = stored_camera(stored, source=options.code)
    camera = options.load_camera(searched_camera)
    scene = stored_scene(stored)
    motion = None
    path_error_px = 0.0
    if options.has_motion:
        stored_motion = options.load_motion()
        motion = stored_motion.trajectory
        path_error_px = options.path_error_px(stored_motion)
    figures = options.find_figures()
    outputs = options.outputs(options.output)
    with progress("auditing") as tick:
        measured = audit_code(
            stored.code,
            motion,
            camera=camera,
            scene=scene,
            flips=options.flips,
            figures=figures,
            progress=tick,
            on_checked=outputs.check,
        )
        advice: Mapping[str, Any] = _NO_ADVICE
        if motion is not None:
            code = stored.code
            problem = SearchProblem.along(
                motion, chips=code.chips, chip_ns=code.chip_ns, camera=camera, scene=scene
            )
            judgement = verdict(problem, code, path_error_px=path_error_px)
            advice = {
                "verdict": judgement.sentence,
                "choice": judgement.choice,
                "gains_db": judgement.gains_db,
            }
    verified = _verified(stored, motion)
    result = {
        **advice,
        **measured.to_dict(),
        "verified": verified,
        "seed": options.seed,
        "warnings": _warnings(options.code, measured, stored, verified),
    }

    def save(staged: Mapping[Path, Path]) -> None:
        if options.output is not None:
            write_text(staged[options.output], json_text(result))

    finish(
        result,
        _page(measured, verified, advice["verdict"]),
        as_json=options.as_json,
        tables=options.tables,
        outputs=outputs,
        save=save,
    )


def _verified(stored: StoredCode, motion: Trajectory | None) -> Verdict | None:
    """Check a file's certificate; None where there is none."""
    from cep.proofs.verify import verify

    if not stored.certificate:
        return None
    path = None
    if motion is not None:  # as plain numbers: the checker shares no code with the product
        path = (motion.t.tolist(), motion.xy.tolist())
    return verify(stored.certificate, bits=stored.code.bits, path=path)


def _warnings(
    name: str, measured: Audit, stored: StoredCode, verified: Verdict | None
) -> list[str]:
    minimum = measured.certificate
    warnings = []
    if measured.null:
        has = "has" if minimum.upper == 0 else "nearly has"
        warnings.append(f"the code {has} a zero at {_place(minimum.at)}")
    if verified is None:
        return warnings
    if not verified.holds:
        warnings.append(f"{name}: its certificate is not confirmed: {verified.reasons[-1]}")
    elif measured.along is not None and not _covers(stored.certificate, minimum.directions):
        warnings.append(
            f"{name}: its certificate does not cover this motion,"
            f" {' and '.join(minimum.directions)}"
        )
    return warnings


def _covers(certificate: Mapping[str, Any], directions: tuple[str, ...]) -> bool:
    """Whether a certificate is of |H| in all these directions along its path."""
    return certificate["unit"] == "light-true" and set(directions) <= set(
        certificate.get("directions", directions)
    )


def _page(measured: Audit, verified: Verdict | None, sentence: str | None) -> Page:
    """Lay an audit out for people, along a motion with the advice's sentence first."""
    from cep.proofs.measure import figure_head, figure_in_words

    code = measured.code
    motion = measured.trajectory
    minimum = measured.certificate
    scale = " (1 px a chip)"
    if sentence is not None:
        yield sentence
        scale = ""
    yield f"{code.chips} chips, {code.open_chips} open, {code.pulses} openings: {code.bits}"
    yield f"motion: {motion.length_px:.1f} px, direction {motion.direction}{scale}"
    figures = {name: measured.metrics.in_words(name) for name in measured.metrics.to_dict()}
    if measured.no_inverse:
        figures |= dict.fromkeys(_INVERSE, "infinite")
    for name, value in measured.figures.items():
        figures[figure_head(name, value)] = figure_in_words(value)
    yield Table("figures", ("figure", "value"), list(figures.items()))
    modulus, unit = ("|H|", "light-true")
    if measured.along is None:  # a straight motion's minimum is that of the code's polynomial
        modulus, unit = ("|P|", "chips")
    # both bounds as they are: an upper bound of 1e-13 is no proven zero
    yield (
        f"smallest {modulus}: {minimum.lower:.6g} .. {minimum.upper:.6g} ({unit}) at"
        f" {_place(minimum.at)}"
    )
    yield f"proof: {minimum.method}{_in_words(verified)}"
    for direction, zeros in measured.zeros.items():
        label = f"true zeros {direction}".removesuffix(" both")
        yield f"{label}: {len(zeros.found)}{'' if zeros.complete else ' or more'}"
        for zero in zeros.found[:_LISTED_ZEROS]:
            yield f"  {_place(zero.at)}, {zero.method}"
        if len(zeros.found) > _LISTED_ZEROS:
            yield f"  and {len(zeros.found) - _LISTED_ZEROS} more: --json lists them"
    grids = [(claim.name, claim.minimum, claim.verdict) for claim in measured.grids]
    yield Table("what grids say", ("grid", "minimum", "verdict"), grids)
    neighbours = [
        (", ".join(map(str, neighbour.flips)), neighbour.minimum, neighbour.code.bits)
        for neighbour in measured.neighbours
    ]
    if neighbours:
        yield Table("better codes nearby", ("flip chips", "minimum", "bits"), neighbours)
    else:
        yield f"no better code was found within {measured.flips} flips"


def _place(frequency: tuple[float, ...]) -> str:
    """Write one frequency along a straight motion, or the two of a path."""
    numbers = ", ".join(f"{value:.5f}" for value in frequency)
    if len(frequency) == 1:
        return f"{numbers} cycles per chip"
    return f"({numbers}) cycles/px"


def _in_words(verified: Verdict | None) -> str:
    if verified is None:
        return ""
    if verified.holds:
        return "; the file's certificate is confirmed"
    return f"; the file's certificate is refused: {verified.reasons[-1]}"
