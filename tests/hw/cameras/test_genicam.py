"""Unpacking of GenICam's pixel formats, against their bit layouts written out pixel by pixel."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hw.cameras.genicam import deepest, pixel_format


def bit_stream(values, bits):
    """Pixels one after the other, lowest bit first (PFNC ``p``), as one long number."""
    stream = sum(int(value) << bits * index for index, value in enumerate(values))
    return stream.to_bytes((len(values) * bits + 7) // 8, "little")


def gige_packed(values, bits):
    """GigE Vision: high byte of the first, low bits of both, high byte of the second."""
    low = bits - 8
    data = bytearray()
    for first, second in zip(values[::2], [*values[1::2], 0], strict=False):
        low_bits = first & (1 << low) - 1 | (second & (1 << low) - 1) << 4
        data += bytes([first >> low, low_bits, second >> low])
    return bytes(data[: (len(values) * 3 + 1) // 2])


PACKERS = {"p": bit_stream, "Packed": gige_packed}


@given(
    packing=st.sampled_from(["p", "Packed"]),
    bits=st.sampled_from([10, 12]),
    width=st.integers(1, 9),
    height=st.integers(1, 4),
    seed=st.integers(0, 2**32 - 1),
)
def test_packed_pixels_are_unpacked_to_their_values(packing, bits, width, height, seed):
    values = np.random.default_rng(seed).integers(0, 2**bits, (height, width))
    pack = PACKERS[packing]
    layout = pixel_format(f"Mono{bits}{packing}")
    whole = pack(values.reshape(-1).tolist(), bits)
    np.testing.assert_array_equal(layout.unpack(whole, values.shape), values)
    # and with each row on its own, three bytes behind it
    rows = b"".join(pack(row.tolist(), bits) + b"\xff\xff\xff" for row in values)
    np.testing.assert_array_equal(layout.unpack(rows, values.shape, padding=3), values)


@pytest.mark.parametrize(("name", "dtype"), [("Mono8", "u1"), ("BayerGB10", "<u2")])
def test_unpacked_pixels_keep_their_values(name, dtype):
    values = np.arange(12, dtype=dtype).reshape(3, 4) * 20
    unpacked = pixel_format(name).unpack(values.tobytes() + b"trailer", (3, 4))
    np.testing.assert_array_equal(unpacked, values)
    assert unpacked.flags.owndata or unpacked.base.flags.owndata  # no view of a buffer that goes


def test_too_few_bytes_are_refused():
    with pytest.raises(ValueError, match="17 bytes for 12 pixels of Mono12p: 18 are needed"):
        pixel_format("Mono12p").unpack(bytes(17), (3, 4))


@pytest.mark.parametrize("name", ["RGB8", "YUV422Packed", "Mono1p", "BayerRG8Extra", "Mono12X"])
def test_other_formats_are_none(name):
    assert pixel_format(name) is None


def test_the_deepest_format_of_several_bayer_patterns_is_grey():
    names = ("Mono8", "Mono16", *(f"Bayer{first}16" for first in ("RG", "GR", "GB", "BG")))
    assert deepest(names).name == "Mono16"
    assert deepest(("RGB8", "YUV411Packed")) is None
