"""Section of the demo's report on the motion: what the photos told, and what the open photo alone
would have told.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cep.plots import psf_figure, trajectory_figure
from cep.report.result_page import Section, Table, picture
from motdiff.metrics import mnc_subpixel, path_distance_px, timed_distance_px
from motdiff.psf_frame import PSF_PX

if TYPE_CHECKING:
    from cep.report.demo_chain import Chain

_SURE = 0.5


def motion_section(chain: Chain) -> Section:
    """Make the section on the motion of a chain."""
    motion = chain.estimate.best
    estimate = chain.estimate
    psfs = {"estimated": estimate.psf, "estimated path": motion.psf(motion.frame_size(PSF_PX))}
    if (truth := chain.scene.motion) is not None:
        psfs["true"] = truth.psf(truth.frame_size(PSF_PX))
    warnings = [*chain.scene.warnings, *estimate.warnings]
    if estimate.confidence < _SURE:
        warnings.append(
            "The confidence is low: everything on this page builds on a motion that may be wrong."
        )
    return Section(
        "Motion",
        (f"{chain.scene.name}.", _found(chain), *_truth(chain), *_direction(chain)),
        (*_alone(chain), *_alternatives(chain)),
        (
            picture(
                trajectory_figure(chain.scene.photo, motion),
                "The photo and the estimated motion. Dots mark equal steps of time: where they"
                " crowd, the camera dwelt.",
                "blurred photo with the motion path, and the path enlarged, coloured by time",
            ),
            picture(
                psf_figure(psfs),
                "Point spread functions: what a point of light becomes.",
                "point spread functions side by side",
            ),
        ),
        tuple(warnings),
    )


def _found(chain: Chain) -> str:
    motion = chain.estimate.best
    estimate = chain.estimate
    path = (
        f"found a path of {motion.length_px:.1f} px, {motion.extent_px:.1f} px wide, with"
        f" confidence {estimate.confidence:.2f}"
    )
    if not chain.found.codes:
        return f"The method {estimate.method} {path}."
    return (
        f"The motion was photographed {len(chain.found.codes)} times, with the shutter open and"
        f" through known codes, which write the time onto the path. Together these photos {path},"
        f" and expect it to be {estimate.path_error_px:.2f} px off."
    )


def _truth(chain: Chain) -> tuple[str, ...]:
    if (truth := chain.scene.motion) is None:
        return ()
    motion = chain.estimate.best
    true_psf = truth.psf(truth.frame_size(PSF_PX))
    off = (
        f"{timed_distance_px(motion, truth):.2f} px off at equal times (rms)"
        if motion.direction == "known"
        else f"{path_distance_px(motion, truth):.2f} px off on average"
    )
    return (
        (
            "The true motion is known here: the estimated PSF matches it with an MNC of"
            f" {mnc_subpixel(chain.estimate.psf, true_psf):.3f} (1 is perfect), the path lies"
            f" {off}."
        ),
    )


def _direction(chain: Chain) -> tuple[str, ...]:
    said = []
    if chain.estimate.best.direction == "unknown":
        said.append(
            "One ordinary photo cannot tell the direction: a path and its reverse give the same"
            " photo. So the exposure is chosen for the worse of the two."
        )
    if chain.coded and not chain.found.codes:
        said.append(
            "Two to four photos of the same motion through known codes would tell its direction"
            " and order in time, and the error of the path: cep calibration-set designs the codes."
            " Once a coded photo is taken, cep calibrate --trajectory improves the path by it."
        )
    return tuple(said)


def _alone(chain: Chain) -> tuple[Table, ...]:
    """Compare what the set gives with what the open photo alone would have given."""
    alone = chain.found.alone
    truth = chain.scene.motion
    if alone is None or chain.alone is None or truth is None:
        return ()
    rows = tuple(
        (
            photos,
            estimate.best.direction,
            (
                f"{timed_distance_px(estimate.best, truth):.2f}"
                if estimate.best.direction == "known"
                else f"{path_distance_px(estimate.best, truth):.2f}"
            ),
            shot.way.label,
            f"{shot.psnr_db:.2f}",
        )
        for photos, estimate, shot in (
            (f"{len(chain.found.codes)}, through codes", chain.estimate, chain.advised_shot),
            ("1, open shutter", alone, chain.alone),
        )
    )
    return (
        Table(
            (
                "calibration photos",
                "direction",
                "path off, px",
                "exposure advised along it",
                "PSNR restored, dB",
            ),
            rows,
            highlight=0,
            note=(
                "Each exposure is photographed with the true motion and restored along the path of"
                " its row. A path without a direction is compared as a shape, without its timing."
            ),
        ),
    )


def _alternatives(chain: Chain) -> tuple[Table, ...]:
    motion = chain.estimate.best
    estimate = chain.estimate
    others = tuple(
        (
            f"alternative {i}",
            f"{weight:.2f}",
            f"{path.length_px:.1f}",
            f"{path_distance_px(path, motion):.1f}",
        )
        for i, (weight, path) in enumerate(
            zip(estimate.weights[1:], estimate.trajectories[1:], strict=True), 1
        )
    )
    if not others:
        return ()
    rows = (("most likely", f"{estimate.weights[0]:.2f}", f"{motion.length_px:.1f}", "0"), *others)
    note = "Other paths that explain the photos."
    return (Table(("path", "weight", "length, px", "distance, px"), rows, highlight=0, note=note),)
