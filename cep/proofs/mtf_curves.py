"""MTF curves of codes along a motion's main axis, beside the open shutter's, and figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cep.optics.code import ShutterCode
from cep.optics.exposure import mtf
from cep.optics.path_limits import check_frame, check_resolved
from cep.proofs.measure import CodeMetrics, FigureOfMerit, OwnFigure, measure_worst, own_figures
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

OPEN = "open shutter"
"""Name of the row that every comparison begins with."""


def main_axis(trajectory: Trajectory) -> FloatArray:
    """Return the unit vector (2,) along which the motion spreads most, weighted by time.

    Its larger component is positive.
    """
    samples = trajectory.at(np.linspace(0, 1, 501))
    values, vectors = np.linalg.eigh(np.cov(samples.T))
    axis = np.asarray(vectors[:, int(np.argmax(values))], dtype=np.float64)
    return np.asarray(np.copysign(1.0, axis[np.argmax(np.abs(axis))]) * axis)


def mtf_curve(trajectory: Trajectory, code: ShutterCode | None) -> tuple[FloatArray, FloatArray]:
    """MTF along the motion's main axis, light-true; of the open shutter where there is no code.

    Returned are 501 frequencies, 0..0.5 cycles/px, and the MTF at each.
    """
    freq_cy_px = np.linspace(0, 0.5, 501)
    axis = main_axis(trajectory)
    return freq_cy_px, mtf(trajectory, code, freq_cy_px * axis[0], freq_cy_px * axis[1])


@dataclass(frozen=True)
class MtfRow:
    """A code's MTF along the motion's main axis, and its figures.

    Attributes
    ----------
    code : ShutterCode or None
        None is the open shutter.
    freq_cy_px, mtf : (F,) ndarray
    metrics : CodeMetrics
        Of the worse direction where it is unknown.
    figures : mapping from a name to a number, or to those of both directions
        Figures of merit of the user's own.
    """

    code: ShutterCode | None
    freq_cy_px: FloatArray
    mtf: FloatArray
    metrics: CodeMetrics
    figures: Mapping[str, OwnFigure] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Fields for JSON: bits, curve, metrics, and the user's own ``figures`` if any."""
        return {
            "bits": self.code and self.code.bits,
            "freq_cy_px": self.freq_cy_px,
            "mtf": self.mtf,
            **self.metrics.to_dict(),
            **({"figures": dict(self.figures)} if self.figures else {}),
        }


def compare_mtfs(
    trajectory: Trajectory,
    codes: Mapping[str, ShutterCode],
    *,
    figures: Mapping[str, FigureOfMerit] | None = None,
    on_checked: Callable[[], None] = lambda: None,
) -> dict[str, MtfRow]:
    """Measure the MTFs of codes along a motion, the open shutter's first, by their names.

    ValueError if the path cannot be measured, or is too short for the chips of a code; or a figure
    of the user's own fails.

    Parameters
    ----------
    figures : mapping from a name to a function, optional
        Figures of merit of the user's own, see :func:`cep.proofs.measure.own_figures`.
    on_checked : callable, optional
        Called before the work, when the path has been checked.
    """
    check_frame(trajectory)
    for code in codes.values():
        check_resolved(trajectory, code.chips)
    on_checked()
    shutters: dict[str, ShutterCode | None] = {OPEN: None, **codes}
    played = {name: shutter or ShutterCode("1") for name, shutter in shutters.items()}
    # first: one that fails does so before the work
    own_of = {name: own_figures(figures or {}, trajectory, code) for name, code in played.items()}
    return {
        name: MtfRow(
            shutter,
            *mtf_curve(trajectory, shutter),
            measure_worst(trajectory, played[name]),
            own_of[name],
        )
        for name, shutter in shutters.items()
    }
