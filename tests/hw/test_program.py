import struct
import zlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hw.program import Program

RASKAR = "1010000111000001010000110011110111010111001001100111"

programs = st.builds(
    Program,
    st.text("01", min_size=1, max_size=80).filter(lambda bits: "1" in bits),
    chip_ns=st.one_of(st.integers(1, 10**6), st.integers(1, 2**63 - 1)),
)


def test_raskar_has_26_edges_and_13_pulses():
    program = Program(RASKAR, chip_ns=200_000)
    assert (program.chips, len(program.edges), program.pulses) == (52, 26, 13)
    assert program.duration_ns == 10_400_000
    assert program.open_ns == 26 * 200_000
    assert program.duty == 0.5
    assert program.edges[0] == (0, 1)
    assert program.edges[-1] == (10_400_000, 0)


@settings(deadline=None)
@given(programs)
def test_edges_replay_to_the_bits(program):
    # Play the edges on a clock and sample the middle of each chip: an independent way back.
    edges = list(program.edges)
    assert [level for _, level in edges] == [1, 0] * program.pulses
    level = 0
    sampled = ""
    for k in range(program.chips):
        while edges and 2 * edges[0][0] < (2 * k + 1) * program.chip_ns:
            level = edges.pop(0)[1]
        sampled += str(level)
    assert sampled == program.bits
    assert edges in ([], [(program.duration_ns, 0)])


@settings(deadline=None)
@given(programs)
def test_runs_add_up_and_all_ways_back_are_exact(program):
    assert sum(ns for _, ns in program.runs) == program.duration_ns
    assert sum(ns for level, ns in program.runs if level) == program.open_ns
    assert all(a != b for (a, _), (b, _) in zip(program.runs, program.runs[1:], strict=False))
    assert (
        Program.from_edges(program.edges, chip_ns=program.chip_ns, chips=program.chips) == program
    )
    assert (
        Program.from_bytes(program.to_bytes(), chips=program.chips, chip_ns=program.chip_ns)
        == program
    )


def test_first_edge_waits_for_the_first_open_chip():
    assert Program("0010", chip_ns=7).edges == ((14, 1), (21, 0))


def test_bytes_are_msb_first():
    assert Program("100000011", chip_ns=1).to_bytes() == b"\x81\x80"


def test_crc_tells_code_length_and_chip_apart():
    program = Program("1011", chip_ns=200_000)
    assert program.code_crc32 == zlib.crc32(struct.pack("<QI", 200_000, 4) + b"\xb0")
    others = [
        Program("10110", chip_ns=200_000),
        Program("1011", chip_ns=200_001),
    ]
    assert program.code_crc32 not in {other.code_crc32 for other in others}


@pytest.mark.parametrize(
    ("bits", "chip_ns", "words"),
    [
        ("", 5, "empty"),
        ([1, 0], 5, "bits is a list"),
        ("102", 5, "'2' at chip 2"),
        ("1 0", 5, "' ' at chip 1"),
        ("1\n0", 5, "chip 1"),
        ("١٠", 5, "chip 0"),
        ("0000", 5, "no open chip"),
        ("1", 0, "at least 1"),
        ("1", -5, "at least 1"),
        ("1", 2**63, "below 2^63"),
        ("1", 1.5, "whole number"),
        ("1", True, "whole number"),
        ("1", "5", "whole number"),
        ("1", None, "whole number"),
    ],
)
def test_bad_programs_get_one_clear_line(bits, chip_ns, words):
    with pytest.raises(ValueError, match=r".") as caught:
        Program(bits, chip_ns=chip_ns)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("edges", "words"),
    [
        ([(0, 1), (15, 0)], "off the grid"),
        ([(0, 0)], "level 0"),
        ([(0, 1), (10, 1)], "level 1"),
        ([(20, 1), (10, 0)], "out of order"),
        ([(10, 1), (10, 0)], "out of order"),
        ([(-10, 1), (10, 0)], "out of order"),
        ([(0, 1), (50, 0)], "past the end"),
        ([(0, 1), (10, 0), (40, 1)], "past the end"),
        ([(0, 1)], "leave the shutter open"),
        ([], "no open chip"),
    ],
)
def test_bad_edges_get_one_clear_line(edges, words):
    with pytest.raises(ValueError, match=words):
        Program.from_edges(edges, chip_ns=10, chips=4)


def test_bad_bytes_get_one_clear_line():
    with pytest.raises(ValueError, match="padding"):
        Program.from_bytes(b"\xff", chips=4, chip_ns=1)
    with pytest.raises(ValueError, match="2 bytes"):
        Program.from_bytes(b"\xff\x00", chips=4, chip_ns=1)
    with pytest.raises(ValueError, match="0 bytes"):
        Program.from_bytes(b"", chips=0, chip_ns=1)
