"""Contracts of ShutterCode."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cep.optics.code import ShutterCode

codes = st.text("01", min_size=1, max_size=40).filter(lambda bits: "1" in bits).map(ShutterCode)


@given(codes)
def test_runs_spell_the_code(code):
    assert "".join(str(bit) * length for bit, length in code.runs) == code.bits
    assert sum(length for bit, length in code.runs if bit) == code.open_chips == code.array.sum()
    assert code.pulses == (np.diff(code.array, prepend=0) > 0).sum()
    assert code.duty == code.open_chips / code.chips


@given(codes)
def test_array_and_reversal_round_trip(code):
    assert ShutterCode(code.array, chip_ns=code.chip_ns) == code
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


@pytest.mark.parametrize(
    "chips",
    [
        [1, 0, 1, 1],
        (1, 0, 1, 1),
        [True, False, True, True],
        [1.0, 0.0, 1.0, 1.0],
        np.array([1, 0, 1, 1], dtype=np.int8),
        np.array([1, 0, 1, 1], dtype=np.uint64),
        np.array([True, False, True, True]),
        np.array([1, 0, 1, 1], dtype=np.float32),
    ],
)
def test_sequences_and_arrays_spell_a_code(chips):
    for code in (ShutterCode(chips), ShutterCode(bits=chips)):
        assert code == ShutterCode("1011")
        assert hash(code) == hash(ShutterCode("1011"))
        assert type(code.bits) is str
    timed = ShutterCode(chips, 250_000)
    assert (
        timed == pickle.loads(pickle.dumps(timed)) == replace(ShutterCode("1011"), chip_ns=250_000)
    )
    assert replace(timed, bits=[0, 1]) == ShutterCode("01", 250_000)


@pytest.mark.parametrize(
    ("chips", "message"),
    [
        ([0, 2, 1], "found 2 at chip 2"),
        ([0.5, 1], "found 0.5 at chip 1"),
        ([1, float("nan")], "found nan at chip 2"),
        ([1, -1], "found -1 at chip 2"),
        ([[1, 0]], "one-dimensional"),
        ([[1, 0], [1]], "one-dimensional"),
        (["1", "0"], "string or a one-dimensional array"),
        ([1 + 0j, 1], "string or a one-dimensional array"),
        ([1, None], "string or a one-dimensional array"),
        (None, "NoneType"),
        (101, "got int"),
        (1.0, "got float"),
        (b"101", "got bytes"),
        ({1, 0}, "got set"),
        ([], "empty"),
        ([0, 0], "all chips are closed"),
    ],
)
def test_other_values_than_0_and_1_are_one_line(chips, message):
    with pytest.raises(ValueError, match=message) as caught:
        ShutterCode(chips)
    assert str(caught.value).startswith("bits: ")
    assert "\n" not in str(caught.value)
