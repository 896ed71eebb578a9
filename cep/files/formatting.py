"""Numbers and times in text for people; JSON and files keep full precision."""

from __future__ import annotations

from collections.abc import Mapping

_UNITS_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_ROUNDING = 1e-12  # of figures around 1, in dB or px: smaller values are rounding errors of a zero


def number(value: float) -> str:
    """Format a number to four digits; rounding errors of a zero become 0.

    Examples
    --------
    >>> number(0.0317612), number(1.2e-16), number(-3e-15)
    ('0.03176', '0', '0')
    """
    if abs(value) < _ROUNDING:
        return "0"
    return f"{value:.4g}"


def formatted(value: float | None, spec: str) -> str | None:
    """Format a figure for a table's cell; None stays None, which is printed as a dash.

    Examples
    --------
    >>> formatted(1.234, "+.2f"), formatted(None, "+.2f")
    ('+1.23', None)
    """
    return None if value is None else format(value, spec)


def option_words(options: Mapping[str, str | float | None]) -> list[str]:
    """Write options as the words of a command line; those of None are left out.

    Examples
    --------
    >>> option_words({"--camera": "flir", "--photons": 2e3, "--read-noise": None})
    ['--camera', 'flir', '--photons', '2000']
    """
    words = []
    for option, value in options.items():
        if value is not None:
            words += [option, f"{value:g}" if isinstance(value, float | int) else value]
    return words


def duration(seconds: float, *, digits: int = 3) -> str:
    """Format a duration in the unit that suits it.

    Examples
    --------
    >>> duration(1 / 30), duration(2.5e-5), duration(90)
    ('33.3 ms', '25 us', '90 s')
    """
    for unit in ("s", "ms", "us"):
        if seconds >= _UNITS_S[unit]:
            return f"{seconds / _UNITS_S[unit]:.{digits}g} {unit}"
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
    # "s" last, as the other units end with it
    unit = next((unit for unit in ("ns", "us", "ms") if figure.endswith(unit)), "s")
    over, slash, under = figure.removesuffix(unit).partition("/")
    try:
        value = float(over)
        if slash:
            value /= float(under)
        value *= _UNITS_S[unit]
    except (ValueError, ZeroDivisionError):
        value = float("nan")  # refused below, as it compares as false
    if not 0 < value < float("inf"):
        raise ValueError(
            f"exposure: must be a time above 0 as 1/30, 0.02, 20ms or 500us, got {text!r}"
        )
    return value
