import binascii
import contextlib
import struct
import zlib
from dataclasses import replace
from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hw.cxp.protocol import (
    BINARY,
    TEXT,
    FrameError,
    Hello,
    Op,
    Reply,
    ResetCause,
    State,
    Status,
    Stored,
    crc16,
    pack_arm,
    parse_reply,
    request_body,
    stored_program,
    unpack_crc,
    unpack_hello,
    unpack_status,
    unpack_stored,
)
from hw.errors import (
    DeviceError,
    WrongStateError,
    device_error,
)
from hw.program import Program

HELLO = (
    bytes.fromhex("43585031 01 03 0004 f401 64000000 ffff0000 00000000 e803 204e0000 00")
    + b"cxp-avr 1"
)


def test_crc_check_value():
    assert crc16(b"123456789") == 0x29B1
    assert crc16(b"") == 0xFFFF


@settings(deadline=None)
@given(st.binary(max_size=600))
def test_crc_against_the_standard_library(data):
    assert crc16(data) == binascii.crc_hqx(data, 0xFFFF)


COUNT = bytes(range(1, 256))


@pytest.mark.parametrize(
    ("data", "stuffed"),
    [
        (b"", b"\x01"),
        (b"\0", b"\x01\x01"),
        (b"\0\0", b"\x01\x01\x01"),
        (b"\0\x11\0", b"\x01\x02\x11\x01"),
        (b"\x11\x22\0\x33", b"\x03\x11\x22\x02\x33"),
        (b"\x11\x22\x33\x44", b"\x05\x11\x22\x33\x44"),
        (b"\x11\0\0\0", b"\x02\x11\x01\x01\x01"),
        (COUNT[:254], b"\xff" + COUNT[:254]),
        (b"\0" + COUNT[:254], b"\x01\xff" + COUNT[:254]),
        (COUNT, b"\xff" + COUNT[:254] + b"\x02\xff"),
        (COUNT[1:] + b"\0", b"\xff" + COUNT[1:] + b"\x01\x01"),
        (COUNT[2:] + b"\0\x01", b"\xfe" + COUNT[2:] + b"\x02\x01"),
    ],
)
def test_published_cobs_vectors(data, stuffed):
    """The firmware stuffs by its own code: both sides keep to the published bytes."""
    assert BINARY.wrap(data) == stuffed
    assert BINARY.unwrap(stuffed) == data


# Zero positions in 250..600 bytes: what matters is where the 254-byte blocks end.
long_data = st.builds(
    lambda size, zeros: bytes(0 if k in zeros else 1 + k % 255 for k in range(size)),
    st.integers(250, 600),
    st.sets(
        st.one_of(st.integers(0, 599), st.sampled_from([253, 254, 255, 508, 509])), max_size=4
    ),
)


@settings(deadline=None, max_examples=300)
@given(st.one_of(st.binary(max_size=40), long_data))
def test_cobs_round_trip_without_zeros(data):
    stuffed = BINARY.wrap(data)
    assert 0 not in stuffed
    assert len(stuffed) <= len(data) + 1 + len(data) // 254
    assert BINARY.unwrap(stuffed) == data


@settings(deadline=None)
@given(st.binary(max_size=60).filter(len))
def test_any_bytes_become_less_or_are_refused(data):
    with contextlib.suppress(FrameError):
        assert len(BINARY.unwrap(data)) < len(data)


@pytest.mark.parametrize("bad", [b"", b"\x00", b"\x02\x00", b"\x03\x11", b"\x02\x11\x05\x22"])
def test_bad_stuffing_is_refused(bad):
    with pytest.raises(FrameError, match=r"^frame (is not byte-stuffed: |has 0 bytes: )"):
        BINARY.decode(bad)


framings = pytest.mark.parametrize("framing", [BINARY, TEXT], ids=lambda framing: framing.name)


@framings
@settings(deadline=None)
@given(st.lists(st.binary(min_size=2, max_size=9), max_size=6), st.data())
def test_frames_come_through_however_the_bytes_arrive(framing, bodies, data):
    stream = framing.end + b"".join(framing.encode(body) for body in bodies)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=5)))
    got = []
    rest = b""
    for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        new, rest = framing.split(rest + stream[start:end])
        got += new
    assert [framing.decode(frame) for frame in got] == bodies
    assert rest == b""


def test_frames_on_the_line():
    body = bytes([5, 5])
    assert BINARY.encode(body).hex(" ") == "05 05 05 5f b2 00"
    assert TEXT.encode(body) == b":05055FB2\n"


@framings
@given(st.binary(min_size=2, max_size=40), st.data())
def test_every_single_bit_error_is_noticed(framing, body, data):
    frame = bytearray(framing.encode(body)[:-1])
    bit = data.draw(st.integers(0, 8 * len(frame) - 1))
    frame[bit // 8] ^= 1 << bit % 8
    if framing is TEXT and frame.upper() == framing.encode(body)[:-1]:
        return
    with pytest.raises(FrameError):
        framing.decode(bytes(frame))


def test_a_text_frame_after_a_prompt_and_before_a_carriage_return():
    assert TEXT.decode(b">>> half:0a:05055FB2\r") == bytes([5, 5])


@pytest.mark.parametrize(
    "line", [b"", b":", b"05055FB2", b":05055fb2", b":05055FB", b":05 055FB2", b":0505"]
)
def test_malformed_text_frames(line):
    with pytest.raises(FrameError, match=r"^(line is no frame|frame has 2 bytes)"):
        TEXT.decode(line)


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
    ("code", "kind"), [(4, WrongStateError), (5, DeviceError), (77, DeviceError)]
)
def test_errors_are_typed(code, kind):
    error = device_error(code, request="ARM", source="COM3")
    assert type(error) is kind
    assert str(error).startswith("COM3 refuses ARM: ")
    assert "\n" not in str(error)


UNO = Hello(
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
WHOLE = replace(UNO, fractions=False)
PROGRAM = Program("101100000111", chip_ns=200_000)


def test_layout_and_crc():
    stored = stored_program(PROGRAM, UNO)
    assert stored == Stored("101100000111", 400, 0)
    assert stored.payload.hex(" ") == "90 01 00 00 00 00 0c 00 b0 70"
    assert stored.crc32 == zlib.crc32(stored.payload)


@given(
    st.text("01", min_size=1, max_size=80).filter(lambda bits: "1" in bits),
    st.integers(100, 65535),
)
def test_reading_is_the_inverse_of_loading(bits, ticks):
    stored = Stored(bits, ticks, 12345)
    assert unpack_stored(stored.payload) == stored


@given(
    st.integers(52_000, 20_000_000), st.floats(-20_000, 20_000).filter(lambda ppm: abs(ppm) > 1e-3)
)
def test_a_clock_error_is_taken_out_to_a_fraction_of_a_tick(chip_ns, ppm):
    stored = stored_program(Program("1", chip_ns), UNO, clock_ppm=ppm)
    # What the device counts as a tick lasts tick / (1 + ppm) of true time.
    true_ns = stored.chip_ticks * UNO.tick_ns / (1 + Fraction(ppm) / 10**6)
    assert abs(true_ns - chip_ns) <= Fraction(UNO.tick_ns, 65536)


def test_a_device_without_fractions_takes_the_nearest_tick():
    assert stored_program(PROGRAM, WHOLE, clock_ppm=-2021) == Stored(PROGRAM.bits, 399, 0)
    assert stored_program(PROGRAM, UNO, clock_ppm=-2021).chip_ticks == Fraction(
        round(400 * (1 - 0.002021) * 65536), 65536
    )


@pytest.mark.parametrize(
    ("chip_ns", "chips", "ppm", "words"),
    [
        (200_100, 52, 0, "500 ns ticks"),
        (65536 * 500, 52, 0, "50000 to 32767500 ns"),
        (49_500, 52, 0, "50000 to 32767500 ns"),
        (65535 * 500, 52, 10, "50000 to 32767500 ns"),
        (200_000, 1025, 0, "at most 1024"),
        (200_000, 52, float("nan"), "clock_ppm is nan"),
        (200_000, 52, 2e5, "clock_ppm"),
    ],
)
def test_what_the_device_cannot_play(chip_ns, chips, ppm, words):
    with pytest.raises(ValueError, match=words) as caught:
        stored_program(Program("1" * chips, chip_ns), UNO, clock_ppm=ppm)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "data",
    [
        "",
        "9001000000000c00",
        "9001000000000c00b0",
        "9001000000000800ff00",
        "90010000000008000000",
        "900100000000080000",
    ],
)
def test_what_is_no_program(data):
    with pytest.raises(FrameError, match="READ reply"):
        unpack_stored(bytes.fromhex(data))


def test_differences_are_named():
    stored = Stored("1011", 400, 0)
    assert stored.difference(stored) == ""
    assert stored.difference(replace(stored, fraction=32768)) == "chip of 400.5 ticks, not 400"
    assert stored.difference(replace(stored, bits="101")) == "3 chips, not 4"
    assert (
        stored.difference(replace(stored, bits="1111"))
        == "1 of 4 chips differ, the first is chip 1"
    )
