"""Independent check of a certificate: plain and slow, sharing no code with its making.

It uses only numpy and the certificate's data. Values are summed directly from the path's vertices.
The lower bound is checked by its own subdivision into cells of half-sides h and circumradius r, on
which

    |H|  >=  |H0| - sum_i h_i |d|H|/df_i| - r^2 / 2 (2 pi)^2 lambda,

lambda the larger principal moment of the open path; zeros by integer division, a change of sign,
or the winding number of H around them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import gcd, pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Vertices = tuple[FloatArray, FloatArray]
"""Times (T,) from 0 to 1, and vertices (T, 2) in px, of a path."""
_CHUNK = 2**19  # numbers held at once: a few arrays of 8 MB, of twice as many around a zero
_SERIES = 1e-3  # rad, below which sinc's slope by its quotient loses six digits or more
_TOLERANCE = 1e-9  # relative, on both bounds: numbers in a file may have been rounded
_SAME_PLACE = 1e-9  # cycles or px: as above, of a frequency and of a path
_MOST_TURNS = 2**20  # points on a circle around a zero, beyond which it is not confirmed
# |H(-f)| = |H(f)|, as codes are real: half of the circle and of the band is enough
_CIRCLE = np.array([[0.0, 0.5], [0.0, 0.0]])  # cycles per chip
_BAND = np.array([[-0.5, 0.5], [0.0, 0.5]])  # cycles/px
_CORNERS = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])


@dataclass(frozen=True)
class Verdict:
    """Outcome of a check.

    Attributes
    ----------
    holds : bool
        Whether every claim was confirmed.
    reasons : tuple of str
        One line per check: the confirmed claim, or the reason why it was not confirmed.
    """

    holds: bool
    reasons: tuple[str, ...]

    def __bool__(self) -> bool:
        return self.holds


def verify(
    certificate: Any,
    *,
    bits: str | None = None,
    path: tuple[Sequence[float], Sequence[Sequence[float]]] | None = None,
    budget: int = 400_000,
) -> Verdict:
    """Check a certificate of a code's minimum from scratch.

    Parameters
    ----------
    certificate : mapping, or an object whose ``to_dict()`` is one
        As in ``code.json``: ``unit``, ``lower``, ``upper``, ``at``; ``zero`` where 0 is claimed;
        ``trajectory`` with ``t``, ``x``, ``y``; ``directions``; ``bits``.
    bits : str, optional
        The code that it must be about, as 0 and 1; the one that it names when omitted.
    path : (t, xy), optional
        Times (T,) from 0 to 1 and vertices (T, 2), px, where it does not hold them itself.
    budget : int
        Largest number of frequencies; a check that needs more counts as not confirmed.

    Examples
    --------
    A minimum of one chip at half a cycle per chip is claimed, and too high: the true one is
    0.91277.

    >>> claim = {"unit": "chips", "bits": "11100101", "lower": 0.95, "upper": 1.0, "at": [0.5]}
    >>> bool(verify(claim)), bool(verify(claim | {"lower": 0.9}))
    (False, True)
    """
    reasons: list[str] = []
    try:
        claim = certificate if isinstance(certificate, Mapping) else certificate.to_dict()
        _check(claim.get("bits", "") if bits is None else bits, claim, path, budget, reasons)
    except RefusedError as refusal:
        return Verdict(False, (*reasons, str(refusal)))
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        return Verdict(
            False, (*reasons, f"the certificate cannot be read ({type(error).__name__}: {error})")
        )
    return Verdict(True, tuple(reasons))


class RefusedError(Exception):
    """A claim does not hold; the message says why."""


def require(condition: bool, refusal: str) -> None:
    """Refuse the claim where a condition does not hold."""
    if not condition:
        raise RefusedError(refusal)


def _check(
    bits: str, claim: Mapping[str, Any], path: Any, budget: int, reasons: list[str]
) -> None:
    require(bool(bits) and "1" in bits and not set(bits) - {"0", "1"}, "the bits are no code")
    require(claim.get("bits", bits) == bits, "the certificate is about another code")
    lower = float(claim["lower"])
    upper = float(claim["upper"])
    unit = claim["unit"]
    at = np.array([float(value) for value in claim["at"]])
    # as "between", so that a bound that is no number fails too
    require(0 <= lower <= upper < np.inf, f"the bounds {lower:g} .. {upper:g} are no interval")
    vertices = None
    if unit == "chips":
        is_number = at.shape == (1,) and bool(np.isfinite(at).all())
        require(is_number, "a frequency in chip units is one number")
        lines_by_direction = {"forward": chip_lines(bits)}
        box = _CIRCLE
    else:
        require(unit == "light-true", f"the unit {unit!r} is unknown")
        inside = at.shape == (2,) and bool((np.abs(at) <= 0.5 + 1e-12).all())
        require(inside, "the frequency lies outside the band")
        t, xy = vertices = _vertices(claim.get("trajectory"), path)
        paths = {"forward": (t, xy), "backward": (1 - t[::-1], xy[::-1])}
        listed = tuple(claim.get("directions", paths))
        require(bool(listed) and not set(listed) - set(paths), "the directions are unknown")
        lines_by_direction = {name: path_lines(bits, *paths[name]) for name in listed}
        box = _BAND
    direction = claim.get("direction", next(iter(lines_by_direction)))
    covered = direction in lines_by_direction
    require(covered, "the direction of the minimum is not among those covered")
    lines = lines_by_direction[direction]
    value = abs(lines.look(np.pad(at, (0, 2 - at.size))[None])[0][0])
    if upper == 0:
        reasons.append(_zero_holds(bits, claim.get("zero") or {}, at, lines, vertices))
        return
    attained = f"|H| at {place_in_words(at)} is {value:.9g}"
    require(
        value <= upper * (1 + _TOLERANCE) + 2 * lines.slack,
        f"{attained}, above the upper bound {upper:.9g}",
    )
    reasons.append(f"{attained}, not above the upper bound")
    if lower == 0:
        reasons.append("no lower bound above 0 is claimed")
        return
    for name, directed in lines_by_direction.items():
        # open chips may lie on a straight stretch one way and on a bend the other: each way has
        # its own frequencies
        looked = _nothing_below(*on_axis(directed, box), lower * (1 - _TOLERANCE), budget)
        reasons.append(
            f"{name}, nothing lies below the lower bound {lower:.9g} ({looked} frequencies)"
        )


def _vertices(stored: Any, path: Any) -> Vertices:
    """Read the path from the certificate, from outside it, or from both if they agree."""
    paths = []
    if stored is not None:
        xy = np.stack([np.array(stored[axis], float) for axis in "xy"], axis=1)
        paths.append((np.array(stored["t"], float), xy))
    if path is not None:
        paths.append((np.array(path[0], float), np.array(path[1], float)))
    require(bool(paths), "the certificate does not hold its trajectory, and none was given")
    agree = all(
        a.shape == b.shape and np.allclose(a, b, rtol=0, atol=_SAME_PLACE, equal_nan=True)
        for a, b in zip(paths[0], paths[-1], strict=True)
    )
    require(agree, "the certificate is about another trajectory")
    t, xy = paths[0]
    rises = len(t) > 1 and bool((np.diff(t) > 0).all() and t[0] == 0 and t[-1] == 1)
    rises = rises and xy.shape == (len(t), 2)
    require(rises, "the trajectory's times do not rise from 0 to 1")
    require(bool(np.isfinite(xy).all()), "the trajectory's places are not finite")
    return t, xy


def _nothing_below(lines: Lines, box: FloatArray, level: float, budget: int) -> int:
    """Subdivide the box until no cell can hold less than ``level``; returns the work."""
    sides = np.ptp(box, axis=1)
    active = sides > 0
    # four cells in a period of the fastest wave, 1 / spread: larger ones settle nothing
    counts = np.where(active, np.ceil(4 * sides * max(2.0, lines.spread)), 1).astype(int)
    half = sides / counts / 2
    axes = [box[k, 0] + half[k] * (2 * np.arange(counts[k]) + 1) for k in (0, 1)]
    cells = np.array(np.meshgrid(*axes, indexing="ij")).reshape(2, -1).T
    signs = np.unique(_CORNERS * active, axis=0)
    looked = 0
    while len(cells):
        looked += len(cells)
        require(
            looked <= budget,
            f"the lower bound {level:.9g} could not be confirmed with {budget} frequencies",
        )
        size, loss = lines.bound_cells(cells, half, active)
        at = place_in_words(cells[size.argmin()][active])
        require(
            size.min() >= level - lines.slack,
            f"|H| at {at} is {size.min():.9g}, below the lower bound {level:.9g}",
        )
        # the gradient that enters the loss is rounded as well, the more the wider the path
        slack = lines.slack * (1 + 10 * lines.spread * float(np.hypot(*half)))
        cells = cells[size - loss - slack < level]
        # once rounding outweighs the cell's size, smaller cells decide nothing
        require(
            not len(cells) or loss.max() >= slack,
            f"the lower bound {level:.9g} is too close to the minimum for double precision",
        )
        half = half / 2
        cells = (cells[:, None] + signs * half).reshape(-1, 2)
    return looked


def _zero_holds(
    bits: str, zero: Mapping[str, Any], at: FloatArray, lines: Lines, vertices: Vertices | None
) -> str:
    """Return the proof of the zero in words; ``vertices`` are None in chip units."""
    kind = zero.get("kind")
    if kind == "kantorovich" and vertices is not None:
        return _encircled(lines, at, float(zero["alone_within"]))
    turns = _turns_per_chip(bits, at, vertices)
    if kind == "root of unity":
        order = int(zero["order"])
        turn = round(turns * order)
        require(
            # beyond six times the degree a cyclotomic polynomial is longer than the code's
            2 <= order <= 6 * len(bits)
            and abs(turns - turn / order) <= _SAME_PLACE
            and gcd(turn, order) == 1,
            f"{place_in_words(at)} is no primitive root of unity of order {order}",
        )
        require(
            not any(_long_division([int(bit) for bit in bits], _cyclotomic(order))[1]),
            f"the polynomial does not vanish at the roots of unity of order {order}",
        )
        return f"the cyclotomic polynomial of order {order} divides the code's, in integers"
    if kind == "sign change":
        factor = [int(value) for value in zero["factor"]]
        return _crossing(bits, factor, turns, float(zero["radius"]))
    if kind == "closed form" and vertices is not None:
        is_period = round(turns) != 0 and abs(turns - round(turns)) <= _SAME_PLACE
        require(is_period, f"{place_in_words(at)} is no zero of a chip's sinc")
        return "a chip of the straight motion covers a whole number of periods"
    raise RefusedError("a minimum of 0 is claimed without a proof that can be checked")


def _turns_per_chip(bits: str, at: FloatArray, vertices: Vertices | None) -> float:
    """Cycles per chip of a frequency; of paths, straight uniform motions alone have such."""
    if vertices is None:
        return float(at[0])
    t, xy = vertices
    ideal = xy[0] + np.multiply.outer(t, xy[-1] - xy[0])
    bend = float(np.abs(ideal - xy).max())
    straight = bend <= 2 * _SAME_PLACE * max(1.0, float(np.abs(xy).max()))
    require(straight, "such a zero needs a straight motion of constant speed")
    return abs(float(at @ (xy[-1] - xy[0]))) / len(bits)


def _crossing(bits: str, factor: list[int], turns: float, radius: float) -> str:
    """Check a factor that is real on the circle but for a phase, and its change of sign."""
    negated = [-value for value in factor]
    reciprocal = factor[::-1] in (factor, negated) and abs(factor[-1]) == 1
    require(reciprocal, "the factor is not self-reciprocal")
    require(
        not any(_long_division([int(bit) for bit in bits], factor)[1]) and 0 < radius < 1e-3,
        "the factor does not divide the code's polynomial",
    )
    # of an even factor the imaginary parts cancel, of an odd one the real parts
    wave = np.cos if factor[0] == factor[-1] else np.sin
    places = np.arange(len(factor)) - (len(factor) - 1) / 2
    # a straight motion's frequency is known to a few roundings only
    radius += 1e-12
    edges = [
        sum(value * wave(2 * pi * f * place) for value, place in zip(factor, places, strict=True))
        for f in (turns - radius, turns + radius)
    ]
    slack = 1e-15 * sum(map(abs, factor)) * (len(factor) + 10)
    crosses = min(edges) < -slack and max(edges) > slack
    require(crosses, f"no change of sign is seen at {turns:.9g} cycles per chip")
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
        if np.abs(value).min() <= lines.slack:  # more points would not help
            break
        # between two points H moves by less than its size: the phase cannot slip by a turn
        if (np.abs(value) > steepest * pi * radius / points * 1.01 + lines.slack).all():
            steps = np.angle(np.roll(value, -1) / value)
            require(
                round(float(steps.sum()) / (2 * pi)) != 0,
                f"H does not turn around 0 near {place_in_words(at)}: no zero there",
            )
            return (
                f"H turns once around 0 on the circle of {radius:.2e} cycles/px about"
                f" {place_in_words(at)}"
            )
        points *= 2
    raise RefusedError(f"the zero at {place_in_words(at)} could not be encircled within the band")


def _cyclotomic(order: int) -> list[int]:
    """Coefficients, lowest first: Phi_mp(z) = Phi_m(z^p) / Phi_m(z), prime by prime p of m."""
    coefficients = [-1, 1]
    radical = 1
    unfactored = order
    for prime in range(2, order + 1):
        if unfactored % prime == 0:
            while unfactored % prime == 0:
                unfactored //= prime
            coefficients = _long_division(_spread(coefficients, prime), coefficients)[0]
            radical *= prime
    # a repeated prime only spreads the coefficients: Phi_d(z) = Phi_r(z^(d / r)), r the radical
    return _spread(coefficients, order // radical)


def _spread(coefficients: list[int], step: int) -> list[int]:
    out = [0] * ((len(coefficients) - 1) * step + 1)
    out[::step] = coefficients
    return out


def _long_division(dividend: list[int], factor: list[int]) -> tuple[list[int], list[int]]:
    """Quotient and remainder; the factor's leading coefficient is 1 or -1."""
    # lists of Python's integers, which have no largest one: numpy's would overflow
    remainder = list(dividend)
    quotient = []
    size = len(factor)
    while len(remainder) >= size:
        lead = remainder.pop() * factor[-1]
        quotient.append(lead)
        for place in range(size - 1):
            remainder[len(remainder) - size + 1 + place] -= lead * factor[place]
    return quotient[::-1], remainder


# -- H and its gradient, summed from the vertices -------------------------------------------------


@dataclass(frozen=True)
class Lines:
    """Straight pieces of the open path, about their centroid.

    Attributes
    ----------
    weight : (S,) float
    middle, delta : (S, 2) float
        Midpoints and extents, px or chips.
    principal : float
        Larger eigenvalue of their second moments: it bounds how |H| curves.
    spread : float
        Largest coordinate of any piece.
    slack : float
        Bound of the rounding error of H.
    """

    weight: FloatArray
    middle: FloatArray
    delta: FloatArray
    principal: float
    spread: float
    slack: float

    def look(self, f: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """H (F,) and its gradient (F, 2) at frequencies (F, 2), one at least."""
        look = self._look_at_lines if self.delta.any() else self._look_at_points
        step = max(1, _CHUNK // len(self.weight))
        chunks = [look(f[lo : lo + step]) for lo in range(0, len(f), step)]
        values, slopes = zip(*chunks, strict=True)
        return np.concatenate(values), np.concatenate(slopes)

    def _look_at_lines(self, f: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        turns = f @ self.middle.T
        x = pi * (f @ self.delta.T)
        small = np.abs(x) < _SERIES
        safe = np.where(small, 1.0, x)
        gain = np.where(small, 1 - x * x / 6, np.sin(safe) / safe)
        change = np.where(small, -x / 3 + x**3 / 30, (np.cos(safe) - gain) / safe)
        wave = self.weight * np.exp(-2j * pi * (turns - np.rint(turns)))
        terms = wave * gain
        slope = -2j * pi * (terms @ self.middle) + pi * ((wave * change) @ self.delta)
        return terms.sum(axis=1), slope

    def _look_at_points(self, f: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Sum open chips in extended precision: a minimum may be a millionth of their number."""
        places = self.middle[:, 0].astype(np.longdouble)
        turns = f[:, :1].astype(np.longdouble) * places
        # 4 arctan 1 is pi in this precision; math.pi would be rounded to double
        wave = np.exp(-2j * (4 * np.arctan(np.longdouble(1))) * (turns - np.rint(turns)))
        slope = np.zeros((len(f), 2), np.complex128)
        slope[:, 0] = -2j * pi * (wave * places).sum(axis=1)
        return wave.sum(axis=1).astype(np.complex128), slope

    def bound_cells(
        self, cells: FloatArray, half: FloatArray, active: NDArray[np.bool_]
    ) -> tuple[FloatArray, FloatArray]:
        """|H| at the centres of cells (F, 2), and how much lower it may be within, (F,) each.

        The cells have half-sides ``half``, (2,); an axis that is not ``active`` has none. Rounding
        comes on top.
        """
        value, slope = self.look(cells)
        size = np.abs(value)
        # d|H| = Re(conj(H) dH) / |H|
        downhill = np.where(active, np.abs((np.conj(value)[:, None] * slope).real), 0)
        downhill /= np.maximum(size, 1e-300)[:, None]
        bend = 2 * pi**2 * self.principal * float(np.hypot(*half)) ** 2
        return size, (downhill * half).sum(axis=1) * (1 + 1e-12) + bend


def chip_lines(bits: str) -> Lines:
    """Open chips as points on a line, a chip a unit."""
    places = np.array([k for k, bit in enumerate(bits) if bit == "1"], dtype=np.float64)
    vertices = np.stack([places, 0 * places], axis=1)
    return _about_centroid(np.ones(len(places)), vertices, vertices)


def path_lines(bits: str, t: FloatArray, xy: FloatArray) -> Lines:
    """Cut a path at its vertices and at equal chips, and keep the pieces of open ones."""
    chips = len(bits)
    cuts = np.union1d(t, np.arange(chips + 1) / chips)
    cuts = cuts[(cuts >= 0) & (cuts <= 1)]
    vertices = np.stack([np.interp(cuts, t, xy[:, 0]), np.interp(cuts, t, xy[:, 1])], axis=1)
    chip = np.clip(np.floor((cuts[1:] + cuts[:-1]) / 2 * chips).astype(int), 0, chips - 1)
    is_open = np.array([bit == "1" for bit in bits])[chip]
    return _about_centroid(np.diff(cuts)[is_open], vertices[:-1][is_open], vertices[1:][is_open])


def _about_centroid(weight: FloatArray, a: FloatArray, b: FloatArray) -> Lines:
    middle = (a + b) / 2
    delta = b - a
    total = float(weight.sum())
    # whole chips stay whole, so that their phases are exact to the last digit
    centre = np.average(middle, axis=0, weights=weight)
    precision: type = np.float64
    if not delta.any():
        centre = np.rint(centre)
        precision = np.longdouble
    middle = middle - centre
    spread = float((np.abs(middle) + np.abs(delta)).max())
    # a uniform piece adds its own d d' / 12 to the moment of its middle
    second = np.einsum("s,si,sj->ij", weight, middle, middle)
    second += np.einsum("s,si,sj->ij", weight, delta, delta) / 12
    principal = float(np.linalg.eigvalsh(second)[-1]) * (1 + 1e-9)
    # roundings: of each phase in proportion to the turns, and one per term of the sum
    rounding = float(np.finfo(precision).eps) * 0.55
    slack = rounding * (total * (100 * (spread + 1) + len(weight) + 100) + 10 * len(weight))
    return Lines(weight, middle, delta, principal, spread, slack)


def on_axis(lines: Lines, box: FloatArray) -> tuple[Lines, FloatArray]:
    """Reduce a straight path to its axis: H depends on the frequency along it only."""
    shift = lines.delta[np.argmax(np.abs(lines.delta).sum(axis=1))]
    size = float(np.hypot(*shift))
    if box[1, 0] == box[1, 1] or size == 0:
        return lines, box
    along = shift / size
    across = np.array([-shift[1], shift[0]]) / size
    width = np.abs(lines.middle @ across).max() + np.abs(lines.delta @ across).max()
    if width > 1e-12 * lines.spread:
        return lines, box
    a, b = (
        np.stack([vertices @ along, 0 * lines.weight], axis=1)
        for vertices in (lines.middle - lines.delta / 2, lines.middle + lines.delta / 2)
    )
    # the axis leaves the square band at its edge, which an oblique one reaches beyond 0.5
    reach = 0.5 * np.abs(along).sum()
    return _about_centroid(lines.weight, a, b), np.array([[0.0, reach], [0.0, 0.0]])


def place_in_words(at: FloatArray) -> str:
    """Write a frequency."""
    return "(" + ", ".join(f"{value:.6g}" for value in at) + ")"
