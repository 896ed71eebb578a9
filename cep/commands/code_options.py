"""Options that say which code is searched, the problem that they make, and how a search ends."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cep.commands.options import CameraOptions, SceneOptions, option, output_option
from cep.search.chip_count import STANDARD_CHIPS
from cep.search.objectives import OBJECTIVES

if TYPE_CHECKING:
    from cep.files.code_files import StoredCode
    from cep.optics.code import ShutterCode
    from cep.search.problem import Mix, Scenario, ScenarioRule, SearchProblem
    from motdiff.files.outputs import Outputs
    from motdiff.trajectory import Trajectory

# panels of the help pages
CODE = "Code"
_OBJECTIVE = "Objective"
_LIMITS = "Limits of the shutter"
SEARCH = "Search"

STANDARD_CHIPS_HELP = (
    "Number of chips; when omitted the most of 52, 32, 16, 8, 4 and 2 that the motion and the"
    " shutter allow."
)


def chips_option(
    help: str = STANDARD_CHIPS_HELP, default: int | None = None, *, fewest: int
) -> Any:
    """Make the field of the option ``--chips``."""
    return option("--chips", "N", help, default, short="-n", panel=CODE, min=fewest)


def exposure_seconds(text: str | None) -> float | None:
    """Read ``--exposure``: seconds, a fraction of one, or a number with its unit.

    Examples
    --------
    >>> exposure_seconds("1/50"), exposure_seconds("20ms"), exposure_seconds("0.5")
    (0.02, 0.02, 0.5)
    """
    if text is None:
        return None
    from cep.files.formatting import seconds_of

    try:
        return seconds_of(text)
    except ValueError as error:
        raise ValueError(f"--{error}") from None


OpenChips = Annotated[
    str | None,
    typer.Option(
        "--open",
        metavar="K|LOW:HIGH",
        rich_help_panel=CODE,
        help="Open chips, as 26 or 20:30, or their share, as 40%:60%; any number when omitted.",
    ),
]
ExposureTime = Annotated[
    str | None,
    typer.Option(
        "--exposure",
        metavar="S",
        rich_help_panel=CODE,
        help="Length of the exposure, which sets the chip time: 1/30, 0.02, 20ms or 500us.",
    ),
]
Device = Annotated[
    str | None,
    typer.Option(
        "--device",
        metavar="NAME|FILE",
        rich_help_panel=_LIMITS,
        help="What this shutter can play: a built-in profile or a .toml file. Stricter limits may"
        " be added.",
    ),
]


@dataclass(frozen=True, kw_only=True)
class CodeOptions(CameraOptions, SceneOptions):
    """Number of chips, light, exposure and limits of the codes that are searched."""

    chips: int | None = chips_option("Number of chips; 52 when omitted.", fewest=1)
    open_chips: OpenChips = None
    exposure: ExposureTime = None
    device: Device = None
    min_open: int = option("--min-open", "N", "Shortest open run, chips.", 1, panel=_LIMITS, min=1)
    min_closed: int = option(
        "--min-closed", "N", "Shortest closed run, chips.", 1, panel=_LIMITS, min=1
    )

    def problem(
        self,
        *motions: Trajectory | Scenario,
        chips: int | None = None,
        exposure_s: float | None = None,
        objective: Mix = "min-mtf",
        rule: ScenarioRule = "worst",
        frames: int = 1,
    ) -> SearchProblem:
        """Make the problem of the options along motions.

        Parameters
        ----------
        *motions : Trajectory or Scenario
        chips, exposure_s : optional
            Where the options leave them open; then 52 chips of 1 ms.
        objective, rule, frames
            As of :class:`cep.search.problem.SearchProblem`.
        """
        from cep.search.limits import RunLimits
        from cep.search.problem import SearchProblem

        chips = chips or self.chips or STANDARD_CHIPS
        return SearchProblem.along(
            *motions,
            chips=chips,
            open_range=open_range(self.open_chips, chips),
            exposure_s=exposure_seconds(self.exposure) or exposure_s,
            device=self.device,
            objective=objective,
            rule=rule,
            frames=frames,
            runs=RunLimits(min_open=self.min_open, min_closed=self.min_closed),
            camera=self.load_camera(),
            scene=self.load_scene(),
        )


@dataclass(frozen=True, kw_only=True)
class SearchRunOptions:
    """Objective, moves and time of a search, and the file of its code."""

    objective: str | None = option(
        "--objective",
        "NAME",
        f"{'; '.join(f'{name} ({term.help})' for name, term in OBJECTIVES.items())}; or a mix as"
        " min-mtf:0.15,noise:1. mse when omitted; min-mtf with --method exact along a uniform"
        " straight motion.",
        panel=_OBJECTIVE,
    )
    steps: int | None = option(
        "--steps",
        "N",
        "Make so many moves, however long it takes: the same seed and moves give the same"
        " code. With --time whichever ends first; without either as many as suit the motion,"
        " for 60 s at most.",
        panel=SEARCH,
        min=1,
    )
    time_s: float | None = option(
        "--time",
        "S",
        "Search for so many seconds, however many moves that is: the code depends on the machine.",
        panel=SEARCH,
    )
    output: Path = output_option("File to write.", Path("code.json"))


def open_range(text: str | None, chips: int) -> tuple[int, int]:
    """Read ``--open``: fewest and most open chips.

    Examples
    --------
    >>> open_range("3", 8), open_range("2:4", 8), open_range("25%:50%", 8)
    ((3, 3), (2, 4), (2, 4))
    """
    if text is None:
        return 1, chips
    low, _, high = text.partition(":")
    high = high or low
    # a share beside a number, 40%:6, is a slip: it is refused below
    as_shares = low.endswith("%") and high.endswith("%")
    try:
        if as_shares:
            least_share, largest_share = (
                float(percent.removesuffix("%")) / 100 for percent in (low, high)
            )
        else:
            fewest = int(low)
            largest = int(high)
    except ValueError:
        raise ValueError(
            f"--open: must be K or LOW:HIGH in whole chips, or LOW%:HIGH%, got {text!r}"
        ) from None
    if as_shares:
        from cep.search.problem import open_range_of_duty

        return open_range_of_duty(chips, least_share, largest_share)
    if not 1 <= fewest <= largest <= chips:
        raise ValueError(f"--open: must lie within 1..{chips}, got {text}")
    return fewest, largest


def objective_mix(text: str) -> Mix:
    """Read ``--objective``: a name, or a mix of names with weights.

    Examples
    --------
    >>> objective_mix("min-mtf:0.15,noise")
    (('min-mtf', 0.15), ('noise', 1.0))
    """
    if ":" not in text and "," not in text:
        return text  # a single name, which the problem checks
    mix = []
    for term in text.split(","):
        name, _, weight = term.partition(":")
        try:
            mix.append((name.strip(), float(weight or 1)))
        except ValueError:
            raise ValueError(
                f"--objective: must be a name or a mix as min-mtf:0.15,noise:1, got {text!r}"
            ) from None
    if len({name for name, _ in mix}) < len(mix):
        raise ValueError(f"--objective: names one objective twice, got {text!r}")
    return tuple(mix)


def openings(code: ShutterCode) -> str:
    """Say in words how often a code opens."""
    return "1 opening" if code.pulses == 1 else f"{code.pulses} openings"


def ending(stopped: str, steps: int) -> str:
    """Say in words what ended a search after so many moves, or codes counted."""
    if stopped == "proven" and not steps:  # by a proof that comes with the package
        return "proven before"
    return {
        "steps": f"all {steps:,} moves made",
        "time": f"stopped by the time, {steps:,} moves made",
        "interrupted": "stopped by Ctrl-C",
        "complete": "no other code keeps the limits",
        "proven": f"all {steps:.2g} codes counted",
    }[stopped]


@contextmanager
def saved_on_interrupt(outputs: Outputs) -> Iterator[Callable[[Mapping[Path, StoredCode]], None]]:
    """Write codes on Ctrl-C that are found but not yet compared; another error names them.

    What it yields is called with each file's code as soon as they are known.
    """
    from cep.files.code_files import write_code

    codes: dict[Path, StoredCode] = {}
    try:
        yield codes.update
    except KeyboardInterrupt:
        if codes:
            summary = in_bits(stored.code for stored in codes.values())
            # the code alone: the rest is not made yet
            with replace(outputs, paths=tuple(codes)).written(summary=summary) as staged:
                for path, stored in codes.items():
                    write_code(staged[path], stored)
        raise
    except Exception as error:
        if codes:
            error.add_note(f"found: {in_bits(stored.code for stored in codes.values())}")
        raise


def in_bits(codes: Iterable[ShutterCode]) -> str:
    """Write codes for an error line."""
    return ", ".join(code.bits for code in codes)
