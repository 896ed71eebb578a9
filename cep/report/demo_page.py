"""HTML report of the demo: motion, code, expected gains and losses, restored photos."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cep.optics.camera import LIGHT_LEVELS
from cep.optics.exposure import coded_psf
from cep.plots import before_after, code_strips, mtf_figure, psf_figure, trajectory_figure
from cep.report.result_page import Report, Section, Table, picture
from motdiff.metrics import mnc_subpixel, path_distance_px
from motdiff.psf_frame import PSF_PX

if TYPE_CHECKING:
    from cep.workflows.demo_chain import Chain

__all__ = ["DEMO_PICTURES", "demo_report", "verdict"]

DEMO_PICTURES = ("code_strip", "mtf", "photos", "restored")
"""Pictures of the report that are files of their own too."""

_SURE = 0.5
_NOTICEABLE_DB = 0.1


def demo_report(chain: Chain) -> Report:
    """Make the report of a chain."""
    open_db, coded_db = (shot.psnr_db for shot in chain.shots[:2])
    facts = (
        ("path", f"{chain.motion.length_px:.1f} px long"),
        ("confidence of the motion", f"{chain.estimate.confidence:.2f}"),
        ("code", f"{chain.code.chips} chips, {chain.code.duty:.0%} of the light"),
        ("restored, open shutter", f"{open_db:.2f} dB"),
        ("restored, coded", f"{coded_db:.2f} dB ({coded_db - open_db:+.2f})"),
        ("direction test", f"{chain.direction.direction} ({chain.direction.confidence:.2f})"),
    )
    colophon = (
        f"coded-exposure {_version('coded-exposure')}, numpy {_version('numpy')}, torch {_version('torch')}, "
        f"Python {platform.python_version()}; seed {chain.seed}; camera: {chain.camera}. "
        + "Seconds: " + ", ".join(f"{what} {seconds:.1f}" for what, seconds in chain.seconds) + "."
    )  # fmt: skip
    sections = (_motion(chain), _code(chain), _mtf(chain), _photos(chain), _light(chain), _next())
    return Report("From one blurred photo to a shutter code", _summary(open_db, coded_db), facts, sections, colophon)


def verdict(expected: tuple[tuple[str, tuple[float, ...]], ...]) -> str:
    """Verdict in words, from the expected figures: where coding gains over the open shutter and where it loses.

    Parameters
    ----------
    expected : tuple of (name, PSNR in dB at each of LIGHT_LEVELS)
        The first row is the code; one is named "open shutter".
    """
    ours = np.array(expected[0][1])
    gains = ours - np.array(dict(expected)["open shutter"])
    wins, losses = _levels(gains, gains > _NOTICEABLE_DB), _levels(gains, gains < -_NOTICEABLE_DB)
    parts = []
    if wins:
        parts.append(f"Coding is expected to gain at {wins} photo-electrons at full scale.")
    if losses:
        parts.append(
            f"It is expected to lose at {losses}: the closed chips cost more light there than the flatter MTF gains."
        )
    if not wins and not losses:
        parts.append("Coding and not coding are expected to differ by less than 0.1 dB at every light level.")
    elif not losses:
        parts.append("No light level among these is expected to lose more than 0.1 dB.")
    for name, values in expected[1:]:
        ahead = np.array(values) - ours
        better = _levels(ahead, ahead > _NOTICEABLE_DB)
        if better and name != "open shutter":
            parts.append(f'The "{name}" is expected to do better than this code at {better}.')
    return " ".join(parts)


def _levels(gains_db: NDArray[np.float64], chosen: NDArray[np.bool_]) -> str:
    return ", ".join(
        f"{level:,.0f} ({gain:+.2f} dB)" for level, gain, one in zip(LIGHT_LEVELS, gains_db, chosen, strict=True) if one
    )


def _summary(open_db: float, coded_db: float) -> str:
    gain = coded_db - open_db
    if gain > _NOTICEABLE_DB:
        return f"The coded photo restores {gain:.2f} dB better than the ordinary one of the same exposure time."
    if gain < -_NOTICEABLE_DB:
        return (
            f"Here coding does not pay: the coded photo restores {-gain:.2f} dB worse than the ordinary one of "
            f"the same "
            "exposure time. The tables below say why."
        )
    return "Here the coded photo restores as well as the ordinary one: within 0.1 dB."


def _motion(chain: Chain) -> Section:
    estimate, motion = chain.estimate, chain.motion
    paragraphs = [
        f"{chain.scene.name}. The method {estimate.method} found a path of {motion.length_px:.1f} px, "
        f"{motion.extent_px:.1f} px wide, with confidence {estimate.confidence:.2f}.",
    ]
    psfs = {"estimated": estimate.psf, "traced path": motion.psf(motion.frame_size(PSF_PX))}
    if chain.scene.motion is not None:
        truth = chain.scene.motion
        psfs["true"] = truth.psf(truth.frame_size(PSF_PX))
        paragraphs.append(
            f"The true motion is known here: the estimated PSF matches it with an MNC of "
            f"{mnc_subpixel(estimate.psf, psfs['true']):.3f} (1 is perfect), the path lies "
            f"{path_distance_px(motion, truth):.2f} px off on average."
        )
    warnings = [*chain.scene.warnings, *estimate.warnings]
    if estimate.confidence < _SURE:
        warnings.append("The confidence is low: everything below builds on a motion that may be wrong.")
    if motion.direction == "unknown":
        paragraphs.append(
            "A path and its reverse give the same photo, so one ordinary photo cannot tell the direction: "
            "the code is designed for the worse of the two."
        )
    return Section(
        "Motion",
        tuple(paragraphs),
        pictures=(
            picture(
                trajectory_figure(chain.scene.photo, motion),
                "The photo and the estimated motion. Dots mark equal steps of time: where they crowd, the camera "
                "dwelt.",
                "blurred photo with the motion path, and the path enlarged, coloured by time",
            ),
            picture(
                psf_figure(psfs),
                "Point spread functions: what a point of light becomes.",
                "point spread functions side by side",
            ),
        ),
        warnings=tuple(warnings),
    )


def _code(chain: Chain) -> Section:
    figures = ("noise_gain_db", "dnf_db", "flatness_var", "mse_db")
    table = Table(
        ("code", "open chips", "light, %", "noise gain, dB", "DNF, dB", "flatness (variance)", "error, dB"),
        tuple(
            (row.label, row.code.open_chips, 100 * row.code.duty, *(row.metrics.in_words(figure) for figure in figures))
            for row in chain.compared
        ),
        highlight=0,
        note="Along the estimated motion, the worse direction where it is unknown; light-true, so a darker code pays "
        "for the light it loses. Noise gain and DNF are those of the inverse filter, the error is "
        "the expected mean square error of the Wiener filter with this camera's noise; lower is better everywhere. The "
        "best snapshot is the one exposure, of any length, with the least error, the best strobe the periodic pulses; "
        "codes outside the limits on light could not be chosen; the length-only code was searched for "
        "a straight motion as long as this one; the random code is the middle one of 15.",
    )
    strips = {row.name: row.code for row in chain.compared if row.name != "open shutter"}
    return Section(
        "Code",
        (
            f"{chain.search.steps:,} moves of the annealing search took {chain.search.seconds:.1f} s. "
            f"The code: {chain.code.bits}",
        ),
        (table,),
        (
            picture(
                code_strips(strips),
                "Codes over time: yellow is open.",
                "shutter codes as strips of chips",
                name="code_strip",
            ),
        ),
        ("The search was stopped by its time limit: another machine may find another code.",)
        if chain.search.stopped == "time"
        else (),
    )


def _mtf(chain: Chain) -> Section:
    shown = ("this code", "open shutter", "best snapshot")
    codes = {row.name: row.code for row in chain.compared if row.name in shown}
    figure = mtf_figure(chain.motion, codes)
    size = chain.motion.frame_size(PSF_PX)
    psfs = {"open shutter": chain.motion.psf(size), "this code": coded_psf(chain.motion, chain.code, size)}
    return Section(
        "MTF",
        (
            "What the motion leaves of each spatial frequency. The open shutter starts at 1 and falls into deep "
            "valleys; "
            "the code starts lower, at its share of the light, and should keep the valleys shallow.",
        ),
        pictures=(
            picture(
                figure,
                "Above: along the motion's main axis. Below: the whole band, all maps on one scale.",
                "modulation transfer functions",
                name="mtf",
            ),
            picture(psf_figure(psfs), "The motion as the open and the coded shutter draw it.", "two PSFs"),
        ),
    )


def _photos(chain: Chain) -> Section:
    table = Table(
        ("photo", "light, %", "PSNR of the restoration, dB"),
        tuple((shot.name, 100 * shot.code.duty, shot.psnr_db) for shot in chain.shots),
        highlight=1,
        note="Grey, linear light, up to a shift, borders left out, against the scene at rest. Both photos have the "
        "same exposure time and the same motion; Wiener filter with the camera's noise.",
    )
    open_shot, coded_shot = chain.shots[:2]
    light = coded_shot.code.duty
    taken = {
        "open shutter, as taken": open_shot.photo,
        "coded, as taken": coded_shot.photo,
        f"coded, brightened {1 / light:.2g} times": coded_shot.photo / light,
    }
    restored = {
        "open shutter, restored": open_shot.restored,
        "coded, restored": coded_shot.restored,
        "scene at rest": chain.reference,
    }
    likely = {
        "forward": "runs as drawn",
        "reverse": "runs backwards",
        "reordered": "runs through some of its loops the other way round",
        "undecidable": "cannot be told",
    }
    paragraphs = [
        f"The coded photo is simulated: this camera, this motion, this code. The direction test says that the motion "
        f"{likely[chain.direction.direction]} (confidence {chain.direction.confidence:.2f})."
    ]
    if chain.scene.sharp is None:
        paragraphs.append(
            "The true scene of your photo is not known: its own restoration (TV) stands in for the scene, and "
            "both photos "
            "here are simulated from it with the estimated motion. The figures compare the two ways of exposing, "
            "they do "
            "not measure how well your photo was restored."
        )
    return Section(
        "Photos",
        tuple(paragraphs),
        (table,),
        (
            picture(
                before_after(taken, detail_of=chain.reference),
                "Before. Below: the framed detail. The coded photo is darker, since the shutter was closed for part of "
                "the time.",
                "the ordinary and the coded photo, with a detail of each",
                name="photos",
            ),
            picture(
                before_after(restored),
                "After, all at the brightness of the full exposure. Below: the framed detail.",
                "both photos restored, beside the scene at rest",
                name="restored",
            ),
        ),
    )


def _light(chain: Chain) -> Section:
    columns = ("code", *(f"{level:,.0f} e⁻" for level in LIGHT_LEVELS))
    table = Table(
        columns,
        tuple((name, *values) for name, values in chain.expected_db),
        highlight=0,
        note="Expected PSNR, dB, of the Wiener restoration of a 1/f² scene, by photo-electrons at full scale, at this "
        f"camera's read noise of {chain.camera.read_noise_e:g} e⁻; the motion taken as exactly known.",
    )
    return Section("Where coding gains and where it loses", (verdict(chain.expected_db),), (table,))


def _next() -> Section:
    return Section(
        "With your own camera",
        (
            "The folder of this report holds the motion (trajectory.json, psf.npy, psf.mat), the code "
            "(code.json), and the "
            "shutter program as shutter_code.h, .csv and .json.",
            "make demo PHOTO=path, or cep demo --photo path, does the same on a blurred photo of yours; cep "
            "upload code.json "
            "--port PORT puts the code on a shutter controller; cep deblur restores the coded photo.",
        ),
    )


def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:  # run from the source tree
        return "(not installed)"
