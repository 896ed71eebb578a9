"""Bounds over all codes: of the smallest |H| and |P| from above, of the noise gain from below.

Each figure is the best of several arguments: those of :mod:`cep.search.bounding.quick_bounds`, and
those of :mod:`cep.search.bounding.dual_proofs`, for which the relaxation supplies multipliers.
Every bound holds for each number of open chips alone, and a problem's bound is the weakest over
its range. Limits on runs and single chips are ignored, so the bounds hold with them. A shutter
with ramps is only bounded by its light: its |H|^2 is no quadratic form in the code.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cep.optics.band import BandSamples, band_samples, straight_axis
from cep.optics.exposure import chip_basis, chip_parts
from cep.search.bounding.dual_proofs import DualProof, relaxed, tightened
from cep.search.bounding.motion_basis import MotionBasis, circle_grid
from cep.search.bounding.quick_bounds import chip_ceilings, mtf_ceilings, noise_floors
from cep.search.bounding.relaxation import Relaxation
from cep.search.problem import SearchProblem
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

_MOST_NUMBERS = 2**22  # of a basis: 64 MB
_MOST_CHIPS = 256  # of a relaxation, whose steps invert n x n matrices


@dataclass(frozen=True)
class Bound:
    """Bounds over every code within a problem's light.

    Attributes
    ----------
    min_mtf : float
        No code's smallest |H| exceeds it, worst scenario and direction under either rule;
        light-true. On the unit circle it is ``min_chip / chips``.
    min_chip : float
        No code's smallest |P| over the unit circle exceeds it, chips.
    noise : float
        No code's ``10 log10 mean 1/|H|^2`` lies below it, worst scenario and direction;
        light-true. The mean is that of :func:`cep.proofs.measure.measure`; on the unit circle it
        is the one over the whole circle.
    method : dict of str to str
        The argument with the best bound for each of the three.
    proofs : tuple of DualProof
        Of the relaxation, one for each number of open chips that it bounds better than the other
        arguments.
    """

    min_mtf: float
    min_chip: float
    noise: float
    method: dict[str, str]
    proofs: tuple[DualProof, ...] = ()


def bound(problem: SearchProblem, *, effort: Literal["quick", "sdp"] = "quick") -> Bound:
    """Bound the figures of all codes of ``problem``.

    Parameters
    ----------
    problem : SearchProblem
    effort : {"quick", "sdp"}
        Quick takes milliseconds to a second. "sdp" relaxes the objective: the smallest |H| along
        motions for "min-mtf", in seconds, and the mean of 1/|H|^2 for "noise", up to a minute on a
        curved path.

    Raises
    ------
    ValueError
        If ``effort`` is another word.

    Examples
    --------
    >>> limits = bound(SearchProblem.along(chips=16, open_range=(8, 8)))
    >>> print(f"no code has a minimum above {limits.min_chip:.3f} chips")
    no code has a minimum above 2.000 chips
    """
    if effort not in ("quick", "sdp"):
        raise ValueError(f'effort: must be "quick" or "sdp", got {effort!r}')
    low, high = problem.open_limits
    counts = np.arange(low, high + 1)
    objectives = set()
    if effort == "sdp" and problem.chips <= _MOST_CHIPS:
        objectives = set(dict(problem.objective_mix))
    chip_name, chip = _best(chip_ceilings(problem.chips, counts))
    parts, noisy_parts = _motions(problem)
    light = _light(problem, counts)
    proofs: list[DualProof] = []
    # on the circle a relaxation gains nothing: docs/decisions/proofs.md
    mtf_name = chip_name
    mtf = chip / problem.chips
    if problem.scenarios:
        mtf_name, mtf = _best({"light": light, **mtf_ceilings(parts, counts)})
        if "min-mtf" in objectives and parts:
            mtf, won = tightened(parts, counts, mtf, "min")
            proofs += won
            if _decides(won, counts[mtf.argmax()]):
                mtf_name = "sdp"
    noise_name = "light"
    noise = -20 * np.log10(light)
    worst: MotionBasis | None = None
    for motion_basis in noisy_parts:
        # the worst scenario counts, and each of them bounds it
        name, floors = _best(noise_floors(motion_basis, counts), upper=False)
        if floors.min() > noise.min():
            noise_name = name
            noise = floors
            worst = motion_basis
    if "noise" in objectives and worst is not None:
        noise, won = tightened([worst], counts, noise, "noise")
        proofs += won
        if _decides(won, counts[noise.argmin()]):
            noise_name = "sdp"
    names = {"min_mtf": mtf_name, "min_chip": chip_name, "noise": noise_name}
    return Bound(float(mtf.max()), float(chip.max()), float(noise.min()), names, tuple(proofs))


def relaxed_minimum(problem: SearchProblem, open_chips: int) -> Relaxation:
    """Relax the largest smallest |H| of so many open chips, for starts by ``rounded_codes``.

    Raises
    ------
    ValueError
        If ``open_chips`` is not within 2..n-1, the shutter has ramps, or no solver finds an
        optimum.
    """
    if not 1 < open_chips < problem.chips:
        raise ValueError(f"open_chips: must be within 2..{problem.chips - 1}, got {open_chips}")
    parts = _motions(problem)[0]
    if not parts:
        raise ValueError("response: the relaxation is for a shutter that follows at once")
    return relaxed(parts, open_chips)[0]


def _best(limits: dict[str, FloatArray], *, upper: bool = True) -> tuple[str, FloatArray]:
    """Best bound for each number of open chips, and the name of the weakest one's argument."""
    sign = 1.0 if upper else -1.0  # lower bounds are upper ones of the negated figure
    values = sign * np.stack(list(limits.values()))
    best = values.min(axis=0)
    weakest = int(best.argmax())
    return list(limits)[int(values[:, weakest].argmin())], sign * best


def _decides(proofs: list[DualProof], open_chips: np.intp) -> bool:
    return any(proof.open_chips == open_chips for proof in proofs)


def _motions(problem: SearchProblem) -> tuple[list[MotionBasis], list[MotionBasis]]:
    """Bases of all motions: for minima on any frequencies, for means on the quadrature's."""
    chips = problem.chips
    if not problem.scenarios:
        samples = circle_grid(chips)
        basis = np.exp(-2j * np.pi * np.outer(np.arange(chips), samples.fx)) / chips
        circle = [MotionBasis(None, False, samples, basis)]
        return circle, circle
    for_minima = []
    for_means = []
    for motion, reversible, edges in _played(problem):
        samples = band_samples(motion)
        affordable = chips * samples.fx.size <= _MOST_NUMBERS
        if affordable:
            basis = chip_basis(motion, chips, samples.fx, samples.fy, edges=edges)
            for_means.append(MotionBasis(motion, reversible, samples, basis, edges))
        if affordable and straight_axis(motion) is None:
            for_minima.append(for_means[-1])
            continue
        # a straight motion has few frequencies, so more are cheap; too many are thinned out
        samples = _thinned(band_samples(motion, oversampling=8), _MOST_NUMBERS // chips)
        basis = chip_basis(motion, chips, samples.fx, samples.fy, edges=edges)
        for_minima.append(MotionBasis(motion, reversible, samples, basis, edges))
    return for_minima, for_means


def _played(problem: SearchProblem) -> list[tuple[Trajectory, bool, FloatArray | None]]:
    """Motions, whether both directions count, and chip edges."""
    # through ramps |H|^2 is no quadratic form
    if problem.response is not None and not problem.response.instant:
        return []
    motions: list[tuple[Trajectory, bool, FloatArray | None]] = []
    for scenario in problem.scenarios:
        motion = scenario.trajectory
        reversible = problem.both_directions(motion)
        if scenario.edges is None:
            motions.append((motion, reversible, None))
            continue
        motions.append((motion, False, scenario.edges))
        if reversible:  # the reversed path's chips are not the forward ones in another order
            motions.append((motion.reversed(), False, scenario.edges))
    return motions


def _light(problem: SearchProblem, counts: NDArray[np.intp]) -> FloatArray:
    """Most light that so many open chips let through, (K,), in the darkest scenario; 1 is all."""
    if not problem.scenarios:
        return np.asarray(counts / problem.chips, dtype=np.float64)
    ceiling = np.full(counts.size, np.inf)
    for scenario in problem.scenarios:
        basis, _, tail = chip_parts(
            scenario.trajectory,
            problem.chips,
            0.0,
            0.0,
            response=problem.response,
            edges=scenario.edges,
        )
        # what opening takes away is left out: it only lowers the light; and each pulse has one
        # tail
        pulses = np.minimum(counts, problem.chips - counts + 1)
        chips, tails = (np.sort(column.real)[::-1].cumsum() for column in (basis, tail))
        ceiling = np.minimum(ceiling, chips[counts - 1] + tails[pulses - 1])
    return np.asarray(ceiling * (1 + 1e-12), dtype=np.float64)


def _thinned(samples: BandSamples, size: int) -> BandSamples:
    stride = slice(None, None, -(-samples.fx.size // size))
    return BandSamples(**{name: column[stride] for name, column in vars(samples).items()})
