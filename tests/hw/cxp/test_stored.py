import zlib
from dataclasses import replace
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hw.cxp.framing import FrameError
from hw.cxp.protocol import Hello, ResetCause
from hw.cxp.stored import Stored, stored_program, unpack_stored
from hw.program import Program

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
PROGRAM = Program.from_bits("101100000111", chip_ns=200_000)


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
