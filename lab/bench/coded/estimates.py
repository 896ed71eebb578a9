"""Which motion a design and its restoration know: estimated, calibrated, or the true one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from lab.bench.coded.calibrations import (
    CALIBRATIONS,
    POINT,
)
from lab.bench.coded.designs import DESIGNS, MotionPrior, design_of
from lab.bench.coded.protocol import CodedProtocol, paths_from
from lab.evaluation.quadratic_limits import nearest_quadratic
from lab.jobs.cells import Figure
from motdiff.trajectory import Trajectory

ESTIMATORS = {"ours": "motdiff", "parametric": "parametric"}
"""Estimator behind each kind of path that is estimated from an open photo of the scene."""

Estimates = Mapping[tuple[str, str, int], Mapping[str, Figure]]
"""Figures of each estimate by kind, photo and motion; empty where it failed."""


def kinds_needed(protocol: CodedProtocol, designs: Sequence[str]) -> list[str]:
    """List the kinds of estimates and calibrations that designs or their restoration need."""
    kinds = {design_of(name).path for name in designs}
    if protocol.restored_by == "estimate":
        kinds |= {_restored_by(name) for name in designs}
    return [kind for kind in (*ESTIMATORS, *CALIBRATIONS, POINT) if kind in kinds]


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


def restored_by_path(protocol: CodedProtocol, design: str) -> bool:
    """Whether the restoration is given a path, and not the true PSF or a kernel."""
    if protocol.restored_by == "path":
        return not design_of(design).uses_truth  # or else its code is made for one direction
    return protocol.restored_by == "estimate" and design_of(design).path != "true"


def assumed_path(
    protocol: CodedProtocol,
    design: str,
    truth: Trajectory,
    estimates: Estimates,
    photo: str,
    index: int,
) -> Trajectory | None:
    """Path given to the restoration; None where its estimate failed."""
    if protocol.restored_by == "path":
        return replace(truth, direction="unknown")
    path = _restored_by(design)
    if path == "parametric oracle":
        return nearest_quadratic(truth).trajectory()
    figures = estimates[path, photo, index]
    return paths_from(str(figures["paths"]))[0][0] if figures else None


def _restored_by(design: str) -> str:
    # designs without a path need an estimate for the restoration: the best one
    path = design_of(design).path
    return "ours" if path in ("none", "class", "length") else path
