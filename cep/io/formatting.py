"""Formatting of numbers in text for people; JSON and files keep full precision."""

from __future__ import annotations

__all__ = ["duration", "number"]

_ROUNDING = 1e-12  # of figures around 1, in dB or px: smaller values are rounding errors of a zero


def number(value: float, *, digits: int = 4) -> str:
    """Format a number to some digits; rounding errors of a zero become 0.

    Examples
    --------
    >>> number(0.0317612), number(1.2e-16), number(-3e-15)
    ('0.03176', '0', '0')
    """
    return f"{value:.{digits}g}" if not abs(value) < _ROUNDING else "0"


def duration(seconds: float, *, digits: int = 3) -> str:
    """Format a duration in the unit that suits it.

    Examples
    --------
    >>> duration(1 / 30), duration(2.5e-5), duration(90)
    ('33.3 ms', '25 us', '90 s')
    """
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if seconds >= size:
            return f"{seconds / size:.{digits}g} {unit}"
    return f"{seconds * 1e9:.{digits}g} ns"
