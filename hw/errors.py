"""Errors of a device as typed exceptions, and any error as one line."""

from __future__ import annotations

from enum import IntEnum


class ErrorCode(IntEnum):
    """Error byte of a CXP1 reply."""

    OK = 0
    BAD_OP = 1
    BAD_LENGTH = 2
    OUT_OF_RANGE = 3
    WRONG_STATE = 4
    DUTY_LIMIT = 5
    ON_LIMIT = 6


class DeviceError(RuntimeError):
    """The device understood a request and refused it; nothing changed in the device."""


class VerifyError(RuntimeError):
    """The device holds another program, or is in another state, than requested."""


class BadOpError(DeviceError):
    """The request is unknown to the device."""


class BadLengthError(DeviceError):
    """The payload has a length the request does not take."""


class OutOfRangeError(DeviceError):
    """A value is out of the device's range."""


class WrongStateError(DeviceError):
    """The request is not allowed in the present state."""


class DutyLimitError(DeviceError):
    """The program is open for too large a part of its time, or follows another too soon."""


class OnLimitError(DeviceError):
    """An opening is longer than the device allows."""


_KINDS: dict[int, tuple[type[DeviceError], str]] = {
    ErrorCode.BAD_OP: (BadOpError, "unknown request: its firmware is another version"),
    ErrorCode.BAD_LENGTH: (
        BadLengthError,
        "wrong payload length: its firmware is another version",
    ),
    ErrorCode.OUT_OF_RANGE: (
        OutOfRangeError,
        "value out of range: check chip time and number of chips",
    ),
    ErrorCode.WRONG_STATE: (
        WrongStateError,
        "not allowed in its present state: ask STATUS; load before arm, arm "
        "before trigger, abort before load",
    ),
    ErrorCode.DUTY_LIMIT: (
        DutyLimitError,
        "open for too much of the time: use a code with fewer open chips",
    ),
    ErrorCode.ON_LIMIT: (
        OnLimitError,
        "an opening is too long: use shorter runs of open chips, or shorter chips",
    ),
}

# DUTY_LIMIT as the answer to ARM, where the program itself is allowed.
_OWED = (
    "a play was cut short, and no other may begin before it would have ended: wait, then arm again"
)


def device_error(code: int, *, request: str, source: str) -> DeviceError:
    """Typed exception for an error byte: `source` refuses `request`."""
    kind, text = _KINDS.get(code, (DeviceError, f"error {code}, which this version does not know"))
    if kind is DutyLimitError and request == "ARM":
        text = _OWED
    return kind(f"{source} refuses {request}: {text}")


def one_line(error: Exception) -> str:
    """Text of an error in one line, of at most 160 characters."""
    return " ".join(str(error).split())[:160] or type(error).__name__
