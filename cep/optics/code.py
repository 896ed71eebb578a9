"""A binary shutter code: which chips of the exposure are open."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import groupby
from typing import TypeGuard

import numpy as np
from numpy.typing import ArrayLike

from motdiff.types import FloatArray


@dataclass(frozen=True, init=False)
class ShutterCode:
    """Shutter code, first chip first.

    Parameters
    ----------
    bits : str or (n,) array_like
        "1" is an open chip, "0" a closed one; or numbers or booleans, each exactly 0 or 1. At
        least one is open.
    chip_ns : int
        Duration of a chip, ns.

    Raises
    ------
    ValueError
        If ``bits`` has other characters or values, is empty or all closed, or ``chip_ns`` is not a
        positive integer.

    Examples
    --------
    >>> code = ShutterCode("11100101")
    >>> code.chips, code.open_chips, code.duty, code.pulses
    (8, 5, 0.625, 3)
    >>> code.runs
    ((1, 3), (0, 2), (1, 1), (0, 1), (1, 1))
    >>> code.integration_ns, ShutterCode("01110000").integration_ns
    (8000000, 3000000)

    Lists and arrays will do as well:

    >>> ShutterCode([1, 0, 1])
    ShutterCode(bits='101', chip_ns=1000000)
    >>> ShutterCode(np.array([True, False, True]), chip_ns=250_000).bits
    '101'
    >>> ShutterCode([0.5, 1.0])
    Traceback (most recent call last):
    ValueError: bits: only 0 and 1 are allowed, found 0.5 at chip 1
    """

    bits: str
    chip_ns: int

    def __init__(self, bits: str | ArrayLike, chip_ns: int = 1_000_000) -> None:
        text = _text(bits)
        wrong = next((i for i, bit in enumerate(text) if bit not in "01"), None)
        if wrong is not None:
            raise ValueError(
                f"bits: only 0 and 1 are allowed, found {text[wrong]!r} at chip {wrong + 1}"
            )
        if "1" not in text:
            state = "all chips are closed" if text else "the code is empty"
            raise ValueError(f"bits: {state}; at least one chip must be open")
        # controllers and files hold times in 64 bits with a sign
        if not (is_whole(chip_ns) and 0 < chip_ns < 2**63):
            raise ValueError(
                f"chip_ns: must be a whole number of nanoseconds within 1..2^63-1, got {chip_ns!r}"
            )
        # frozen: set past the dataclass, whose own __init__ would not take arrays
        object.__setattr__(self, "bits", text)
        object.__setattr__(self, "chip_ns", int(chip_ns))

    @property
    def chips(self) -> int:
        """Number of chips, n."""
        return len(self.bits)

    @property
    def open_chips(self) -> int:
        """Number of open chips, k."""
        return self.bits.count("1")

    @property
    def duty(self) -> float:
        """Open fraction of the exposure, k / n."""
        return self.open_chips / self.chips

    @property
    def duration_ns(self) -> int:
        """Length of the exposure, ns."""
        return self.chips * self.chip_ns

    @property
    def integration_ns(self) -> int:
        """Time for which a sensor integrates dark current, ns.

        A single opening is an exposure of its own, and no longer than that. Any other code takes
        the whole exposure.
        """
        if self.pulses == 1:
            return self.chip_ns * self.open_chips
        return self.duration_ns

    @property
    def array(self) -> FloatArray:
        """(n,) float64 of 0 and 1."""
        return (np.frombuffer(self.bits.encode(), dtype=np.uint8) - ord("0")).astype(np.float64)

    @property
    def runs(self) -> tuple[tuple[int, int], ...]:
        """Runs of equal chips in order, as (0 or 1, number of chips)."""
        return tuple((int(bit), len(list(group))) for bit, group in groupby(self.bits))

    @property
    def pulses(self) -> int:
        """Number of open runs: how often the shutter opens."""
        return sum(bit for bit, _ in self.runs)

    def complement(self) -> ShutterCode:
        """Return the code that is open where this one is closed; ValueError if that is none."""
        return ShutterCode(self.bits.translate(str.maketrans("01", "10")), self.chip_ns)

    def reversed(self) -> ShutterCode:
        """Return the code played backwards."""
        return replace(self, bits=self.bits[::-1])


def is_whole(value: object) -> TypeGuard[int]:
    """Whether a value is an integer, of numpy as well; True and False are none.

    Examples
    --------
    >>> is_whole(np.int64(8)), is_whole(8.0), is_whole(True)
    (True, False, False)
    """
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def _text(chips: str | ArrayLike) -> str:
    """Spell (n,) numbers or booleans as 0 and 1."""
    if isinstance(chips, str):
        return chips
    try:
        values = np.asarray(chips)
    except (TypeError, ValueError):  # rows of unequal length
        values = np.empty((0, 0))
    if values.ndim != 1 or values.dtype.kind not in "biuf":
        kind = type(chips).__name__
        if values.ndim > 1 and values.dtype.kind in "biuf":
            kind = "rows of them"
        raise ValueError(
            f"bits: must be a string or a one-dimensional array of 0 and 1, got {kind}"
        )
    wrong = np.flatnonzero((values != 0) & (values != 1))
    if wrong.size:
        raise ValueError(
            f"bits: only 0 and 1 are allowed, found {values[wrong[0]]:g} at chip {wrong[0] + 1}"
        )
    return "".join(str(int(value)) for value in values)
