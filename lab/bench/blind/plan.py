"""Plan of a blind table: one cell for every photo, motion, light level and method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lab.bench.blind.cases import RealPhoto, check_real, real_photos, shot_of
from lab.bench.blind.cells import CEILINGS, FLOORS, measure_levin, measure_real, measure_simulated
from lab.bench.blind.methods import budget_warning, label_of, version_of
from lab.bench.blind.protocol import Protocol, drawn_shakes, paired_shakes
from lab.bench.datasets import (
    BUNDLED_WARNING,
    Layout,
    bundled_photos,
    labels_of,
    layout_of,
    photo_folder,
    pick,
)
from lab.evaluation.floors import mean_psf
from lab.jobs.cells import Cell
from motdiff.gyro import GyroTrace
from motdiff.trajectory import Trajectory

_OTHERS = 200
_OTHER_STREAM = 1
_BLIND = ("delta", "gaussian")
_REAL: dict[Layout, tuple[str, tuple[str, ...], tuple[str, ...]]] = {
    "levin": ("Levin's real shakes", _BLIND, ("true-kernel",)),
    "rsblur": ("RSBlur's real photos", _BLIND, ()),
    "koehler": ("Koehler's real shakes", _BLIND, ()),
}
"""Name of the table, floors, and ceilings, by layout."""


@dataclass(frozen=True)
class Plan:
    """Cells of a blind table and their common settings.

    Attributes
    ----------
    protocol : Protocol
    cells : tuple of Cell
        Named (method, photo, motion, light).
    lights : tuple of str
        Names of the light levels, a table each.
    warnings : tuple of str
        Reasons why the figures are no sound comparison.
    """

    protocol: Protocol
    cells: tuple[Cell, ...]
    lights: tuple[str, ...]
    warnings: tuple[str, ...] = ()


def blind_plan(
    protocol: Protocol,
    methods: Sequence[str],
    *,
    folder: Path | None = None,
    trace: GyroTrace | None = None,
) -> Plan:
    """List the cells of a blind table, ordered by photo and motion: an interrupted run has
    complete pairs.

    Parameters
    ----------
    protocol : Protocol
        Of photos with real blur (see :func:`lab.bench.blind.cases.real_photos`) only
        ``real_photos``, ``crop_px``, ``gamma`` and ``seed`` count: their motion and noise are
        given.
    methods : sequence of str
        Estimators.
    folder : Path, optional
        Photos; those that scikit-image carries when omitted.
    trace : GyroTrace, optional
        Recording for the hand shake.

    Raises
    ------
    ValueError
        If the folder holds no usable photo, or a photo is too small.
    """
    if folder is not None and (photos := real_photos(folder, protocol.real_photos)):
        plan = _of_real(protocol, methods, layout_of(folder), photos)
    else:
        plan = _of_sharp(protocol, methods, folder, trace)
    budgets = budget_warning(methods)
    return plan if budgets is None else replace(plan, warnings=(*plan.warnings, budgets))


def one_cell_each(plan: Plan) -> Plan:
    """Keep one cell per photo and estimator, each photo with another motion, at the first light
    level.
    """
    photos = list(dict.fromkeys(cell.name[1] for cell in plan.cells))
    shakes = {
        photo: list(dict.fromkeys(c.name[2] for c in plan.cells if c.name[1] == photo))
        for photo in photos
    }
    first_cases = {
        photo: shakes[photo][index % len(shakes[photo])] for index, photo in enumerate(photos)
    }
    cells = [
        cell
        for cell in plan.cells
        for method, photo, shake, light in (cell.name,)
        if method not in (*FLOORS, *CEILINGS)
        and shake == first_cases[photo]
        and light == plan.lights[0]
    ]
    return replace(plan, cells=tuple(cells), lights=plan.lights[:1])


def _of_real(
    protocol: Protocol, methods: Sequence[str], layout: Layout, photos: Sequence[RealPhoto]
) -> Plan:
    light, floors, ceilings = _REAL[layout]
    check_real(photos, protocol.crop_px)
    if layout != "levin" and photos[0].sharp is None:
        floors = ()  # without a sharp photo a kernel cannot be evaluated
    versions = {method: version_of(method) for method in (*floors, *methods, *ceilings)}
    cells = [
        _real_cell(protocol, layout, photo, method, versions[method])
        for photo in photos
        for method in versions
    ]
    return Plan(protocol, tuple(cells), (light,))


def _of_sharp(
    protocol: Protocol, methods: Sequence[str], folder: Path | None, trace: GyroTrace | None
) -> Plan:
    photo_files = bundled_photos() if folder is None else photo_folder(folder)
    photos = pick(photo_files, protocol.photos, least_px=protocol.least_px)
    listed = tuple(zip(labels_of(photos), photos, strict=True))
    if protocol.pairs == "each":
        exposures: list[tuple[str, Path, int, Trajectory, Mapping[str, Any] | None]] = [
            (*listed[index % len(listed)], index, motion, generator)
            for index, (motion, generator) in enumerate(paired_shakes(protocol, trace))
        ]
        other_motions = tuple(
            motion for motion, _ in paired_shakes(protocol, trace, others=_OTHERS)
        )
    else:
        motions = drawn_shakes(protocol, trace)
        exposures = [
            (*item, index, motion, None) for index, motion in enumerate(motions) for item in listed
        ]
        other_motions = drawn_shakes(
            replace(protocol, motions=_OTHERS), trace, stream=_OTHER_STREAM
        )
    mean = mean_psf([motion.psf(protocol.psf_px) for motion in other_motions])
    versions = {method: version_of(method) for method in (*FLOORS, *methods, *CEILINGS)}
    noise = f"noise {protocol.read_sigma:g}" if protocol.read_sigma else "no noise"
    lights = {
        level: noise if level is None else f"{level:g} photo-electrons"
        for level in protocol.levels
    }
    cells = [
        Cell(
            (label_of(method), label, f"{index:04d}", lights[level]),
            measure_simulated,
            {
                "method": method,
                "photo": photo,
                "motion": motion,
                "shot": shot_of(protocol, label, index, level, generator),
                "mean": mean if method == "mean-kernel" else None,
            },
            version=version,
        )
        for level in lights
        for label, photo, index, motion, generator in exposures
        for method, version in versions.items()
    ]
    warnings = []
    carried = {path.parent for path in bundled_photos()}
    if any(photo.absolute().parent in carried for photo in photos):
        warnings.append(BUNDLED_WARNING)
    if len(photos) < protocol.photos:
        warnings.append(
            f"{len(photos)} photos instead of the {protocol.photos} of the protocol: there are no"
            " more"
        )
    if protocol.motion.gyro > 0 and trace is None:
        warnings.append(
            "the hand shake is made of noise: a recording of a gyroscope makes it real"
        )
    return Plan(protocol, tuple(cells), tuple(lights.values()), tuple(warnings))


def _real_cell(
    protocol: Protocol, layout: Layout, photo: RealPhoto, method: str, version: str
) -> Cell:
    name = (label_of(method), photo.scene, photo.shake, _REAL[layout][0])
    if layout == "levin":
        return Cell(
            name, measure_levin, {"method": method, "photo": photo.blurred}, version=version
        )
    arguments = {
        "method": method,
        "blurred": photo.blurred,
        "sharp": photo.sharp,
        "crop_px": protocol.crop_px,
        "gamma": protocol.gamma,
        "crop_seed": (protocol.seed, *f"{photo.scene}/{photo.shake}".encode()),
    }
    return Cell(name, measure_real, arguments, version=version)
