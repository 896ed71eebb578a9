"""Registry of published shutter codes and classical sequences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from cep.optics.code import ShutterCode

_BITS = {
    "raskar-52": (("raskar2006",), "", "1010000111000001010000110011110111010111001001100111"),
    "merl-32-t64": (("merl2010", "zhang2023dce"), "", "11110001110011010100010010001101"),
    "bdinr-8": (("zhang2024bdinr",), "", "11100101"),
    "merl-31-t62": (("merl2010",), "", "1111101110100110101101110001111"),
    "merl-31-t93": (("merl2010",), "", "1100110011100011101011011111111"),
    "merl-32-t96": (("merl2010",), "", "10011001000101011110011101001001"),
    "merl-50-t850": (("merl2010",), "", "11001111001111001100100001000011111100101000101001"),
    "merl-64-t128": (
        ("merl2010",),
        "",
        "1010100111010100010101010100100100111001110011100010011000111101",
    ),
    "merl-64-t192": (
        ("merl2010",),
        "",
        "1001011010001111100001100111100110010100010010101100101010101101",
    ),
    "barker-13": (("barker1953",), "signs mapped to 0 and 1", "1111100110101"),
}
"""Works, a note, and bits; the second work of merl-32-t64 starts its training from this code."""
CLAIMS: Mapping[str, tuple[int, float]] = MappingProxyType(
    {
        "merl-31-t62": (62, 0.087967),
        "merl-31-t93": (93, 0.081576),
        "merl-32-t64": (64, 0.118593),
        "merl-32-t96": (96, 0.107646),
        "merl-50-t850": (850, 0.055117),
        "merl-64-t128": (128, 0.059397),
        "merl-64-t192": (192, 0.049499),
    }
)
"""Minima that their authors claim, relative to DC, with the points of the DFT they were read
from."""

# hex digits, most significant bit = first chip; the last n bits count
_JEON_HEX = {
    30: "16A3809B",
    40: "6ED109A838",
    50: "02952CB8A2301F",
    60: "0769257A06018B8E",
    70: "2661230C25F85A3554",
    80: "260186CCE097C62AAD2B",
    90: "00733FCFA45A75E02AF092B2",
    100: "0FB14E90234D6C91D5B787A3B9",
    110: "03490F849D2CCFE500CCB9D73F55",
    120: "BE7192BABA931CFA742D801B42E5F3",
    130: "0073E9D0B6006D0B97CE32577752639F4E",
    140: "0FC807BC9964B787C2CA919522842A33AF39",
    150: "011CC82A74E8D5F663BE69680E8FE969823918",
    160: "8C098D191405CBC2E24B3F98EF2F802E596AAF34",
    170: "0166AF63826461899071BD5BACA0B7E1BB0FDA0A6BB5",
    180: "011E755D200EE87C2C789E85219089979468ED49BBED96",
    190: "12CBFD0221072F92F972F0E2660C6192B02D89A2A6B11DC5",
    200: "7302CA07604A05BC6937C5BB2A2AC848B5AED76A600E3F170E",
}
# in hex as well, each in the rotation of largest min |P|: one exposure is not periodic
_M_SEQUENCE_HEX = {
    15: "09AF",
    31: "3A84B3E3",
    63: "64B766AFC10C53D1",
    127: "7438936B7B1A5DCCABF8106147916753",
}
_LEGENDRE_HEX = {31: "62B849DB", 43: "78B8235B29D", 53: "0B81981D769CB7", 61: "19A502967C8EEE27"}


@dataclass(frozen=True)
class PublishedCode:
    """A code with its origin.

    Attributes
    ----------
    works : tuple of str
        Keys of ``cep/files/works.bib``.
    note : str
        How the code comes from them.
    """

    name: str
    code: ShutterCode
    works: tuple[str, ...]
    note: str = ""


def names() -> tuple[str, ...]:
    """Names of all codes, shortest first."""
    return tuple(_REGISTRY)


def published(name: str) -> PublishedCode:
    """Look up a code by name; ValueError, which lists the names, if there is none."""
    if name not in _REGISTRY:
        raise ValueError(f"name: no published code {name!r}; there are {', '.join(names())}")
    return _REGISTRY[name]


def for_chips(chips: int) -> tuple[PublishedCode, ...]:
    """All codes of ``chips`` chips."""
    return tuple(entry for entry in _REGISTRY.values() if entry.code.chips == chips)


def _listed() -> list[PublishedCode]:
    entries = [
        PublishedCode(name, ShutterCode(bits), works, note)
        for name, (works, note, bits) in _BITS.items()
    ]
    families = (
        ("jeon", ("jeon2013",), "", _JEON_HEX),
        ("m-sequence", ("golomb1967",), "", _M_SEQUENCE_HEX),
        ("legendre", ("gottesman1989",), "Legendre sequence", _LEGENDRE_HEX),
    )
    for family, works, note, hex_by_chips in families:
        for chips, digits in hex_by_chips.items():
            bits = f"{int(digits, 16):0{chips}b}"[-chips:]
            entries.append(PublishedCode(f"{family}-{chips}", ShutterCode(bits), works, note))
    # shortest first, as tables and messages list them
    return sorted(entries, key=lambda entry: (entry.code.chips, entry.name))


_REGISTRY = {entry.name: entry for entry in _listed()}
PUBLISHED: Mapping[str, ShutterCode] = MappingProxyType(
    {name: entry.code for name, entry in _REGISTRY.items()}
)
"""Codes by name."""
