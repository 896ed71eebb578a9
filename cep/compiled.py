"""Compiling of the innermost loops: numba, kept between runs, free of the interpreter's lock."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

from numba import njit

__all__ = ["compiled"]

F = TypeVar("F", bound=Callable[..., object])


def compiled(function: F) -> F:
    """Compile at the first call; the machine code is kept beside the module (or in the user's cache folder).

    Threads may run it side by side. Sums may be reordered, for vector instructions; NaN and infinities keep their
    meaning.
    """
    return cast(F, njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "arcp", "nsz"})(function))
