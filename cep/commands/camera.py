"""``cep camera``: profiles of cameras, and the figures of one's own measured."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cep.commands.console import finish, progress, table
from cep.commands.options import Force, Json, PlotFile, TableFile, output_option, table_files

if TYPE_CHECKING:
    from rich.console import Console

    from cep.optics.camera import Camera

camera = typer.Typer(
    help="Cameras: known ones, and yours measured from flat frames.", no_args_is_help=True
)


@camera.command("list")
def list_(tables: TableFile = None, force: Force = False, as_json: Json = False) -> None:
    """List the cameras that --camera knows by name.

    Full well and read noise are in electrons, gain in electrons per code value.

    Example: cep camera list --json
    """
    from cep.optics.camera import Camera, camera_names
    from motdiff.files.outputs import claim

    outputs = claim(table_files(tables), force=force)
    cameras = [Camera.load(name) for name in camera_names()]
    rows = [
        (
            one.name,
            one.kind,
            f"{one.full_well_e:.0f}",
            f"{one.read_noise_e:g}",
            one.bits,
            None if one.gain_e_per_dn is None else f"{one.gain_e_per_dn:g}",
        )
        for one in cameras
    ]
    shown = table("cameras", ("name", "kind", "full well", "read noise", "bits", "gain"), rows)
    result = {"cameras": [one.to_dict() for one in cameras]}
    finish(
        result,
        as_json=as_json,
        show=lambda console: console.print(shown),
        outputs=outputs,
        tables=tables,
    )


@camera.command("show")
def show(
    camera: Annotated[
        str,
        typer.Argument(
            metavar="NAME", help="A camera that cep camera list shows, or a .json or .toml file."
        ),
    ],
    as_json: Json = False,
) -> None:
    """Show a camera's figures and where they come from.

    Example: cep camera show sony-imx250
    """
    from cep.optics.camera import Camera

    found = Camera.load(camera)
    finish(
        {"camera": found.to_dict()}, as_json=as_json, show=lambda console: _show(console, found)
    )


def _show(console: Console, found: Camera) -> None:
    rows = [
        ("kind", found.kind or None),
        ("electrons at value 1", f"{found.photons_full_scale:.6g}"),
        ("full well, e-", None if found.full_well_e is None else f"{found.full_well_e:.6g}"),
        ("read noise, e-", f"{found.read_noise_e:g}"),
        ("bits", found.bits),
        ("response", found.response),
        (
            "gain, e- per code value",
            None if found.gain_e_per_dn is None else f"{found.gain_e_per_dn:g}",
        ),
        ("black level, of value 1", f"{found.black_level:g}"),
        ("dark current, e-/s", f"{found.dark_current_e_s:g}" if found.dark_current_e_s else None),
        ("least exposure, s", f"{found.least_exposure_s:g}" if found.least_exposure_s else None),
    ]
    console.print(table(found.name, ("", ""), rows))
    console.print(f"source: {found.source or 'not stated'}")


@camera.command("estimate")
def estimate(
    flats: Annotated[
        list[Path],
        typer.Argument(
            metavar="FLAT...",
            help=(
                "Frames of an evenly lit surface, two of each level of light, one after the other."
            ),
        ),
    ],
    dark: Annotated[
        tuple[Path, Path] | None,
        typer.Option("--dark", metavar="D1 D2", help="Two frames without light."),
    ] = None,
    black: Annotated[
        float | None,
        typer.Option(
            "--black",
            metavar="DN",
            min=0,
            help="Code value without light, where there are no dark frames; RAW files state it.",
        ),
    ] = None,
    bits: Annotated[
        int | None,
        typer.Option(
            "--bits",
            metavar="N",
            min=1,
            max=16,
            help="Of the camera; found from the values when omitted.",
        ),
    ] = None,
    gamma: Annotated[
        str,
        typer.Option(
            "--gamma", metavar="CURVE", help="Curve of PNG and TIFF files: linear or srgb."
        ),
    ] = "linear",
    output: Annotated[Path, output_option("Camera to write, .toml or .json.")] = Path(
        "camera.toml"
    ),
    plot: PlotFile = None,
    tables: TableFile = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
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

    if output.suffix.lower() not in (".toml", ".json"):
        raise ValueError(f"{output}: a camera file must end in .json or .toml")
    picture = plot or output.with_suffix(".png")
    try:
        check_figure_name(picture)
    except ValueError as error:
        raise ValueError(f"--plot: {error}") from None
    outputs = claim(
        [output, picture, *table_files(tables)], force=force, inputs=[*flats, *(dark or ())]
    )
    with progress("measuring") as tick:
        found = estimate_camera(
            flats,
            dark=dark or (),
            black_dn=black,
            bits=bits,
            gamma=gamma,
            name=output.stem,
            progress=tick,
        )
    transfer = found.transfer
    result = {
        "file": output,
        "image": picture,
        "camera": found.camera.to_dict(),
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
        as_json=as_json,
        show=show,
        outputs=outputs,
        tables=tables,
        summary=transfer.summary,
        save=lambda made: found.save(made[output], made[picture]),
    )
