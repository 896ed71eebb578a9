"""Certificates of a code's smallest |H|: data that :mod:`cep.proofs.verify` checks with
independent arithmetic.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from cep.optics.band import uniform_length_px
from cep.optics.code import ShutterCode
from cep.proofs.certify.minimum import Minimum, chip_minimum, mtf_minimum
from cep.proofs.certify.zeros import Zero
from motdiff.trajectory import Trajectory

FORWARD = ("forward",)
BOTH = ("forward", "backward")
_BUDGET = 400_000


@dataclass(frozen=True)
class Certificate:
    """Proven bounds of a code's minimum, with the code and the motion.

    Attributes
    ----------
    unit : str
        "chips": |P| on the unit circle, DC is the number of open chips; "light-true": |H| over the
        band, DC is the duty.
    lower, upper : float
        The minimum lies between them; both 0 for a proven zero.
    at : tuple of float
        Where ``upper`` is reached: cycles per chip, or (fx, fy) in cycles/px.
    method : str
    bits : str
        The code.
    directions : tuple of str
        Ways along the path that the bounds cover, "forward" and "backward".
    direction : str
        The one of them on which ``upper`` is reached.
    trajectory : mapping or None
        Lists ``t``, ``x``, ``y`` of the path's vertices; None in chip units.
    zero : Zero or None
        Proof of a zero.
    """

    unit: str
    lower: float
    upper: float
    at: tuple[float, ...]
    method: str
    bits: str
    directions: tuple[str, ...] = BOTH
    direction: str = "forward"
    trajectory: Mapping[str, Any] | None = None
    zero: Zero | None = None

    @property
    def relative_width(self) -> float:
        """``(upper - lower) / upper``, 0 for a proven zero."""
        return (self.upper - self.lower) / self.upper if self.upper > 0 else 0.0

    def to_dict(self) -> dict[str, Any]:
        """Fields for JSON, as in ``code.json``."""
        return {
            "unit": self.unit,
            "lower": self.lower,
            "upper": self.upper,
            "at": list(self.at),
            "method": self.method,
            "relative_width": self.relative_width,
            "bits": self.bits,
            "directions": list(self.directions),
            "direction": self.direction,
            "trajectory": None if self.trajectory is None else dict(self.trajectory),
            "zero": None if self.zero is None else self.zero.to_dict(),
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Certificate:
        """Read :meth:`to_dict` back; unknown fields are ignored.

        Raises
        ------
        ValueError
            If a field is missing or of the wrong type.
        """
        try:
            return cls(
                unit=str(data["unit"]),
                lower=float(data["lower"]),
                upper=float(data["upper"]),
                at=tuple(float(value) for value in data["at"]),
                method=str(data["method"]),
                bits=str(data["bits"]),
                directions=tuple(data.get("directions", BOTH)),
                direction=str(data.get("direction", "forward")),
                trajectory=data.get("trajectory"),
                zero=None if data.get("zero") is None else Zero.from_dict(data["zero"]),
            )
        except KeyError as error:
            raise ValueError(f"certificate: field {error} is missing") from None
        except TypeError as error:
            raise ValueError(f"certificate: a field has the wrong type ({error})") from None


def certify(
    code: ShutterCode, trajectory: Trajectory | None = None, *, budget: int = _BUDGET
) -> Certificate:
    """Prove bounds of a code's minimum: of |P| in chips, or of |H| along a trajectory.

    Parameters
    ----------
    code : ShutterCode
    trajectory : Trajectory, optional
        An unknown direction counts as the worse of the two; a uniform straight motion has the same
        |H| on both ways.
    budget : int
        Largest number of cells of the subdivision along a path; running out leaves a wider, still
        valid, interval.

    Examples
    --------
    >>> found = certify(ShutterCode("11100101"))
    >>> f"{found.lower:.5f} {found.upper:.5f} {found.unit}"
    '0.91277 0.91277 chips'
    """
    if trajectory is None:
        return _of(chip_minimum(code), "chips", code, BOTH, "forward", None)
    vertices = {"t": trajectory.t.tolist(), "x": trajectory.x.tolist(), "y": trajectory.y.tolist()}
    forward = mtf_minimum(trajectory, code, budget=budget)
    same_back = uniform_length_px(trajectory) is not None
    if same_back or trajectory.direction == "known":
        return _of(
            forward, "light-true", code, BOTH if same_back else FORWARD, "forward", vertices
        )
    backward = mtf_minimum(trajectory.reversed(), code, budget=budget)
    direction = "forward" if forward.upper <= backward.upper else "backward"
    worse = forward if direction == "forward" else backward
    lower = min(forward.lower, backward.lower)
    return _of(
        Minimum(lower, worse.upper, worse.at, worse.method, worse.zero),
        "light-true",
        code,
        BOTH,
        direction,
        vertices,
    )


def _of(
    minimum: Minimum,
    unit: str,
    code: ShutterCode,
    directions: tuple[str, ...],
    direction: str,
    vertices: Mapping[str, Any] | None,
) -> Certificate:
    lower = float(minimum.lower)
    upper = float(minimum.upper)
    at = tuple(float(value) for value in np.atleast_1d(minimum.at))
    return Certificate(
        unit,
        lower,
        upper,
        at,
        minimum.method,
        code.bits,
        directions,
        direction,
        vertices,
        minimum.zero,
    )
