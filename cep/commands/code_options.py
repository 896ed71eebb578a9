"""Options that say which code is searched, and the problem that they make."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cep.commands.options import CameraOptions, SceneOptions, output_option
from cep.search.objectives import OBJECTIVES

if TYPE_CHECKING:
    from cep.optics.code import ShutterCode
    from cep.search.problem import Mix, ScenarioRule, SearchProblem
    from cep.search.scenarios import Scenario
    from motdiff.trajectory import Trajectory

# panels of the help pages
_CODE = "Code"
_OBJECTIVE = "Objective"
_LIMITS = "Limits of the shutter"
SEARCH = "Search"

# of a code where their number is neither given nor chosen: as many as Raskar's of 2006
STANDARD_CHIPS = 52


def _option(panel: str, name: str, metavar: str | None, help: str, **more: Any) -> Any:
    return typer.Option(name, metavar=metavar, help=help, rich_help_panel=panel, **more)


def _limit(name: str, help: str) -> Any:
    return _option(_LIMITS, name, "N", help, min=1)


def chips_option(*, fewest: int, help: str = "Number of chips.") -> Any:
    """Make the option ``--chips`` of a command."""
    return typer.Option("--chips", "-n", metavar="N", min=fewest, help=help, rich_help_panel=_CODE)


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
        rich_help_panel=_CODE,
        help="Open chips, as 26 or 20:30, or their share, as 40%:60%; any number when omitted.",
    ),
]
ChipTime = Annotated[int, _option(_CODE, "--chip-ns", "NS", "Chip time, ns.", min=1)]
Exposure = Annotated[
    str | None,
    _option(
        _CODE,
        "--exposure",
        "S",
        "Length of the exposure, which sets the chip time: 1/30, 0.02, 20ms or 500us.",
    ),
]
ObjectiveMix = Annotated[
    str | None,
    _option(
        _OBJECTIVE,
        "--objective",
        "NAME",
        f"{'; '.join(f'{name} ({term.help})' for name, term in OBJECTIVES.items())}; or a mix as"
        " min-mtf:0.15,noise:1. mse when omitted; min-mtf with --method exact along a uniform"
        " straight motion.",
    ),
]
Device = Annotated[
    str | None,
    _option(
        _LIMITS,
        "--device",
        "NAME|FILE",
        "What this shutter can play: a built-in profile or a .toml file. Stricter limits may be"
        " added.",
    ),
]


@dataclass(frozen=True, kw_only=True)
class CodeOptions(CameraOptions, SceneOptions):
    """Number of chips, light, exposure and limits of the codes that are searched."""

    chips: Annotated[
        int | None, chips_option(fewest=1, help="Number of chips; 52 when omitted.")
    ] = None
    open_chips: OpenChips = None
    exposure: Exposure = None
    device: Device = None
    min_open: Annotated[int, _limit("--min-open", "Shortest open run, chips.")] = 1
    min_closed: Annotated[int, _limit("--min-closed", "Shortest closed run, chips.")] = 1
    max_pulses: Annotated[int | None, _limit("--max-pulses", "Most open runs.")] = None

    def problem(
        self,
        *motions: Trajectory | Scenario,
        chips: int | None = None,
        exposure_s: float | None = None,
        objective: Mix = "min-mtf",
        rule: ScenarioRule = "worst",
    ) -> SearchProblem:
        """Make the problem of the options along motions.

        Parameters
        ----------
        *motions : Trajectory or Scenario
        chips, exposure_s : optional
            Where the options leave them open; then 52 chips of 1 ms.
        objective, rule
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
            runs=RunLimits(
                min_open=self.min_open, min_closed=self.min_closed, max_pulses=self.max_pulses
            ),
            camera=self.load_camera(),
            scene=self.load_scene(),
        )


@dataclass(frozen=True, kw_only=True)
class SearchOptions:
    """Objective, moves and time of a search, and the file of its code."""

    objective: ObjectiveMix = None
    steps: Annotated[
        int | None,
        _option(
            SEARCH,
            "--steps",
            "N",
            "Make so many moves, however long it takes: the same seed and moves give the same"
            " code. With --time whichever ends first; without either as many as suit the motion,"
            " for 60 s at most.",
            min=1,
        ),
    ] = None
    time_s: Annotated[
        float | None,
        _option(
            SEARCH,
            "--time",
            "S",
            "Search for so many seconds, however many moves that is: the code depends on the"
            " machine. The choice of the number of chips is within it.",
        ),
    ] = None
    output: Annotated[Path, output_option("File to write.")] = Path("code.json")


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
