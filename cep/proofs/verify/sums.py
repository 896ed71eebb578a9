"""Sums of the independent check: H and its gradient from a path's vertices, by numpy alone."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
_CHUNK = 2**19  # numbers held at once: a few arrays of 8 MB, whatever the budget
_SERIES = 1e-3  # rad, below which sinc's slope by its quotient loses six digits or more


class RefusedError(Exception):
    """A claim does not hold; the message says why."""


def require(condition: bool, refusal: str) -> None:
    """Refuse the claim where a condition does not hold."""
    if not condition:
        raise RefusedError(refusal)


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
        """H (F,) and its gradient (F, 2) at frequencies (F, 2)."""
        if not self.delta.any():
            return self._look_at_points(f)
        value = np.empty(len(f), np.complex128)
        slope = np.empty((len(f), 2), np.complex128)
        step = max(1, _CHUNK // len(self.weight))
        for lo in range(0, len(f), step):
            batch = f[lo : lo + step]
            turns = batch @ self.middle.T
            x = pi * (batch @ self.delta.T)
            small = np.abs(x) < _SERIES
            safe = np.where(small, 1.0, x)
            gain = np.where(small, 1 - x * x / 6, np.sin(safe) / safe)
            change = np.where(small, -x / 3 + x**3 / 30, (np.cos(safe) - gain) / safe)
            wave = self.weight * np.exp(-2j * pi * (turns - np.rint(turns)))
            terms = wave * gain
            value[lo : lo + step] = terms.sum(axis=1)
            slope[lo : lo + step] = -2j * pi * (terms @ self.middle) + pi * (
                (wave * change) @ self.delta
            )
        return value, slope

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

    def _look_at_points(self, f: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Sum open chips in extended precision: a minimum may be a millionth of their number."""
        value = np.empty(len(f), np.complex128)
        slope = np.zeros((len(f), 2), np.complex128)
        step = max(1, _CHUNK // len(self.weight))
        places = self.middle[:, 0].astype(np.longdouble)
        for lo in range(0, len(f), step):
            turns = f[lo : lo + step, :1].astype(np.longdouble) * places
            # 4 arctan 1 is pi in this precision; math.pi would be rounded to double
            wave = np.exp(-2j * (4 * np.arctan(np.longdouble(1))) * (turns - np.rint(turns)))
            value[lo : lo + step] = wave.sum(axis=1)
            slope[lo : lo + step, 0] = -2j * pi * (wave * places).sum(axis=1)
        return value, slope


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
