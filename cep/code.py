"""A binary shutter code: which chips of the exposure are open."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["ShutterCode"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class ShutterCode:
    """Shutter code, first chip first.

    Parameters
    ----------
    bits : str
        "1" is an open chip, "0" a closed one; at least one is open.
    chip_ns : int
        Duration of a chip, ns.

    Raises
    ------
    ValueError
        If ``bits`` has other characters, is empty or all closed, or ``chip_ns`` is not a positive integer.

    Examples
    --------
    >>> code = ShutterCode("11100101")
    >>> code.chips, code.open_chips, code.duty, code.pulses
    (8, 5, 0.625, 3)
    >>> code.runs
    ((1, 3), (0, 2), (1, 1), (0, 1), (1, 1))
    """

    bits: str
    chip_ns: int = 1_000_000

    def __post_init__(self) -> None:
        if not isinstance(self.bits, str):
            raise ValueError(f"bits: must be a string of 0 and 1, got {type(self.bits).__name__}")
        wrong = next((i for i, bit in enumerate(self.bits) if bit not in "01"), None)
        if wrong is not None:
            raise ValueError(f"bits: only 0 and 1 are allowed, found {self.bits[wrong]!r} at chip {wrong + 1}")
        if "1" not in self.bits:
            what = "all chips are closed" if self.bits else "the code is empty"
            raise ValueError(f"bits: {what}; at least one chip must be open")
        if isinstance(self.chip_ns, bool) or not isinstance(self.chip_ns, int | np.integer) or self.chip_ns < 1:
            raise ValueError(f"chip_ns: must be a whole number of nanoseconds above 0, got {self.chip_ns!r}")
        object.__setattr__(self, "chip_ns", int(self.chip_ns))

    @classmethod
    def from_array(cls, chips: ArrayLike, *, chip_ns: int = 1_000_000) -> ShutterCode:
        """Make a code from (n,) numbers or booleans, each exactly 0 or 1.

        Raises
        ------
        ValueError
            If the array is not one-dimensional or has other values.
        """
        values = np.asarray(chips)
        if values.ndim != 1 or not np.isin(values, (0, 1)).all():
            raise ValueError(f"chips: must be a one-dimensional array of 0 and 1, got shape {values.shape}")
        return cls("".join("1" if value else "0" for value in values), chip_ns)

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

    @property
    def longest_run(self) -> int:
        """Chips in the longest run, open or closed."""
        return max(length for _, length in self.runs)

    def reversed(self) -> ShutterCode:
        """Return the code played backwards."""
        return replace(self, bits=self.bits[::-1])
