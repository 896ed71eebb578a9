"""Errors of a device as typed exceptions, and any error as one line."""

from __future__ import annotations

_WRONG_STATE = 4
_DUTY_LIMIT = 5
# by the error byte of a CXP1 reply: docs/cxp1.md
_REASONS = {
    1: "unknown request: its firmware is another version",
    2: "wrong payload length: its firmware is another version",
    3: "value out of range: check chip time and number of chips",
    _WRONG_STATE: (
        "not allowed in its present state: ask STATUS; load before arm, arm before trigger, abort"
        " before load"
    ),
    _DUTY_LIMIT: "open for too much of the time: use a code with fewer open chips",
    6: "an opening is too long: use shorter runs of open chips, or shorter chips",
}
# DUTY_LIMIT as the answer to ARM, where the program itself is allowed.
_OWED = (
    "a play was cut short, and no other may begin before it would have ended: wait, then arm again"
)


class DeviceError(RuntimeError):
    """The device understood a request and refused it; nothing changed in the device."""


class WrongStateError(DeviceError):
    """The request is not allowed in the present state."""


class VerifyError(RuntimeError):
    """The device holds another program, or is in another state, than requested."""


def device_error(code: int, *, request: str, source: str) -> DeviceError:
    """Typed exception for an error byte: `source` refuses `request`."""
    reason = _REASONS.get(code, f"error {code}, which this version does not know")
    if code == _DUTY_LIMIT and request == "ARM":
        reason = _OWED
    kind = WrongStateError if code == _WRONG_STATE else DeviceError
    return kind(f"{source} refuses {request}: {reason}")


def one_line(error: Exception) -> str:
    """Text of an error in one line, of at most 160 characters."""
    return " ".join(str(error).split())[:160] or type(error).__name__
