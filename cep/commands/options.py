"""Options that several commands share, and the dataclasses that they fill."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_type_hints

import typer

if TYPE_CHECKING:
    from cep.optics.camera import Camera
    from cep.optics.scene import Scene
    from cep.photographs.scene_photo import ScenePhoto
    from cep.proofs.measure import FigureOfMerit
    from motdiff.files.outputs import Outputs
    from motdiff.files.trajectories import StoredMotion
    from motdiff.trajectory import Trajectory
    from motdiff.types import FloatArray

Options = TypeVar("Options")

# panels of the help pages
COMMON = "Common options"
MOTION = "Motion"
CAMERA = "Camera"
SCENE = "Scene"
MANY = "Folders and benchmarks"  # work that is cut into parts

Json = Annotated[
    bool,
    typer.Option(
        "--json", help="Print one JSON object on stdout, nothing else.", rich_help_panel=COMMON
    ),
]
Seed = Annotated[
    int,
    typer.Option(
        "--seed",
        metavar="N",
        min=0,
        help="Seed of every random draw; the same seed, the same files.",
        rich_help_panel=COMMON,
    ),
]
Force = Annotated[
    bool, typer.Option("--force", help="Replace outputs that exist.", rich_help_panel=COMMON)
]
PlotFile = Annotated[
    Path | None,
    typer.Option(
        "--plot",
        metavar="FILE",
        rich_help_panel=COMMON,
        help="Figure to write: .png, .pdf or .svg; named as the output, .png, when omitted.",
    ),
]
TableFile = Annotated[
    Path | None,
    typer.Option(
        "--table",
        metavar="FILE",
        rich_help_panel=COMMON,
        help="Also write the tables, with all their columns: .tex (booktabs), .csv or .md.",
    ),
]
Gamma = Annotated[
    str,
    typer.Option(
        "--gamma", metavar="CURVE", help="Curve of the photo: srgb, linear, or an exponent as 2.2."
    ),
]
CodeSource = Annotated[
    str,
    typer.Argument(
        metavar="CODE",
        help="Bits as 1011..., a code.json, a published code's name, or module:name.",
    ),
]
ChipNs = Annotated[
    int | None,
    typer.Option("--chip-ns", metavar="NS", min=1, help="Chip time, ns; replaces the file's."),
]
Workers = Annotated[
    int | None,
    typer.Option(
        "--workers",
        metavar="N",
        min=1,
        rich_help_panel=MANY,
        help="Processes of one thread; as many as cores when omitted.",
    ),
]


def option(
    name: str,
    metavar: str | None,
    help: str,
    default: Any = None,
    *,
    short: str | None = None,
    panel: str | None = None,
    **more: Any,
) -> Any:
    """Make the field of an option; ``default=MISSING`` where it is needed.

    Parameters
    ----------
    name, short : str
        As ``--chips`` and ``-n``.
    metavar, help : str
        Of the help page.
    panel : str
        Of the help page; its first when omitted.
    **more
        As of :func:`typer.Option`.
    """
    names = filter(None, (name, short))
    info = typer.Option(*names, metavar=metavar, help=help, rich_help_panel=panel, **more)
    return field(default=default, metadata={"typer": info})


def flag(name: str, help: str, *, panel: str | None = None) -> Any:
    """Make the field of an option without a value: whether it is given."""
    return option(name, None, help, default=False, panel=panel)


def argument(metavar: str, help: str, *, default: Any = MISSING) -> Any:
    """Make the field of an argument, needed unless it has a default."""
    return field(default=default, metadata={"typer": typer.Argument(metavar=metavar, help=help)})


def output_option(help: str, default: Path | None = None, *, metavar: str = "FILE") -> Any:
    """Make the field of the option ``-o``."""
    return option("--output", metavar, help, default, short="-o", panel=COMMON)


def _annotated(kind: Any, metadata: Mapping[Any, Any]) -> Any:
    """Annotate a field's type with typer's declaration of it, unless it is already."""
    return Annotated[kind, metadata["typer"]] if "typer" in metadata else kind


def command(options: type[Options]) -> Callable[[Callable[[Options], None]], Callable[..., None]]:
    """Declare a command's arguments and options by the dataclass that they fill.

    Typer wants them as parameters of the function; a function of so many is hard to read, and
    commands could not share them.

    Parameters
    ----------
    options : a dataclass with ``kw_only=True``
        One field per argument or option: by :func:`option`, :func:`flag` or :func:`argument`, or
        annotated with one that commands share. Bases come first on the help page.

    Examples
    --------
    >>> @dataclass(frozen=True, kw_only=True)
    ... class Greeting:
    ...     name: str = option("--name", "TEXT", "Whom to greet.", "you")
    >>> @command(Greeting)
    ... def greet(options: Greeting) -> None:
    ...     print("hello", options.name)
    >>> greet(name="all")
    hello all
    """
    hints = get_type_hints(options, include_extras=True)
    parameters = [
        inspect.Parameter(
            entry.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=inspect.Parameter.empty if entry.default is MISSING else entry.default,
            annotation=_annotated(hints[entry.name], entry.metadata),
        )
        for entry in fields(options)  # type: ignore[arg-type]
    ]

    def declare(run: Callable[[Options], None]) -> Callable[..., None]:
        def from_values(**values: Any) -> None:
            run(options(**values))

        from_values.__name__ = run.__name__
        from_values.__doc__ = run.__doc__  # the help page
        from_values.__module__ = run.__module__
        # typer reads the command line's options from the signature
        from_values.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        from_values.__annotations__ = {p.name: p.annotation for p in parameters}
        return from_values

    return declare


@dataclass(frozen=True, kw_only=True)
class MotionOptions:
    """The motion of a command: ``--trajectory`` or ``--linear``."""

    trajectory: Path | None = option(
        "--trajectory", "FILE", "A trajectory.json, as cep calibrate writes it.", panel=MOTION
    )
    linear: float | None = option(
        "--linear", "PX", "Straight and uniform motion, this many px long.", panel=MOTION
    )

    @property
    def has_motion(self) -> bool:
        """Whether a motion is named."""
        return self.trajectory is not None or self.linear is not None

    def load_motion(self) -> StoredMotion:
        """Return the motion that is named; ValueError unless it is exactly one, and valid."""
        from motdiff.files.trajectories import StoredMotion, read_motion
        from motdiff.trajectory import LONGEST_PX, Trajectory

        if (self.trajectory is None) == (self.linear is None):
            raise ValueError("--trajectory FILE or --linear PX: exactly one of them is needed")
        if self.trajectory is not None:
            return read_motion(self.trajectory)
        assert self.linear is not None
        if not 0 < self.linear <= LONGEST_PX:
            raise ValueError(
                f"--linear: must be a length above 0 and up to {LONGEST_PX:g} px,"
                f" got {self.linear:g}"
            )
        return StoredMotion(Trajectory.straight(self.linear), source={"method": "linear"})

    def path_error_px(self, motion: StoredMotion) -> float:
        """Error of the motion, px rms over time, as its file states it; else 0."""
        if self.trajectory is None:
            return 0.0
        from motdiff.files.trajectories import stated_uncertainty_px

        return stated_uncertainty_px(motion, self.trajectory) or 0.0


@dataclass(frozen=True, kw_only=True)
class CameraOptions:
    """The camera of a command: ``--camera``, changed by ``--photons`` and ``--read-noise``."""

    camera: str | None = option(
        "--camera",
        "NAME|FILE",
        "A camera that cep camera list shows, or a .json or .toml file with its figures.",
        panel=CAMERA,
    )
    photons: float | None = option(
        "--photons", "N", "Photo-electrons at full scale.", panel=CAMERA
    )
    read_noise: float | None = option(
        "--read-noise", "N", "Read noise, electrons rms.", panel=CAMERA
    )

    @property
    def has_camera(self) -> bool:
        """Whether any of the three is given."""
        return (self.camera, self.photons, self.read_noise) != (None, None, None)

    def load_camera(self, standard: Camera | None = None) -> Camera:
        """Return the camera; where none is named ``standard``, by default that of ``Camera()``."""
        from dataclasses import replace

        from cep.optics.camera import Camera

        camera = standard or Camera()
        if self.camera is not None:
            camera = Camera.load(self.camera)
        if self.photons is not None:
            camera = camera.at(self.photons)
        if self.read_noise is not None:
            camera = replace(camera, read_noise_e=self.read_noise)
        return camera


@dataclass(frozen=True, kw_only=True)
class SceneOptions:
    """The scene of a command: ``--scene``, a name or a photo."""

    scene: str = option(
        "--scene",
        "NAME|PHOTO",
        "What is photographed: photo (any), text, texture, flat-part, or a sharp photo of it,"
        " on whose parts gains are measured. Of text, texture and flat-part they are a model's.",
        "photo",
        panel=SCENE,
    )

    @property
    def scene_file(self) -> Path | None:
        """The photo that is named; None where a name of a scene is."""
        from cep.optics.scene import SCENES

        return None if self.scene in SCENES else Path(self.scene)

    @cached_property
    def own_photo(self) -> ScenePhoto | None:
        """That photo; ValueError unless it is valid."""
        from cep.optics.scene import SCENES
        from cep.photographs.scene_photo import ScenePhoto

        if self.scene_file is None:
            return None
        if not self.scene_file.exists():
            raise ValueError(
                f"--scene: must be one of {', '.join(SCENES)}, or the file of a photo; there is"
                f" no file {self.scene}"
            )
        try:
            return ScenePhoto.read(self.scene_file)
        except ValueError as error:
            raise ValueError(f"--scene: {error}") from None

    def load_scene(self) -> Scene:
        """Return the scene that codes are designed for."""
        from cep.optics.scene import SCENES

        photo = self.own_photo
        return SCENES[self.scene] if photo is None else photo.scene

    def pictures(self, *paths: Trajectory) -> tuple[FloatArray, ...] | None:
        """Return the parts of the photo that gains along paths are measured on; None: no photo."""
        from cep.search.measured import LONGEST_PX

        photo = self.own_photo
        if photo is None:
            return None
        if max(path.extent_px for path in paths) > LONGEST_PX:
            return ()
        try:
            return photo.crops(paths)
        except ValueError as error:
            raise ValueError(f"--scene: {error}") from None


@dataclass(frozen=True, kw_only=True)
class CameraFileOptions:
    """The camera that is measured: its file, and the figure of the measurement."""

    output: Path = output_option("Camera to write, .toml or .json.", Path("camera.toml"))
    plot: PlotFile = None

    @property
    def figure(self) -> Path:
        """File of the figure."""
        return self.plot or self.output.with_suffix(".png")

    def check_names(self) -> None:
        """Refuse names of other files than are written."""
        from cep.plots.canvas import check_figure_name

        if self.output.suffix.lower() not in (".toml", ".json"):
            raise ValueError(f"{self.output}: a camera file must end in .json or .toml")
        try:
            check_figure_name(self.figure)
        except ValueError as error:
            raise ValueError(f"--plot: {error}") from None


@dataclass(frozen=True, kw_only=True)
class CommonOptions:
    """What every command takes that writes files."""

    force: Force = False
    seed: Seed = 0
    as_json: Json = False


def table_files(table: Path | None) -> list[Path]:
    """Return the file of ``--table``, checked, to be claimed with the other outputs."""
    from cep.files.tables import check_table_name

    if table is None:
        return []
    try:
        check_table_name(table)
    except ValueError as error:
        raise ValueError(f"--table: {error}") from None
    return [table]


@dataclass(frozen=True, kw_only=True)
class FigureOptions(MotionOptions, CommonOptions):
    """Options of a command that measures codes along a motion."""

    figure: list[str] | None = option(
        "--figure",
        "MODULE:NAME",
        "Also a figure of merit of your own: a function of (trajectory, code) that returns a"
        " number; may be repeated.",
    )
    tables: TableFile = None

    def find_figures(self) -> dict[str, FigureOfMerit]:
        """Return the figures of merit of ``--figure``."""
        from cep.proofs.measure import find_figures

        return find_figures(self.figure or ())

    def outputs(self, output: Path | None) -> Outputs:
        """Return the files that are written: the output, where there is one, and the tables'."""
        from motdiff.files.outputs import Outputs

        return Outputs(tuple(filter(None, [output, *table_files(self.tables)])), self.force)
