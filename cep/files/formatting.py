"""Numbers and times in text for people, and times as people write them; JSON and files keep full
precision.
"""

from __future__ import annotations

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


def seconds_of(text: str) -> float:
    """Read a time: seconds, a fraction of one, or a number with its unit.

    Raises
    ------
    ValueError
        If it is none of these, or not above 0.

    Examples
    --------
    >>> seconds_of("1/50"), seconds_of("20ms"), seconds_of("0.5")
    (0.02, 0.02, 0.5)
    """
    figure = text.strip()
    size = 1.0
    for unit, factor in (("ns", 1e-9), ("us", 1e-6), ("ms", 1e-3), ("s", 1.0)):
        if figure.endswith(unit):
            figure = figure.removesuffix(unit)
            size = factor
            break
    over, slash, under = figure.partition("/")
    try:
        value = float(over) / (float(under) if slash else 1.0) * size
    except (ValueError, ZeroDivisionError):
        value = float("nan")
    if not 0 < value < float("inf"):
        raise ValueError(
            f"exposure: must be a time above 0 as 1/30, 0.02, 20ms or 500us, got {text!r}"
        )
    return value
