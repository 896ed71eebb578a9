"""Registry of published shutter codes and classical sequences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from types import MappingProxyType

import numpy as np

from cep.optics.code import ShutterCode
from cep.proofs.certify.minimum import min_chip

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

DCE_CODE = ShutterCode("11000001010011111111010010001100")
"""One code for all motions, learned with a restoration network after Zhang et al., DCE, Photonics
Research 2023.

The paper publishes no code: this one comes from our training (``lab/trainings/dce``) and is no
entry of the registry.
"""

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
# primitive polynomials x^a + x^b + 1 over GF(2), by the period 2^a - 1
_TAPS = {15: (4, 3), 31: (5, 3), 63: (6, 5), 127: (7, 6)}
_PRIMES = (31, 43, 53, 61)


@dataclass(frozen=True)
class PublishedCode:
    """A code with its origin.

    Attributes
    ----------
    name : str
    code : ShutterCode
    works : tuple of str
        Keys of ``cep/files/works.bib``.
    note : str
        How the code comes from them.
    periodic : bool
        Whether each of its rotations is the same sequence; the best one is taken.
    """

    name: str
    code: ShutterCode
    works: tuple[str, ...]
    note: str = ""
    periodic: bool = False


def names() -> tuple[str, ...]:
    """Names of all codes, shortest first."""
    return tuple(_registry())


def published(name: str) -> PublishedCode:
    """Look up a code by name.

    Raises
    ------
    ValueError
        If there is none; the line lists the names.
    """
    if name not in _registry():
        raise ValueError(f"name: no published code {name!r}; there are {', '.join(names())}")
    return _rotated(name)


def published_works(name: str) -> tuple[str, ...]:
    """Keys of the works that a code comes from, without the search of its best rotation."""
    return _registry()[name].works


def for_chips(chips: int) -> tuple[PublishedCode, ...]:
    """All codes of ``chips`` chips."""
    return tuple(
        _rotated(name) for name, entry in _registry().items() if entry.code.chips == chips
    )


def m_sequence(chips: int) -> ShutterCode:
    """Maximum-length sequence of 15, 31, 63 or 127 chips; its shift register starts all ones."""
    if chips not in _TAPS:
        raise ValueError(
            f"chips: m-sequences of 15, 31, 63 or 127 chips are known here, got {chips}"
        )
    first, second = _TAPS[chips]
    register = [1] * first
    bits = []
    for _ in range(chips):
        bits.append(str(register[-1]))
        register = [register[first - 1] ^ register[second - 1], *register[:-1]]
    return ShutterCode("".join(bits))


def legendre(prime: int) -> ShutterCode:
    """Legendre sequence: chip i is open if i is 0 or a square modulo the odd ``prime``."""
    if prime < 3 or any(prime % divisor == 0 for divisor in range(2, int(prime**0.5) + 1)):
        raise ValueError(f"prime: must be an odd prime, got {prime}")
    squares = {i * i % prime for i in range(prime)}  # 0 among them
    return ShutterCode([i in squares for i in range(prime)])


def best_rotation(code: ShutterCode) -> ShutterCode:
    """Rotation of largest minimum |P|: one exposure is not periodic, so rotations differ."""
    rotations = [
        ShutterCode(code.bits[i:] + code.bits[:i], code.chip_ns) for i in range(code.chips)
    ]
    values = np.array([min_chip(rotation) for rotation in rotations])
    # values of rotations that are mirror images agree only up to rounding
    return rotations[int(np.flatnonzero(values >= values.max() * (1 - 1e-9))[0])]


@cache
def _registry() -> Mapping[str, PublishedCode]:
    """All codes by name; periodic sequences as they are defined."""
    entries = [
        PublishedCode(name, ShutterCode(bits), keys, note)
        for name, (keys, note, bits) in _BITS.items()
    ]
    for n, digits in _JEON_HEX.items():
        bits = f"{int(digits, 16):0{4 * len(digits)}b}"[-n:]  # leading zeros count as chips
        entries.append(PublishedCode(f"jeon-{n}", ShutterCode(bits), ("jeon2013",)))
    for n in _TAPS:
        entries.append(
            PublishedCode(f"m-sequence-{n}", m_sequence(n), ("golomb1967",), periodic=True)
        )
    for prime in _PRIMES:
        entries.append(
            PublishedCode(
                f"legendre-{prime}",
                legendre(prime),
                ("gottesman1989",),
                "Legendre sequence",
                periodic=True,
            )
        )
    # shortest first, as tables and messages list them
    entries.sort(key=lambda entry: (entry.code.chips, entry.name))
    return MappingProxyType({entry.name: entry for entry in entries})


@cache
def _rotated(name: str) -> PublishedCode:
    """Return the entry of a name, a periodic sequence in its best rotation."""
    entry = _registry()[name]
    if entry.periodic:
        return replace(entry, code=best_rotation(entry.code))
    return entry


class _LazyCodes(Mapping[str, ShutterCode]):
    """The registry as name -> code; rotations are searched on first use, not on import."""

    def __getitem__(self, name: str) -> ShutterCode:
        return _rotated(name).code

    def __iter__(self) -> Iterator[str]:
        return iter(_registry())

    def __len__(self) -> int:
        return len(_registry())


PUBLISHED: Mapping[str, ShutterCode] = _LazyCodes()
