"""Independent check of claimed zeros: integer division, a change of sign, the winding number of
H.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import gcd, pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cep.proofs.verify.sums import Lines, RefusedError, place_in_words

FloatArray = NDArray[np.float64]
_MOST_TURNS = 2**17  # points on a circle


def zero_holds(
    bits: str, zero: Mapping[str, Any], at: FloatArray, lines: Lines, vertices: Any
) -> str:
    """Return the proof of the zero in words; raise RefusedError where there is none.

    Parameters
    ----------
    bits : str
    zero : mapping
        ``kind`` and its data: ``order``, ``factor`` and ``radius``, or ``alone_within``.
    at : (1,) or (2,) float
        Cycles per chip or cycles/px.
    lines : Lines
    vertices : (t, xy), or None in chip units
    """
    kind = zero.get("kind")
    if kind == "kantorovich" and vertices is not None:
        return _encircled(lines, at, float(zero["alone_within"]))
    turns = float(at[0]) if vertices is None else _turns_per_chip(bits, at, *vertices)
    if kind == "root of unity":
        order = int(zero["order"])
        turn = round(turns * order)
        # beyond six times the degree a cyclotomic polynomial is longer than the code's
        if (
            not 2 <= order <= 6 * len(bits)
            or abs(turns - turn / order) > 1e-9
            or gcd(turn, order) != 1
        ):
            raise RefusedError(
                f"{place_in_words(at)} is no primitive root of unity of order {order}"
            )
        if any(_remainder([int(bit) for bit in bits], _cyclotomic(order))):
            raise RefusedError(
                f"the polynomial does not vanish at the roots of unity of order {order}"
            )
        return f"the cyclotomic polynomial of order {order} divides the code's, in integers"
    if kind == "sign change":
        return _crossing(
            bits, [int(value) for value in zero["factor"]], turns, float(zero["radius"])
        )
    if kind == "closed form" and vertices is not None:
        if round(turns) == 0 or abs(turns - round(turns)) > 1e-9:
            raise RefusedError(f"{place_in_words(at)} is no zero of a chip's sinc")
        return "a chip of the straight motion covers a whole number of periods"
    raise RefusedError("a minimum of 0 is claimed without a proof that can be checked")


def _turns_per_chip(bits: str, at: FloatArray, t: FloatArray, xy: FloatArray) -> float:
    """Cycles per chip of a frequency along a straight uniform motion; refuse any other motion."""
    ideal = xy[0] + np.multiply.outer(t, xy[-1] - xy[0])
    if np.abs(ideal - xy).max() > 2e-9 * max(1.0, float(np.abs(xy).max())):
        raise RefusedError("such a zero needs a straight motion of constant speed")
    return abs(float(at @ (xy[-1] - xy[0]))) / len(bits)


def _crossing(bits: str, factor: list[int], turns: float, radius: float) -> str:
    if factor not in (factor[::-1], [-value for value in factor[::-1]]) or abs(factor[-1]) != 1:
        raise RefusedError("the factor is not self-reciprocal")
    if any(_remainder([int(bit) for bit in bits], factor)) or not 0 < radius < 1e-3:
        raise RefusedError("the factor does not divide the code's polynomial")
    places = np.arange(len(factor)) - (len(factor) - 1) / 2
    wave = np.cos if factor[0] == factor[-1] else np.sin
    # a straight motion's frequency is known to a few roundings only
    radius += 1e-12
    edges = [
        sum(value * wave(2 * pi * f * place) for value, place in zip(factor, places, strict=True))
        for f in (turns - radius, turns + radius)
    ]
    slack = 1e-15 * sum(abs(value) for value in factor) * (len(factor) + 10)
    if not (min(edges) < -slack and max(edges) > slack):
        raise RefusedError(f"no change of sign is seen at {turns:.9g} cycles per chip")
    return (
        f"a self-reciprocal factor changes sign within {radius:.1e} of {turns:.9g} cycles per chip"
    )


def _encircled(lines: Lines, at: FloatArray, alone_within: float) -> str:
    """Count how often H turns around 0 on a circle about the point and inside the band."""
    radius = min(0.5 * alone_within, float((0.5 - np.abs(at)).min()) * (1 - 1e-9))
    reach = np.linalg.norm(lines.middle, axis=1) + np.linalg.norm(lines.delta, axis=1)
    steepest = 2 * pi * float(lines.weight @ reach)
    points = 32
    while radius > 1e-12 and points <= _MOST_TURNS:
        angle = 2 * pi * np.arange(points) / points
        value, _ = lines.look(at + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1))
        # between two points H moves by less than its size: the phase cannot slip by a turn
        if (np.abs(value) > steepest * pi * radius / points * 1.01 + lines.slack).all():
            steps = np.angle(np.roll(value, -1) / value)
            if abs(round(float(steps.sum()) / (2 * pi))) >= 1:
                return (
                    f"H turns once around 0 on the circle of {radius:.2e} cycles/px about"
                    f" {place_in_words(at)}"
                )
            raise RefusedError(
                f"H does not turn around 0 near {place_in_words(at)}: no zero there"
            )
        points *= 2
    raise RefusedError(f"the zero at {place_in_words(at)} could not be encircled within the band")


def _cyclotomic(order: int) -> list[int]:
    """Coefficients, lowest first: one prime at a time, Phi_mp(z) = Phi_m(z^p) / Phi_m(z), then z
    -> z^(d / radical).
    """
    coefficients = [-1, 1]
    radical = 1
    unfactored = order
    for prime in range(2, order + 1):
        if unfactored % prime == 0:
            while unfactored % prime == 0:
                unfactored //= prime
            coefficients = _long_division(_spread(coefficients, prime), coefficients)[0]
            radical *= prime
    return _spread(coefficients, order // radical)


def _spread(coefficients: list[int], step: int) -> list[int]:
    out = [0] * ((len(coefficients) - 1) * step + 1)
    out[::step] = coefficients
    return out


def _remainder(dividend: list[int], factor: list[int]) -> list[int]:
    return _long_division(dividend, factor)[1]


def _long_division(dividend: list[int], factor: list[int]) -> tuple[list[int], list[int]]:
    """Quotient and remainder by a polynomial whose leading coefficient is 1 or -1, in Python's
    exact integers.
    """
    remainder = list(dividend)
    quotient = []
    size = len(factor)
    while len(remainder) >= size:
        lead = remainder.pop() * factor[-1]
        quotient.append(lead)
        for place in range(size - 1):
            remainder[len(remainder) - size + 1 + place] -= lead * factor[place]
    return quotient[::-1], remainder
