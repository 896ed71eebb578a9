"""Contracts of ShutterCode."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cep.code import ShutterCode

codes = st.text("01", min_size=1, max_size=40).filter(lambda bits: "1" in bits).map(ShutterCode)


@given(codes)
def test_runs_spell_the_code(code):
    assert "".join(str(bit) * length for bit, length in code.runs) == code.bits
    assert sum(length for bit, length in code.runs if bit) == code.open_chips == code.array.sum()
    assert code.pulses == (np.diff(code.array, prepend=0) > 0).sum()
    assert code.longest_run == max(length for _, length in code.runs)
    assert code.duty == code.open_chips / code.chips


@given(codes)
def test_array_and_reversal_round_trip(code):
    assert ShutterCode.from_array(code.array, chip_ns=code.chip_ns) == code
    assert code.reversed().reversed() == code
    assert np.array_equal(code.reversed().array, code.array[::-1])


@pytest.mark.parametrize(
    ("bits", "message"),
    [
        ("", "empty"),
        ("0000", "all chips are closed"),
        ("10x1", "found 'x' at chip 3"),
        ("1 0", "found ' ' at chip 2"),
        ("1²", "found '²' at chip 2"),
        (101, "must be a string"),
    ],
)
def test_malformed_bits_are_named(bits, message):
    with pytest.raises(ValueError, match=message) as caught:
        ShutterCode(bits)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("chip_ns", [0, -5, 1.5, True, "1"])
def test_malformed_chip_time(chip_ns):
    with pytest.raises(ValueError, match="chip_ns"):
        ShutterCode("1", chip_ns)


@pytest.mark.parametrize("chips", [[0, 2, 1], [[1, 0]], [0.5, 1]])
def test_from_array_wants_zeros_and_ones(chips):
    with pytest.raises(ValueError, match="chips: must be"):
        ShutterCode.from_array(chips)
