"""``cep camera``: profiles of cameras, and the figures of one's own measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cep.commands.console import finish, progress, table
from cep.commands.options import (
    Force,
    Json,
    PlotFile,
    TableFile,
    command,
    output_option,
    table_files,
)

if TYPE_CHECKING:
    from rich.console import Console

    from cep.optics.camera import Camera

camera = typer.Typer(
    help="Cameras: known ones, and yours measured from flat frames.", no_args_is_help=True
)


@dataclass(frozen=True, kw_only=True)
class ListOptions:
    """Options of ``cep camera list``."""

    camera: Annotated[
        str | None,
        typer.Argument(metavar="NAME", help="One camera in full, or a .json or .toml file."),
    ] = None
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
    if options.camera is None:
        profiles = [Camera.load(name) for name in camera_names()]
        result: dict[str, object] = {"cameras": [profile.to_dict() for profile in profiles]}

        def show(console: Console) -> None:
            _show_all(console, profiles)

    else:
        profile = Camera.load(options.camera)
        result = {"camera": profile.to_dict()}

        def show(console: Console) -> None:
            _show(console, profile)

    finish(result, as_json=options.as_json, show=show, outputs=outputs, tables=options.table)


def _show_all(console: Console, profiles: Sequence[Camera]) -> None:
    rows = [
        (
            profile.name,
            profile.kind,
            f"{profile.full_well_e:.0f}",
            f"{profile.read_noise_e:g}",
            profile.bits,
            None if profile.gain_e_per_dn is None else f"{profile.gain_e_per_dn:g}",
        )
        for profile in profiles
    ]
    heads = ("name", "kind", "full well", "read noise", "bits", "gain")
    console.print(table("cameras", heads, rows))


def _show(console: Console, profile: Camera) -> None:
    rows = [
        ("kind", profile.kind or None),
        ("electrons at value 1", f"{profile.photons_full_scale:.6g}"),
        ("full well, e-", None if profile.full_well_e is None else f"{profile.full_well_e:.6g}"),
        ("read noise, e-", f"{profile.read_noise_e:g}"),
        ("bits", profile.bits),
        ("response", profile.response),
        (
            "gain, e- per code value",
            None if profile.gain_e_per_dn is None else f"{profile.gain_e_per_dn:g}",
        ),
        ("black level, of value 1", f"{profile.black_level:g}"),
        (
            "dark current, e-/s",
            f"{profile.dark_current_e_s:g}" if profile.dark_current_e_s else None,
        ),
        (
            "least exposure, s",
            f"{profile.least_exposure_s:g}" if profile.least_exposure_s else None,
        ),
    ]
    console.print(table(profile.name, ("", ""), rows))
    console.print(f"source: {profile.source or 'not stated'}")


@dataclass(frozen=True, kw_only=True)
class EstimateOptions:
    """Options of ``cep camera estimate``."""

    flats: Annotated[
        list[Path],
        typer.Argument(
            metavar="FLAT...",
            help=(
                "Frames of an evenly lit surface, two of each level of light, one after the other."
            ),
        ),
    ]
    dark: Annotated[
        tuple[Path, Path] | None,
        typer.Option("--dark", metavar="D1 D2", help="Two frames without light."),
    ] = None
    black: Annotated[
        float | None,
        typer.Option(
            "--black",
            metavar="DN",
            min=0,
            help="Code value without light, where there are no dark frames; RAW files state it.",
        ),
    ] = None
    bits: Annotated[
        int | None,
        typer.Option(
            "--bits",
            metavar="N",
            min=1,
            max=16,
            help="Of the camera; found from the values when omitted.",
        ),
    ] = None
    gamma: Annotated[
        str,
        typer.Option(
            "--gamma", metavar="CURVE", help="Curve of PNG and TIFF files: linear or srgb."
        ),
    ] = "linear"
    output: Annotated[Path, output_option("Camera to write, .toml or .json.")] = Path(
        "camera.toml"
    )
    plot: PlotFile = None
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
    from cep.plots import check_figure_name
    from motdiff.files.outputs import claim

    output = options.output
    if output.suffix.lower() not in (".toml", ".json"):
        raise ValueError(f"{output}: a camera file must end in .json or .toml")
    picture = options.plot or output.with_suffix(".png")
    try:
        check_figure_name(picture)
    except ValueError as error:
        raise ValueError(f"--plot: {error}") from None
    outputs = claim(
        [output, picture, *table_files(options.table)],
        force=options.force,
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
        "image": picture,
        "camera": measured.camera.to_dict(),
        **transfer.to_dict(),
        "warnings": list(transfer.warnings),
    }

    def show(console: Console) -> None:
        console.print(transfer.summary)
        rows = [
            (
                f"{point.signal_dn:.5g}",
                f"{point.variance_dn2:.4g}",
                f"{point.signal_dn * transfer.gain_e_per_dn:.0f}",
                point.use,
            )
            for point in transfer.points
        ]
        console.print(
            table(
                "photon transfer",
                ("mean above black, DN", "variance, DN²", "electrons", "use"),
                rows,
            )
        )
        console.print(f"{output}: the camera, for --camera; the curve is in {picture}")

    finish(
        result,
        as_json=options.as_json,
        show=show,
        outputs=outputs,
        tables=options.table,
        summary=transfer.summary,
        save=lambda staged: measured.save(staged[output], staged[picture]),
    )
