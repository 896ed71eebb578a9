"""Codes proven to have the largest minimum of |P| on the unit circle: see docs/optima.md."""

from __future__ import annotations

from typing import NamedTuple

_TABLE = "docs/optima.md"
# Codes with their numbers of chips: the best of up to so many, whatever is open. A longer code is
# listed only where it beats all shorter ones, which may be padded with closed chips.
_ANY_LIGHT = (
    ("1", 9),
    ("1110001001", 12),
    ("1111100110101", 20),
    ("110000011011110110101", 21),
    ("1100000111011101101001", 23),
    ("110100110010000101111101", 25),
    ("10111101001011101000110001", 28),
    ("11101011100001001100100001001", 35),
    ("111110111110010010011100100001010101", 37),
    ("11111101000111100011010011010100010001", 38),
    ("100100100100111010000111001110111010001", 39),
    ("1101001001110000000111011111100111010101", 41),
    ("111111100101011010011000011001000100010001", 42),
    ("1111111110001110001010110010100100010010001", 43),
    ("11111111000101100101110101001010001100110001", 47),
    ("111111101111010001110110101000110100110001010101", 48),
)
_BY_OPEN_CHIPS = (
    "1101",
    "11101",
    "1110001001",
    "1000001001100000010000001",
    "10010001101000001000001",
    "1001000001010100110001",
    "1111000001001000000100010001",
    "11001000111000100000100101",
    "1011010100010011000011000001",
    "1110000001001110101100101",
    "100111011100101001101000001",
    "10111101001011101000110001",
    "110100100001110101110110011",
    "1111011110010011101000010101",
    "1111111001110011011010101",
    "1111110101011100100111100011",
    "1111111110011101101011101",
    "1110100111011101011011111101",
    "1111111111110001110101011011",
    "1111100111011101111111101101",
    "1111001101111111111111110101",
    "1111111101111111101111010111",
    "1111111111101111011111011111",
    "111111111111111011111111111",
    "1111111111111101111111111111",
    "1111111111111111111111111111",
)
_MOST_BY_OPEN_CHIPS = 28  # chips to which each number of open chips is proven
_IN_BLOCKS = 42  # chips from which each number has a proof of its own


class ProvenCode(NamedTuple):
    """The code of largest minimum |P| among all of a range of lengths and open chips.

    Attributes
    ----------
    bits : str
        From the first open chip to the last.
    chips : int
        Most chips of the codes that the proof covers.
    fewest_open, most_open : int
        Their fewest and most open chips.
    proof : str
        File of the proof, or else the page with its table, in the documentation.
    """

    bits: str
    chips: int
    fewest_open: int
    most_open: int
    proof: str


OPTIMA = (
    *(
        ProvenCode(
            bits, chips, 1, chips, f"docs/proofs/{chips}.jsonl" if chips >= _IN_BLOCKS else _TABLE
        )
        for bits, chips in _ANY_LIGHT
    ),
    *(
        ProvenCode(bits, _MOST_BY_OPEN_CHIPS, bits.count("1"), bits.count("1"), _TABLE)
        for bits in _BY_OPEN_CHIPS
    ),
    ProvenCode(
        "1110110001101111010111101000101000011010011010001", 52, 26, 26, "docs/proofs/52-26.jsonl"
    ),
)
"""Of any number of open chips, shortest first; of three to 28 open chips; and of 26 open chips of
52."""
