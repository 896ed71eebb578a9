"""Calibration in a closed loop: each code is chosen by what the photos before it left open.

The first photo is taken with the shutter open, and shows the path; the codes of the others tell
its orders in time apart, until one is stated as sure.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from cep.calibration.calibrate import Calibration, estimate_motion
from cep.calibration.next_code import SURE, NextCode, is_sure, next_code, next_limits
from cep.optics.code import ShutterCode
from hw.device import DeviceProfile

MOST_PHOTOS = 5
"""Photos after which the loop ends, sure or not."""
_LEAST_CHIPS = 4
_DESIGN_SHARE = 0.15  # of the time of a step


@dataclass(frozen=True)
class CalibrationStep:
    """What the photos so far show.

    Attributes
    ----------
    photos : tuple of I array, linear light
    codes : tuple of I ShutterCode
    calibration : Calibration
        Of all of them together.
    choice : NextCode or None
        Why the last photo's code was chosen; None for the first, with the shutter open.
    is_sure : bool
        Whether no other photo is needed: the order in time is stated as probable as asked for, or
        the photo shows no motion.
    """

    photos: tuple[ArrayLike, ...]
    codes: tuple[ShutterCode, ...]
    calibration: Calibration
    choice: NextCode | None
    is_sure: bool


def calibration_steps(
    take: Callable[[ShutterCode], ArrayLike],
    *,
    chips: int = 52,
    chip_ns: int = 1_000_000,
    device: DeviceProfile | str | None = None,
    least_probability: float = SURE,
    most_photos: int = MOST_PHOTOS,
    seed: int = 0,
    progress: Callable[[float, str], None] = lambda _share, _note: None,
) -> Iterator[CalibrationStep]:
    """Take photos of one motion, one after the other, until its order in time is sure.

    Parameters
    ----------
    take : callable
        Takes a photo through a code, (H, W) or (H, W, 3) in linear light 0..1, while the motion
        runs anew.
    chips, chip_ns : int
        Of all codes: the motion lasts as long as they do.
    device : DeviceProfile or str, optional
        That can play the codes, of which the first is open throughout.
    least_probability : float
        Stated probability of the order in time from which no other photo is taken, at most 0.97.
    most_photos : int
    seed : int
        Of what is drawn at random.
    progress : callable, optional
        Called with the finished share 0..1 of each step, and what is being done.

    Yields
    ------
    CalibrationStep
        After each photo.

    Raises
    ------
    ValueError
        If an argument is malformed, the device cannot play the codes, or a photo cannot be
        searched.

    Examples
    --------
    ::

        for step in calibration_steps(take, chip_ns=200_000, device="flc"):
            print(step.codes[-1].bits, step.calibration.confidence)
        step.calibration.save("motion")
    """
    if most_photos < 1:
        raise ValueError(f"most_photos: must be at least 1, got {most_photos}")
    if chips < _LEAST_CHIPS:
        raise ValueError(f"chips: must be at least {_LEAST_CHIPS}, got {chips}")
    # refused before a photo is taken
    limits, profile = next_limits(
        (), least_probability=least_probability, chips=chips, chip_ns=chip_ns, device=device
    )
    code = ShutterCode("1" * chips, chip_ns)
    if not limits.satisfied(np.ones((1, chips), dtype=np.int8))[0]:
        assert profile is not None
        raise ValueError(
            f"device: {profile.name} cannot stay open for {code.duration_ns / 1e6:g} ms, and the"
            " first photo needs it; give a shorter chip_ns or fewer chips"
        )
    rng = np.random.default_rng(seed)
    choice = None
    photos: tuple[ArrayLike, ...] = ()
    codes: tuple[ShutterCode, ...] = ()
    while True:
        progress(_DESIGN_SHARE, f"taking photo {len(photos) + 1}")
        photos = (*photos, take(code))
        codes = (*codes, code)
        coded = codes if len(codes) > 1 else ()
        calibration = estimate_motion(
            list(photos),
            codes=coded or None,
            seed=seed,
            progress=lambda share, note: progress(
                _DESIGN_SHARE + (1 - _DESIGN_SHARE) * share, note
            ),
        )
        is_last = is_sure(calibration, coded, least_probability=least_probability)
        yield CalibrationStep(photos, codes, calibration, choice, is_last)
        if is_last or len(photos) >= most_photos:
            return
        choice = next_code(
            photos,
            coded,
            calibration,
            least_probability=least_probability,
            chips=chips,
            chip_ns=chip_ns,
            device=device,
            rng=rng,
            progress=lambda share: progress(_DESIGN_SHARE * share, "choosing the next code"),
        )
        assert choice is not None  # as the order is not sure
        code = choice.code


def calibrate_in_loop(
    take: Callable[[ShutterCode], ArrayLike],
    folder: Path,
    *,
    source: Callable[[CalibrationStep], dict[str, object]],
    chips: int = 52,
    chip_ns: int = 1_000_000,
    device: DeviceProfile | str | None = None,
    force: bool = False,
    progress: Callable[[float, str], None] = lambda _share, _note: None,
) -> tuple[list[CalibrationStep], Path]:
    """Go through :func:`calibration_steps`, and write the motion after each.

    Parameters
    ----------
    take, chips, chip_ns, device
        As of :func:`calibration_steps`.
    folder : Path
        Of the motion, written as by :meth:`cep.calibration.calibrate.Calibration.save`: what fails
        later does not cost it.
    source : callable
        Describes in the trajectory's file what a step's motion was found in.
    force : bool
        Whether files of an earlier run are replaced.
    progress : callable, optional
        Called with the finished share 0..1 of the most photos, and what is being done.

    Returns
    -------
    steps : list of CalibrationStep
    trajectory : Path
        Of the last one.

    Raises
    ------
    ValueError
        As :func:`calibration_steps`.
    OSError
        If the motion cannot be written.
    """
    steps: list[CalibrationStep] = []
    for step in calibration_steps(
        take,
        chips=chips,
        chip_ns=chip_ns,
        device=device,
        progress=lambda share, note: progress(
            (len(steps) + share) / MOST_PHOTOS, f"photo {len(steps) + 1}: {note}"
        ),
    ):
        steps.append(step)
        files = step.calibration.save(
            folder,
            source=source(step),
            force=force or len(steps) > 1,  # over that of the photos before
        )
    return steps, files["trajectory.json"]
