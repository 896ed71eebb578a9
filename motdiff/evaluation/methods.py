"""The estimators that can be measured, by name."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from motdiff.estimators.base import Estimator

__all__ = ["METHODS", "named_estimators"]

METHODS = ("pmp", "motdiff")


def named_estimators(methods: Sequence[str], weights: Sequence[Path] = ()) -> dict[str, Estimator]:
    """Make the estimators that a table should have.

    Parameters
    ----------
    methods : sequence of names in :data:`METHODS`
    weights : sequence of files
        One "motdiff" for each, named by the file's stem; none: the weights of the package, named "motdiff".

    Returns
    -------
    dict from the name in the table to the estimator, in the order asked for

    Raises
    ------
    ValueError
        If a method is unknown, two have one name, or there are weights and no "motdiff".
    FileNotFoundError
        If a file of weights is missing.
    """
    if unknown := [name for name in methods if name not in METHODS]:
        raise ValueError(f"method: must be one of {', '.join(METHODS)}, got {unknown[0]!r}")
    if weights and "motdiff" not in methods:
        raise ValueError("weights: are for the method motdiff, which was not asked for")
    if missing := [path for path in weights if not path.is_file()]:
        raise FileNotFoundError(f"{missing[0]}: no such file of weights")
    named: list[tuple[str, Estimator]] = []
    for method in dict.fromkeys(methods):
        if method == "pmp":
            from motdiff.estimators.pmp import PmpEstimator

            named.append(("pmp", PmpEstimator()))
        else:
            from motdiff.estimators.motdiff import MotDiffEstimator

            named += [(path.stem, MotDiffEstimator(weights=path)) for path in weights]
            named += [] if weights else [("motdiff", MotDiffEstimator())]
    estimators = dict(named)
    if len(estimators) < len(named):
        raise ValueError(f"weights: need different file names, the tables would show {[name for name, _ in named]}")
    return estimators
