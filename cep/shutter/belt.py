"""A code played on the triggers of a machine, as of a conveyor belt."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from cep.optics.code import ShutterCode
from cep.shutter.play import HEARTBEAT_S, LEASE_MS
from hw.cxp.protocol import State
from hw.drivers.cxp import Controller

_LOOK_S = 0.001


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
    port : str
    code : ShutterCode
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
