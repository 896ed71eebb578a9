"""Estimators of the blind table: their names, labels, and cache versions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from lab.bench.blind.cells import CEILINGS, FLOORS
from lab.evaluation.methods import METHODS, RIVALS, named_estimators, split_weights
from lab.jobs.fingerprint import source_version
from motdiff.estimators.registry import blind_methods
from motdiff.files.plugins import is_reference
from motdiff.weights import CORRECTION_WEIGHTS, DEFAULT_WEIGHTS, PATH_WEIGHTS

USUAL = (
    *blind_methods(),
    *(name for name, rival in RIVALS.items() if rival.in_every_table),
)
"""Estimators of every table."""
UNUSUAL = {name: rival.reason for name, rival in RIVALS.items() if rival.reason}
"""Estimators that are measured when named, and why only then."""
OURS = ("motdiff", "networks", "network")
"""The first of these that is measured is what others are compared with."""
SMALL_BUDGETS = {name: rival.samples for name, rival in RIVALS.items() if rival.samples}
"""Samples that the shipped baselines were trained on, after a start from MoTDiff's condition
network."""

_WEIGHTS = {
    **dict.fromkeys(blind_methods(), PATH_WEIGHTS),  # their paths are drawn
    **{
        name: DEFAULT_WEIGHTS if rival.of_motdiff else rival.weights
        for name, rival in RIVALS.items()
    },
}
_CORRECTED = ("motdiff", *(name for name, rival in RIVALS.items() if rival.is_corrected))

_TAKING = (
    "lab.bench.blind.cells",
    "lab.bench.psf_text",
    "lab.bench.blind.cases",
    "lab.bench.datasets",  # the crop
    "motdiff.simulate",
    "motdiff.photo_values",
    "cep.files.images",  # gamma
    "cep.files.raw_files",
    "motdiff.files.decoding",
    "motdiff.threads",  # the one thread
)
"""Modules that take and measure a photo; what else they import has no part in it, or is
followed."""


def select_methods(names: Sequence[str]) -> tuple[tuple[str, ...], list[str]]:
    """Select the estimators to measure: those named, or the default ones whose weights are there.

    Returns
    -------
    names : tuple of str
    warnings : list of str, one for each default one that is left out

    Raises
    ------
    ValueError
        If a name is not known, comes twice, or its weights are missing.
    FileNotFoundError
        If there is no file of the weights that a name has.
    """
    labels = [label_of(name) for name in names]
    if len(set(labels)) < len(labels):
        twice = next(label for label in labels if labels.count(label) > 1)
        raise ValueError(f"methods: every one must come once, {twice} comes twice")
    for name in names:
        weights = split_weights(name)[1]
        if weights is None and (path := _weights(name)) is not None and not path.is_file():
            raise ValueError(
                f"methods: {name} has no weights in this package ({path.name} is missing)"
            )
        named_estimators(
            [name]
        )  # refuses an unknown one, and broken weights, before hours of work
    if names:
        return tuple(_found_from_anywhere(name) for name in names), []
    left_out = {
        name: path for name in USUAL if (path := _weights(name)) is not None and not path.is_file()
    }
    warnings = [
        f"{name} is left out: {path.name} is not in this package"
        for name, path in left_out.items()
    ]
    return tuple(name for name in USUAL if name not in left_out), warnings


def budget_warning(methods: Iterable[str]) -> str | None:
    """Warning that trained baselines among ``methods`` had less training than MoTDiff; None where
    there is none.
    """
    names = {method.split(":")[0] for method in methods}
    if not (
        small := [
            f"{name} {samples:,}" for name, samples in SMALL_BUDGETS.items() if name in names
        ]
    ):
        return None
    return (
        "smaller training budgets than MoTDiff's 209,600 samples drawn from 13,376 prepared ones:"
        f" {' and '.join(small)} from 704, after a start from its condition network at 62,400"
    )


def label_of(method: str) -> str:
    """Label of a method in tables: a file or folder of weights by its own name, without its
    path.
    """
    return _relocated(method, lambda path: path.name)


def version_of(method: str) -> str:
    """Cache version of a method: fingerprint of its code, its weights, and the code that measures
    it.

    Parameters
    ----------
    method : str
        An estimator, a floor or a ceiling. Of one of the user's own, the module that it names
        counts, and what of ours that module imports.
    """
    followed = ["lab.evaluation.measure"]
    modules = list(_TAKING)
    if method in (*FLOORS, *CEILINGS):
        return source_version([*followed, "lab.evaluation.floors"], alone=modules)
    first = split_weights(method)[0].split(":")[0]
    if first in RIVALS:
        followed.append(RIVALS[first].module)
    elif first not in METHODS and is_reference(method):
        followed.append(first)
    else:
        followed.append(f"motdiff.estimators.{first}")
    weights = _weights(method)
    if folder := _folder(method):
        files = sorted(path for path in Path(folder).rglob("*") if path.is_file())
    else:
        files = [] if weights is None else [weights]
        files += [CORRECTION_WEIGHTS] if first in _CORRECTED else []
    return source_version(followed, alone=[*modules, "lab.evaluation.methods"], files=files)


def _weights(method: str) -> Path | None:
    name, weights = split_weights(method)
    return weights or _WEIGHTS.get(name.split(":")[0])


def _folder(method: str) -> str:
    name, _, folder = method.partition(":")
    return folder if name == "blinddps" else ""


def _found_from_anywhere(method: str) -> str:
    """Absolute form of a method with weights of its own: workers may have another current
    folder.
    """
    return _relocated(method, lambda path: str(path.absolute()))


def _relocated(method: str, place: Callable[[Path], str]) -> str:
    name, file = split_weights(method)
    if file is not None:
        return f"{name}@{place(file)}"
    folder = _folder(method)
    return f"{method.partition(':')[0]}:{place(Path(folder))}" if folder else method
