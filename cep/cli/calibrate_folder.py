"""``cep calibrate FOLDER``: the motion in each photo of a folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cep.cli.console import progress
from cep.cli.folders import NOT_REACHED, discard, finish_folder, run_folder, summary_csv

if TYPE_CHECKING:
    from cep.bench.engine import Outcome

__all__ = ["calibrate_folder"]

_SUMMARY = "motions.csv"
_COLUMNS = {
    "photo": "photo",
    "length_px": "long, px",
    "extent_px": "wide, px",
    "direction": "direction",
    "confidence": "confidence",
    "seconds": "s",
}
_MORE = ("method", "warnings", "failure")


def calibrate_folder(
    folder: Path,
    method: str,
    options: Mapping[str, Any],
    *,
    gamma: str,
    seed: int,
    workers: int | None,
    dask: str | None,
    cache: Path | None,
    output: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """Estimate, write and print the motion in each photo; one that fails is told of, the others are kept.

    Parameters
    ----------
    folder : Path
    method : str
    options : mapping
        Of the method, as of :func:`cep.calibrate.check_options`.
    gamma, seed, workers, dask, cache, output, force, as_json
        As the command's options.

    Raises
    ------
    ValueError
        If there are no photos, an output is in the way, or the options suit no folder.
    """
    from cep.bench.cells import Cell
    from cep.calibrate import CALIBRATION_FILES, check_options
    from cep.calibrate_folder import estimate_photo, estimator_version, photos_in, sharp_of, unreadable
    from cep.images import parse_gamma, read_image
    from cep.outputs import claim_folder, write_text

    check_options(method, options)
    if method == "gyro":
        raise ValueError("--method gyro: --start is the opening of one photo; give the photos of a folder one by one")
    parse_gamma(gamma)
    sharp = options["sharp"]
    photos = photos_in(folder, but=sharp)
    sharps = {} if sharp is None else sharp_of(photos, sharp)
    if sharp is not None and not sharp.is_dir():
        read_image(sharp, gamma=gamma, variable="x")  # what is wrong with it is wrong with every photo
    named = folder if folder.name not in ("", "..") else folder.resolve()  # as "." has no name of its own
    target = output or named.with_name(f"{named.name}_motion")
    claim_folder(target, [_SUMMARY], force=force)
    for photo in photos:
        claim_folder(target / photo.stem, CALIBRATION_FILES, force=force)
    failures = {_label(photo): reason for photo in photos if (reason := unreadable(photo))}
    by_label = {_label(photo): photo for photo in photos}
    version = estimator_version(method)
    cells = [
        Cell(
            (label,),
            estimate_photo,
            {
                "photo": photo, "method": method, "samples": options["samples"], "quick": options["quick"],
                "gamma": gamma, "seed": seed, "sharp": sharps.get(photo),
            },
            version,
        )
        for label, photo in by_label.items()
        if label not in failures
    ]  # fmt: skip
    outcome = run_folder(
        cells,
        task=f"estimating the motion ({method})",
        noun="photos",
        cache=cache or target / "cells",
        workers=workers,
        dask=dask,
    )
    failures |= {label: reason for (label,), reason in outcome.failures.items()}
    motions = _written(outcome, by_label, failures, target=target, gamma=gamma, seed=seed, force=force)
    if force:
        for label in failures:
            discard(target / by_label[label].stem, CALIBRATION_FILES)
    rows = [
        {
            "photo": label,
            **motions.get(label, {}),
            "failure": failures.get(label, "" if label in motions else NOT_REACHED),
        }
        for label in by_label
    ]
    spelt = [{**row, "warnings": "; ".join(row.get("warnings", ()))} for row in rows]
    target.mkdir(parents=True, exist_ok=True)  # nothing is in it where every photo failed
    write_text(target / _SUMMARY, summary_csv((*_COLUMNS, *_MORE), spelt))
    finish_folder(
        {"folder": target, "summary": target / _SUMMARY, "method": method, "photos": motions, "seed": seed},
        _COLUMNS,
        rows,
        title="the motion in each photo",
        noun="photos",
        missing=outcome.missing,
        warnings=[
            *outcome.warnings,
            *(f"{label}: {line}" for label, one in motions.items() for line in one["warnings"]),
        ],
        as_json=as_json,
    )


def _written(
    outcome: Outcome,
    by_label: Mapping[str, Path],
    failures: dict[str, str],
    *,
    target: Path,
    gamma: str,
    seed: int,
    force: bool,
) -> dict[str, dict[str, Any]]:
    """Write what was found, each as ``cep calibrate PHOTO`` does; photos that have gone are added to the failures."""
    from cep.calibrate import write_calibration
    from cep.calibrate_folder import estimate_from_figures
    from cep.images import read_image

    done = {label: figures for (label,), figures in outcome.figures.items() if figures}
    motions: dict[str, dict[str, Any]] = {}
    with progress("writing") as tick:
        for label, figures in done.items():
            tick(len(motions) / len(done), label)
            photo = by_label[label]
            try:
                pixels = read_image(photo, gamma=gamma)
            except (ValueError, OSError) as error:  # it was there when its motion was estimated, maybe hours ago
                failures[label] = f"has changed since: {error}"
                continue
            found, warnings = estimate_from_figures(figures)
            source = {"image": str(photo), "seed": seed}
            files = write_calibration(target / photo.stem, found, pixels, source=source, force=force)
            motion = found.trajectories[0]
            motions[label] = {
                "method": found.method,
                "trajectory": files["trajectory.json"],
                "psf": files["psf.npy"],
                "length_px": motion.length_px,
                "extent_px": motion.extent_px,
                "direction": motion.direction,
                "confidence": found.confidence,
                "seconds": figures["seconds"],
                "warnings": warnings,
                "files": list(files.values()),
                "details": found.details,
            }
    return motions


def _label(photo: Path) -> str:
    """Return the photo's name as it can be printed, whatever bytes it has."""
    return photo.name.encode("utf-8", "backslashreplace").decode()
