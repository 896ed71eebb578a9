import struct

import pytest

from hw.framing import FrameError, cobs_decode, cobs_encode, crc16
from hw.program import Program
from hw.protocol import (
    BadLengthError,
    BadOpError,
    DeviceError,
    DutyLimitError,
    ErrorCode,
    Hello,
    Op,
    OutOfRangeError,
    Reply,
    State,
    Status,
    WrongStateError,
    decode_reply,
    device_error,
    encode_request,
    pack_arm,
    pack_load,
    unpack_hello,
    unpack_load,
    unpack_status,
)

PROGRAM = Program.from_bits("101100000111", chip_ns=200_000)


def frame(body):
    return cobs_encode(body + struct.pack("<H", crc16(body)))


def test_request_layout():
    sent = encode_request(Op.LOAD, 2, pack_load(PROGRAM, tick_ns=500))
    assert sent.hex(" ") == "06 02 02 90 01 0c 05 b0 70 26 95 00"
    raw = cobs_decode(sent[:-1])
    assert raw[:2] == bytes([2, 2])
    assert struct.unpack("<HH", raw[2:6]) == (400, 12)
    assert raw[6:8] == bytes([0b10110000, 0b01110000])


def test_reply_layout():
    assert decode_reply(frame(bytes([0x87, 6, 0]) + b"abc")) == Reply(7, 6, 0, b"abc")


def test_every_single_bit_error_in_a_reply_is_noticed():
    good = frame(bytes([0x83, 3, 0]) + pack_load(PROGRAM, tick_ns=500))
    want = decode_reply(good)
    for k in range(8 * len(good)):
        bad = bytearray(good)
        bad[k // 8] ^= 1 << k % 8
        with pytest.raises(FrameError):
            decode_reply(bytes(bad))
    assert decode_reply(good) == want


@pytest.mark.parametrize(
    ("body", "words"), [(bytes([0x81, 1]), "at least 5"), (bytes([0x01, 1, 0]), "not a reply"), (b"", "at least 5")]
)
def test_malformed_replies(body, words):
    with pytest.raises(FrameError, match=words):
        decode_reply(frame(body))


def test_load_and_read_are_inverse():
    for bits in ("1", "10000000", "111111110", "01" * 512):
        program = Program.from_bits(bits, chip_ns=65535 * 500)
        assert unpack_load(pack_load(program, tick_ns=500), tick_ns=500) == program


@pytest.mark.parametrize(("chip_ns", "chips"), [(200_100, 52), (65536 * 500, 52), (200_000, 65536)])
def test_load_refuses_what_its_fields_cannot_say(chip_ns, chips):
    with pytest.raises(ValueError, match=r"whole ticks of 500 ns|at most 65535"):
        pack_load(Program("1" * chips, chip_ns), tick_ns=500)


@pytest.mark.parametrize(
    "data", [b"", b"\x90\x01\x0c\x00", b"\x90\x01\x0c\x00\xb0", b"\0\0\x08\0\xff", b"\1\0\x08\0\0"]
)
def test_read_refuses_what_is_no_program(data):
    with pytest.raises(FrameError, match="READ reply"):
        unpack_load(data, tick_ns=500)


def test_hello():
    assert unpack_hello(b"CXP1\x01\x00\x00\x04\xf4\x01later") == Hello(version=1, max_chips=1024, tick_ns=500)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"CXP1\x01\x00\x00\x04\xf4", "9 bytes"),
        (b"CXP2\x01\x00\x00\x04\xf4\x01", "CXP2"),
        (b"CXP1\x02\x00\x00\x04\xf4\x01", "version 2"),
        (b"CXP1\x01\x00\x00\x00\xf4\x01", "0 chips"),
        (b"CXP1\x01\x00\x00\x04\x00\x00", "tick of 0"),
    ],
)
def test_bad_hello(data, words):
    with pytest.raises(FrameError, match=words):
        unpack_hello(data)


def test_status():
    assert unpack_status(bytes.fromhex("03 0500 0200 00 01")) == Status(State.PLAY, 5, 2, 0, 1)
    with pytest.raises(FrameError, match="state 9"):
        unpack_status(bytes.fromhex("09 0500 0200 00 01"))
    with pytest.raises(FrameError, match="6 bytes"):
        unpack_status(bytes(6))


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
        (77, DeviceError),
    ],
)
def test_errors_are_typed(code, kind):
    error = device_error(Reply(Op.ARM, 1, code, b""), source="COM3")
    assert type(error) is kind
    assert str(error).startswith("COM3 refuses ARM: ")
    assert "\n" not in str(error)
