"""The registered estimators of motion, by name.

To add one: declare it by a :class:`motdiff.estimators.method.Method` in a folder of its own, and
name it in :data:`METHODS`. The command line and the citations list what is registered here; the
laboratory's tables and the studio's server take every blind one by its name.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from typing import Any

from motdiff.estimators.coded import Coded
from motdiff.estimators.gyro import Gyro
from motdiff.estimators.method import Method, is_needed
from motdiff.estimators.motdiff import MotDiff
from motdiff.estimators.pmp import Pmp
from motdiff.estimators.point import Point
from motdiff.estimators.reference import Reference

METHODS: dict[str, type[Method]] = {
    method.name: method for method in (MotDiff, Pmp, Reference, Point, Gyro, Coded)
}


def blind_methods() -> tuple[str, ...]:
    """Return the names of the methods that need nothing but blurred photos."""
    return tuple(name for name, method in METHODS.items() if method.is_blind)


def check_options(name: str, option_names: Iterable[str]) -> None:
    """Check the name of a method and those of its options, before anything is read or loaded.

    Parameters
    ----------
    option_names : iterable of str
        Names of the options that have a value.

    Raises
    ------
    ValueError
        If the method is not known, needs an option that is missing, or has no such option.
    """
    if name not in METHODS:
        raise ValueError(
            f"method: must be one of {', '.join(METHODS)}, or module:name, got {name!r}"
        )
    options = {declared.name: declared for declared in fields(METHODS[name])}
    values = set(option_names)
    for missing in sorted(key for key, declared in options.items() if is_needed(declared)):
        if missing not in values:
            raise ValueError(f"{missing}: needed with method={name!r}")
    for unknown in sorted(values - set(options)):
        raise ValueError(f"{unknown}: not valid with method={name!r}")


def make_method(name: str, options: Mapping[str, Any]) -> Method:
    """Return a method with its options, None for those that are not given.

    Parameters
    ----------
    name : str
        One of :data:`METHODS`.
    options : mapping from the name of an option to its value

    Raises
    ------
    ValueError
        As :func:`check_options`, or if a value is not valid.

    Examples
    --------
    >>> make_method("motdiff", {})
    MotDiff()
    """
    values = {key: value for key, value in options.items() if value is not None}
    check_options(name, values)
    make: Callable[..., Method] = METHODS[name]
    return make(**values)
