"""Search problem: motions, number of chips, light, objective and the shutter's limits."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal, TypedDict, Unpack

import numpy as np
from numpy.typing import NDArray

from cep.optics.camera import Camera
from cep.optics.code import ShutterCode, is_whole
from cep.optics.response import ShutterResponse
from cep.optics.scene import PHOTO, Scene
from cep.optics.straight_motion import straight_axis, uniform_length_px
from cep.proofs.measure import CodeMetrics, measure, worst_of
from cep.search.limits import Limits, RunLimits, check_feasible
from cep.search.objectives import OBJECTIVES, Criterion
from cep.search.playable import chip_time_ns, within_camera, within_device
from cep.search.sampling import draw
from hw.device import DeviceProfile, load_profile
from motdiff.estimators.base import MotionEstimate
from motdiff.trajectory import Trajectory
from motdiff.types import BoolArray

DirectionRule = Literal["auto", "unknown", "forward"]
ScenarioRule = Literal["worst", "mean"]
Mix = str | tuple[tuple[str, float], ...]
"""Name of an objective, or names with their weights."""


@dataclass(frozen=True)
class Scenario:
    """A possible motion with its weight.

    Parameters
    ----------
    trajectory : Trajectory
    weight : float
        Above 0; the weights of a problem's scenarios are relative to their sum.
    """

    trajectory: Trajectory
    weight: float = 1.0


class ProblemFields(TypedDict, total=False):
    """Fields of a problem that :meth:`SearchProblem.along` takes as they are."""

    objective: Mix
    direction: DirectionRule
    rule: ScenarioRule
    runs: RunLimits
    camera: Camera
    chip_ns: int
    scene: Scene
    frames: int


@dataclass(frozen=True, kw_only=True)
class SearchProblem:
    """Problem of a search for a shutter code; :meth:`along` makes one.

    Parameters
    ----------
    chips : int
        Number of chips n.
    scenarios : tuple of Scenario
        Motions to design for. None at all means the unit circle of the code's polynomial: the
        objective is then :func:`cep.proofs.certify.minimum.min_chip` and its like, whatever the
        speed of a straight motion.
    open_range : (int, int), optional
        Fewest and most open chips; any number when omitted.
    objective : str or tuple of (name, weight)
        Of :data:`cep.search.objectives.OBJECTIVES`; a mix adds the objectives' decibels.
    direction : {"auto", "unknown", "forward"}
        Unknown: the worse of both directions counts. Forward: only the one given. Auto: as of each
        trajectory.
    rule : {"worst", "mean"}
        How scenarios combine: the worst of their decibels, or the weighted mean of their decibels,
        which one bad motion does not rule as it would the decibels of a mean.
    runs : RunLimits
        Limits on runs and pulses.
    camera : Camera
        For the objective "mse".
    response : ShutterResponse, optional
        How the shutter opens and closes along the scenarios; at once when omitted.
    chip_ns : int
        Duration of a chip, ns.
    device : DeviceProfile, optional
        Shutter whose limits are among the others, as of :meth:`along`; code files carry it.
    scene : Scene
        What is photographed, for the objective "mse".
    frames : {1, 2}
        Photos of the exposure. Two are those of a pair of cameras, which play the code and its
        complement at the same time and are restored together: both codes keep the limits, and the
        objective is of both (:class:`cep.search.cost.CodeCost`). The camera, with its light, is
        each of the two.

    Raises
    ------
    ValueError
        If an argument is malformed, or limits conflict: the line names a smallest set of them that
        no code keeps.

    Examples
    --------
    >>> path, runs = Trajectory.straight(20.0), RunLimits(min_open=2)
    >>> problem = SearchProblem.along(path, chips=20, open_range=(8, 12), runs=runs)
    >>> problem.satisfied(np.array([[1, 1] * 5 + [0] * 10, [1, 0] * 10])).tolist()
    [True, False]
    """

    chips: int
    scenarios: tuple[Scenario, ...] = ()
    open_range: tuple[int, int] | None = None
    objective: Mix = "min-mtf"
    direction: DirectionRule = "auto"
    rule: ScenarioRule = "worst"
    runs: RunLimits = field(default_factory=RunLimits)
    camera: Camera = field(default_factory=Camera)
    response: ShutterResponse | None = None
    chip_ns: int = 1_000_000
    device: DeviceProfile | None = None
    scene: Scene = PHOTO
    frames: int = 1

    def __post_init__(self) -> None:
        if not is_whole(self.frames) or self.frames not in (1, 2):
            raise ValueError(
                "frames: must be 1, or 2 for a pair of cameras that play a code and its"
                f" complement, got {self.frames}; codes of more exposures: python -m lab frames"
            )
        if not is_whole(self.chip_ns) or self.chip_ns < 1:
            raise ValueError(
                f"chip_ns: must be a whole number of nanoseconds above 0, got {self.chip_ns!r}"
            )
        if not is_whole(self.chips) or self.chips < 1:
            raise ValueError(f"chips: must be a whole number of at least 1, got {self.chips!r}")
        for name in ("frames", "chip_ns", "chips"):
            object.__setattr__(self, name, int(getattr(self, name)))
        if self.open_range is not None:
            if np.shape(self.open_range) != (2,) or not all(map(is_whole, self.open_range)):
                raise ValueError(
                    "open_range: must be two whole numbers, the fewest and the most open chips,"
                    f" got {self.open_range!r}"
                )
            low, high = map(int, self.open_range)
            object.__setattr__(self, "open_range", (low, high))
        for name, allowed in (
            ("direction", ("auto", "unknown", "forward")),
            ("rule", ("worst", "mean")),
        ):
            if getattr(self, name) not in allowed:
                raise ValueError(
                    f"{name}: must be one of {', '.join(allowed)}, got {getattr(self, name)!r}"
                )
        for name, weight in self.objective_mix:
            if name not in OBJECTIVES:
                raise ValueError(
                    f"objective: must be one of {', '.join(OBJECTIVES)}, got {name!r}"
                )
            if not (np.isfinite(weight) and weight > 0):
                raise ValueError(f"objective: the weight of {name} must be above 0, got {weight}")
        if not self.objective_mix:
            raise ValueError("objective: needs at least one objective")
        if not all(np.isfinite(s.weight) and s.weight > 0 for s in self.scenarios):
            raise ValueError("scenarios: every weight must be above 0")
        # ramps take a share of a chip along a path, not of a polynomial
        if self.response is not None and not self.scenarios:
            raise ValueError(
                "response: needs a motion (scenarios), the unit circle of a polynomial has no"
                " ramps"
            )
        self._check_feasible()

    @classmethod
    def along(
        cls,
        *motions: Trajectory | MotionEstimate | Scenario,
        chips: int,
        open_range: tuple[int, int] | None = None,
        duty: tuple[float, float] | None = None,
        exposure_s: float | None = None,
        device: DeviceProfile | str | None = None,
        response: ShutterResponse | None = None,
        **fields: Unpack[ProblemFields],
    ) -> SearchProblem:
        """Make the problem of motions, a camera or a device, an exposure and limits.

        Every command and study makes its problems here, so that none forgets what the shutter
        cannot do.

        Parameters
        ----------
        *motions : Trajectory, MotionEstimate or Scenario
            Of an estimate its best trajectory, with a weight of 1. None at all: the unit circle.
        chips : int
        open_range : (int, int), optional
            Fewest and most open chips.
        duty : (float, float), optional
            Instead of the open range, least and largest open fraction.
        exposure_s : float, optional
            Length of the exposure, which sets ``chip_ns``, to the device's nearest tick.
        device : DeviceProfile or str, optional
            Shutter that must be able to play the codes, or its name as of
            :func:`hw.device.load_profile`: its limits tighten ``runs`` and the open range, and the
            search counts its rise and fall. Without one the camera's own shutter plays them, and
            its shortest exposure is the shortest opening.
        response : ShutterResponse, optional
            Rise and fall of a shutter without a profile.
        **fields
            The other fields.

        Raises
        ------
        ValueError
            If an argument is malformed or they conflict.

        Examples
        --------
        >>> path = Trajectory.straight(40.0)
        >>> problem = SearchProblem.along(
        ...     path, chips=40, duty=(0.4, 0.6), exposure_s=0.004, device="flc"
        ... )
        >>> problem.open_range, problem.chip_ns, problem.runs.min_open
        ((16, 24), 100000, 1)
        """
        if duty is not None:
            if open_range is not None:
                raise ValueError("duty and open_range: give one of them")
            open_range = open_range_of_duty(chips, *duty)
        profile = load_profile(device) if isinstance(device, str) else device
        if exposure_s is not None:
            if "chip_ns" in fields:
                raise ValueError("exposure_s and chip_ns: give one of them")
            fields["chip_ns"] = chip_time_ns(exposure_s, chips, profile)
        chip_ns = fields.get("chip_ns", cls.chip_ns)
        runs = fields.get("runs", RunLimits())
        # without a device the camera's own shutter plays the code
        if profile is None:
            camera = fields.get("camera", Camera())
            fields["runs"] = within_camera(camera, chips=chips, chip_ns=chip_ns, runs=runs)
        else:
            played = within_device(
                profile,
                chips=chips,
                chip_ns=chip_ns,
                open_range=open_range or (1, chips),
                runs=runs,
            )
            open_range = played.open_range
            fields["runs"] = played.runs
            if response is not None:
                raise ValueError("response and device: give one of them")
            response = played.response
        return cls(
            chips=chips,
            scenarios=tuple(_scenario(motion) for motion in motions),
            open_range=open_range,
            response=response,
            device=profile,
            **fields,
        )

    @property
    def on_circle(self) -> bool:
        """Whether the code's polynomial alone decides: one uniform straight motion, no ramps.

        ``abs H`` is then ``abs sinc`` of a chip times ``abs P``, and zeros of the sinc are no
        fault of the code.
        """
        if len(self.scenarios) != 1 or self.response is not None:
            return False
        return uniform_length_px(self.scenarios[0].trajectory) is not None

    @property
    def straight(self) -> bool:
        """Whether every motion runs along a line; so does the unit circle's."""
        return all(straight_axis(s.trajectory) is not None for s in self.scenarios)

    @property
    def objective_mix(self) -> tuple[tuple[str, float], ...]:
        """Objectives with their weights."""
        if isinstance(self.objective, str):
            return ((self.objective, 1.0),)
        return tuple(self.objective)

    @property
    def criteria(self) -> tuple[tuple[Criterion, float], ...]:
        """The registered objectives with their weights."""
        return tuple((OBJECTIVES[name], weight) for name, weight in self.objective_mix)

    @property
    def open_limits(self) -> tuple[int, int]:
        """Fewest and most open chips that the limits leave."""
        limits = self.limits
        low, high = limits.open_range
        return max(low, limits.runs.min_open), high

    @property
    def limits_runs(self) -> bool:
        """Whether runs, pulses or their period are limited: few flips and swaps are allowed."""
        return self.runs != RunLimits()

    @property
    def mirrors(self) -> bool:
        """Whether a code's mirror image keeps the limits on runs as well."""
        # a longer period counts from start to start: reversed, it would be from end to end
        return self.limits.period == self.runs.min_open + self.runs.min_closed

    @property
    def limits(self) -> Limits:
        """All limits of a code, and of its complement where a second camera plays that."""
        open_range = self.open_range or (1, self.chips)
        if self.frames == 2:
            return Limits.of_pair(self.chips, open_range, self.runs)
        return Limits(self.chips, open_range, self.runs)

    @property
    def of_one_camera(self) -> SearchProblem:
        """The same problem for one camera."""
        return replace(self, frames=1)

    def both_directions(self, trajectory: Trajectory) -> bool:
        """Whether the reversed path counts as well; a uniform straight one is its own."""
        # time reversal: an uncoded photo is the same for a path and its reverse
        unknown = self.direction == "unknown" or (
            self.direction == "auto" and trajectory.direction == "unknown"
        )
        return unknown and uniform_length_px(trajectory) is None

    def directed(self, trajectory: Trajectory) -> tuple[Trajectory, ...]:
        """Return a path in each direction that counts: as it is, then reversed."""
        if self.both_directions(trajectory):
            return (trajectory, trajectory.reversed())
        return (trajectory,)

    def directed_paths(self) -> tuple[Trajectory, ...]:
        """Return every scenario's path in every direction that counts, scenario by scenario."""
        return tuple(path for s in self.scenarios for path in self.directed(s.trajectory))

    def satisfied(self, codes: NDArray[np.integer] | BoolArray) -> BoolArray:
        """Which of (R, n) codes keep every limit, (R,) bool."""
        return self.limits.satisfied(codes)

    def allows(self, code: ShutterCode) -> bool:
        """Whether a code keeps every limit."""
        return bool(self.satisfied(code.array[None].astype(np.int8))[0])

    def random_codes(self, count: int, *, rng: np.random.Generator) -> NDArray[np.int8]:
        """Draw ``count`` codes within the limits, (count, n) of 0 and 1, all equally likely."""
        return draw(self.limits, count, rng=rng)

    def measure(self, code: ShutterCode, *, budget: int = 20_000) -> CodeMetrics:
        """Worst of each figure of one camera over all scenarios and directions.

        The shutter opens and closes by :attr:`response`. The chips last as long as the problem's,
        whatever the code says.
        """
        if code.chips != self.chips:
            raise ValueError(f"code: must have {self.chips} chips, got {code.chips}")
        played = ShutterCode(code.bits, self.chip_ns)
        # a px a chip: the figures of the unit circle in chips
        circle = Trajectory.straight(float(self.chips))
        return worst_of(
            *(
                measure(
                    path,
                    played,
                    camera=self.camera,
                    budget=budget,
                    response=self.response,
                    scene=self.scene,
                )
                for path in self.directed_paths() or (circle,)
            )
        )

    def _check_feasible(self) -> None:
        # plain conflicts first: their messages are plainer than a smallest set of limits
        low, high = self.open_range or (1, self.chips)
        shortest = self.runs.min_open
        if shortest > self.chips:
            raise ValueError(
                f"min_open: runs of {shortest} open chips do not fit a code of {self.chips} chips"
            )
        if low > high:
            raise ValueError(f"open_range: fewest {low} is above most {high}")
        if low < 1 or high > self.chips:
            raise ValueError(
                f"open_range: must lie within 1..{self.chips} chips, got {low}..{high}"
            )
        if high < shortest:
            raise ValueError(
                f"min_open: runs of {shortest} open chips conflict with at most {high} open chips"
                " (open_range)"
            )
        if self.frames == 2:
            self._check_complements(low, high)
        check_feasible(self.limits)
        if self.frames == 2 and self.limits_runs:
            self.random_codes(1, rng=np.random.default_rng(0))  # refuses where it finds none

    def _check_complements(self, low: int, high: int) -> None:
        fewest_open, most_open = self.limits.open_range
        if fewest_open > most_open:
            low = max(low, self.runs.min_open)
            raise ValueError(
                f"open_range, min_open and frames: conflict: with {low} to {high} of {self.chips}"
                f" chips open in one camera, {self.chips - high} to {self.chips - low} are in the"
                f" other; a range around {self.chips / 2:g} suits both"
            )


def _scenario(motion: Trajectory | MotionEstimate | Scenario) -> Scenario:
    if isinstance(motion, Scenario):
        return motion
    if isinstance(motion, MotionEstimate):
        motion = motion.best
    return Scenario(motion)


def open_range_of_duty(chips: int, low: float, high: float) -> tuple[int, int]:
    """Range of open chips whose duty lies within ``low``..``high``.

    Raises
    ------
    ValueError
        If the duties are not within 0..1 and in order, or no whole number of chips lies between
        them.
    """
    if not 0 <= low <= high <= 1:
        raise ValueError(
            f"duty: must be LOW:HIGH within 0..100%, got {100 * low:g}%:{100 * high:g}%"
        )
    # a product such as 0.07 * 100 = 7.000000000000001 must still count as whole
    fewest = max(1, int(np.ceil(low * chips - 1e-9)))
    largest = int(np.floor(high * chips + 1e-9))
    if fewest > largest:
        raise ValueError(
            f"duty: no whole number of open chips out of {chips} lies within"
            f" {100 * low:g}%:{100 * high:g}%"
        )
    return fewest, largest


def speed_range(motion: Trajectory, low: float, high: float, count: int) -> tuple[Scenario, ...]:
    """Scale a path by ``count`` factors, evenly spaced from ``low`` to ``high``.

    Raises
    ------
    ValueError
        If the factors are not positive and in order, or one alone is to span a range.
    """
    if not (np.isfinite(high) and 0 < low <= high):
        raise ValueError(f"speed: factors must be above 0 and in order, got {low:g}..{high:g}")
    if count < 1 or (count == 1 and low < high):
        raise ValueError(f"count: a range of speeds needs at least 2 of them, got {count}")
    return tuple(
        Scenario(motion.scaled(factor), 1 / count)
        for factor in np.linspace(low, high, count).tolist()
    )
