"""Device profiles: limits of shutters, read from TOML, and the check of a program against them."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Any

from hw.errors import one_line
from hw.files import content
from hw.program import Program

_SCHEMA = "hw.device/1"
_PROFILE_BYTES = 2**20  # far more than any profile has


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceProfile:
    """Limits of a shutter and its controller; None means no limit.

    Parameters
    ----------
    name : str
        Short name, as in ``--device NAME``.
    description : str
        Description in one line.
    tick_ns : int
        Resolution of the device clock: a chip must be a whole number of ticks.
    min_chip_ns, max_chip_ns : int or None
        Range of the chip time the controller accepts.
    max_chips : int or None
        Longest code the controller stores.
    min_on_ns, max_on_ns : int or None
        Range of an open run as commanded.
    min_off_ns : int or None
        Shortest closed run between two openings.
    max_duty : float or None
        Largest open fraction of the whole program, 0..1.
    max_pulses : int or None
        Most openings in one program.
    max_rate_hz : float or None
        Highest rate of openings, taken at the two openings nearest to each other.
    dead_time_ns : int
        Time the device is blind after an opening (frame overhead): every gap must last longer than
        that or as long.
    on_bias_ns : int
        Time the device adds to every opening by itself; the command is shortened by it, and must
        remain possible.
    rise_ns, fall_ns : int
        Time the shutter takes from closed to fully open, and back, each a straight ramp that
        begins at its edge.
    closed_level : int
        Output level, 0 or 1, at which the shutter is closed.

    Examples
    --------
    >>> from hw.program import Program
    >>> slow = DeviceProfile(name="slow", min_on_ns=2_000_000)
    >>> slow.check(Program("1011", chip_ns=1_000_000))
    ('slow: shortest opening is 1 ms; at least 2 ms',)
    """

    name: str
    description: str = ""
    tick_ns: int = 1
    min_chip_ns: int | None = None
    max_chip_ns: int | None = None
    max_chips: int | None = None
    min_on_ns: int | None = None
    max_on_ns: int | None = None
    min_off_ns: int | None = None
    max_duty: float | None = None
    max_pulses: int | None = None
    max_rate_hz: float | None = None
    dead_time_ns: int = 0
    on_bias_ns: int = 0
    rise_ns: int = 0
    fall_ns: int = 0
    closed_level: int = 0

    def __post_init__(self) -> None:
        for field in fields(self):
            _check_field(field.name, getattr(self, field.name), optional=field.default is None)
        for low, high in (("min_chip_ns", "max_chip_ns"), ("min_on_ns", "max_on_ns")):
            low_value = getattr(self, low)
            high_value = getattr(self, high)
            if low_value is not None and high_value is not None and low_value > high_value:
                raise ValueError(
                    f"{low} is {low_value} but {high} is {high_value}: the least must not"
                    " exceed the most"
                )

    @classmethod
    def from_dict(cls, table: Mapping[str, Any], *, source: str = "profile") -> DeviceProfile:
        """Make a profile of its file's content, the inverse of `to_dict`; `source` is its name.

        ValueError if it has another schema, an unknown field, or a value out of range.
        """
        figures = dict(table)
        schema = figures.pop("schema", None)
        if schema != _SCHEMA:
            raise ValueError(
                f'{source} has schema {str(schema)[:40]!r}: schema = "{_SCHEMA}" is needed'
            )
        names = {field.name for field in fields(cls)}
        # An unknown field may be a misspelt limit, which must not be dropped in silence.
        unknown = sorted(set(figures) - names)
        if unknown:
            raise ValueError(
                f"{source} has unknown field {unknown[0][:40]!r}: known are"
                f" {', '.join(sorted(names))}"
            )
        missing = [
            field.name
            for field in fields(cls)
            if field.default is MISSING and field.name not in figures
        ]
        if missing:
            raise ValueError(f"{source} has no {missing[0]}: every profile needs one")
        try:
            return cls(**figures)
        except (ValueError, OverflowError) as error:  # whole numbers that no float reaches
            raise ValueError(f"{source}: {one_line(error)}") from None

    def to_dict(self) -> dict[str, Any]:
        """Content of the profile's file: its schema, and the fields that are not left out."""
        figures = {
            field.name: value
            for field in fields(self)
            if (value := getattr(self, field.name)) != field.default
        }
        return {"schema": _SCHEMA, **figures}

    def check(self, program: Program) -> tuple[str, ...]:
        """List every limit that a program breaks, each in one plain sentence.

        A sentence has the figure of the program, and the figure that would be right.
        """
        return tuple(
            f"{self.name}: {problem}" for problem in (*self._grid(program), *self._runs(program))
        )

    def _grid(self, program: Program) -> list[str]:
        problems: list[str] = []
        chip = program.chip_ns
        if chip % self.tick_ns:
            below = chip - chip % self.tick_ns
            nearest = " or ".join(str(value) for value in (below, below + self.tick_ns) if value)
            problems.append(
                f"chip of {chip} ns is not a whole number of {self.tick_ns} ns ticks; {nearest} ns"
                " would be"
            )
        if self.min_chip_ns is not None and chip < self.min_chip_ns:
            problems.append(
                f"chip of {_time(chip)} is too short; at least {_time(self.min_chip_ns)}"
            )
        if self.max_chip_ns is not None and chip > self.max_chip_ns:
            problems.append(
                f"chip of {_time(chip)} is too long; at most {_time(self.max_chip_ns)}"
            )
        if self.max_chips is not None and program.chips > self.max_chips:
            problems.append(f"code of {program.chips} chips is too long; at most {self.max_chips}")
        return problems

    def _runs(self, program: Program) -> list[str]:
        problems: list[str] = []
        edges = program.edges
        openings = [t for t, level in edges if level]
        closings = [t for t, level in edges if not level]
        open_ns = [end - start for start, end in zip(openings, closings, strict=True)]
        gaps_ns = [start - end for start, end in zip(openings[1:], closings[:-1], strict=True)]
        # The shutter may rest closed before and after as long as it likes: only gaps between
        # openings are limited.
        min_on_ns = self.min_on_ns or 0
        bias = ""
        if self.on_bias_ns:
            # The command is shorter by the bias, and of a tick at least.
            min_on_ns = max(min_on_ns, self.tick_ns) + self.on_bias_ns
            bias = f" (its own {_time(self.on_bias_ns)} included)"
        if min(open_ns) < min_on_ns:
            problems.append(
                f"shortest opening is {_time(min(open_ns))}; at least {_time(min_on_ns)}{bias}"
            )
        if self.max_on_ns is not None and max(open_ns) > self.max_on_ns:
            problems.append(
                f"longest opening is {_time(max(open_ns))}; at most {_time(self.max_on_ns)}"
            )
        if self.min_off_ns is not None and gaps_ns and min(gaps_ns) < self.min_off_ns:
            problems.append(
                f"shortest gap between openings is {_time(min(gaps_ns))}; at least"
                f" {_time(self.min_off_ns)}"
            )
        if gaps_ns and min(gaps_ns) < self.dead_time_ns:
            problems.append(
                f"shortest gap between openings is {_time(min(gaps_ns))}; the dead time is"
                f" {_time(self.dead_time_ns)}"
            )
        if self.max_duty is not None and program.duty > self.max_duty:
            problems.append(f"duty is {program.duty:.3f}; at most {self.max_duty:.3f}")
        if self.max_pulses is not None and program.pulses > self.max_pulses:
            problems.append(f"code has {program.pulses} openings; at most {self.max_pulses}")
        if self.max_rate_hz is not None and len(openings) > 1:
            # The two nearest openings: strobes are limited by the shortest period, not the mean.
            rate_hz = 1e9 / min(b - a for a, b in pairwise(openings))
            if rate_hz > self.max_rate_hz:
                problems.append(
                    f"openings come at up to {rate_hz:.4g} Hz; at most {self.max_rate_hz:.4g} Hz"
                )
        return problems


def parse_profile(text: str, *, source: str = "profile") -> DeviceProfile:
    """Read a profile from TOML text.

    Parameters
    ----------
    text : str
        TOML with ``schema = "hw.device/1"`` and the fields of `DeviceProfile`.
    source : str
        File, for messages.

    Raises
    ------
    ValueError
        If the text is not TOML, has another schema, an unknown field, or a value out of range.
    """
    try:
        table = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{source} is not TOML: {one_line(error)}") from None
    return DeviceProfile.from_dict(table, source=source)


def profile_names() -> tuple[str, ...]:
    """Names of the built-in profiles, sorted."""
    folder = resources.files("hw") / "profiles"
    return tuple(
        sorted(
            item.name.removesuffix(".toml")
            for item in folder.iterdir()
            if item.name.endswith(".toml")
        )
    )


def load_profile(name: str | Path) -> DeviceProfile:
    """Load a built-in profile by name, or one's own by the path of its ``.toml`` file.

    ValueError if there is no such profile, or its file cannot be read or is wrong.
    """
    text_name = str(name)
    # a path is a file's, whatever its suffix
    if isinstance(name, str) and not text_name.endswith(".toml"):
        names = profile_names()
        if text_name not in names:
            raise ValueError(
                f"device profile {text_name!r} is unknown: built in are {', '.join(names)}; or"
                " name a .toml file"
            )
        text = (resources.files("hw") / "profiles" / f"{text_name}.toml").read_text(
            encoding="utf-8"
        )
        return parse_profile(text, source=text_name)
    try:
        text = content(name, most_bytes=_PROFILE_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError:
        text = "\0"
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or one_line(error)
        raise ValueError(
            f"{text_name} cannot be read: {reason}; name a built-in profile or a .toml file"
        ) from None
    if "\0" in text:  # UTF-16 without a mark is UTF-8 with zeros
        raise ValueError(
            f"{text_name} is not UTF-8: a device profile is a TOML file, save it as UTF-8"
        )
    return parse_profile(text, source=text_name)


def refusal(problems: Sequence[str], limits: DeviceProfile) -> str:
    """Say why a program cannot be played, and with which profile to search one that can.

    Examples
    --------
    >>> board = DeviceProfile(name="uno", tick_ns=500, max_chips=1024)
    >>> refusal(["uno: chip of 641026 ns is odd"], board).partition("; ")[2]
    'search a code that can with --device cxp-avr'
    """
    alike = (
        name
        for name in profile_names()
        if limits.max_chips is not None
        and (limits.tick_ns, limits.max_chips)
        == ((profile := load_profile(name)).tick_ns, profile.max_chips)
    )
    hint = next((f"; search a code that can with --device {name}" for name in alike), "")
    return f"program cannot be played: {'; '.join(problems)}{hint}"


def _check_field(name: str, value: Any, *, optional: bool) -> None:
    if value is None and optional:
        return
    if name in {"name", "description"}:
        if not isinstance(value, str) or "\n" in value or (name == "name" and not value):
            raise ValueError(f"{name} is {str(value)[:40]!r}: one line of text is needed")
    elif isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{name} is {value!r}: a finite number is needed")
    elif name == "max_duty":
        if not 0 < value <= 1:
            raise ValueError(f"max_duty is {value}: it must be above 0 and at most 1")
    elif name == "max_rate_hz":
        if value <= 0:
            raise ValueError(f"max_rate_hz is {value}: it must be above 0")
    elif not isinstance(value, int):
        raise ValueError(f"{name} is {value!r}: a whole number is needed")
    elif name == "closed_level":
        if value not in (0, 1):
            raise ValueError(f"closed_level is {value}: it must be 0 or 1")
    else:
        zero = {"dead_time_ns", "on_bias_ns", "rise_ns", "fall_ns", "min_on_ns", "min_off_ns"}
        lowest = 0 if name in zero else 1
        if value < lowest:
            raise ValueError(f"{name} is {value}: it must be at least {lowest}")


def _time(time_ns: int) -> str:
    for unit_ns, unit in ((10**9, "s"), (10**6, "ms"), (10**3, "us")):
        if time_ns >= unit_ns:
            return f"{time_ns / unit_ns:.6g} {unit}"
    return f"{time_ns} ns"
