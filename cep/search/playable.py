"""Codes that a device can play: its limits in chips, its rise and fall."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass

from cep.optics.camera import Camera
from cep.optics.response import ShutterResponse
from cep.search.limits import RunLimits
from hw.device import DeviceProfile
from hw.program import Program

_LONGEST_S = 3600.0  # longest exposure: an hour


@dataclass(frozen=True)
class Playable:
    """Limits of the codes that a device can play and that keep the user's limits too.

    Attributes
    ----------
    runs : RunLimits
    open_range : (int, int)
        Fewest and most open chips.
    response : ShutterResponse or None
        How its shutter opens and closes; None where it does so at once.
    """

    runs: RunLimits
    open_range: tuple[int, int]
    response: ShutterResponse | None


def within_device(
    profile: DeviceProfile,
    *,
    chips: int,
    chip_ns: int,
    open_range: tuple[int, int],
    runs: RunLimits,
) -> Playable:
    """Tighten limits by those of a device.

    Raises
    ------
    ValueError
        If the device can play no such code; the line says why.
    """
    limits, most_open = limits_of_device(profile, chips=chips, chip_ns=chip_ns)
    low, high = open_range
    # named here: as a conflict of limits the device's part would not be seen
    if most_open < low:
        raise ValueError(
            f"{profile.name}: at most {most_open} of {chips} chips may be open, at least {low}"
            " were asked for"
        )
    return Playable(
        runs.tightened(limits), (low, min(high, most_open)), response_of_device(profile, chip_ns)
    )


def within_camera(camera: Camera, *, chips: int, chip_ns: int, runs: RunLimits) -> RunLimits:
    """Tighten limits by the shortest exposure of a camera whose own shutter plays the code.

    Raises
    ------
    ValueError
        If that is longer than the whole code.
    """
    if camera.least_exposure_s * 1e9 > chips * chip_ns:
        raise ValueError(
            f"exposure: the camera exposes for at least {camera.least_exposure_s * 1e3:g} ms, a"
            f" code of {chips} chips lasts {chips * chip_ns / 1e6:g} ms"
        )
    return runs.tightened(
        # a product such as 1e-3 * 1e9 may round up to the next chip
        RunLimits(min_open=max(1, math.ceil(camera.least_exposure_s * 1e9 / chip_ns - 1e-9)))
    )


def limits_of_device(profile: DeviceProfile, *, chips: int, chip_ns: int) -> tuple[RunLimits, int]:
    """Translate a device's limits on times into limits on chips.

    A code within them is one that :meth:`hw.device.DeviceProfile.check` passes, and the other way
    round.

    Parameters
    ----------
    profile : DeviceProfile
    chips, chip_ns : int

    Returns
    -------
    RunLimits, int
        And the most open chips of all runs together.

    Raises
    ------
    ValueError
        If the device cannot play codes of this length or chip time at all; the line says what it
        can.
    """
    _check_chip(profile, chip_ns)
    if profile.max_chips is not None and chips > profile.max_chips:
        raise ValueError(
            f"{profile.name}: plays at most {profile.max_chips} chips, {chips} were asked for"
        )
    bias_ns = profile.on_bias_ns
    least_open_ns = profile.min_on_ns or 0
    if bias_ns:
        # commands are shortened by the bias, and the device counts them in whole ticks
        least_open_ns = max(least_open_ns, profile.tick_ns) + bias_ns
    least_closed_ns = max(profile.min_off_ns or 0, profile.dead_time_ns)
    min_open = max(1, -(-least_open_ns // chip_ns))  # rounded up
    max_open = None
    if min_open > chips:
        raise ValueError(
            f"chips: {profile.name} opens for at least {least_open_ns / 1e6:g} ms, a code of"
            f" {chips} chips lasts {chips * chip_ns / 1e6:g} ms; longer chips, or a faster"
            " shutter, would do"
        )
    if profile.max_on_ns is not None:
        max_open = profile.max_on_ns // chip_ns
        if max_open < 1:
            raise ValueError(
                f"chip_ns: {profile.name} opens for {profile.max_on_ns} ns at most, "
                f"a chip must not last longer, got {chip_ns} ns"
            )
        if max_open < min_open:
            raise ValueError(
                f"chip_ns: {profile.name} opens for {least_open_ns} to {profile.max_on_ns} ns, "
                f"no whole number of chips of {chip_ns} ns does; shorter chips would"
            )
    most_open_chips = chips
    if profile.max_duty is not None:
        # the device compares rounded quotients: so do these two, or a code at the very limit would
        # be refused
        most_open_chips = bisect_right(
            range(1, chips + 1), profile.max_duty, key=lambda open_chips: open_chips / chips
        )
        if most_open_chips < min_open:
            raise ValueError(
                f"chips: {profile.name} may be open for {profile.max_duty:g} of the time at most, "
                f"too little for {min_open} of {chips} chips"
            )
    min_period = 1
    if profile.max_rate_hz is not None:
        # of chips, where every shorter one is too fast: a single opening is left
        min_period += bisect_left(
            range(1, chips), -profile.max_rate_hz, key=lambda period: -1e9 / (period * chip_ns)
        )
    runs = RunLimits(
        min_open=min_open,
        min_closed=max(1, -(-least_closed_ns // chip_ns)),
        max_pulses=profile.max_pulses,
        max_open=max_open,
        min_period=min_period,
    )
    return runs, most_open_chips


def response_of_device(profile: DeviceProfile, chip_ns: int) -> ShutterResponse | None:
    """Rise and fall of a device's shutter; None where it opens and closes at once.

    The response does not contain ``on_bias_ns``, the time by which the device lengthens every
    opening. Commands to the device are to be shorter by this time, as those of
    :mod:`hw.export.camera` are.

    Parameters
    ----------
    profile : DeviceProfile
    chip_ns : int

    Raises
    ------
    ValueError
        If the chip time is none of the device's, or opening or closing takes longer than a chip.
    """
    _check_chip(profile, chip_ns)
    # a transition must end within its chip, see ShutterResponse
    slowest = max(profile.rise_ns, profile.fall_ns)
    if slowest > chip_ns:
        raise ValueError(
            f"chip_ns: {profile.name} takes {slowest} ns to open or close, "
            f"chips must last at least as long, got {chip_ns} ns"
        )
    response = ShutterResponse(chip_ns=chip_ns, rise_ns=profile.rise_ns, fall_ns=profile.fall_ns)
    if response.instant:
        return None
    return response


def chip_time_ns(exposure_s: float, chips: int, profile: DeviceProfile | None = None) -> int:
    """Return the chip time of an exposure, ns: the nearest whole number of the device's ticks.

    Raises
    ------
    ValueError
        If the exposure is not above 0 or longer than an hour.
    """
    if not 0 < exposure_s <= _LONGEST_S:
        raise ValueError(
            f"exposure_s: must be above 0 and at most {_LONGEST_S:g} s, got {exposure_s:g}"
        )
    tick = 1 if profile is None else profile.tick_ns
    return max(1, round(exposure_s * 1e9 / chips / tick)) * tick


def _check_chip(profile: DeviceProfile, chip_ns: int) -> None:
    """Refuse a chip time out of range or not of whole ticks; name the nearest that would do."""
    tick = profile.tick_ns
    shortest_ns = -(-(profile.min_chip_ns or 1) // tick) * tick
    longest_ns = None
    words = f"whole ticks of {tick} ns, from {shortest_ns} ns"
    if profile.max_chip_ns is not None:
        longest_ns = profile.max_chip_ns // tick * tick
        words += f" to {longest_ns} ns"
    if chip_ns % tick == 0 and shortest_ns <= chip_ns <= (longest_ns or chip_ns):
        return
    # the whole numbers of ticks on either side, moved into the range
    below = chip_ns // tick * tick
    nearest_ns = sorted(
        {
            min(max(time_ns, shortest_ns), longest_ns or time_ns + shortest_ns)
            for time_ns in (below, below + tick)
        }
    )
    raise ValueError(
        f"chip_ns: {profile.name} plays chips of {words}, got {chip_ns} ns; "
        f"{' or '.join(str(time_ns) for time_ns in nearest_ns)} ns would do"
    )


def unplayable(bits: str, profile: DeviceProfile | None, chip_ns: int) -> str:
    """Say why the device cannot play a code; empty where it can, or none was named."""
    if profile is None:
        return ""
    problems = profile.check(Program(bits, chip_ns=chip_ns))
    if not problems:
        return ""
    return f"no code was found that the device can play: {'; '.join(problems)}"
