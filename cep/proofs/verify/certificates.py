"""Independent check of a certificate: plain and slow, sharing no code with its making.

It uses only numpy and the certificate's data. Values are summed directly from the path's vertices;
the lower bound is checked by its own subdivision into cells of half-sides h and circumradius r, on
which

    |H|  >=  |H0| - sum_i h_i |d|H|/df_i| - r^2 / 2 (2 pi)^2 lambda,

lambda the larger principal moment of the open path; zeros by integer division, a change of sign,
or the winding number of H around them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from cep.proofs.verify.sums import (
    Lines,
    RefusedError,
    chip_lines,
    on_axis,
    path_lines,
    place_in_words,
)
from cep.proofs.verify.zeros import zero_holds

FloatArray = NDArray[np.float64]
_TOLERANCE = 1e-9  # relative, on both bounds


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


class Claim(Protocol):
    """A certificate as an object, which can be written as a mapping."""

    def to_dict(self) -> Mapping[str, Any]:
        """Its fields."""
        ...


def verify(
    certificate: Mapping[str, Any] | Claim,
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
        The code that the certificate must be about, as 0 and 1; the one that it names when
        omitted.
    path : (t, xy), optional
        Times (T,) from 0 to 1 and vertices (T, 2), px, where the certificate does not hold them
        itself.
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


def _check(
    bits: str, claim: Mapping[str, Any], path: Any, budget: int, reasons: list[str]
) -> None:
    if not bits or set(bits) - {"0", "1"} or "1" not in bits:
        raise RefusedError("the bits are no code")
    if claim.get("bits", bits) != bits:
        raise RefusedError("the certificate is about another code")
    lower = float(claim["lower"])
    upper = float(claim["upper"])
    unit = claim["unit"]
    at = np.array([float(value) for value in claim["at"]])
    if not 0 <= lower <= upper < np.inf:
        raise RefusedError(f"the bounds {lower:g} .. {upper:g} are no interval")
    if unit == "chips":
        if at.shape != (1,) or not np.isfinite(at).all():
            raise RefusedError("a frequency in chip units is one number")
        lines_by_direction = {"forward": chip_lines(bits)}
        box = np.array([[0.0, 0.5], [0.0, 0.0]])
        vertices = None
        point = np.array([[at[0], 0.0]])
    elif unit == "light-true":
        if at.shape != (2,) or not (np.abs(at) <= 0.5 + 1e-12).all():
            raise RefusedError("the frequency lies outside the band")
        vertices = _vertices(claim.get("trajectory"), path)
        t, xy = vertices
        listed = tuple(claim.get("directions", ("forward", "backward")))
        if not listed or set(listed) - {"forward", "backward"}:
            raise RefusedError("the directions are unknown")
        paths = {"forward": (t, xy), "backward": (1 - t[::-1], xy[::-1])}
        lines_by_direction = {
            direction: path_lines(bits, *paths[direction]) for direction in listed
        }
        box = np.array([[-0.5, 0.5], [0.0, 0.5]])
        point = at[None]
    else:
        raise RefusedError(f"the unit {unit!r} is unknown")
    direction = claim.get("direction", next(iter(lines_by_direction)))
    if direction not in lines_by_direction:
        raise RefusedError("the direction of the minimum is not among those covered")
    value = abs(lines_by_direction[direction].look(point)[0][0])
    if value > upper * (1 + _TOLERANCE) + 2 * lines_by_direction[direction].slack and upper > 0:
        raise RefusedError(
            f"|H| at {place_in_words(at)} is {value:.9g}, above the upper bound {upper:.9g}"
        )
    if upper == 0:
        reasons.append(
            zero_holds(bits, claim.get("zero") or {}, at, lines_by_direction[direction], vertices)
        )
        return
    reasons.append(f"|H| at {place_in_words(at)} is {value:.9g}, not above the upper bound")
    if lower == 0:
        reasons.append("no lower bound above 0 is claimed")
        return
    for name, lines in lines_by_direction.items():
        # open chips may lie on a straight stretch one way and on a bend the other: each way has
        # its own frequencies
        looked = _nothing_below(*on_axis(lines, box), lower * (1 - _TOLERANCE), budget)
        reasons.append(
            f"{name}, nothing lies below the lower bound {lower:.9g} ({looked} frequencies)"
        )


def _nothing_below(lines: Lines, box: FloatArray, level: float, budget: int) -> int:
    sides = np.ptp(box, axis=1)
    looked = 0
    active = sides > 0
    counts = np.where(
        active, np.maximum(1, np.ceil(4 * sides * max(2.0, lines.spread))), 1
    ).astype(int)
    half = sides / counts / 2
    axes = [box[k, 0] + half[k] * (2 * np.arange(counts[k]) + 1) for k in (0, 1)]
    cells = np.array(np.meshgrid(*axes, indexing="ij")).reshape(2, -1).T
    signs = np.array(
        [
            (i, j)
            for i in ((-1, 1) if active[0] else (0,))
            for j in ((-1, 1) if active[1] else (0,))
        ]
    )
    while len(cells):
        looked += len(cells)
        if looked > budget:
            raise RefusedError(
                f"the lower bound {level:.9g} could not be confirmed with {budget} frequencies"
            )
        size, loss = lines.bound_cells(cells, half, active)
        if size.min() < level - lines.slack:
            where = cells[size.argmin()]
            at = place_in_words(where[active])
            raise RefusedError(
                f"|H| at {at} is {size.min():.9g}, below the lower bound {level:.9g}"
            )
        slack = lines.slack * (1 + 10 * lines.spread * float(np.hypot(*half)))
        cells = cells[size - loss - slack < level]
        if len(cells) and loss.max() < slack:
            raise RefusedError(
                f"the lower bound {level:.9g} is too close to the minimum for double precision"
            )
        half = half / 2
        cells = (cells[:, None] + signs * half).reshape(-1, 2)
    return looked


def _vertices(stored: Any, path: Any) -> tuple[FloatArray, FloatArray]:
    expected = None if path is None else (np.array(path[0], float), np.array(path[1], float))
    if stored is not None:
        own_path = (
            np.array(stored["t"], float),
            np.stack([np.array(stored[k], float) for k in "xy"], axis=1),
        )
        if expected and any(
            a.shape != b.shape or not np.allclose(a, b, rtol=0, atol=1e-9)
            for a, b in zip(own_path, expected, strict=True)
        ):
            raise RefusedError("the certificate is about another trajectory")
        expected = own_path
    if expected is None:
        raise RefusedError("the certificate does not hold its trajectory, and none was given")
    t, xy = expected
    if (
        len(t) < 2
        or xy.shape != (len(t), 2)
        or not (np.diff(t) > 0).all()
        or t[0] != 0
        or t[-1] != 1
    ):
        raise RefusedError("the trajectory's times do not rise from 0 to 1")
    if not np.isfinite(xy).all():
        raise RefusedError("the trajectory's places are not finite")
    return t, xy
