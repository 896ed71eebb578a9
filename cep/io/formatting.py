"""Formatting of numbers in text for people; JSON and files keep full precision."""

from __future__ import annotations

__all__ = ["number"]

_ROUNDING = 1e-12  # of figures around 1, in dB or px: smaller values are rounding errors of a zero


def number(value: float, *, digits: int = 4) -> str:
    """Format a number to some digits; rounding errors of a zero become 0.

    Examples
    --------
    >>> number(0.0317612), number(1.2e-16), number(-3e-15)
    ('0.03176', '0', '0')
    """
    return f"{value:.{digits}g}" if not abs(value) < _ROUNDING else "0"
