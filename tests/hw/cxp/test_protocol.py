import struct
import zlib

import pytest

from hw.cxp.framing import FrameError
from hw.cxp.protocol import (
    Hello,
    Op,
    Reply,
    ResetCause,
    State,
    Status,
    pack_arm,
    parse_reply,
    request_body,
    unpack_crc,
    unpack_hello,
    unpack_status,
)
from hw.errors import (
    BadLengthError,
    BadOpError,
    DeviceError,
    DutyLimitError,
    ErrorCode,
    OnLimitError,
    OutOfRangeError,
    WrongStateError,
    device_error,
)

HELLO = (
    bytes.fromhex("43585031 01 03 0004 f401 64000000 ffff0000 00000000 e803 204e0000 00")
    + b"cxp-avr 1"
)


def test_request_layout():
    assert request_body(Op.LOAD, 2, b"abc") == b"\x02\x02abc"


def test_reply_layout():
    assert parse_reply(bytes([0x87, 6, 0]) + b"abc") == Reply(7, 6, 0, b"abc")


@pytest.mark.parametrize(
    ("body", "words"), [(bytes([0x81, 1]), "at least 3"), (bytes([0x01, 1, 0]), "not a reply")]
)
def test_malformed_replies(body, words):
    with pytest.raises(FrameError, match=words):
        parse_reply(body)


def test_hello():
    told = Hello(
        version=1,
        fractions=True,
        trigger_input=True,
        max_chips=1024,
        tick_ns=500,
        min_ticks=100,
        max_ticks=65535,
        max_on_ticks=None,
        max_duty=None,
        lead_ns=20_000,
        reset_cause=ResetCause.POWER,
        firmware="cxp-avr 1",
    )
    assert unpack_hello(HELLO) == told
    assert unpack_hello(HELLO + b"\0and more of later versions") == told


def test_hello_with_limits_after_a_watchdog_reset():
    data = bytearray(HELLO)
    data[5] = 0
    data[18:24] = struct.pack("<IH", 4000, 250)
    data[28] = 3
    told = unpack_hello(bytes(data))
    assert (told.fractions, told.trigger_input) == (False, False)
    assert (told.max_on_ticks, told.max_duty, told.reset_cause) == (
        4000,
        0.25,
        ResetCause.WATCHDOG,
    )
    data[28] = 77
    assert unpack_hello(bytes(data)).reset_cause is ResetCause.UNKNOWN


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (HELLO[:28], "28 bytes"),
        (b"", "begins with b''"),
        (HELLO.replace(b"CXP1", b"CXP2"), "CXP2"),
        (HELLO[:4] + b"\2" + HELLO[5:], "version 2"),
        (HELLO[:6] + b"\0\0" + HELLO[8:], "0 chips"),
        (HELLO[:8] + b"\0\0" + HELLO[10:], "ticks of 0 ns"),
        (HELLO[:10] + bytes(4) + HELLO[14:], r"of 0\.\.65535"),
        (HELLO[:14] + bytes(4) + HELLO[18:], r"of 100\.\.0"),
    ],
)
def test_bad_hello(data, words):
    with pytest.raises(FrameError, match=words):
        unpack_hello(data)


def test_status():
    data = bytes.fromhex("03 0500 0200 00 01 87d61200 e0944ccb")
    assert unpack_status(data) == Status(State.PLAY, 5, 2, 0, 1, 1_234_567, 0xCB4C94E0)
    assert unpack_status(data + b"later").state is State.PLAY
    with pytest.raises(FrameError, match="state 9"):
        unpack_status(b"\x09" + data[1:])
    with pytest.raises(FrameError, match="14 bytes"):
        unpack_status(data[:-1])


def test_confirmed_crc():
    assert unpack_crc(struct.pack("<I", zlib.crc32(b"x"))) == zlib.crc32(b"x")
    with pytest.raises(FrameError, match="3 bytes"):
        unpack_crc(b"abc")


def test_lease():
    assert pack_arm(5000) == b"\x88\x13"
    for bad in (0, 65536, 1.5, True, None):
        with pytest.raises(ValueError, match="lease_ms"):
            pack_arm(bad)


@pytest.mark.parametrize(
    ("code", "kind"),
    [
        (ErrorCode.BAD_OP, BadOpError),
        (ErrorCode.BAD_LENGTH, BadLengthError),
        (ErrorCode.OUT_OF_RANGE, OutOfRangeError),
        (ErrorCode.WRONG_STATE, WrongStateError),
        (ErrorCode.DUTY_LIMIT, DutyLimitError),
        (ErrorCode.ON_LIMIT, OnLimitError),
        (77, DeviceError),
    ],
)
def test_errors_are_typed(code, kind):
    error = device_error(code, request="ARM", source="COM3")
    assert type(error) is kind
    assert str(error).startswith("COM3 refuses ARM: ")
    assert "\n" not in str(error)
