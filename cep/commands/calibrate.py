"""``cep calibrate``: a photo, several of one motion, or each of a folder, to the motion in it."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, make_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from cep.commands.calibrate_next import NextOptions, next_step
from cep.commands.calibrate_refine import refine
from cep.commands.code_options import exposure_seconds
from cep.commands.console import Table, end, finish, part, progress
from cep.commands.errors import in_options, with_photo_file
from cep.commands.options import (
    CommonOptions,
    Gamma,
    Workers,
    argument,
    command,
    option,
    output_option,
)
from motdiff.estimators.method import Kind, Option, command_options
from motdiff.estimators.registry import METHODS, blind_methods

if TYPE_CHECKING:
    from cep.calibration.calibrate import Calibration

# where in the time of the command an estimate begins and ends; the preview and the restored photo
# take most of the rest
_BLIND_ESTIMATE = (0.07, 0.88)
_OTHER_ESTIMATE = (0.3, 0.8)
_SEVERAL_END = 0.96  # of several photos only the first is drawn and restored

# types of the options' values as typer reads them
_TYPES: Mapping[Kind, Any] = {
    "number": float,
    "text": str,
    "duration": str,
    "photo": Path,
    "gyro": Path,
    "codes": list[str],
}

# of all registered methods, by the names of their fields
_OPTIONS: Mapping[str, Option] = {
    name: declared
    for method in METHODS.values()
    for name, declared in command_options(method).items()
}
# heads of the table of a folder
_COLUMNS = {
    "photo": "photo",
    "length_px": "long, px",
    "extent_px": "wide, px",
    "direction": "direction",
    "confidence": "confidence",
    "seconds": "s",
}
_FAILED = "failed"


def _method_field(name: str, declared: Option) -> tuple[str, Any, Any]:
    """Make the field of a method's option, in a panel of the method if no other has it."""
    owners = [key for key, method in METHODS.items() if name in command_options(method)]
    field = option(
        declared.flag,
        declared.metavar,
        declared.help,
        panel=f"With --method {owners[0]}" if len(owners) == 1 else None,
        show_default=declared.shown_default or False,
    )
    return name, _TYPES[declared.kind] | None, field


@dataclass(frozen=True, kw_only=True)
class CalibrateOptions(NextOptions, CommonOptions):
    """Options of ``cep calibrate`` that do not depend on the registered methods."""

    context: typer.Context
    images: list[Path] = argument(
        "IMAGE...",
        "Blurred photo: PNG, TIFF, JPEG, WebP or RAW; several of one motion; or a folder,"
        " each by itself.",
    )
    method: str | None = option(
        "--method",
        "NAME",
        ", ".join(f"{name} ({method.about})" for name, method in METHODS.items())
        + ", or module:name of a user-defined estimator.",
        show_default="motdiff; coded with --code",
    )
    trajectory: Path | None = option(
        "--trajectory",
        "FILE",
        "A calibration, trajectory.json, to be improved by photos of its motion, each"
        " through a known --code.",
    )
    gamma: Gamma = "srgb"
    workers: Workers = None
    output: Path | None = output_option(
        "Folder to write into, IMAGE_motion when omitted; with --trajectory the file to write,"
        " FILE_refined.json when omitted.",
        metavar="PATH",
    )

    def method_options(self) -> dict[str, Any]:
        """Return the values of the methods' options, None for those that are not given."""
        values = {name: getattr(self, name) for name in _OPTIONS}
        for name, declared in _OPTIONS.items():
            if declared.kind == "duration":
                values[name] = exposure_seconds(values[name])
        return values


@command(
    make_dataclass(
        "AllCalibrateOptions",
        [_method_field(name, declared) for name, declared in _OPTIONS.items()],
        bases=(CalibrateOptions,),
        frozen=True,
        kw_only=True,
    )
)
def calibrate(options: CalibrateOptions) -> None:
    """Estimate the motion in a blurred photo, in each of a folder, or in several of one motion.

    A photo with an open shutter shows the path, but neither its order nor its direction in time.
    Several, of any scenes, show it more surely: blind methods search them together, and say how
    repeatable the motion is. Photos of the same motion through known codes (one may be open; cep
    calibration-set designs them) show its order.

    Writes trajectory.json, psf.npy, psf.mat, psf.png, map.png, preview.png and sharpened.png, the
    photo restored; of a folder, into a folder for each photo, named like it, and motions.csv.
    Finished photos are kept: stopped by Ctrl-C, the same command with --force goes on; of a photo
    that fails now, --force removes earlier files.

    With --trajectory a calibrated path is improved by coded photos of that motion. Two or more of
    one scene show the order in time too, and the path to a tenth of a pixel. From a single photo
    the gain is smaller; the given path is kept where the photos show no better one.

    Example: cep calibrate blurred.jpg -o motion

    Example: cep calibrate shots -o shots_motion --workers 4

    Example: cep calibrate run1.png run2.png run3.png -o motion

    Example: cep calibrate open.png coded.png --code open --code code.json -o motion

    With --next the code of the next photo is chosen for this motion: the one that best tells apart
    the orders that the photos so far leave open. That goes on until the order is sure.

    Example: cep calibrate open.png --next next.json -o motion

    Example: cep calibrate open.png coded.png --code open --code next.json --next third.json -o
    motion_2

    Example: cep calibrate light.png --method point --code code.json -o motion

    Example: cep calibrate coded.png --code code.json --trajectory motion/trajectory.json -o
    better.json
    """
    images = options.images
    method_options = options.method_options()
    sources: list[str] = method_options.pop("codes") or []
    if options.next_file is not None and sources == ["open"] and len(images) == 1:
        sources = []  # the first photo of a loop: no code yet, and no order
    if options.next_file is not None and (options.trajectory or any(map(Path.is_dir, images))):
        raise ValueError("--next: is for photos of one motion, without --trajectory")
    folders = [image for image in images if image.is_dir()]
    if options.workers is not None and (options.trajectory is not None or not folders):
        raise ValueError("--workers: is for a folder (cep calibrate FOLDER), here is a single one")
    if options.trajectory is not None:
        refine(options, options.trajectory, method_options, sources)
        return
    method = options.method or ("coded" if sources else "motdiff")
    if sources and folders:
        raise ValueError("--code: is for photos of one motion; give the photos, not a folder")
    if folders and len(images) > 1:
        raise ValueError(
            "IMAGE: several are photos of one motion; give the photos, or one folder alone"
        )
    if folders:
        _calibrate_folder(options, method, method_options)
    else:
        _calibrate_photos(options, method, method_options, sources)


def _calibrate_photos(
    options: CalibrateOptions, method: str, method_options: Mapping[str, Any], sources: list[str]
) -> None:
    """Estimate the motion in a photo, or in several of one motion."""
    images = options.images
    is_blind = method in blind_methods()
    options.check_next(sources, method=method, is_blind=is_blind, photos=len(images))
    with progress(f"estimating the motion ({method})") as tick:
        tick(0.0, "reading the photo")
        from cep.calibration.calibrate import (
            CALIBRATION_FILES,
            check_method,
            estimate_motion,
            read_options,
        )
        from cep.codes.sources import code_file, load_codes
        from cep.files.images import parse_gamma
        from cep.files.shot_files import read_light
        from motdiff.files.outputs import claim, claim_folder

        check_method(method, {**method_options, "codes": sources or None})
        codes = load_codes(sources) or None
        parse_gamma(options.gamma)
        options.check_code(codes or ())
        folder = options.output or images[0].with_name(f"{images[0].stem}_motion")
        claim_folder(folder, CALIBRATION_FILES, force=options.force)
        next_files = [] if options.next_file is None else [options.next_file]
        inputs = [*images, *filter(None, map(code_file, sources))]
        outputs = claim(next_files, force=options.force, inputs=inputs)
        photos = [read_light(image, gamma=options.gamma) for image in images]
        values = read_options(method, method_options, gamma=options.gamma)
        started = time.perf_counter()
        start_share, end_share = _BLIND_ESTIMATE if is_blind else _OTHER_ESTIMATE
        if is_blind and len(images) > 1:
            end_share = _SEVERAL_END
        tick(start_share, "estimating")
        pixels = [photo.pixels for photo in photos]
        try:
            calibration = estimate_motion(
                pixels,
                method=method,
                codes=codes,
                seed=options.seed,
                progress=part(tick, start_share, end_share),
                **values,
            )
        except ValueError as error:
            raise ValueError(_with_file(str(error), images)) from None
        seconds = time.perf_counter() - started
        tick(end_share, "writing")
        source: dict[str, object] = {"image": str(images[0]), "seed": options.seed}
        if codes is not None or len(images) > 1:
            source["images"] = list(map(str, images))
        if codes is not None:
            source["codes"] = [code.bits for code in codes]
        files = calibration.save(
            folder,
            source=source,
            force=options.force,
            bits=min(photos[0].bits, 16),  # a PNG has no floating point
            gamma=options.gamma,
        )
        choice = None
        if options.next_file is not None:  # what fails here does not cost the estimate
            tick(0.97, "choosing the next code")
            choice = options.write_next(
                pixels, codes or (), calibration, outputs=outputs, seed=options.seed
            )
        tick(1.0)
    warnings = [line for photo in photos for line in photo.warnings]
    warnings += [in_options(line, options.context) for line in calibration.warnings]
    result = calibration.to_dict(files, seconds=seconds, warnings=warnings)
    lines = _summary(calibration, folder, seconds=seconds, is_coded=codes is not None)
    if options.next_file is not None:
        result["next"] = choice and {"code": options.next_file, **choice.to_dict()}
        step = next_step(
            choice,
            options,
            sources=sources,
            codes=codes or (),
            estimate=calibration,
            folder=folder,
        )
        lines = [*step, *lines]
    if method_options.get("gyro") is not None:
        columns = calibration.details["columns"]
        lines.append(f"{method_options['gyro']}: {columns}; axes: {calibration.details['axes']}")
    finish(result, lines, as_json=options.as_json)


def _with_file(error: str, images: Sequence[Path]) -> str:
    """Name the file of a photo in an error about it; an error about an option stays as it is."""
    if error.partition(": ")[0] in (*_OPTIONS, "method", "code"):
        return error
    if len(images) > 1:
        return with_photo_file(error, images)
    return f"{images[0]}: {error.removeprefix('photo: ')}"


def _summary(
    calibration: Calibration, folder: Path, *, seconds: float, is_coded: bool
) -> list[str]:
    """Say in lines what was found, and how sure it is."""
    motion = calibration.best
    certainty = f"direction {motion.direction}; confidence {calibration.confidence:.2f}"
    heads = _repeatability(motion.length_px, calibration.details)
    if calibration.details.get("motion_blur", True) is False:
        heads = [f"{calibration.warnings[0]}."]
    elif is_coded:
        certainty = (
            f"in this order in time with probability {calibration.confidence:.2f}, and then exact"
            f" to {calibration.details['path_uncertainty_px']:.2g} px"
        )
    return [
        *heads,
        f"{folder}: path of {motion.length_px:.1f} px, {motion.extent_px:.1f} px wide,"
        f" {certainty}; {calibration.method}, {seconds:.1f} s",
    ]


def _repeatability(length_px: float, details: Mapping[str, Any]) -> list[str]:
    """Say how alike several photos of one motion show it; nothing of one photo."""
    if "seen_in" not in details:
        return []
    agreeing = details["seen_in"]
    photos = details["photos"]
    if agreeing < 2:
        lone_photos = f"no two of {photos} photos alone show it alike"
        return [
            f"One motion of {length_px:.0f} px; {lone_photos}: whether it repeats is not known."
        ]
    squares = sum(distance**2 for distance in details["repeatability_px"] if distance is not None)
    # less one, as one of the paths may be the one that they are compared with
    apart_px = (squares / (agreeing - 1)) ** 0.5
    return [
        f"One motion of {length_px:.0f} px, seen alike in {agreeing} of {photos} photos: their"
        f" paths differ by {apart_px:.2g} px."
    ]


def _calibrate_folder(
    options: CalibrateOptions, method: str, method_options: Mapping[str, Any]
) -> None:
    with progress(f"estimating the motion ({method})") as tick:
        from cep.calibration.calibrate_folder import calibrate_folder

        results = calibrate_folder(
            options.images[0],
            options.output,
            method=method,
            options=method_options,
            gamma=options.gamma,
            seed=options.seed,
            workers=options.workers,
            force=options.force,
            progress=tick,
        )
    failures = {
        str(row["photo"]): str(row["failure"]) for row in results.rows if _state(row) == _FAILED
    }
    warnings = [*results.warnings, *(f"{photo}: {reason}" for photo, reason in failures.items())]
    if results.missing:
        warnings.append(
            f"stopped early: {results.missing} photos are left out; the same command with --force"
            " goes on"
        )
    finish(
        {
            "folder": results.folder,
            "summary": results.summary,
            "method": method,
            "photos": results.figures,
            "seed": options.seed,
            "failures": failures,
            "missing": results.missing,
            "warnings": warnings,
        },
        [folder_table(results.rows), str(results.summary)],
        as_json=options.as_json,
    )
    end(missing=results.missing, failed=len(failures))


def folder_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Lay the motions of a folder's photos out; a figure that no photo has is left out."""
    keys = [
        key for key in _COLUMNS if key == "photo" or any(row.get(key) is not None for row in rows)
    ]
    lines = [(*(row.get(key) for key in keys), _state(row)) for row in rows]
    heads = (*(_COLUMNS[key] for key in keys), "warnings")
    return Table("the motion in each photo", heads, lines, last_columns=1)


def _state(row: Mapping[str, Any]) -> str:
    """Return the state of a photo in a word; reasons and warnings are printed on stderr."""
    from cep.calibration.calibrate_folder import NOT_REACHED

    failure = row.get("failure")
    if failure == NOT_REACHED:
        return NOT_REACHED
    if failure:
        return _FAILED
    return str(len(row.get("warnings") or ()) or "")
