"""Run of the coded-exposure table in three cached stages: motions, codes, photos."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from cep.optics.code import ShutterCode
from lab.bench.coded.calibrations import (
    CALIBRATIONS,
    motion_from_codes,
    motion_from_light,
    set_of_codes,
)
from lab.bench.coded.designs import DESIGNS, USUAL_DESIGNS, MotionPrior
from lab.bench.coded.estimates import (
    ESTIMATORS,
    Estimates,
    assumed_path,
    kinds_needed,
    motion_prior,
    restored_by_path,
)
from lab.bench.coded.protocol import (
    CodedProtocol,
    class_motions,
    drawn_motions,
)
from lab.bench.coded.stages import Exposure, choose_code, kernel_of, motion_of, photo_of
from lab.bench.coded.versions import (
    code_version,
    kernel_version,
    motion_version,
    photo_version,
    set_version,
)
from lab.bench.datasets import Cut
from lab.jobs.cells import Cell, Figure
from lab.jobs.engine import Engine, Outcome
from motdiff.simulate import border_px

_NAME = re.compile(r"[\w.+-]+")
_STAGES = {  # of the progress
    "set": (0.0, 0.01),
    "motion": (0.01, 0.25),
    "code": (0.25, 0.6),
    "kernel": (0.6, 0.65),
    "photo": (0.65, 1.0),
}


@dataclass(frozen=True)
class Shot:
    """One coded photo, restored.

    Attributes
    ----------
    design, photo : str
        The design's name; that of the user's own code.
    motion : int
    photons : float or None
    figures : mapping
        Of :func:`lab.bench.coded.stages.take_photo`, and ``kernel_mnc`` where the kernel was found
        in the photo.
    bits : str
    arguments : mapping
        Arguments of :func:`lab.bench.coded.stages.photo_of`.
    """

    design: str
    photo: str
    motion: int
    photons: float | None
    figures: Mapping[str, Figure]
    bits: str
    arguments: Mapping[str, Any]


@dataclass(frozen=True)
class CodedTable:
    """All measured figures of the table.

    Attributes
    ----------
    protocol : CodedProtocol
    shots : tuple of Shot
        In order of design, light, photo and motion; without the failed ones.
    estimates : mapping from (kind, photo, motion) to figures
        Of :func:`lab.bench.coded.stages.estimate_motion`, or of
        :mod:`lab.bench.coded.calibrations`.
    outcome : Outcome
        Of all stages.
    """

    protocol: CodedProtocol
    shots: tuple[Shot, ...]
    estimates: Estimates
    outcome: Outcome


def measure_coded(
    protocol: CodedProtocol,
    photos: Mapping[str, Path],
    *,
    engine: Engine,
    designs: Sequence[str] = USUAL_DESIGNS,
    codes: Mapping[str, ShutterCode] | None = None,
    calibrated_on: Sequence[Path] = (),
    progress: Callable[[float, str], None] = lambda _fraction, _note: None,
) -> CodedTable:
    """Measure every design on every photo, motion and light level.

    Parameters
    ----------
    protocol : CodedProtocol
    photos : mapping from a photo's name to its file
        Sharp; seeds of its crop and noise depend on the name.
    engine : Engine
    designs : sequence of names of :data:`lab.bench.coded.designs.DESIGNS`
    codes : mapping from a name to a code, optional
        Codes of the user's own, which follow the designs; :func:`check_names` says what names they
        may have.
    calibrated_on : sequence of Path
        Photos whose most textured parts are shown by coded calibration photos: one for each motion
        in turn, for all sharp photos alike. The sharp ones themselves when empty.
    progress : callable

    Raises
    ------
    ValueError
        If a design is unknown or comes twice, or a code has the name of a design.
    OSError, RuntimeError
        As :func:`lab.jobs.engine.run_cells`.
    """
    unknown = [name for name in designs if name not in DESIGNS]
    if unknown:
        raise ValueError(f"designs: must be among {', '.join(DESIGNS)}, got {unknown[0]!r}")
    if len(set(designs)) < len(designs):
        raise ValueError(f"designs: each must come once, got {', '.join(designs)}")
    own_codes = codes or {}
    check_names(own_codes)
    stages = _Stages(engine, progress)
    rows = (*designs, *own_codes)
    exposed = _Exposed(protocol, photos)
    estimates = _estimates(exposed, kinds_needed(protocol, rows), calibrated_on, stages)
    bits = _chosen_codes(exposed, designs, estimates, stages)
    bits |= {
        (name, *place): code.bits for name, code in own_codes.items() for place in exposed.places
    }
    # in the table's order: design, light, photo, motion
    keys = [(row, *place) for row in rows for place in exposed.places]
    ordered = {key: bits[key] for key in keys if key in bits}
    shots = _shots(exposed, ordered, estimates, stages)
    return CodedTable(protocol, shots, estimates, stages.outcome)


Place = tuple[str, int, float | None]
"""Photo, motion and light level."""


class _Exposed:
    """Photos, motions and light levels of a protocol."""

    def __init__(self, protocol: CodedProtocol, photos: Mapping[str, Path]) -> None:
        self.protocol = protocol
        self.photos = photos
        self.truths = drawn_motions(protocol)
        self.pairs = [(photo, index) for photo in photos for index in range(len(self.truths))]
        self.places: list[Place] = [
            (photo, index, level) for level in protocol.levels for photo, index in self.pairs
        ]

    def scene(self, photo: str) -> dict[str, Any]:
        """Arguments that a cell has of a photo."""
        return {
            "photo": self.photos[photo],
            "cut": Cut(
                scene_px(self.protocol),
                _gamma(self.protocol),
                (self.protocol.seed, 5, *photo.encode()),
            ),
        }


def _estimates(
    exposed: _Exposed, kinds: Sequence[str], calibrated_on: Sequence[Path], stages: _Stages
) -> Estimates:
    """Estimate or calibrate every motion in every way that is needed."""
    sets = _sets(exposed.protocol, kinds, stages)
    scenes = tuple(calibrated_on) or tuple(exposed.photos.values())
    cells = []
    for kind in kinds:
        if kind in CALIBRATIONS and kind not in sets:
            continue
        version = motion_version(kind)
        for photo, index in exposed.pairs:
            name = ("motion", kind, photo, str(index))
            if kind in ESTIMATORS:
                arguments = exposed.scene(photo) | {
                    "motion": exposed.truths[index],
                    "method": ESTIMATORS[kind],
                    "borders": exposed.protocol.borders,
                    "camera": exposed.protocol.calibration_camera,
                    "seed": _seed(exposed.protocol, photo, index),
                }
                cells.append(Cell(name, motion_of, arguments, version=version))
            else:
                scene = scenes[index % len(scenes)]
                calibrate, of_motion = _calibration(exposed, scene, sets.get(kind), index)
                cells.append(Cell(name, calibrate, of_motion, version=version))
    figures = stages.run("motion", cells)
    return {
        (kind, photo, index): figures.get(("motion", kind, photo, str(index)), {})
        for kind in kinds
        for photo, index in exposed.pairs
    }


def _calibration(
    exposed: _Exposed, scene: Path, codes: str | None, index: int
) -> tuple[Callable[..., Mapping[str, Figure]], Mapping[str, Any]]:
    """Calibrate by other photos than an open one of the scene: the same for every photo, run once
    a motion.
    """
    protocol = exposed.protocol
    arguments = {
        "motion": exposed.truths[index],
        "camera": protocol.calibration_camera,
        "seed": _seed(protocol, "calibration", index),
    }
    if codes is None:
        return motion_from_light, arguments
    return motion_from_codes, arguments | {
        "photo": scene,
        "side_px": scene_px(protocol),
        "gamma": _gamma(protocol),
        "codes": codes,
        "borders": protocol.borders,
        "light_true": bool(protocol.photons),
    }


def _chosen_codes(
    exposed: _Exposed, designs: Sequence[str], estimates: Estimates, stages: _Stages
) -> dict[tuple[str, str, int, float | None], str]:
    """Choose the code of every design at every place; one whose estimate failed has none."""
    protocol = exposed.protocol
    class_prior = None
    if any(DESIGNS[design].path == "class" for design in designs):
        motions = class_motions(protocol)
        class_prior = MotionPrior(motions, (1 / len(motions),) * len(motions))
    cells = []
    rows: dict[tuple[str, ...], tuple[str, str, int, float | None]] = {}
    for design in designs:
        of_class = DESIGNS[design].path == "class"
        version = code_version(design)
        for photo, index in exposed.pairs:
            prior = class_prior
            if not of_class:
                prior = motion_prior(design, exposed.truths[index], estimates, photo, index)
            if prior is None:
                continue
            for level in protocol.levels:
                light = _designed_for(design, protocol.objective, level)
                name = ("code", design, photo, str(index), str(level))
                rows[name] = (design, photo, index, level)
                arguments = {
                    "prior": prior,
                    "design": design,
                    "chips": protocol.chips,
                    "open_range": protocol.open_range,
                    "objective": protocol.objective,
                    "camera": protocol.camera(light),
                    "steps": protocol.steps,
                    "seed": protocol.seed + (0 if of_class else index),
                }
                cells.append(Cell(name, choose_code, arguments, version=version))
    return {
        rows[name]: str(figures["bits"]) for name, figures in stages.run("code", cells).items()
    }


def _shots(
    exposed: _Exposed,
    bits: Mapping[tuple[str, str, int, float | None], str],
    estimates: Estimates,
    stages: _Stages,
) -> tuple[Shot, ...]:
    """Take and restore every photo."""
    protocol = exposed.protocol
    exposures = {}
    for (design, photo, index, level), code in bits.items():
        exposures[design, photo, index, level] = exposed.scene(photo) | {
            "exposure": Exposure(
                motion=exposed.truths[index],
                bits=code,
                light_true=bool(protocol.photons),
                camera=protocol.camera(level),
                borders=protocol.borders,
                seed=_seed(protocol, photo, index),
            )
        }
    kernels: Mapping[tuple[str, ...], Mapping[str, Figure]] = {}
    if protocol.restored_by == "blind":
        version = kernel_version()
        kernels = stages.run(
            "kernel",
            [
                Cell(_cell_name("kernel", *row), kernel_of, arguments, version=version)
                for row, arguments in exposures.items()
            ],
        )
    version = photo_version(protocol.restoration)
    cells = {}
    for row, exposure in exposures.items():
        design, photo, index, _ = row
        kernel = kernels.get(_cell_name("kernel", *row))
        if protocol.restored_by == "blind" and kernel is None:
            continue
        assumed = None
        if restored_by_path(protocol, design):
            truth = exposed.truths[index]
            assumed = assumed_path(protocol, design, truth, estimates, photo, index)
            if assumed is None:
                continue
        arguments = exposure | {
            "assumed": assumed,
            "kernel": kernel and kernel["psf"],
            "restoration": protocol.restoration,
            "border_rounds": protocol.border_rounds,
        }
        cells[row] = Cell(_cell_name("photo", *row), photo_of, arguments, version=version)
    photo_figures = stages.run("photo", list(cells.values()))
    shots = []
    for row, cell in cells.items():
        if figures := photo_figures.get(cell.name):
            kernel = kernels.get(_cell_name("kernel", *row))
            kernel_mnc = {"kernel_mnc": kernel["mnc"]} if kernel else {}
            shots.append(Shot(*row, {**figures, **kernel_mnc}, bits[row], cell.arguments))
    return tuple(shots)


def _cell_name(
    stage: str, design: str, photo: str, index: int, level: float | None
) -> tuple[str, ...]:
    return (stage, design, photo, str(index), str(level))


def _sets(protocol: CodedProtocol, kinds: Sequence[str], stages: _Stages) -> Mapping[str, str]:
    """Codes of each kind of calibration by coded photos; a kind whose set failed is left out."""
    version = set_version()
    cells = [
        Cell(
            ("set", kind),
            set_of_codes,
            {"name": CALIBRATIONS[kind], "chips": protocol.chips},
            version=version,
        )
        for kind in kinds
        if kind in CALIBRATIONS
    ]
    return {kind: str(figures["codes"]) for (_, kind), figures in stages.run("set", cells).items()}


class _Stages:
    """Runs the stages one after the other and collects their outcomes."""

    def __init__(self, engine: Engine, progress: Callable[[float, str], None]) -> None:
        self._engine = engine
        self._progress = progress
        self._outcomes: list[Outcome] = []

    def run(
        self, stage: str, cells: Sequence[Cell]
    ) -> dict[tuple[str, ...], Mapping[str, Figure]]:
        """Return the figures of the cells that did not fail; none after Ctrl-C."""
        if any(outcome.missing for outcome in self._outcomes):
            return {}
        low, high = _STAGES[stage]
        outcome = self._engine.run(
            cells,
            progress=lambda fraction, note: self._progress(
                low + (high - low) * fraction, f"{stage}s: {note}"
            ),
        )
        self._outcomes.append(outcome)
        return {name: figures for name, figures in outcome.figures.items() if figures}

    @property
    def outcome(self) -> Outcome:
        """All stages as one run."""
        outcomes = self._outcomes
        return Outcome(
            tuple(result for outcome in outcomes for result in outcome.results),
            sum(outcome.missing for outcome in outcomes),
            tuple(dict.fromkeys(line for outcome in outcomes for line in outcome.warnings)),
        )


def check_names(codes: Iterable[str]) -> None:
    """Refuse names of codes that the tables could not hold, or that are those of built-in designs.

    Raises
    ------
    ValueError
        If a name is empty, has other characters than letters, digits and ``. _ + -``, or is a
        design's.
    """
    for name in codes:
        if not _NAME.fullmatch(name):
            raise ValueError(
                f"code: a name must be of letters, digits and . _ + -, got {name[:40]!r}"
            )
        if name in DESIGNS:
            raise ValueError(f"code: {name} is the name of a built-in design, take another")


def scene_px(protocol: CodedProtocol) -> int:
    """Return the side of a scene, px: with real borders light comes in from beyond the photo, a
    PSF's frame less 1.
    """
    return protocol.crop_px + border_px(protocol.borders)


def _gamma(protocol: CodedProtocol) -> Literal["srgb", "linear"]:
    return "srgb" if protocol.photons else "linear"  # the paper uses code values as light


def _designed_for(design: str, objective: str, level: float | None) -> float | None:
    # only a Wiener filter's error depends on the light, and only along a path: otherwise one cell
    # serves all levels
    return level if objective == "mse" and DESIGNS[design].path not in ("none", "length") else None


def _seed(protocol: CodedProtocol, photo: str, index: int) -> int:
    # By the photo's name, not its number: adding photos changes no seed.
    return int(
        np.random.SeedSequence([protocol.seed, index, *photo.encode()]).generate_state(1)[0]
    )
