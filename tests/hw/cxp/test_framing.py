import binascii

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hw.cxp.framing import BINARY, TEXT, FrameError, crc16


def test_crc_check_value():
    assert crc16(b"123456789") == 0x29B1
    assert crc16(b"") == 0xFFFF


@settings(deadline=None)
@given(st.binary(max_size=600))
def test_crc_against_the_standard_library(data):
    assert crc16(data) == binascii.crc_hqx(data, 0xFFFF)


@pytest.mark.parametrize("bad", [b"", b"\x00", b"\x02\x00", b"\x03\x11", b"\x02\x11\x05\x22"])
def test_bad_stuffing_is_refused(bad):
    with pytest.raises(FrameError, match=r"^frame "):
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
