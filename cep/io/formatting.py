"""How figures are told to people; JSON and files keep them as they are."""

from __future__ import annotations

__all__ = ["number"]

_ROUNDING = 1e-12  # of figures around 1, in dB or px: smaller is what sums leave of a zero


def number(value: float, *, digits: int = 4) -> str:
    """Write a figure with so many digits, and what rounding left of a zero as 0.

    Examples
    --------
    >>> number(0.0317612), number(1.2e-16), number(-3e-15)
    ('0.03176', '0', '0')
    """
    return f"{value:.{digits}g}" if not abs(value) < _ROUNDING else "0"
