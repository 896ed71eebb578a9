import binascii
import contextlib

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
