"""A code on its way to the shutter: in whole ticks, into a controller, or on an emulated board."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

from cep.optics.code import ShutterCode
from hw.cxp.protocol import State
from hw.device import DeviceProfile
from hw.drivers import DRIVERS, Driver, UploadReport
from hw.drivers.cxp import Controller
from hw.program import Program

LEASE_MS = 1000
"""An armed controller disarms itself after this without its host, ms."""
HEARTBEAT_S = LEASE_MS / 4000
"""So often the host renews that."""
MOST_ROUNDING = 0.005
"""Share of a chip by which it may be rounded to a device's ticks: with that 52 chips end a quarter
of a chip off."""

Timed = TypeVar("Timed", ShutterCode, Program)
_LAST_EDGE_S = 2.0  # an emulated clock may lag behind
_LOOK_S = 0.001


def open_shutter(port: str, *, driver: str = "cxp") -> Driver:
    """Open a shutter controller: a context manager that closes the shutter on an exception.

    It can ``upload`` a code, and arm or play it; ``play`` what is armed; and ``abort``:
    :class:`hw.drivers.driver.Driver`.

    Parameters
    ----------
    port : str
        Serial port as ``/dev/ttyACM0`` or ``COM3``, a USB serial number, or with "cxp" ``auto``
        for the only one connected; with "scpi" a VISA resource.
    driver : {"cxp", "pulse-pal", "scpi"}

    Raises
    ------
    ValueError
        If the driver is not known, or the port cannot be used; the line says why.

    Examples
    --------
    ::

        with open_shutter("/dev/ttyACM0") as shutter:
            shutter.upload(ShutterCode("11100101", chip_ns=500_000), arm=True)
    """
    if driver not in DRIVERS:
        raise ValueError(f"driver: must be one of {', '.join(DRIVERS)}, got {driver[:40]!r}")
    return DRIVERS[driver].open(port)


def on_ticks(code: Timed, tick_ns: int) -> tuple[Timed, tuple[str, ...]]:
    """Return a code or program with chips of whole ticks, and a warning where they changed.

    One that would last more than :data:`MOST_ROUNDING` longer or shorter is left as it is.

    Examples
    --------
    >>> code = ShutterCode("101", 641_026)
    >>> on_ticks(code, 500)[0].chip_ns, on_ticks(code, 50_000)[0].chip_ns
    (641000, 641026)
    """
    # At least one tick, for chips shorter than half of one.
    chip_ns = max(1, round(code.chip_ns / tick_ns)) * tick_ns
    if not 0 < abs(chip_ns - code.chip_ns) <= MOST_ROUNDING * code.chip_ns:
        return code, ()
    warning = (
        f"its chips last {chip_ns} ns instead of {code.chip_ns} ns: whole ticks of {tick_ns} ns"
    )
    return replace(code, chip_ns=chip_ns), (warning,)


def play_emulated(
    code: ShutterCode, *, profile: DeviceProfile | None = None
) -> tuple[UploadReport, tuple[tuple[int, int], ...]]:
    """Load a code into an emulated Uno with the shipped firmware, read it back, and play it once.

    ValueError if the emulator cannot run here, or the board cannot play the code; the line says
    why. The edges are times after the first opening, ns, and the levels from then on.
    """
    from hw.emulation.uno import CLOCK_HZ, EmulatedUno, EmulationError

    uno = EmulatedUno()
    try:
        uno.start()
    except EmulationError as error:
        raise ValueError(str(error)) from None  # what is missing can be installed
    try:
        with open_shutter(uno.port) as shutter:
            report = shutter.upload(code, profile=profile, play=True)
        deadline = time.monotonic() + _LAST_EDGE_S
        # The play is over by this computer's clock; the emulated one may lag behind.
        while len(edges := uno.edges()) < 2 * code.pulses and time.monotonic() < deadline:
            time.sleep(0.01)
    finally:
        uno.stop()
    first = edges[0][0] if edges else 0
    return report, tuple(
        (round((cycle - first) * 1e9 / CLOCK_HZ), level) for cycle, level in edges
    )


@dataclass(frozen=True)
class Belt:
    """Plays on a machine's triggers.

    Attributes
    ----------
    plays, missed_edges : int
        Counted by the controller.
    seconds : float
    interrupted : bool
        Ended by Ctrl-C.
    """

    plays: int
    missed_edges: int
    seconds: float
    interrupted: bool = False


def play_on_triggers(
    port: str,
    code: ShutterCode,
    *,
    plays: int | None = None,
    wait_s: float = math.inf,
    tell: Callable[[int], None] = lambda _plays: None,
) -> Belt:
    """Arm the controller again after every play, with a lease that ends when the host is gone.

    A trigger that comes while a code plays, or within some milliseconds after it, is not obeyed.

    Parameters
    ----------
    plays : int, optional
        How many; until Ctrl-C when omitted.
    wait_s : float
        Without a trigger for so long it ends.
    tell : callable
        Called with the count after each play.

    Raises
    ------
    ValueError, hw.errors.VerifyError, hw.port.LinkError, hw.errors.DeviceError
        As :func:`cep.shutter.shoot.shoot`; the shutter is closed.
    """
    with Controller.open(port) as controller:
        controller.upload(code)
        start = controller.status()
        start_s = last_s = beat_s = time.monotonic()
        count = 0
        controller.arm(lease_ms=LEASE_MS)
        interrupted = False
        try:
            while plays is None or count < plays:
                status = controller.status()
                now_s = time.monotonic()
                # the controller counts plays in 16 bits
                if (counted := (status.runs - start.runs) % 65536) != count:
                    count, last_s = counted, now_s
                    tell(count)
                if now_s - last_s >= wait_s:
                    break
                is_wanted = plays is None or count < plays
                if is_wanted and status.state is State.ARMED and now_s - beat_s > HEARTBEAT_S:
                    controller.renew(lease_ms=LEASE_MS)
                    beat_s = now_s
                # a play uses the arming up
                elif is_wanted and status.state not in (State.ARMED, State.PLAY):
                    controller.arm(lease_ms=LEASE_MS)
                    beat_s = now_s
                time.sleep(_LOOK_S)
        except KeyboardInterrupt:
            interrupted = True  # the ordinary end of "always"
        status = controller.abort()
        return Belt(
            count, status.late - start.late, time.monotonic() - start_s, interrupted=interrupted
        )
