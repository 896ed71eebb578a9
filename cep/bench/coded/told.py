"""Who is told what: of the motion when a code is chosen, and of it when the photo is restored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from cep.bench.cells import Figure
from cep.bench.coded.designs import DESIGNS, Known
from cep.bench.coded.paths import paths_from, paths_to
from cep.bench.coded.protocol import CodedProtocol
from motdiff.quadratic import nearest_quadratic
from motdiff.trajectory import Trajectory

__all__ = ["ESTIMATORS", "Estimates", "assumed_path", "kinds_needed", "told"]

ESTIMATORS = {"ours": "motdiff-quick", "parametric": "parametric"}
"""Estimator behind each kind of estimated path."""

Estimates = Mapping[tuple[str, str, int], Mapping[str, Figure]]
"""Figures of each estimate by kind, photo and motion; empty where it failed."""


def kinds_needed(protocol: CodedProtocol, designs: Sequence[str]) -> list[str]:
    """List the kinds of :data:`ESTIMATORS` that designs or their restoration go by."""
    wanted = {DESIGNS[name].path for name in designs}
    if protocol.restored_by == "estimate":
        wanted |= {_restored_by(name) for name in designs}
    return [kind for kind in ESTIMATORS if kind in wanted]


def told(design: str, truth: Trajectory, estimates: Estimates, photo: str, index: int) -> Known | None:
    """Return what a design knows of a motion; None where its estimate failed."""
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


def assumed_path(
    protocol: CodedProtocol, design: str, truth: Trajectory, estimates: Estimates, photo: str, index: int
) -> str | None:
    """Return the path that a restoration goes by; None when it knows the PSF, empty when the estimate failed."""
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


def _restored_by(design: str) -> str:
    # who knows nothing, or the length only, of the motion needs an estimate to restore by: the best there is
    path = DESIGNS[design].path
    return "ours" if path in ("none", "length") else path
