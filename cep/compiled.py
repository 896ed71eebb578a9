"""Compiling of the innermost loops: numba, kept between runs, free of the interpreter's lock."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

from numba import njit

__all__ = ["compiled", "inlined"]

F = TypeVar("F", bound=Callable[..., object])
_OPTIONS = {
    "nogil": True,
    # as C divides: a check for zero in every iteration would keep vector instructions away
    "error_model": "numpy",
    # sums may be reordered, for the same reason; NaN and infinities keep their meaning
    "fastmath": {"reassoc", "contract", "arcp", "nsz"},
}


def compiled(function: F) -> F:
    """Compile at the first call; the machine code is kept beside the module, or else in the user's cache folder.

    Threads may run it side by side.
    """
    return cast(F, njit(cache=True, **_OPTIONS)(function))


def inlined(function: F) -> F:
    """Compile into whatever compiled function calls it: handing over many arrays costs more than a short loop."""
    return cast(F, njit(cache=True, forceinline=True, **_OPTIONS)(function))
