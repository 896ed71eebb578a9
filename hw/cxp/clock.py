"""Error of a controller's clock, fitted against the host's."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import linear_regression, pstdev

from hw.drivers.cxp import Controller
from hw.errors import VerifyError

_WRAP_US = 2**32  # STATUS counts 32 bits: some 72 minutes
_LEAST = 8
_IN_A_ROW = 4
_LARGEST_PPM = 100_000  # 10 %: a clock that is worse is no clock


@dataclass(frozen=True, slots=True)
class ClockFit:
    """Error of a device's clock.

    Parameters
    ----------
    ppm : float
        Parts per million; negative when it is slow and plays everything too long.
    uncertainty_ppm : float
        Two standard errors of the fit. The host's own clock, good to some 20 ppm, is taken as
        right.
    seconds : float
        Time between the first and the last reading.
    samples : int
        Readings used.
    """

    ppm: float
    uncertainty_ppm: float
    seconds: float
    samples: int


def fit_clock(readings: Sequence[tuple[float, float, int]]) -> ClockFit:
    """Fit a line to readings of a device's clock.

    The time of a reading lies between the request and its reply. The quickest of every four in a
    row is used, at the middle: a constant delay moves the line without tilting it. (The quickest
    quarter of all may come from a short part of the time where delays are even.)

    Parameters
    ----------
    readings : sequence of (sent_s, received_s, device_us)
        Host times, and the device's clock, which wraps at 2^32 us; 8 or more.

    Raises
    ------
    ValueError
        If the device's clock does not go on with the host's (a restart).
    """
    start_s, _, start_us = readings[0]
    # delay, host s, device s less host s (small: it keeps its digits)
    points: list[tuple[float, float, float]] = []
    device_us = 0
    previous = start_us
    for sent_s, received_s, now_us in readings:
        device_us += (now_us - previous) % _WRAP_US
        previous = now_us
        host_s = 0.5 * (sent_s + received_s) - start_s
        drift_s = device_us * 1e-6 - host_s
        # Half a second beyond the largest error: a slow first reply is no restart.
        if abs(drift_s) > _LARGEST_PPM * 1e-6 * host_s + 0.5:
            raise ValueError(
                "the device's clock jumped: it was restarted meanwhile, or is no clock; measure"
                " again"
            )
        points.append((received_s - sent_s, host_s, drift_s))
    row = min(_IN_A_ROW, len(points) // _LEAST)
    quick = [min(points[k : k + row]) for k in range(0, len(points) - row + 1, row)]
    _, times_s, drifts_s = zip(*quick, strict=True)
    slope, offset_s = linear_regression(times_s, drifts_s)
    residuals = [d - offset_s - slope * t for t, d in zip(times_s, drifts_s, strict=True)]
    # Two standard errors of the slope.
    error = math.hypot(*residuals) / math.sqrt((len(quick) - 2) * len(quick)) / pstdev(times_s)
    return ClockFit(1e6 * slope, 2e6 * error, times_s[-1] - times_s[0], len(quick))


def measure_clock(
    controller: Controller,
    *,
    seconds: float = 10.0,
    progress: Callable[[float], None] | None = None,
) -> ClockFit:
    """Read a controller's clock again and again, and fit it against the host's.

    Parameters
    ----------
    controller : Controller
    seconds : float
        Duration; the error falls with its power of 1.5.
    progress : callable, optional
        Called with the fraction done, 0..1.

    Raises
    ------
    ValueError
        If `seconds` is not above 0.
    VerifyError
        If the device was restarted meanwhile.
    """
    if not 0 < seconds < 3600:
        raise ValueError(f"seconds is {seconds}: above 0 and below 3600 are needed; 10 are plenty")
    readings: list[tuple[float, float, int]] = []
    start = time.monotonic()
    while (sent_s := time.monotonic()) < start + seconds or len(readings) < _LEAST:
        retries = controller.link.retries
        uptime_us = controller.status().uptime_us
        if controller.link.retries == retries:  # a retry hides when the clock was read
            readings.append((sent_s, time.monotonic(), uptime_us))
        if progress is not None:
            progress(min(1.0, (time.monotonic() - start) / seconds))
    try:
        return fit_clock(readings)
    except ValueError as error:
        raise VerifyError(f"{controller.link.name}: {error}") from None
