"""MTFs of codes along a motion, with their figures and the open shutter's."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cep.optics.code import ShutterCode
from cep.optics.path_limits import check_frame, check_resolved
from cep.plots import mtf_curve, mtf_figure, save
from cep.proofs.measure import CodeMetrics, FigureOfMerit, OwnFigure, measure_worst, own_figures
from motdiff.trajectory import Trajectory

OPEN = "open shutter"  # name of the row that every comparison begins with


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
    freq_cy_px: NDArray[np.float64]
    mtf: NDArray[np.float64]
    metrics: CodeMetrics
    figures: Mapping[str, OwnFigure] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Fields for JSON: bits, curve, metrics, and the user's own ``figures`` if any."""
        fields: dict[str, Any] = {
            "bits": self.code and self.code.bits,
            "freq_cy_px": self.freq_cy_px,
            "mtf": self.mtf,
            **self.metrics.to_dict(),
        }
        if self.figures:
            fields["figures"] = dict(self.figures)
        return fields


@dataclass(frozen=True)
class MtfComparison:
    """MTFs of codes along one motion.

    Attributes
    ----------
    trajectory : Trajectory
    rows : mapping from a name to MtfRow
        The open shutter first.
    """

    trajectory: Trajectory
    rows: Mapping[str, MtfRow]

    def to_dict(self) -> dict[str, Any]:
        """Rows for JSON, as ``cep mtf --json`` prints them as its curves."""
        return {name: row.to_dict() for name, row in self.rows.items()}

    def save(self, path: Path | str) -> None:
        """Draw the MTFs in one and two dimensions, as .png, .pdf or .svg, whole or not at all."""
        codes = {name: row.code for name, row in self.rows.items()}
        save(mtf_figure(self.trajectory, codes), path)


def compare_mtfs(
    trajectory: Trajectory,
    codes: Mapping[str, ShutterCode],
    *,
    figures: Mapping[str, FigureOfMerit] | None = None,
    on_checked: Callable[[], None] = lambda: None,
) -> MtfComparison:
    """Measure the MTFs of codes along a motion, and the open shutter's.

    Parameters
    ----------
    trajectory : Trajectory
    codes : mapping from a name to a code
    figures : mapping from a name to a function, optional
        Figures of merit of the user's own, see :func:`cep.proofs.measure.own_figures`.
    on_checked : callable, optional
        Called before the work, when the path has been checked.

    Raises
    ------
    ValueError
        If the path cannot be measured, or is too short for the chips of a code; or a figure of the
        user's own fails.
    """
    check_frame(trajectory)
    for code in codes.values():
        check_resolved(trajectory, code.chips)
    on_checked()
    shutters: dict[str, ShutterCode | None] = {OPEN: None, **codes}
    played = {name: shutter or ShutterCode("1") for name, shutter in shutters.items()}
    # first: one that fails does so before the work
    own_of = {name: own_figures(figures or {}, trajectory, code) for name, code in played.items()}
    rows = {
        name: MtfRow(
            shutter,
            *mtf_curve(trajectory, shutter),
            measure_worst(trajectory, played[name]),
            own_of[name],
        )
        for name, shutter in shutters.items()
    }
    return MtfComparison(trajectory, rows)
