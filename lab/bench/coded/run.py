"""Run of the coded-exposure table in three cached stages: motions, codes, photos."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from cep.jobs.cells import Cell, Figure
from cep.jobs.engine import Outcome, run_cells
from cep.jobs.fingerprint import source_version
from cep.optics.code import ShutterCode
from lab.bench.coded.calibrations import (
    CALIBRATIONS,
    POINT,
    motion_from_codes,
    motion_from_light,
    set_of_codes,
)
from lab.bench.coded.designs import DESIGNS, USUAL_DESIGNS, MotionPrior, design_of
from lab.bench.coded.protocol import (
    CodedProtocol,
    class_motions,
    drawn_motions,
    paths_from,
    paths_to,
)
from lab.bench.coded.stages import choose_code, kernel_of, motion_of, photo_of
from lab.bench.datasets import Cut
from lab.weights import PATH_WEIGHTS
from motdiff.files.plugins import is_reference
from motdiff.simulate import border_px
from motdiff.tracing.quadratic import nearest_quadratic
from motdiff.trajectory import Trajectory
from motdiff.weights import MOTDIFF_FILES

Say = Callable[[float, str], None]

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
    failures : mapping from a cell's label to its reason
    missing : int
        Cells not reached, after Ctrl-C.
    warnings : tuple of str
    machines : list of mapping
    """

    protocol: CodedProtocol
    shots: tuple[Shot, ...]
    estimates: Estimates
    failures: Mapping[str, str]
    missing: int
    warnings: tuple[str, ...]
    machines: list[Mapping[str, Any]]


def measure_coded(
    protocol: CodedProtocol,
    photos: Mapping[str, Path],
    *,
    cache: Path,
    designs: Sequence[str] = USUAL_DESIGNS,
    codes: Mapping[str, ShutterCode] | None = None,
    calibrated_on: Sequence[Path] = (),
    workers: int = 1,
    dask: str | None = None,
    progress: Say = lambda _fraction, _note: None,
) -> CodedTable:
    """Measure every design on every photo, motion and light level.

    Parameters
    ----------
    protocol : CodedProtocol
    photos : mapping from a photo's name to its file
        Sharp; seeds of its crop and noise depend on the name.
    cache : folder of finished cells
    designs : sequence of names of :data:`lab.bench.coded.designs.DESIGNS`
    codes : mapping from a name to a code, optional
        Codes of the user's own, which follow the designs; :func:`check_names` says what names they
        may have.
    calibrated_on : sequence of Path
        Photos whose most textured parts are shown by coded calibration photos: one for each motion
        in turn, for all sharp photos alike. The sharp ones themselves when empty.
    workers, dask
        As :func:`cep.jobs.engine.run_cells` takes them.
    progress : callable

    Raises
    ------
    ValueError
        If a design is unknown or comes twice, or a code has the name of a design.
    OSError, RuntimeError
        As :func:`cep.jobs.engine.run_cells`.
    """
    unknown = [name for name in designs if name not in DESIGNS]
    if unknown:
        raise ValueError(f"designs: must be among {', '.join(DESIGNS)}, got {unknown[0]!r}")
    if len(set(designs)) < len(designs):
        raise ValueError(f"designs: each must come once, got {', '.join(designs)}")
    own = codes or {}
    check_names(own)
    stages = _Stages(cache, workers, dask, progress)
    truths = drawn_motions(protocol)
    motions = [paths_to([path], [1.0]) for path in truths]
    cuts = {photo: _cut(protocol, photo) for photo in photos}
    keys = [(photo, index) for photo in photos for index in range(len(truths))]

    rows = (*designs, *own)
    kinds = kinds_needed(protocol, rows)
    sets = _sets(protocol, kinds, stages)
    scenes = tuple(calibrated_on) or tuple(photos.values())
    versions = {kind: motion_version(kind) for kind in kinds}
    cells = [
        Cell(("motion", kind, photo, str(index)), work, arguments, version=versions[kind])
        for kind in kinds
        if kind not in CALIBRATIONS or kind in sets
        for photo, index in keys
        for work, arguments in [
            _from_open_photo(protocol, kind, photo, photos[photo], index, motions[index])
            if kind in ESTIMATORS
            else _from_other_photos(
                protocol, scenes[index % len(scenes)], sets.get(kind), index, motions[index]
            )
        ]
    ]
    found = stages.run("motion", cells)
    estimates = {
        (kind, photo, index): found.get(("motion", kind, photo, str(index)), {})
        for kind in kinds
        for photo, index in keys
    }

    versions = {design: code_version(design) for design in designs}
    known = None
    if any(DESIGNS[design].path == "class" for design in designs):
        known = MotionPrior(others := class_motions(protocol), (1 / len(others),) * len(others))
    priors = {
        (design, photo, index): known
        if DESIGNS[design].path == "class"
        else motion_prior(design, truths[index], estimates, photo, index)
        for design in designs
        for photo, index in keys
    }
    cells = [
        Cell(
            ("code", design, photo, str(index), str(level)),
            choose_code,
            {
                "prior": prior,
                "design": design,
                "chips": protocol.chips,
                "open_range": protocol.open_range,
                "objective": protocol.objective,
                "camera": protocol.camera(
                    _designed_for(design, protocol.objective, level)
                ).to_dict(),
                "steps": protocol.steps,
                "seed": protocol.seed + (index if prior is not known else 0),
            },
            version=versions[design],
        )
        for (design, photo, index), prior in priors.items()
        if prior is not None
        for level in protocol.levels
    ]
    chosen = {name: str(figures["bits"]) for name, figures in stages.run("code", cells).items()}
    chosen |= {
        ("code", name, photo, str(index), str(level)): code.bits
        for name, code in own.items()
        for photo, index in keys
        for level in protocol.levels
    }

    shots = [
        (design, photo, index, level, bits)
        for design in rows
        for level in protocol.levels
        for photo, index in keys
        if (bits := chosen.get(("code", design, photo, str(index), str(level))))
    ]
    exposures = {
        (design, photo, index, level): {
            "photo": photos[photo],
            "cut": cuts[photo],
            "motion": motions[index],
            "bits": bits,
            "borders": protocol.borders,
            "light_true": bool(protocol.photons),
            "camera": protocol.camera(level).to_dict(),
            "seed": _seed(protocol, photo, index),
        }
        for design, photo, index, level, bits in shots
    }
    kernels: Mapping[tuple[str, ...], Mapping[str, Figure]] = {}
    if protocol.restored_by == "blind":
        version = kernel_version()
        cells = [
            Cell(
                ("kernel", design, photo, str(index), str(level)),
                kernel_of,
                arguments,
                version=version,
            )
            for (design, photo, index, level), arguments in exposures.items()
        ]
        kernels = stages.run("kernel", cells)

    version = photo_version(protocol.restoration)
    cells = [
        Cell(("photo", *name), photo_of, arguments | how, version=version)
        for (design, photo, index, level), arguments in exposures.items()
        for name in [(design, photo, str(index), str(level))]
        if protocol.restored_by != "blind" or ("kernel", *name) in kernels
        if (assumed := assumed_path(protocol, design, truths[index], estimates, photo, index))
        != ""
        for how in [
            {
                "assumed": assumed,
                "kernel": kernels[("kernel", *name)]["psf"] if kernels else None,
                "restoration": protocol.restoration,
                "border_rounds": protocol.border_rounds,
            }
        ]
    ]
    taken = stages.run("photo", cells)
    levels = {str(level): level for level in protocol.levels}
    restored = tuple(
        Shot(
            design,
            photo,
            int(index),
            levels[level],
            {**figures, **of_kernel},
            cell.arguments["bits"],
            cell.arguments,
        )
        for cell in cells
        for _, design, photo, index, level in [cell.name]
        if (figures := taken.get(cell.name))
        for found in [kernels.get(("kernel", *cell.name[1:]))]
        for of_kernel in [{"kernel_mnc": found["mnc"]} if found else {}]
    )
    return CodedTable(
        protocol,
        restored,
        estimates,
        stages.failures,
        stages.missing,
        tuple(stages.warnings),
        stages.machines,
    )


_Task = tuple[Callable[..., Mapping[str, Figure]], Mapping[str, Any]]


def _from_open_photo(
    protocol: CodedProtocol, kind: str, name: str, photo: Path, index: int, motion: str
) -> _Task:
    return motion_of, {
        "photo": photo,
        "cut": _cut(protocol, name),
        "motion": motion,
        "method": ESTIMATORS[kind],
        "borders": protocol.borders,
        "camera": protocol.calibration_camera.to_dict(),
        "seed": _seed(protocol, name, index),
    }


def _from_other_photos(
    protocol: CodedProtocol, scene: Path, codes: str | None, index: int, motion: str
) -> _Task:
    """Calibrate by other photos than an open one of the scene: the same work for every photo, done
    once a motion.
    """
    common = {
        "motion": motion,
        "camera": protocol.calibration_camera.to_dict(),
        "seed": _seed(protocol, "calibration", index),
    }
    if codes is None:
        return motion_from_light, common
    return motion_from_codes, common | {
        "photo": scene,
        "side_px": scene_px(protocol),
        "gamma": _gamma(protocol),
        "codes": codes,
        "borders": protocol.borders,
        "light_true": bool(protocol.photons),
    }


def _sets(protocol: CodedProtocol, kinds: Sequence[str], stages: _Stages) -> Mapping[str, str]:
    """Codes of each kind of calibration by coded photos; a kind whose set failed is left out."""
    version = source_version(["cep.calibration.calibration_set"], alone=[_CALIBRATIONS])
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
    """Runs the stages one after the other and collects their failures and warnings."""

    def __init__(self, cache: Path, workers: int, dask: str | None, progress: Say) -> None:
        self._cache = cache
        self._workers = workers
        self._dask = dask
        self._progress = progress
        self.failures: dict[str, str] = {}
        self.missing = 0
        self.warnings: list[str] = []
        self.machines: list[Mapping[str, Any]] = []

    def run(
        self, stage: str, cells: Sequence[Cell]
    ) -> dict[tuple[str, ...], Mapping[str, Figure]]:
        if self.missing:
            return {}  # interrupted before
        low, high = _STAGES[stage]
        outcome: Outcome = run_cells(
            cells,
            cache=self._cache,
            workers=self._workers,
            dask=self._dask,
            progress=lambda fraction, note: self._progress(
                low + (high - low) * fraction, f"{stage}s: {note}"
            ),
        )
        self.failures |= {"/".join(name): reason for name, reason in outcome.failures.items()}
        self.missing += outcome.missing
        self.warnings += [warning for warning in outcome.warnings if warning not in self.warnings]
        self.machines += [machine for machine in outcome.machines if machine not in self.machines]
        return {name: figures for name, figures in outcome.figures.items() if figures}


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


def _cut(protocol: CodedProtocol, photo: str) -> Cut:
    return Cut(scene_px(protocol), _gamma(protocol), (protocol.seed, 5, *photo.encode()))


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


ESTIMATORS = {"ours": "motdiff", "parametric": "parametric"}
"""Estimator behind each kind of path that is estimated from an open photo of the scene."""

Estimates = Mapping[tuple[str, str, int], Mapping[str, Figure]]
"""Figures of each estimate by kind, photo and motion; empty where it failed."""


def kinds_needed(protocol: CodedProtocol, designs: Sequence[str]) -> list[str]:
    """List the kinds of estimates and calibrations that designs or their restoration need."""
    wanted = {design_of(name).path for name in designs}
    if protocol.restored_by == "estimate":
        wanted |= {_restored_by(name) for name in designs}
    return [kind for kind in (*ESTIMATORS, *CALIBRATIONS, POINT) if kind in wanted]


def motion_prior(
    design: str, truth: Trajectory, estimates: Estimates, photo: str, index: int
) -> MotionPrior | None:
    """Motion prior of a design for one motion; None where its estimate failed."""
    path = DESIGNS[design].path
    if path == "none":
        return MotionPrior()
    if path == "length":
        return MotionPrior(length_px=truth.length_px)
    if path == "true":
        return MotionPrior((truth,), (1.0,))
    if path == "parametric oracle":
        return MotionPrior((nearest_quadratic(truth).trajectory(),), (1.0,))
    figures = estimates[path, photo, index]
    return MotionPrior(*paths_from(str(figures["paths"]))) if figures else None


def assumed_path(
    protocol: CodedProtocol,
    design: str,
    truth: Trajectory,
    estimates: Estimates,
    photo: str,
    index: int,
) -> str | None:
    """Path given to the restoration; None when it has the true PSF or a kernel, empty when the
    estimate failed.
    """
    if protocol.restored_by in ("psf", "blind") or design_of(design).path == "true":
        return None
    if protocol.restored_by == "path":
        if design_of(design).uses_truth:
            return None  # its code is made for one direction
        return paths_to([replace(truth, direction="unknown")], [1.0])
    path = _restored_by(design)
    if path == "parametric oracle":
        return paths_to([nearest_quadratic(truth).trajectory()], [1.0])
    figures = estimates[path, photo, index]
    return str(figures["paths"]) if figures else ""


def _restored_by(design: str) -> str:
    # designs without a path need an estimate for the restoration: the best one
    path = design_of(design).path
    return "ours" if path in ("none", "class", "length") else path


_DENOISER = Path(__file__).parents[3] / "cep/restoration/denoiser/denoiser.safetensors"
_HERE = "lab.bench.coded"
_PATHS = f"{_HERE}.protocol"
_CALIBRATIONS = f"{_HERE}.calibrations"
_EXPOSED = (
    _PATHS,
    f"{_HERE}.stages",
    "lab.bench.datasets",
    "lab.bench.psf_text",
    "cep.files.images",
    "motdiff.files.decoding",
    "motdiff.crops",
)
"""From the file to the photo."""
_ESTIMATED: dict[str, tuple[str, tuple[Path, ...]]] = {
    "motdiff": ("motdiff.estimators.motdiff", MOTDIFF_FILES),
    "parametric": ("lab.rivals.parametric", (PATH_WEIGHTS,)),
}
_LIGHT = "cep.search.light"
_PUBLISHED = "cep.codes.published"
_SEARCHED = ("cep.search.annealing.anneal", _LIGHT, _PUBLISHED)  # searches start from both
_CHOSEN = {
    "open": ("cep.optics.code",),
    "snapshot": (_LIGHT,),
    "class-snapshot": (_LIGHT,),
    "strobe": (_LIGHT,),
    "random": (_LIGHT,),
    "raskar-52": (_PUBLISHED,),
    "dnf": ("cep.search.dnf", *_SEARCHED),
    "dce": (_PUBLISHED,),
}


def motion_version(kind: str) -> str:
    """Cache version of the motions: fingerprint of what finds a kind of path, estimated or
    calibrated.
    """
    shared = ["motdiff.metrics", "motdiff.simulate", "cep.optics.camera"]
    if kind in ESTIMATORS:
        module, weights = _ESTIMATED[ESTIMATORS[kind]]
        return source_version(
            [module, *shared], alone=[*_EXPOSED, "lab.evaluation.methods"], files=weights
        )
    module = f"motdiff.estimators.coded.{'trail_estimator' if kind == POINT else 'estimator'}"
    return source_version([module, *shared], alone=[*_EXPOSED, _CALIBRATIONS])


def kernel_version() -> str:
    """Cache version of the kernels found in the photos themselves."""
    used = ["cep.restoration.blind", "motdiff.metrics", "motdiff.simulate", "cep.optics.camera"]
    return source_version(used, alone=_EXPOSED)


def code_version(design: str) -> str:
    """Cache version of the codes: fingerprint of a design of
    :data:`lab.bench.coded.designs.DESIGNS`.
    """
    return source_version(
        _CHOSEN.get(design, _SEARCHED), alone=[_PATHS, f"{_HERE}.designs", f"{_HERE}.stages"]
    )


def photo_version(restoration: str) -> str:
    """Cache version of the photos: fingerprint of capture, restoration and comparison.

    Of a restoration of the user's own, the module that it names counts, and what of ours that
    module imports.
    """
    used = ["cep.restoration", "cep.proofs.measure", "motdiff.metrics", "motdiff.simulate"]
    used += [restoration.partition(":")[0]] if is_reference(restoration) else []
    return source_version(used, alone=_EXPOSED, files=[_DENOISER])
