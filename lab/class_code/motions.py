"""Motions of a class: simulated hand shakes, pieces of a recording, or those of a folder."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cep.optics.straight_motion import uniform_length_px
from cep.search.problem import Scenario
from motdiff.files.gyro_tables import read_gyro
from motdiff.files.trajectories import read_motion
from motdiff.gyro import GyroTrace
from motdiff.motions import boracchi_foi, random_gyro_motion
from motdiff.trajectory import Trajectory

DRAWN = 100
OTHERS = 300
"""Motions drawn to search a code on, and others to judge it by: docs/decisions/search.md."""

WALKS = "walks"
"""Class of simulated hand shakes; another class is named by a gyro recording."""

MOST_SCENARIOS = 256
"""Most scenarios of a problem: a search looks at each of them in every move."""

_MOTION = "trajectory.json"
_LENGTH_PX = 60.0
_TOLERANCE_PX = 0.01  # of the drawn paths: a walk of 2000 samples takes eight times as long


@dataclass(frozen=True)
class MotionClass:
    """Motions of a class.

    Attributes
    ----------
    searched, held_out : tuple of Trajectory
        Motions to search a code on, and others of the same class to judge it by.
    source : mapping
        Where they come from, for the code file.
    warnings : tuple of str
        Of the recording.
    """

    searched: tuple[Trajectory, ...]
    held_out: tuple[Trajectory, ...]
    source: Mapping[str, object]
    warnings: tuple[str, ...] = ()


def motion_class(
    kind: str,
    *,
    length_px: float | None = None,
    count: int | None = None,
    exposure_s: float,
    seed: int = 0,
) -> MotionClass:
    """Draw the motions of a class, or read those of a folder.

    Parameters
    ----------
    kind : str
        :data:`WALKS`; a gyro recording, whose z axis is the line of sight and whose x and y may
        point anywhere; or a folder with motions, as ``cep calibrate FOLDER`` writes it.
    length_px, count : optional
        Of the drawn motions; 60 px and :data:`DRAWN` when omitted.
    exposure_s : float
        Length of each shake that is cut from a recording.
    seed : int

    Raises
    ------
    ValueError
        If there are no motions, one cannot be read, or the length is out of range.
    """
    if Path(kind).is_dir():
        if length_px is not None or count is not None:
            option = "--length"
            if length_px is None:
                option = "--motions"
            raise ValueError(f"{option}: not valid with a folder, whose motions are all taken")
        read = tuple(read_motion(path).trajectory for path in motions_in(kind).values())
        return MotionClass(read, (), {"folder": kind, "class": None})
    if length_px is None:
        length_px = _LENGTH_PX
    if not 1 <= length_px <= 1000:
        raise ValueError(f"--length: must lie within 1..1000 px, got {length_px:g}")
    if kind != WALKS and not Path(kind).exists():
        raise ValueError(
            f"CLASS: must be {WALKS}, a gyro recording or a folder, and there is no file {kind}"
        )
    gyro = None
    warnings: tuple[str, ...] = ()
    if kind != WALKS:
        gyro = read_gyro(kind)
        warnings = gyro.warnings
    motions = []
    for number, size in enumerate((count or DRAWN, OTHERS)):
        # streams of their own: more motions to search on leave those that judge as they are
        rng = np.random.default_rng([seed, 4, number])
        try:
            motions.append(
                draw_motions(size, length_px=length_px, rng=rng, gyro=gyro, exposure_s=exposure_s)
            )
        except ValueError as error:  # only a recording's
            raise ValueError(
                f"{kind}: {str(error).partition(': ')[2]}; --exposure says how long a shake is"
            ) from None
    source = {"folder": None, "class": {"kind": kind, "length_px": length_px}}
    return MotionClass(motions[0], motions[1], source, warnings)


def motions_in(folder: Path | str) -> dict[str, Path]:
    """List the motions that ``cep calibrate FOLDER`` wrote, by the names of their folders.

    Raises
    ------
    ValueError
        If the folder holds no motions.
    """
    root = Path(folder)
    motions = {
        path.parent.name: path for path in sorted(root.glob(f"*/{_MOTION}")) if not path.is_dir()
    }
    if not motions:
        single = root / _MOTION
        hint = ""
        if single.is_file():
            hint = f"; for a single motion: cep optimize --trajectory {single}"
        raise ValueError(
            f"{root}: holds no */{_MOTION}, as cep calibrate FOLDER writes them{hint}"
        )
    return motions


def draw_motions(
    count: int,
    *,
    length_px: float,
    rng: np.random.Generator,
    gyro: GyroTrace | None = None,
    exposure_s: float | None = None,
) -> tuple[Trajectory, ...]:
    """Draw hand shakes: simulated walks, or pieces of a recording.

    Parameters
    ----------
    count : int
    length_px : float
        Length of each path, or with a recording the larger side of its bounding box, px.
    rng : numpy Generator
    gyro : GyroTrace, optional
        Recording; walks as of :func:`motdiff.motions.boracchi_foi` when omitted.
    exposure_s : float, optional
        Length of each piece of the recording, seconds; needed with one.

    Raises
    ------
    ValueError
        If the length is not positive, or the recording is too short or too still.
    """
    if gyro is None:
        walks = [boracchi_foi(rng, max_length_px=length_px) for _ in range(count)]
    else:
        assert exposure_s is not None
        walks = [
            random_gyro_motion(gyro, rng, exposure_s=exposure_s, extent_px=length_px)
            for _ in range(count)
        ]
    return tuple(path.thinned(_TOLERANCE_PX) for path in walks)


def class_scenarios(motions: Iterable[Trajectory]) -> tuple[Scenario, ...]:
    """Make a class of motions of equal weight; an unknown direction is in it both ways.

    For a problem of the rule "mean" and the direction "forward": over a class the ways of a motion
    are averaged as its motions are, while the other problems count the worse one.

    Raises
    ------
    ValueError
        If there are no motions, or the scenarios are too many.

    Examples
    --------
    >>> bent = Trajectory.from_samples([[0, 0], [9, 3], [14, 12]])
    >>> straight = Trajectory.straight(20.0)
    >>> [one.weight for one in class_scenarios([bent, straight])]
    [0.5, 0.5, 1.0]
    """
    scenarios: list[Scenario] = []
    for path in motions:
        # the reverse of a uniform straight motion blurs as the motion does
        if path.direction == "unknown" and uniform_length_px(path) is None:
            scenarios += [Scenario(path, 0.5), Scenario(path.reversed(), 0.5)]
        else:
            scenarios.append(Scenario(path))
    if not scenarios:
        raise ValueError("motions: a class needs at least one")
    if len(scenarios) > MOST_SCENARIOS:
        raise ValueError(
            f"scenarios: {len(scenarios)} are too many, at most {MOST_SCENARIOS}; take fewer"
            " motions"
        )
    return tuple(scenarios)
