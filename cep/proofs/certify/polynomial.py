"""Exact zeros of a code's 0/1 polynomial on the unit circle, in integer arithmetic.

A zero on the circle is shared with the reversed polynomial, so it divides the greatest common
divisor of the two: a product of cyclotomic polynomials (roots of unity), times a self-reciprocal
rest. On the circle the rest is a real function but for its phase, whose zeros are changes of sign.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motdiff.types import FloatArray

IntArray = NDArray[np.int64]
_PRIME = 2**31 - 1  # products of its residues fit 64 bits
_CELLS = 200_000  # looked at; if more were needed, the list is not proven to be complete


@dataclass(frozen=True)
class SignChange:
    """A frequency, cycles per chip, within whose ``radius`` a real function changes sign."""

    at: float
    radius: float


def vanishing_orders(coefficients: IntArray) -> tuple[int, ...]:
    """Orders d of the roots of unity at which an integer polynomial vanishes, in rising order.

    Coefficients come lowest degree first.

    Examples
    --------
    >>> vanishing_orders(np.ones(6, dtype=np.int64))
    (2, 3, 6)
    """
    degree = len(coefficients) - 1
    # phi(d) <= degree, and phi(d) > d / 6 for every d up to 500,000
    orders = (d for d, phi in enumerate(_totients(6 * degree + 6)) if 0 < phi <= degree)
    return tuple(d for d in orders if divisible(coefficients, d))


def divisible(coefficients: IntArray, order: int) -> bool:
    """Whether the cyclotomic polynomial of ``order`` divides, decided in integers.

    It does exactly if ``z^d - 1`` divides the product with ``z^(d/p) - 1`` over the primes p of d:
    those contain every other factor of ``z^d - 1``, and never this one.
    """
    # modulo z^d - 1 exponents are equal that differ by d
    remainder = np.zeros(order, dtype=np.int64)
    np.add.at(remainder, np.arange(len(coefficients)) % order, coefficients)
    for prime in _primes_of(order):
        remainder = np.roll(remainder, order // prime) - remainder
    return not remainder.any()


def divided(coefficients: IntArray, order: int) -> IntArray:
    """Quotient by the cyclotomic polynomial of ``order`` > 1, which must divide."""
    # Phi_d is the product of (1 - z^(d/e))^mu(e) over the squarefree e: as power series, shifts
    # and running sums
    quotient = coefficients.copy()
    squarefree = [(1, 1)]
    for prime in _primes_of(order):
        squarefree += [(e * prime, -sign) for e, sign in squarefree]
    for e, sign in squarefree:
        step = order // e
        if sign > 0:
            for start in range(min(step, len(quotient))):
                quotient[start::step] = np.cumsum(quotient[start::step])
        else:
            quotient[step:] = quotient[step:] - quotient[:-step]
    return np.trim_zeros(quotient, "b")


def circle_rest(coefficients: IntArray) -> IntArray | None:
    """Factor with every zero on the circle that is no root of unity; (1,) where there is none.

    Parameters
    ----------
    coefficients : (m,) int
        0/1 polynomial, lowest degree first, first and last coefficient not 0.

    Returns
    -------
    (r,) int, self-reciprocal up to sign and an exact divisor, or None where it could not be found.
    """
    cofactor = coefficients
    for order in vanishing_orders(coefficients):
        while divisible(cofactor, order):
            cofactor = divided(cofactor, order)
    if len(cofactor) == 1:
        return np.ones(1, dtype=np.int64)
    if _is_reciprocal(cofactor):
        return cofactor
    # modulo a prime the divisor's degree can only grow: what is 1 there is 1
    common = _gcd(cofactor % _PRIME, cofactor[::-1] % _PRIME)
    if len(common) == 1:
        return np.ones(1, dtype=np.int64)
    # back to integers of either sign; that they divide is then checked without the prime
    lifted = np.where(common > _PRIME // 2, common - _PRIME, common)
    if _is_reciprocal(lifted) and _divides(lifted, cofactor):
        return lifted
    return None


def _is_reciprocal(coefficients: IntArray) -> bool:
    """Whether a polynomial is its own reverse, up to the sign."""
    mirrored = coefficients[::-1]
    return np.array_equal(coefficients, mirrored) or np.array_equal(coefficients, -mirrored)


def real_form(factor: IntArray, cycles: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Real function of a self-reciprocal factor on the circle, its slope, and its rounding error.

    Parameters
    ----------
    factor : (m,) int
    cycles : (F,) float
        Frequencies, cycles per chip.
    """
    middle = np.arange(len(factor)) - 0.5 * (len(factor) - 1)
    # half-turns are exact in floating point, so the phase is reduced before pi comes in
    turns = np.multiply.outer(cycles, middle)
    phase = 2 * np.pi * (turns - np.rint(turns))
    weights = factor.astype(np.float64)
    slack = 2.0**-53 * float(np.abs(weights).sum()) * (40 * len(factor) + 100)
    if factor[0] == factor[-1]:
        return np.cos(phase) @ weights, -2 * np.pi * np.sin(phase) @ (weights * middle), slack
    return np.sin(phase) @ weights, 2 * np.pi * np.cos(phase) @ (weights * middle), slack


def sign_changes(factor: IntArray) -> tuple[tuple[SignChange, ...], bool]:
    """All changes of sign of a self-reciprocal factor, and whether these are all its zeros.

    On every cell of 0..1/2 cycles per chip the function either keeps away from zero or is
    monotone, by its value, slope and curvature.
    """
    if len(factor) < 2:
        return (), True
    middle = np.arange(len(factor)) - 0.5 * (len(factor) - 1)
    # of the second derivative: each term cos(2 pi f m) has at most (2 pi m)^2
    bend = 4 * np.pi**2 * float(np.abs(factor) @ middle**2)
    centres = (np.arange(4 * len(factor)) + 0.5) / (8 * len(factor))
    half = 1 / (16 * len(factor))
    changes = []
    looked = 0
    while centres.size and looked < _CELLS and half > 1e-13:
        looked += centres.size
        value, slope, slack = real_form(factor, centres)
        reach = np.abs(slope) * half + 0.5 * bend * half**2 + slack
        may_vanish = np.abs(value) <= reach
        monotone = np.abs(slope) > bend * half + slack * 2 * np.pi * len(factor)
        below = real_form(factor, centres - half)[0]
        above = real_form(factor, centres + half)[0]
        crosses = (below > 0) != (above > 0)
        for centre in centres[may_vanish & monotone & crosses]:
            changes.append(_bisected(factor, float(centre - half), float(centre + half)))
        centres = centres[may_vanish & ~monotone]
        half /= 2
        centres = np.concatenate([centres - half, centres + half])
    proven = tuple(change for change in changes if change is not None)
    return proven, not centres.size and len(proven) == len(changes)


def _bisected(factor: IntArray, low: float, high: float) -> SignChange | None:
    """Halve an interval 60 times, to the last digit, then widen it until both signs are sure."""
    rising = real_form(factor, np.array([high]))[0][0] > 0
    for _ in range(60):
        middle = 0.5 * (low + high)
        if (real_form(factor, np.array([middle]))[0][0] > 0) == rising:
            high = middle
        else:
            low = middle
    at = 0.5 * (low + high)
    radius = 1e-14
    while radius < 1e-3:
        edges, _, slack = real_form(factor, np.array([at - radius, at + radius]))
        if abs(edges[0]) > slack and abs(edges[1]) > slack and (edges[0] > 0) != (edges[1] > 0):
            return SignChange(at, radius)
        radius *= 2
    return None


def _primes_of(number: int) -> list[int]:
    primes = []
    divisor = 2
    while divisor * divisor <= number:
        if number % divisor == 0:
            primes.append(divisor)
            while number % divisor == 0:
                number //= divisor
        divisor += 1
    if number > 1:
        primes.append(number)
    return primes


def _totients(limit: int) -> list[int]:
    phi = np.arange(limit + 1)
    for prime in range(2, limit + 1):
        if phi[prime] == prime:
            phi[prime::prime] -= phi[prime::prime] // prime
    return [int(value) for value in phi]


def _gcd(a: IntArray, b: IntArray) -> IntArray:
    """Monic greatest common divisor modulo the prime, lowest degree first."""
    while b.size:
        b = b * pow(int(b[-1]), -1, _PRIME) % _PRIME
        remainder = a.copy()
        while remainder.size >= b.size:
            offset = remainder.size - b.size
            remainder[offset:] = (remainder[offset:] - remainder[-1] * b) % _PRIME
            remainder = np.trim_zeros(remainder, "b")
        a = b
        b = remainder
    return np.asarray(a * pow(int(a[-1]), -1, _PRIME) % _PRIME, dtype=np.int64)


def _divides(factor: IntArray, dividend: IntArray) -> bool:
    """Whether a monic factor divides, by long division in Python's unbounded integers."""
    remainder = [int(v) for v in dividend]
    divisor = [int(v) for v in factor]
    while len(remainder) >= len(divisor):
        lead = remainder.pop()
        offset = len(remainder) + 1 - len(divisor)
        for place, coefficient in enumerate(divisor[:-1]):
            remainder[offset + place] -= lead * coefficient
    return not any(remainder)
