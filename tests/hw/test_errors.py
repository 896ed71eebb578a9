"""Errors of a device: the exception of each error byte, and any error in one line."""

import pytest

from hw.errors import DeviceError, WrongStateError, device_error, one_line


@pytest.mark.parametrize(
    ("code", "request_name", "kind", "reason"),
    [
        (3, "LOAD", DeviceError, "value out of range"),
        (4, "ARM", WrongStateError, "present state"),
        (5, "LOAD", DeviceError, "use a code with fewer open chips"),
        (5, "ARM", DeviceError, "a play was cut short"),
        (6, "ARM", DeviceError, "an opening is too long"),
        (77, "ARM", DeviceError, "error 77, which this version does not know"),
    ],
)
def test_an_error_byte_has_its_exception_and_reason(code, request_name, kind, reason):
    error = device_error(code, request=request_name, source="ttyZ1")
    assert type(error) is kind
    assert str(error).startswith(f"ttyZ1 refuses {request_name}: ")
    assert reason in str(error)


def test_any_error_is_one_line():
    assert one_line(OSError("the line\n  is   broken\t")) == "the line is broken"
    assert one_line(OSError("x" * 1000)) == "x" * 160
    assert one_line(KeyError()) == "KeyError"
