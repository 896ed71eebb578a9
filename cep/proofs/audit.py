"""Audit of a code: zeros, frequency grids that miss them, and better codes within a few flips."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cep.compiled import compiled
from cep.optics.band import band, band_samples
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.exposure import chip_basis, mtf
from cep.optics.path_limits import check_frame, check_resolved
from cep.optics.scene import PHOTO, Scene
from cep.proofs.certify.certificate import Certificate, certify, paths_by_direction
from cep.proofs.certify.minimum import min_chip, mtf_minimum
from cep.proofs.certify.zeros import Zeros, zeros_along, zeros_of_code
from cep.proofs.measure import CodeMetrics, FigureOfMerit, OwnFigure, measure_worst, own_figures
from motdiff.trajectory import Trajectory
from motdiff.types import ComplexArray, FloatArray

_NO_LIGHT = 1e-9  # of the duty: smaller values of |H| at a proven zero are rounding
_LONG_CHIPS = 256  # beyond it three flips take minutes
_REFINED = 24  # candidates of the grid whose minimum over the continuum is searched
_WORTH = 1.001  # a neighbour must be better by more than rounding
_HONEST = 1.05  # a grid's value within 5 % of the truth
_NULL = 1e-4  # of DC: a minimum below it is a zero for every practical purpose
_NO_ZERO = 1e-6  # of DC: a neighbour whose minimum is no larger is no repair


@dataclass(frozen=True)
class Neighbour:
    """A code a few flips away.

    Attributes
    ----------
    flips : tuple of int
        Chips that differ, counted from 1.
    minimum : float
        Its minimum over the continuum: |P| in chips, or |H| along the trajectory.
    """

    flips: tuple[int, ...]
    code: ShutterCode
    minimum: float


@dataclass(frozen=True)
class GridClaim:
    """Minimum of a code on a frequency grid, compared with the true one.

    Attributes
    ----------
    points : int
        Along one axis.
    minimum : float
        Smallest modulus on the grid.
    verdict : str
        "honest", "overstates" by more than 5 %, or "hides the zero".
    """

    name: str
    points: int
    minimum: float
    verdict: str


@dataclass(frozen=True)
class Audit:
    """What is true of a code along a motion.

    Attributes
    ----------
    trajectory : Trajectory
        The motion; a straight one of 1 px a chip where none was given.
    along : Trajectory or None
        What the proofs are about: None is the unit circle of the code's polynomial, which decides
        along uniform straight motions.
    metrics : CodeMetrics
        Of the worse direction where it is unknown. Noise gains are infinite where a straight
        motion has a proven zero within the band.
    certificate : Certificate
        Proven bounds of the smallest MTF.
    zeros : mapping of direction to Zeros
    grids : tuple of GridClaim
        Minima that common frequency grids show.
    neighbours : tuple of Neighbour
        Better codes few flips away, the best for each number of flips.
    flips : int
        Most chips changed in looking for them.
    figures : mapping from a name to a number, or to those of both directions
        User-defined figures of merit.
    """

    code: ShutterCode
    trajectory: Trajectory
    along: Trajectory | None
    metrics: CodeMetrics
    certificate: Certificate
    zeros: Mapping[str, Zeros]
    grids: tuple[GridClaim, ...]
    neighbours: tuple[Neighbour, ...]
    flips: int
    figures: Mapping[str, OwnFigure] = field(default_factory=dict)

    @property
    def no_inverse(self) -> bool:
        """Whether noise is amplified without bound: a proven zero lies within the band."""
        return math.isinf(self.metrics.noise_gain_db)

    @property
    def null(self) -> bool:
        """Whether the code has, for every practical purpose, a zero."""
        return self.certificate.upper < _NULL * _dc(self.code, self.along)

    def to_dict(self) -> dict[str, Any]:
        """Fields for JSON, as ``cep audit --json`` prints them."""
        certificate = self.certificate.to_dict()
        del certificate["trajectory"]  # the path is the one that was asked for
        return {
            "bits": self.code.bits,
            "chips": self.code.chips,
            "open": self.code.open_chips,
            "duty": self.code.duty,
            **self.metrics.to_dict(),
            **({"figures": dict(self.figures)} if self.figures else {}),
            "motion": {
                "length_px": self.trajectory.length_px,
                "direction": self.trajectory.direction,
            },
            "certificate": certificate,
            "lowest_at": self.certificate.at,
            "null": self.null,
            "zeros": [
                {"direction": direction, **zero.to_dict(), "method": zero.method}
                for direction, zeros in self.zeros.items()
                for zero in zeros.found
            ],
            "zeros_complete": all(zeros.complete for zeros in self.zeros.values()),
            "grids": self.grids,
            "neighbours": [
                {"flips": n.flips, "bits": n.code.bits, "minimum": n.minimum}
                for n in self.neighbours
            ],
        }


def with_proven_zero(
    code: ShutterCode, along: Trajectory | None, metrics: CodeMetrics
) -> CodeMetrics:
    """Make noise gains infinite where a straight motion has a proven zero within the band.

    The samples of the band miss the line of the zero, whose share of 1/|H|^2 has no bound.
    """
    # along a curved path zeros are isolated points
    dark = along is None and metrics.min_mtf < _NO_LIGHT * code.duty
    if dark and zeros_of_code(code.bits).found:
        return replace(metrics, noise_gain_db=math.inf, dnf_db=math.inf)
    return metrics


def audit(
    code: ShutterCode,
    trajectory: Trajectory | None = None,
    *,
    camera: Camera | None = None,
    scene: Scene = PHOTO,
    flips: int | None = None,
    figures: Mapping[str, FigureOfMerit] | None = None,
    progress: Callable[[float, str], None] = lambda _share, _note: None,
    on_checked: Callable[[], None] = lambda: None,
) -> Audit:
    """Measure a code, prove its minimum, list its zeros, and look for better neighbours.

    Parameters
    ----------
    trajectory : Trajectory, optional
        A straight one of 1 px a chip when omitted.
    camera : Camera, optional
        For the expected error; ``Camera()`` when omitted.
    scene : Scene
        For the expected error.
    flips : int, optional
        Look for better codes up to so many flips away, 0..3; 3 when omitted, of more than 256
        chips 2.
    figures : mapping from a name to a function, optional
        User-defined figures of merit, see :func:`cep.proofs.measure.own_figures`.
    progress : callable, optional
        Called with the finished share, 0..1, and what comes next.
    on_checked : callable, optional
        Called before the work, when the path has been checked.

    Raises
    ------
    ValueError
        If the path cannot be measured, or is too short for so many chips; or a user-defined figure
        fails.

    Examples
    --------
    A published code whose claimed minimum of 0.088 is a true zero:

    >>> from cep.codes.published import published
    >>> found = audit(published("merl-31-t62").code, flips=1)
    >>> found.null, found.grids[0].verdict
    (True, 'hides the zero')
    """
    motion = trajectory or Trajectory.straight(float(code.chips))
    check_frame(motion)
    check_resolved(motion, code.chips)
    on_checked()
    if flips is None:
        flips = 3 if code.chips <= _LONG_CHIPS else 2
    progress(0.0, "measuring")
    # first, so that a function that fails does so before the long work
    own_values = own_figures(figures or {}, motion, code)
    metrics = measure_worst(motion, code, camera=camera, scene=scene)
    progress(0.1, "proving the minimum")
    along: Trajectory | None = None
    if metrics.min_chip is not None:  # a uniform straight motion: the polynomial alone decides
        zeros = {"both": zeros_of_code(code.bits)}
    else:
        along = motion
        paths = paths_by_direction(motion)
        zeros = {direction: zeros_along(path, code) for direction, path in paths.items()}
    certificate = certify(code, along)
    metrics = with_proven_zero(code, along, metrics)
    grids = grid_claims(code, along, certificate.upper)
    progress(0.5, "looking at neighbours")
    neighbours = better_neighbours(code, along, flips=flips)
    progress(1.0, "")
    return Audit(
        code, motion, along, metrics, certificate, zeros, grids, neighbours, flips, own_values
    )


def _dc(code: ShutterCode, trajectory: Trajectory | None) -> float:
    """|H| at zero frequency, in the unit of the minima: chips, or light-true along a path."""
    if trajectory is None:
        return code.open_chips
    return code.duty


def grid_claims(
    code: ShutterCode, trajectory: Trajectory | None, truth: float
) -> tuple[GridClaim, ...]:
    """Compare the minima on common grids with the true minimum over the continuum.

    Without a trajectory they are in chips: the DFT of the bits, padded with zeros.
    """
    minima: dict[tuple[int, str], float] = {}
    if trajectory is None:
        n = code.chips
        names = {n: "n", 2 * n: "2n", 3 * n: "3n", 64: "64", 16 * n: "16n"}
        for points, name in sorted(names.items()):
            if points >= n:  # a shorter DFT would cut the code
                spectrum = np.abs(np.fft.rfft(code.array, points))
                minima[points, f"{name}-point DFT"] = float(spectrum.min())
    else:
        paths = paths_by_direction(trajectory).values()
        for points in (32, 64, 128, 256):
            fx, fy = band(points)
            half = fy <= 0  # |H| is even
            lowest = min(float(mtf(path, code, fx[half], fy[half]).min()) for path in paths)
            minima[points, f"{points} x {points} FFT"] = lowest
    dc = _dc(code, trajectory)
    return tuple(
        GridClaim(name, points, lowest, _verdict(lowest, truth, dc))
        for (points, name), lowest in minima.items()
    )


def better_neighbours(
    code: ShutterCode, trajectory: Trajectory | None = None, *, flips: int = 2
) -> tuple[Neighbour, ...]:
    """Find, for each number of flips up to ``flips``, the best code that beats this one's minimum.

    Every combination is evaluated on a grid of frequencies, up to the first at which it is no
    better than this code. The minima of the best ones are then found over the continuum.

    The minima count along the trajectory, of an unknown direction the worse one; in chips without
    a trajectory. The fewest flips come first, and there may be none. ValueError if ``flips`` is
    not 0 to 3.
    """
    if not 0 <= flips <= 3:
        raise ValueError(f"flips: must be 0 to 3, got {flips}")
    basis = _basis(code.chips, trajectory)
    chips = code.array
    spectrum = chips @ basis
    order = np.argsort(np.abs(spectrum))
    re = np.ascontiguousarray(basis[:, order].real)
    im = np.ascontiguousarray(basis[:, order].imag)
    change = 1 - 2 * chips
    to_beat = max(_WORTH * _exact(code, trajectory), _NO_ZERO * _dc(code, trajectory))
    changes = (re * change[:, None], im * change[:, None])
    starts = (chips @ re, chips @ im)
    neighbours: list[Neighbour] = []
    for count in range(1, min(flips, code.chips) + 1):
        scores = np.full(_REFINED, to_beat**2)
        places = np.full((_REFINED, 3), -1, dtype=np.int64)
        _scan(*changes, *starts, count, scores, places)
        exact = []
        for row in places[places[:, -1] >= 0, -count:].tolist():
            flipped = code.array
            flipped[row] = 1 - flipped[row]
            if flipped.any():  # all closed is no code
                neighbour = ShutterCode(flipped, chip_ns=code.chip_ns)
                minimum = _exact(neighbour, trajectory)
                exact.append(Neighbour(tuple(k + 1 for k in row), neighbour, minimum))
        best = max(exact, key=lambda neighbour: neighbour.minimum, default=None)
        # the grid may have missed a dip: the minimum over the continuum decides
        if best is not None and best.minimum > to_beat:
            neighbours.append(best)
    return tuple(neighbours)


def _basis(chips: int, trajectory: Trajectory | None) -> ComplexArray:
    """Spectra (n, F) of single chips, the directions that count side by side."""
    if trajectory is None:
        # of long codes fewer frequencies: the work grows with the chips to the fourth power
        per_chip = 8 if chips <= _LONG_CHIPS else 4
        cycles = np.linspace(0, 0.5, per_chip * chips + 1)
        return np.asarray(np.exp(-2j * np.pi * np.arange(chips)[:, None] * cycles))
    samples = band_samples(trajectory, oversampling=8)
    forward = chip_basis(trajectory, chips, samples.fx, samples.fy)
    if trajectory.direction == "known":
        return forward
    # the reversed path draws the same chips in the opposite order
    return np.concatenate([forward, forward[::-1]], axis=1)


@compiled
def _scan(
    re: FloatArray,
    im: FloatArray,
    start_re: FloatArray,
    start_im: FloatArray,
    count: int,
    scores: FloatArray,
    places: NDArray[np.int64],
) -> None:
    """Keep the sums of the start and ``count`` rows whose smallest power is largest.

    ``scores`` are ascending and hold what must be beaten; the last columns of ``places`` the rows.
    """
    chips, size = re.shape
    two_re = np.empty(size)
    two_im = np.empty(size)
    killer = 0
    for i in range(chips if count > 2 else 1):
        for j in range(i + 1 if count > 2 else 0, chips if count > 1 else 1):
            for f in range(size):
                two_re[f], two_im[f] = start_re[f], start_im[f]
                if count > 2:
                    two_re[f] += re[i, f]
                    two_im[f] += im[i, f]
                if count > 1:
                    two_re[f] += re[j, f]
                    two_im[f] += im[j, f]
            for k in range(j + 1 if count > 1 else 0, chips):
                # the frequency that rejected the last one often rejects this one too
                a = two_re[killer] + re[k, killer]
                b = two_im[killer] + im[k, killer]
                lowest = a * a + b * b
                f = 0
                while f < size and lowest > scores[0]:
                    a = two_re[f] + re[k, f]
                    b = two_im[f] + im[k, f]
                    power = a * a + b * b
                    if power < lowest:
                        lowest = power
                        if power <= scores[0]:
                            killer = f
                    f += 1
                if lowest > scores[0]:
                    at = 0
                    while at + 1 < scores.size and scores[at + 1] < lowest:
                        scores[at] = scores[at + 1]
                        places[at] = places[at + 1]
                        at += 1
                    scores[at] = lowest
                    places[at, 0], places[at, 1], places[at, 2] = i, j, k


def _exact(code: ShutterCode, trajectory: Trajectory | None) -> float:
    """Smallest |P| or |H| over the continuum, as far as a quick search shows."""
    if trajectory is None:
        return min_chip(code)
    paths = paths_by_direction(trajectory).values()
    return min(mtf_minimum(path, code, budget=0).upper for path in paths)


def _verdict(lowest: float, truth: float, dc: float) -> str:
    if truth <= _NO_ZERO * dc and lowest > _NULL * dc:
        return "hides the zero"
    if truth > _NO_ZERO * dc and lowest > _HONEST * truth:
        return "overstates"
    return "honest"
