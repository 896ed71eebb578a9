"""User-defined objects, named as ``module:name``."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from motdiff.files.inputs import one_line


def is_reference(text: str) -> bool:
    """Whether a text has the form ``module:name``, as ``package.module:MyEstimator``."""
    module, _, name = text.partition(":")
    return all(label.isidentifier() for label in (name, *module.split(".")))


def load_object(reference: str) -> Any:
    """Import an object by its reference, ``module:name``.

    Modules in the current folder are found too, from then on.

    Raises
    ------
    ValueError
        If the text is no reference, the module cannot be imported, or has no such object.

    Examples
    --------
    >>> load_object("math:tau")
    6.283185307179586
    >>> load_object("math:no_such_thing")
    Traceback (most recent call last):
    ValueError: math:no_such_thing: the module math has no 'no_such_thing'
    """
    if not is_reference(reference):
        raise ValueError(f"{reference[:80]!r}: must be module:name, as mymodule:MyEstimator")
    module, _, name = reference.partition(":")
    folder = str(Path.cwd())
    # it stays: what is made of the object may import more, or be sent to a worker
    if folder not in sys.path:
        sys.path.append(folder)
    try:
        imported = import_module(module)
    except Exception as error:  # whatever the user's module raises
        reason = f"{type(error).__name__}: {one_line(error)}"
        raise ValueError(f"{reference}: importing {module} failed ({reason})") from None
    try:
        return getattr(imported, name)
    except AttributeError:
        raise ValueError(f"{reference}: the module {module} has no {name!r}") from None
