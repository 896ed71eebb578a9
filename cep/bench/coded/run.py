"""The coded-exposure table measured: three stages of cells, each kept on disk."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cep.bench.cells import Cell, Figure
from cep.bench.coded.designs import DESIGNS, Known
from cep.bench.coded.motions import drawn_motions
from cep.bench.coded.protocol import CodedProtocol
from cep.bench.coded.stages import PSF_PX, choose_code, estimate_motion, paths_from, paths_to, take_photo
from cep.bench.coded.versions import code_version, motion_version, photo_version
from cep.bench.engine import Outcome, run_cells
from motdiff.quadratic import nearest_quadratic
from motdiff.trajectory import Trajectory

__all__ = ["ESTIMATORS", "MARGIN_PX", "CodedTable", "Shot", "measure_coded"]

FloatArray = NDArray[np.float64]
Say = Callable[[float, str], None]

MARGIN_PX = PSF_PX - 1
"""By how much a scene is larger than its photo when borders are real: the PSF's frame less one pixel."""
ESTIMATORS = {"ours": "motdiff-quick", "parametric": "parametric"}
"""Estimator behind each kind of estimated path."""

_STAGES = {"motion": (0.0, 0.4), "code": (0.4, 0.6), "photo": (0.6, 1.0)}  # of the progress


@dataclass(frozen=True)
class Shot:
    """One coded photo, restored.

    Attributes
    ----------
    design, photo : str
    motion : int
    photons : float or None
    figures : mapping
        Of :func:`cep.bench.coded.stages.take_photo`.
    bits : str
    arguments : mapping
        That :func:`cep.bench.coded.stages.take_photo` was called with.
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
    """Everything measured.

    Attributes
    ----------
    protocol : CodedProtocol
    shots : tuple of Shot
        In order of design, light, photo and motion; without the failed ones.
    estimates : mapping from (kind, photo, motion) to figures
        ``mnc`` and ``cpu_s`` of each estimated motion.
    failures : mapping from a cell's label to its reason
    missing : int
        Cells not reached, after Ctrl-C.
    warnings : tuple of str
    machines : list of mapping
    """

    protocol: CodedProtocol
    shots: tuple[Shot, ...]
    estimates: Mapping[tuple[str, str, int], Mapping[str, Figure]]
    failures: Mapping[str, str]
    missing: int
    warnings: tuple[str, ...]
    machines: list[Mapping[str, Any]]


def measure_coded(
    protocol: CodedProtocol,
    scenes: Mapping[str, FloatArray],
    *,
    cache: Path,
    designs: Sequence[str] = tuple(DESIGNS),
    workers: int = 1,
    dask: str | None = None,
    progress: Say = lambda _fraction, _note: None,
) -> CodedTable:
    """Measure every design on every photo, motion and light level.

    Parameters
    ----------
    protocol : CodedProtocol
    scenes : mapping from a photo's name to its sharp scene, (H, W) linear light
        The crop itself with symmetric borders, larger by :data:`MARGIN_PX` with real ones.
    cache : folder of finished cells
    designs : sequence of names of :data:`cep.bench.coded.designs.DESIGNS`
    workers, dask
        As :func:`cep.bench.engine.run_cells` takes them.
    progress : callable

    Raises
    ------
    ValueError
        If a design is unknown or comes twice.
    OSError, RuntimeError
        As :func:`cep.bench.engine.run_cells`.
    """
    unknown = [name for name in designs if name not in DESIGNS]
    if unknown:
        raise ValueError(f"designs: must be among {', '.join(DESIGNS)}, got {unknown[0]!r}")
    if len(set(designs)) < len(designs):
        raise ValueError(f"designs: each must come once, got {', '.join(designs)}")
    stages = _Stages(cache, workers, dask, progress)
    truths = drawn_motions(protocol)
    motions = [paths_to([path], [1.0]) for path in truths]
    keys = [(photo, index) for photo in scenes for index in range(len(truths))]

    kinds = _kinds(protocol, designs)
    versions = {kind: motion_version(ESTIMATORS[kind]) for kind in kinds}
    cells = [
        Cell(
            ("motion", kind, photo, str(index)),
            estimate_motion,
            {
                "scene": scenes[photo], "motion": motions[index], "method": ESTIMATORS[kind],
                "borders": protocol.borders, "camera": protocol.calibration_camera.to_dict(),
                "seed": _seed(protocol, photo, index),
            },
            version=versions[kind],
        )
        for kind in kinds
        for photo, index in keys
    ]  # fmt: skip
    found = stages.run("motion", cells)
    estimates = {
        (kind, photo, index): found.get(("motion", kind, photo, str(index)), {})
        for kind in kinds
        for photo, index in keys
    }

    versions = {design: code_version(design) for design in designs}
    told = {
        (design, photo, index): _told(design, truths[index], estimates, photo, index)
        for design in designs
        for photo, index in keys
    }
    cells = [
        Cell(
            ("code", design, photo, str(index)),
            choose_code,
            {
                "known": known, "design": design, "chips": protocol.chips, "open_range": protocol.open_range,
                "objective": protocol.objective, "camera": protocol.camera(protocol.design_photons).to_dict(),
                "steps": protocol.steps, "seed": protocol.seed + index,
            },
            version=versions[design],
        )
        for (design, photo, index), known in told.items()
        if known is not None
    ]  # fmt: skip
    codes = stages.run("code", cells)

    version = photo_version()
    cells = [
        Cell(("photo", design, photo, str(index), str(level)), take_photo, arguments, version=version)
        for design in designs
        for level in protocol.levels
        for photo, index in keys
        if (code := codes.get(("code", design, photo, str(index))))
        and (assumed := _assumed(protocol, design, truths[index], estimates, photo, index)) != ""
        for arguments in [
            {
                "scene": scenes[photo],
                "motion": motions[index],
                "assumed": assumed,
                "bits": str(code["bits"]),
                "borders": protocol.borders,
                "light_true": bool(protocol.photons),
                "restoration": protocol.restoration,
                "border_rounds": protocol.border_rounds,
                "camera": protocol.camera(level).to_dict(),
                "seed": _seed(protocol, photo, index),
            }
        ]
    ]
    taken = stages.run("photo", cells)
    levels = {str(level): level for level in protocol.levels}
    shots = tuple(
        Shot(design, photo, int(index), levels[level], figures, cell.arguments["bits"], cell.arguments)
        for cell in cells
        for _, design, photo, index, level in [cell.name]
        if (figures := taken.get(cell.name))
    )
    return CodedTable(
        protocol, shots, estimates, stages.failures, stages.missing, tuple(stages.warnings), stages.machines
    )


class _Stages:
    """Runs one stage after the other and keeps what they have to tell."""

    def __init__(self, cache: Path, workers: int, dask: str | None, progress: Say) -> None:
        self._cache, self._workers, self._dask, self._progress = cache, workers, dask, progress
        self.failures: dict[str, str] = {}
        self.missing = 0
        self.warnings: list[str] = []
        self.machines: list[Mapping[str, Any]] = []

    def run(self, stage: str, cells: Sequence[Cell]) -> dict[tuple[str, ...], Mapping[str, Figure]]:
        if self.missing:
            return {}  # interrupted before
        low, high = _STAGES[stage]
        outcome: Outcome = run_cells(
            cells, cache=self._cache, workers=self._workers, dask=self._dask,
            progress=lambda fraction, note: self._progress(low + (high - low) * fraction, f"{stage}s: {note}"),
        )  # fmt: skip
        self.failures |= {"/".join(name): reason for name, reason in outcome.failures.items()}
        self.missing += outcome.missing
        self.warnings += [warning for warning in outcome.warnings if warning not in self.warnings]
        self.machines += [machine for machine in outcome.machines if machine not in self.machines]
        return {name: figures for name, figures in outcome.figures.items() if figures}


def _kinds(protocol: CodedProtocol, designs: Sequence[str]) -> list[str]:
    wanted = {DESIGNS[name].path for name in designs}
    if protocol.restored_by == "estimate":
        wanted |= {_restored_by(name) for name in designs}
    return [kind for kind in ESTIMATORS if kind in wanted]


def _restored_by(design: str) -> str:
    # who knows nothing, or the length only, of the motion needs an estimate to restore by: the best there is
    path = DESIGNS[design].path
    return "ours" if path in ("none", "length") else path


def _told(
    design: str,
    truth: Trajectory,
    estimates: Mapping[tuple[str, str, int], Mapping[str, Figure]],
    photo: str,
    index: int,
) -> Known | None:
    path = DESIGNS[design].path
    if path == "none":
        return Known()
    if path == "length":
        return Known(length_px=truth.length_px)
    if path == "true":
        return Known((truth,), (1.0,))
    if path == "parametric oracle":
        return Known((nearest_quadratic(truth).trajectory(),), (1.0,))
    figures = estimates[path, photo, index]
    return Known(*paths_from(str(figures["paths"]))) if figures else None


def _assumed(
    protocol: CodedProtocol,
    design: str,
    truth: Trajectory,
    estimates: Mapping[tuple[str, str, int], Mapping[str, Figure]],
    photo: str,
    index: int,
) -> str | None:
    """Path that the restoration goes by; None when it knows the PSF, empty when the estimate failed."""
    if protocol.restored_by == "psf" or DESIGNS[design].path == "true":
        return None
    if protocol.restored_by == "path":
        if DESIGNS[design].knows_truth:
            return None  # its code is made for one direction
        return paths_to([replace(truth, direction="unknown")], [1.0])
    path = _restored_by(design)
    if path == "parametric oracle":
        return paths_to([nearest_quadratic(truth).trajectory()], [1.0])
    figures = estimates[path, photo, index]
    return str(figures["paths"]) if figures else ""


def _seed(protocol: CodedProtocol, photo: str, index: int) -> int:
    # By the photo's name, so that a photo's noise does not depend on which others are there.
    return int(np.random.SeedSequence([protocol.seed, index, *photo.encode()]).generate_state(1)[0])
