"""Expected PSNR of the restoration through codes: at any light, and for a path known to so many pixels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cep.optics.band import BandSamples, band_samples, grid_samples, straight_axis
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.mtf import inverse_scene, noise_variance
from cep.search.objective import Objective
from cep.search.problem import SearchProblem
from cep.search.scenarios import Scenario, scenario_rows
from motdiff.motions import with_smooth_error
from motdiff.trajectory import Trajectory

__all__ = ["equal_light_noise", "expected_psnr_db", "light_noise"]

FloatArray = NDArray[np.float64]
_OVERSAMPLING = 16
_DRAWS = 24  # of a path's error
_INTERVALS = 128  # a side: a path near a straight one has valleys as narrow


def light_noise(camera: Camera, chips: int) -> FloatArray:
    """Variance of the noise by number of open chips, (n + 1,): the light falls with them."""
    return np.array([noise_variance(camera, k / chips) for k in range(chips + 1)])


def equal_light_noise(camera: Camera, chips: int) -> FloatArray:
    """Variance of the noise by number of open chips, (n + 1,), where a brighter lamp makes up for the closed ones.

    A pixel collects as many photo-electrons through every code; fixed noise weighs less against them the shorter the
    code is open, as full scale is what an open shutter would collect of that lamp.
    """
    noise = [noise_variance(camera, 1.0)]  # of no open chip there is no photo
    for k in range(1, chips + 1):
        lamp = replace(camera, photons_full_scale=camera.photons_full_scale * chips / k)
        noise.append(noise_variance(lamp, k / chips))
    return np.array(noise)


def expected_psnr_db(
    problem: SearchProblem,
    codes: Sequence[ShutterCode],
    *,
    noise: ArrayLike,
    path_error_px: float = 0.0,
    rng: np.random.Generator | None = None,
) -> FloatArray:
    """PSNR, dB, of the best linear restoration of the reference scene, (codes, L); the worse direction counts.

    Where the path is known to ``path_error_px`` only, the filter knows the mean and the scatter of the OTF H over such
    paths, each shifted so that the code's light stays in place: a shift of the restored photo is no error. The least
    mean square error of a linear filter is then the mean over the band of
    ``S (S (E|H|^2 - |E H|^2) + N) / (S E|H|^2 + N)``, with the scene's spectrum S and the noise N.

    Parameters
    ----------
    problem : SearchProblem
        Its motions, directions and shutter; its objective and camera do not matter.
    codes : sequence of ShutterCode
    noise : (L, n + 1) array_like
        Variance by number of open chips, as :func:`light_noise` and :func:`equal_light_noise` give it, for L cases.
    path_error_px : float
        Rms over time, smooth; see :func:`motdiff.motions.with_smooth_error`.
    rng : numpy Generator, optional
        Of the paths drawn where there is such an error; of seed 0 when omitted.

    Raises
    ------
    ValueError
        If the error is negative or not finite, or the problem has no motion.
    """
    if not (np.isfinite(path_error_px) and path_error_px >= 0):
        raise ValueError(f"path_error_px: must be 0 px or more, got {path_error_px:g}")
    if not problem.scenarios:
        raise ValueError("scenarios: need a motion to expect a restoration along")
    chips = np.array([code.array for code in codes], dtype=np.float64)
    cases = np.atleast_2d(np.asarray(noise, dtype=np.float64))
    judged = Objective(replace(problem, objective="mse"), oversampling=_OVERSAMPLING, dtype=np.float64)
    if path_error_px == 0:
        return -np.stack([judged.with_noise(case).cost_of(chips) for case in cases], axis=1)
    duty, counts = judged.duty(chips), np.arange(problem.chips + 1)
    variances = np.stack([np.interp(duty * problem.chips, counts, case) for case in cases], axis=1)
    rng = np.random.default_rng(0) if rng is None else rng
    errors_db = np.full((len(problem.scenarios), *variances.shape), -np.inf)
    for index, scenario in enumerate(problem.scenarios):
        for turned in problem.directions(scenario):
            path = scenario.path(reversed_path=turned)
            error = _uncertain_error(problem, replace(scenario, trajectory=path), chips, variances, path_error_px, rng)
            errors_db[index] = np.maximum(errors_db[index], 10 * np.log10(error))
    if problem.rule == "mean":
        return -np.tensordot(judged.scenario_shares, errors_db, axes=1)
    return -np.asarray(errors_db.max(axis=0), dtype=np.float64)


def _uncertain_error(
    problem: SearchProblem, scenario: Scenario, chips: FloatArray, variances: FloatArray, path_error_px: float,
    rng: np.random.Generator,
) -> FloatArray:  # fmt: skip
    """Mean square error (R, L) of codes (R, n) along a path that is known to so many px."""
    path = scenario.trajectory
    straight = straight_axis(path) is not None
    samples = grid_samples(_INTERVALS) if straight else band_samples(path)
    mean, power = np.zeros((len(chips), samples.fx.size), dtype=complex), np.zeros((len(chips), samples.fx.size))
    for near in _near(path, path_error_px, problem.chips, rng):
        otf = _otf(problem, replace(scenario, trajectory=near), chips, samples)
        shift = chips @ (_at_chips(near, problem.chips) - _at_chips(path, problem.chips))
        shift /= chips.sum(axis=1, keepdims=True)
        otf *= np.exp(2j * np.pi * (np.outer(shift[:, 0], samples.fx) + np.outer(shift[:, 1], samples.fy)))
        mean += otf / _DRAWS
        power += np.abs(otf) ** 2 / _DRAWS
    scatter = np.maximum(power - np.abs(mean) ** 2, 0.0)
    inverse = inverse_scene(samples)[:, 0]  # 1 / S
    errors = [
        ((scatter / inverse + variance[:, None]) / (power + variance[:, None] * inverse)) @ samples.weight
        for variance in variances.T
    ]
    return np.stack(errors, axis=1)


def _near(path: Trajectory, error_px: float, chips: int, rng: np.random.Generator) -> Iterator[Trajectory]:
    for _ in range(_DRAWS):
        yield with_smooth_error(path, error_px, rng=rng, samples=max(101, chips + 1))


def _at_chips(path: Trajectory, chips: int) -> FloatArray:
    return path.at((np.arange(chips) + 0.5) / chips)


def _otf(problem: SearchProblem, scenario: Scenario, chips: FloatArray, samples: BandSamples) -> NDArray[np.complex128]:
    """OTF (R, F) of codes (R, n)."""
    rows = scenario_rows(scenario, problem.chips, samples.fx, samples.fy, response=problem.response)
    if problem.response is None:
        return np.asarray(chips @ rows[:, 0, 0])
    left = np.pad(chips, ((0, 0), (1, 0)))[:, :-1]  # opened one after the other: the right neighbour is closed yet
    return np.asarray((chips * (1 - left)) @ rows[:, 0, 0] + (chips * left) @ rows[:, 1, 0])
