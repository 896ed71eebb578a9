"""Certificates of a code's smallest |H|, which :mod:`cep.proofs.verify` checks on its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from cep.optics.code import ShutterCode
from cep.optics.straight_motion import uniform_length_px
from cep.proofs.certify.minimum import Minimum, chip_minimum, mtf_minimum
from motdiff.trajectory import Trajectory

_FIELDS = (
    *("unit", "lower", "upper", "at", "method", "relative_width"),
    *("bits", "directions", "direction", "trajectory", "zero"),
)
BOTH = ("forward", "backward")


@dataclass(frozen=True, kw_only=True)
class Certificate(Minimum):
    """Proven bounds of a code's minimum, with the code and the motion.

    Attributes
    ----------
    unit : str
        "chips": |P| on the unit circle, DC is the number of open chips; "light-true": |H| over the
        band, DC is the duty.
    bits : str
        The code.
    directions : tuple of str
        Ways along the path that the bounds cover, "forward" and "backward".
    direction : str
        The one of them on which ``upper`` is reached.
    trajectory : mapping or None
        Lists ``t``, ``x``, ``y`` of the path's vertices; None in chip units.
    """

    unit: str
    bits: str
    directions: tuple[str, ...] = BOTH
    direction: str = "forward"
    trajectory: Mapping[str, Any] | None = None

    def to_dict(self) -> dict[str, Any]:
        """Fields for JSON, as in ``code.json``."""
        data = asdict(self) | {"at": list(self.at), "directions": list(self.directions)}
        data["relative_width"] = self.relative_width
        # the order in which files have always had them
        return {name: data[name] for name in _FIELDS}


def certify(
    code: ShutterCode, trajectory: Trajectory | None = None, *, budget: int = 400_000
) -> Certificate:
    """Prove bounds of a code's minimum: of |P| in chips, or of |H| along a trajectory.

    Parameters
    ----------
    trajectory : Trajectory, optional
        An unknown direction counts as the worse of the two.
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
        return Certificate(unit="chips", bits=code.bits, **vars(chip_minimum(code)))
    paths = paths_by_direction(trajectory)
    covered = tuple(paths)
    if uniform_length_px(trajectory) is not None:
        # a uniform straight motion has the same |H| on both ways
        paths = {"forward": trajectory}
        covered = BOTH
    minima = {name: mtf_minimum(path, code, budget=budget) for name, path in paths.items()}
    direction = min(minima, key=lambda name: minima[name].upper)
    lower = min(minimum.lower for minimum in minima.values())
    return Certificate(
        unit="light-true",
        bits=code.bits,
        directions=covered,
        direction=direction,
        trajectory={
            "t": trajectory.t.tolist(),
            "x": trajectory.x.tolist(),
            "y": trajectory.y.tolist(),
        },
        **vars(replace(minima[direction], lower=lower)),
    )


def paths_by_direction(trajectory: Trajectory) -> dict[str, Trajectory]:
    """Name the ways along a path that count: both, where its direction is unknown."""
    if trajectory.direction == "known":
        return {"forward": trajectory}
    return {"forward": trajectory, "backward": trajectory.reversed()}
