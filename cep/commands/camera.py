"""``cep camera``: profiles of cameras, and the figures of one's own measured."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from cep.commands.console import Page, Table, finish, progress
from cep.commands.options import (
    CameraFileOptions,
    Force,
    Json,
    TableFile,
    argument,
    command,
    option,
    table_files,
)

if TYPE_CHECKING:
    from cep.optics.camera import Camera

camera = typer.Typer(
    help="Cameras: known ones, and yours measured from flat frames.", no_args_is_help=True
)


@dataclass(frozen=True, kw_only=True)
class ListOptions:
    """Options of ``cep camera list``."""

    camera: str | None = argument(
        "NAME", "One camera in full, or a .json or .toml file.", default=None
    )
    table: TableFile = None
    force: Force = False
    as_json: Json = False


@camera.command("list")
@command(ListOptions)
def list_(options: ListOptions) -> None:
    """List the cameras that --camera knows by name, or show one with the source of its figures.

    Full well and read noise are in electrons, gain in electrons per code value.

    Example: cep camera list --json

    Example: cep camera list sony-imx250
    """
    from cep.optics.camera import Camera, camera_names
    from motdiff.files.outputs import claim

    outputs = claim(table_files(options.table), force=options.force)
    result: dict[str, object]
    if options.camera is None:
        profiles = [Camera.load(name) for name in camera_names()]
        result = {"cameras": [profile.to_dict() for profile in profiles]}
        page: Page = [_list_of(profiles)]
    else:
        profile = Camera.load(options.camera)
        result = {"camera": profile.to_dict()}
        page = [_figures_of(profile), f"source: {profile.source or 'not stated'}"]
    finish(result, page, as_json=options.as_json, outputs=outputs, tables=options.table)


def _list_of(profiles: list[Camera]) -> Table:
    from cep.files.formatting import formatted

    rows = [
        (
            profile.name,
            profile.kind,
            f"{profile.full_well_e:.0f}",
            f"{profile.read_noise_e:g}",
            profile.bits,
            formatted(profile.gain_e_per_dn, "g"),
        )
        for profile in profiles
    ]
    return Table("cameras", ("name", "kind", "full well", "read noise", "bits", "gain"), rows)


def _figures_of(profile: Camera) -> Table:
    from cep.files.formatting import formatted

    rows = [
        ("kind", profile.kind or None),
        ("electrons at value 1", f"{profile.photons_full_scale:.6g}"),
        ("full well, e-", formatted(profile.full_well_e, ".6g")),
        ("read noise, e-", f"{profile.read_noise_e:g}"),
        ("bits", profile.bits),
        ("response", profile.response),
        ("gain, e- per code value", formatted(profile.gain_e_per_dn, "g")),
        ("black level, of value 1", f"{profile.black_level:g}"),
        # 0 of these two stands for a figure that the source does not state
        ("dark current, e-/s", formatted(profile.dark_current_e_s or None, "g")),
        ("least exposure, s", formatted(profile.least_exposure_s or None, "g")),
    ]
    return Table(profile.name, ("", ""), rows)


@dataclass(frozen=True, kw_only=True)
class EstimateOptions(CameraFileOptions):
    """Options of ``cep camera estimate``."""

    flats: list[Path] = argument(
        "FLAT...",
        "Frames of an evenly lit surface, two of each level of light, one after the other.",
    )
    dark: tuple[Path, Path] | None = option("--dark", "D1 D2", "Two frames without light.")
    black: float | None = option(
        "--black",
        "DN",
        "Code value without light, where there are no dark frames; RAW files state it.",
        min=0,
    )
    bits: int | None = option(
        "--bits", "N", "Of the camera; found from the values when omitted.", min=1, max=16
    )
    gamma: str = option(
        "--gamma", "CURVE", "Curve of PNG and TIFF files: linear or srgb.", "linear"
    )
    table: TableFile = None
    force: Force = False
    as_json: Json = False


@camera.command("estimate")
@command(EstimateOptions)
def estimate(options: EstimateOptions) -> None:
    """Measure gain, read noise and full well from pairs of flat frames: the photon-transfer curve.

    Photograph an evenly lit surface out of focus, two frames at each of three levels of light or
    more, up to one that is too bright, and two with the cap on. Keep the gain, and switch all
    processing off. Files are grey PNG or TIFF of 8 or 16 bits, or RAW. The noise is that of the
    two frames' difference, so uneven light does no harm.

    Example: cep camera estimate flat1a.png flat1b.png flat2a.png flat2b.png --dark dark1.png
    dark2.png -o camera.toml

    Example: cep camera estimate bright1.dng bright2.dng --dark dark1.dng dark2.dng
    """
    from cep.calibration.camera_from_frames import estimate_camera
    from motdiff.files.outputs import claim

    options.check_names()
    output = options.output
    outputs = claim(
        [output, options.figure, *table_files(options.table)],
        force=options.force,
        # never written over, not even with --force
        inputs=[*options.flats, *(options.dark or ())],
    )
    with progress("measuring") as tick:
        measured = estimate_camera(
            options.flats,
            dark=options.dark or (),
            black_dn=options.black,
            bits=options.bits,
            gamma=options.gamma,
            name=output.stem,
            progress=tick,
        )
    transfer = measured.transfer
    result = {
        "file": output,
        "image": options.figure,
        "camera": measured.camera.to_dict(),
        **transfer.to_dict(),
        "warnings": list(transfer.warnings),
    }
    rows = [
        (
            f"{point.signal_dn:.5g}",
            f"{point.variance_dn2:.4g}",
            f"{point.signal_dn * transfer.gain_e_per_dn:.0f}",
            point.use,
        )
        for point in transfer.points
    ]
    heads = ("mean above black, DN", "variance, DN²", "electrons", "use")
    finish(
        result,
        [
            transfer.summary,
            Table("photon transfer", heads, rows),
            f"{output}: the camera, for --camera; the curve is in {options.figure}",
        ],
        as_json=options.as_json,
        outputs=outputs,
        tables=options.table,
        summary=transfer.summary,
        save=lambda staged: measured.save(staged[output], staged[options.figure]),
    )
