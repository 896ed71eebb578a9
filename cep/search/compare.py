"""A code beside what would be used instead of it, and the figures of each."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from cep.optics.code import ShutterCode
from cep.proofs.measure import CodeMetrics
from cep.search.problem import SearchProblem
from cep.search.recipe import Baseline
from cep.search.recipe import baselines as find_baselines


@dataclass(frozen=True)
class BaselineRow:
    """A line of the comparison.

    Attributes
    ----------
    name : str
        "this code", or of a :class:`cep.search.recipe.Baseline`.
    code : ShutterCode
    metrics : CodeMetrics
        Worst over the problem's scenarios and directions. Only the first row's ``min_mtf_lower``
        is worth anything: the others carry no certificate.
    within_limits : bool
        Whether the code keeps the problem's limits: others could not be returned, however good
        they are.
    stopped_early : bool
        Whether the time limit or Ctrl-C ended the search of this code: another run may give
        another.
    """

    name: str
    code: ShutterCode
    metrics: CodeMetrics
    within_limits: bool
    stopped_early: bool = False

    @property
    def label(self) -> str:
        """The name, and whether the code breaks the limits, for tables."""
        if self.within_limits:
            return self.name
        return f"{self.name} (outside the limits)"


class Comparison(tuple[BaselineRow, ...]):
    """Rows of a comparison, the code itself first; printed as a table."""

    __slots__ = ()

    def __repr__(self) -> str:
        cells = [("", "open", "min MTF", "noise gain, dB", "MSE, dB"), *map(_cells, self)]
        # names flush left, figures flush right, as in the commands' tables
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        return "\n".join(
            "  ".join(
                [
                    row[0].ljust(widths[0]),
                    *(text.rjust(n) for text, n in zip(row[1:], widths[1:], strict=True)),
                ]
            )
            for row in cells
        )


def compare(
    problem: SearchProblem,
    code: ShutterCode,
    *,
    baselines: Iterable[Baseline] | None = None,
    seed: int = 0,
) -> Comparison:
    """Measure a code, and what would be used instead of it, on the same motions.

    Parameters
    ----------
    problem : SearchProblem
    code : ShutterCode
    baselines : iterable of Baseline, optional
        As the code's search returned them; :func:`cep.search.recipe.baselines` of the problem when
        omitted.
    seed : int
        Of the baselines that are searched or drawn here.

    Raises
    ------
    ValueError
        If the code has another number of chips.

    Examples
    --------
    >>> from motdiff.trajectory import Trajectory
    >>> path = Trajectory.from_samples([[0, 0], [9, 3], [14, 12]])
    >>> problem = SearchProblem.along(path, chips=8, objective="mse")
    >>> rows = compare(problem, ShutterCode("11100101"))
    >>> [row.name for row in rows][:4]
    ['this code', 'open shutter', 'best snapshot', 'best strobe']
    """
    if baselines is None:
        baselines = find_baselines(problem, rng=np.random.default_rng(seed))
    rows = (
        BaselineRow("this code", code, problem.measure(code), problem.allows(code)),
        *(
            BaselineRow(
                baseline.name,
                ShutterCode(baseline.code.bits, code.chip_ns),  # published codes have none
                problem.measure(baseline.code, budget=0),  # no proof: it would take seconds
                baseline.within_limits,
                baseline.stopped_early,
            )
            for baseline in baselines
        ),
    )
    return Comparison(rows)


def _cells(row: BaselineRow) -> tuple[str, ...]:
    figures = [row.metrics.in_words(name) for name in ("min_mtf", "noise_gain_db", "mse_db")]
    return (
        row.label,
        str(row.code.open_chips),
        *(f"{x:.4g}" if isinstance(x, float) else str(x) for x in figures),
    )
