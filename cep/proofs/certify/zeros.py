"""Proven zeros of a code: exact on the unit circle, by Newton-Kantorovich along a curved path.

A zero of the code's 0/1 polynomial on the circle is shared with the reversed polynomial, so it
divides the greatest common divisor of the two: a product of cyclotomic polynomials (roots of
unity), times a self-reciprocal rest. On the circle the rest is a real function but for its phase,
whose zeros are changes of sign. All of that is decided in integers.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from math import ceil, gcd
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cep.optics.band import in_band
from cep.optics.code import ShutterCode
from cep.optics.exposure import open_path
from cep.optics.straight_motion import straight_axis, uniform_length_px
from cep.proofs.certify.taylor import Pieces, first_cells, floors, jets, pieces_of_path
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

IntArray = NDArray[np.int64]
_PRIME = 2**31 - 1  # products of its residues fit 64 bits
_CELLS = 200_000  # looked at; if more were needed, the list is not proven to be complete
_NEWTON = 8  # steps: each doubles the right digits, and a start close enough needs five
_TRIED = 2000  # cells from which zeros are still looked for when the budget is spent
_MOST_H = 0.49  # of the theorem's 1/2: a margin for rounding


@dataclass(frozen=True)
class Zero:
    """A frequency at which H is exactly zero, with its proof.

    Attributes
    ----------
    at : tuple of float
        Cycles per chip, or (fx, fy) in cycles/px: the zero lies within ``radius`` of it.
    kind : str
        "root of unity", "sign change", "closed form" (of a straight motion's chip) or
        "kantorovich".
    radius : float
        0 for a root of unity at the fraction ``at`` rounded.
    alone_within : float
        No other zero lies this close; 0 where this is not known.
    order : int
        Of the root of unity, else 0.
    factor : tuple of int
        "sign change": the self-reciprocal factor of the code's polynomial that changes sign,
        lowest degree first.
    """

    at: tuple[float, ...]
    kind: str
    radius: float = 0.0
    alone_within: float = 0.0
    order: int = 0
    factor: tuple[int, ...] = ()

    @property
    def method(self) -> str:
        """Name of the proof in a certificate."""
        if self.order:
            return f"root of unity of order {self.order}"
        return f"zero proven ({self.kind})"

    def to_dict(self) -> dict[str, Any]:
        """Fields for JSON."""
        return asdict(self)


@dataclass(frozen=True)
class Zeros:
    """Proven zeros.

    Attributes
    ----------
    found : tuple of Zero
        One of each pair f, -f; in order of frequency.
    complete : bool
        Whether it is proven that there are no others.
    """

    found: tuple[Zero, ...]
    complete: bool


@lru_cache(maxsize=256)
def zeros_of_code(bits: str) -> Zeros:
    """All zeros of a code's polynomial on the unit circle, 0..1/2 cycles per chip, exactly.

    Examples
    --------
    >>> [(zero.at, zero.order) for zero in zeros_of_code("111").found]
    [((0.3333333333333333,), 3)]
    >>> zeros_of_code("1101").found
    ()
    """
    # closed chips at the ends only shift the phase; circle_rest needs both ends open
    chips = np.array([int(bit) for bit in bits.strip("0")], dtype=np.int64)
    zeros = [
        Zero((turn / order,), "root of unity", order=order)
        for order in vanishing_orders(chips)
        for turn in range(1, order // 2 + 1)
        if gcd(turn, order) == 1
    ]
    complete = False
    cofactor = circle_rest(chips)
    if cofactor is not None:
        changes, complete = sign_changes(cofactor)
        zeros += changes
    return Zeros(tuple(sorted(zeros, key=lambda zero: zero.at)), complete)


def zeros_along(trajectory: Trajectory, code: ShutterCode, *, budget: int = 200_000) -> Zeros:
    """All zeros of H in the band along a trajectory taken as given, fy >= 0.

    Every cell of a subdivision either keeps away from zero, or lies within the ball in which the
    Newton-Kantorovich theorem allows one zero only. A straight motion's zeros are lines across it:
    their points on its axis are listed. After ``budget`` cells the claim to be complete is given
    up.
    """
    if uniform_length_px(trajectory) is not None:
        return _straight_zeros(trajectory, code)
    if straight_axis(trajectory) is not None:
        return Zeros((), complete=False)
    pieces = pieces_of_path(open_path(trajectory, code))
    corners = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    cells, half = first_cells(pieces)
    zeros: list[Zero] = []
    complete = True
    while len(cells):
        if len(cells) > budget:
            # no time for all: only those that Newton's iteration reaches from some of the cells
            points = _newton(pieces, cells[:: max(1, len(cells) // _TRIED)])
            zeros = _joined(zeros, [zero for zero in points if _place_in(pieces.box, zero)])
            complete = False
            break
        budget -= len(cells)
        jet = jets(pieces, cells)
        keep = floors(pieces, jet, half) <= 0
        cells = cells[keep]
        jet = jet[keep]
        _, alone_within = _radii(pieces, jet)
        settled = alone_within > float(np.hypot(*half))
        proven = [(zero, _place_in(pieces.box, zero)) for zero in _newton(pieces, cells[settled])]
        # in each settled cell at most one zero may lie: a cell without one has not been explained
        complete &= len(proven) == settled.sum() and all(place is not None for _, place in proven)
        zeros = _joined(zeros, [zero for zero, place in proven if place])
        half = half / 2
        cells = (cells[~settled][:, None] + half * corners).reshape(-1, 2)
    return Zeros(tuple(sorted(zeros, key=lambda zero: zero.at)), complete)


def kantorovich(pieces: Pieces, point: FloatArray) -> Zero | None:
    """Prove a zero of H beside a refined point (2,), in the box; None where that fails.

    References
    ----------
    Ortega, "The Newton-Kantorovich theorem", American Mathematical Monthly 75, 1968: with the
    Jacobian J at the point, a Lipschitz constant L of the derivative, ``eta = |J^-1 H|`` and ``h =
    |J^-1| L eta <= 1/2``, a zero lies within ``(1 - sqrt(1 - 2 h)) / (|J^-1| L)`` and no other
    within ``(1 + sqrt(1 - 2 h)) / (|J^-1| L)``.
    """
    proven = _newton(pieces, point[None])
    return next((zero for zero in proven if _place_in(pieces.box, zero)), None)


def _radii(pieces: Pieces, jet: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Radii (F,) that hold a zero, infinite where none is proven, and that hold no other."""
    # second derivatives of H are at most (2 pi)^2 times the second moment of the open path
    lipschitz = 4 * np.pi**2 * float(np.linalg.eigvalsh(pieces.moment)[-1])
    residual = np.hypot(jet[:, 0], jet[:, 1]) + pieces.slack
    # smallest singular value of the 2 x 2 Jacobian, less what rounding may have added
    squares = (jet[:, 2:] ** 2).sum(axis=1)
    determinant = np.abs(jet[:, 2] * jet[:, 5] - jet[:, 3] * jet[:, 4])
    largest = np.sqrt((squares + np.sqrt(np.maximum(squares**2 - 4 * determinant**2, 0))) / 2)
    smallest = determinant / np.maximum(largest, 1e-300)
    smallest = np.maximum(smallest - 4 * pieces.gradient_slack - 1e-12 * largest, 1e-100)
    h = lipschitz * residual / smallest**2
    root = np.sqrt(np.maximum(1 - 2 * h, 0))
    # (1 - root) / (K) with K = lipschitz / smallest, written without cancellation
    inner = np.where(h <= _MOST_H, 2 * residual / (smallest * (1 + root)), np.inf)
    return inner, np.where(h <= _MOST_H, (1 + root) * smallest / lipschitz, 0.0)


def _newton(pieces: Pieces, points: FloatArray) -> list[Zero]:
    """Zeros that Newton's iteration reaches from (F, 2) points and the theorem proves."""
    if not len(points):
        return []
    points = points.copy()
    for _ in range(_NEWTON):
        jet = jets(pieces, points)
        determinant = jet[:, 2] * jet[:, 5] - jet[:, 3] * jet[:, 4]
        determinant = np.where(determinant == 0, np.inf, determinant)
        points[:, 0] -= (jet[:, 5] * jet[:, 0] - jet[:, 4] * jet[:, 1]) / determinant
        points[:, 1] -= (jet[:, 2] * jet[:, 1] - jet[:, 3] * jet[:, 0]) / determinant
        np.clip(points, -1, 1, out=points)
    radius, alone_within = _radii(pieces, jets(pieces, points))
    return [
        Zero((float(f[0]), float(f[1])), "kantorovich", float(r), float(a))
        for f, r, a in zip(points, radius, alone_within, strict=True)
        if np.isfinite(r)
    ]


def _place_in(box: FloatArray, zero: Zero) -> bool | None:
    """Whether the zero lies in the box; None where it is too close to the edge to tell."""
    edge = float((0.5 - np.abs(np.array(zero.at))).min())
    if abs(edge) <= zero.radius:
        return None
    # just below fy = 0 lies the mirror image of a zero just above
    return edge > 0 and zero.at[1] >= box[1, 0] - max(zero.alone_within, zero.radius)


def _joined(zeros: list[Zero], more: list[Zero]) -> list[Zero]:
    """Add the zeros that are not in the list yet: neighbouring cells find the same ones."""
    for zero in more:
        if not any(_same(zero, known_zero) for known_zero in zeros):
            zeros = [*zeros, zero]
    return zeros


def _same(a: Zero, b: Zero) -> bool:
    place_a = np.array(a.at)
    place_b = np.array(b.at)
    # H(-f) is the conjugate of H(f): a zero and its mirror image are one
    apart = min(np.linalg.norm(place_a - place_b), np.linalg.norm(place_a + place_b))
    return bool(apart < max(a.alone_within, b.alone_within))


def _straight_zeros(trajectory: Trajectory, code: ShutterCode) -> Zeros:
    """|H| is |sinc(s) P(s)| / n along the axis, s in cycles per chip."""
    axis = straight_axis(trajectory)
    length_px = uniform_length_px(trajectory)
    assert axis is not None
    assert length_px is not None
    per_chip = code.chips / length_px
    reach = 0.5 * float(np.abs(axis).sum()) / per_chip
    of_code = zeros_of_code(code.bits)
    zeros: dict[float, Zero] = {}
    for cycle in range(ceil(reach) + 1):
        turns = [(float(cycle), Zero((), "closed form"))]
        turns += [(cycle + sign * zero.at[0], zero) for zero in of_code.found for sign in (1, -1)]
        # half a cycle is its own mirror image
        zeros |= {round(turn, 12): zero for turn, zero in turns if 0 < turn <= reach}
    listed = [
        replace(zero, at=in_band(turn * per_chip, axis), radius=zero.radius * per_chip)
        for turn, zero in sorted(zeros.items())
    ]
    return Zeros(tuple(listed), of_code.complete)


# -- zeros on the unit circle, in integer arithmetic ----------------------------------------------


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

    The coefficients (m,) are those of a 0/1 polynomial, lowest degree first, the first and the
    last not 0. The factor is self-reciprocal up to sign and an exact divisor; None where it could
    not be found.
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
    """Real function (F,) of a self-reciprocal factor, its slope (F,), and its rounding error.

    ``cycles`` (F,) are cycles per chip.
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


def sign_changes(factor: IntArray) -> tuple[tuple[Zero, ...], bool]:
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


def _bisected(factor: IntArray, low: float, high: float) -> Zero | None:
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
            return Zero((at,), "sign change", radius, factor=tuple(factor.tolist()))
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
