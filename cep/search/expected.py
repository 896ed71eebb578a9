"""Expected PSNR of the restoration through codes, at any light and error of the path."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cep.optics.band import BandSamples, band_samples, grid_samples
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.exposure import chip_rows, coded_sum, distinct_rows
from cep.optics.response import ShutterResponse, open_time
from cep.optics.scene import PHOTO, Scene, inverse_scene, noise_variance, wiener_mse
from cep.optics.straight_motion import straight_axis
from cep.search.problem import Scenario, SearchProblem
from motdiff.motions import with_smooth_error
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

WORTH_DB = 0.1
"""Expected gain below which the simpler exposure is advised."""

_OVERSAMPLING = 16  # samples per 1 / extent of a straight motion: twice a search's
_INTERVALS = 128  # a side of a curved motion's grid: twice a search's
_PAIRS = 16  # draws of a path's error; opposite ones cancel what is linear in the error
_TOLERANCE_PX = 0.003  # by which a path is thinned: the work grows with its samples


def open_share(
    codes: Sequence[ShutterCode], response: ShutterResponse | None = None
) -> FloatArray:
    """Share of the exposure that each code lets in, (R,), with the shutter's ramps."""
    return open_time(np.array([code.array for code in codes]), response)


def light_noise(
    camera: Camera,
    codes: Sequence[ShutterCode],
    *,
    response: ShutterResponse | None = None,
    scene: Scene = PHOTO,
) -> FloatArray:
    """Variance of the noise through each code, (R,): the light falls with the open time.

    Dark current counts for each code's integration time.
    """
    return noise_variance(
        camera, open_share(codes, response), integration_s=_integration_s(codes), scene=scene
    )


def collected_e(
    camera: Camera, codes: Sequence[ShutterCode], *, response: ShutterResponse | None = None
) -> FloatArray:
    """Electrons of light and dark current in a pixel of value 1 through each code, (R,)."""
    light_e = camera.photons_full_scale * open_share(codes, response)
    return np.asarray(light_e + camera.dark_e(_integration_s(codes)), dtype=np.float64)


def equal_light_noise(
    camera: Camera,
    codes: Sequence[ShutterCode],
    *,
    response: ShutterResponse | None = None,
    scene: Scene = PHOTO,
) -> FloatArray:
    """Variance of the noise, (R,), where a brighter lamp makes up for the closed time.

    A pixel collects as many photo-electrons through every code as with the shutter open, and has
    the same photon noise. It is given relative to what the lamp would give an open shutter, as the
    OTF is.
    """
    return (
        noise_variance(camera, 1.0, integration_s=_integration_s(codes), scene=scene)
        * open_share(codes, response) ** 2
    )


class ExpectedPsnr:
    """Expected PSNR of codes along a problem's motions; tables may be reused between codes.

    Where the path is known to ``path_error_px`` only, the filter knows the mean and the scatter of
    the OTF H over such paths, each shifted so that the code's light stays in place: a shift of the
    restored photo is no error. The least mean square error of a linear filter is then the mean
    over the band of
    ``S (S (E|H|^2 - |E H|^2) + N) / (S E|H|^2 + N)``, with the scene's spectrum S and the noise N.

    Parameters
    ----------
    problem : SearchProblem
        Its motions, directions and shutter; its objective and camera do not matter.
    path_error_px : float
        Rms over time, smooth; see :func:`motdiff.motions.with_smooth_error`.
    most_bytes : int
        The chips' OTFs are computed once and kept, in single precision, where they take at most so
        much memory. With an error of the path, a code is then judged some 50 times as fast.

    Raises
    ------
    ValueError
        If the error is negative or not finite, or the problem has no motion.
    """

    def __init__(
        self,
        problem: SearchProblem,
        *,
        path_error_px: float = 0.0,
        most_bytes: int = 0,
    ) -> None:
        if not (np.isfinite(path_error_px) and path_error_px >= 0):
            raise ValueError(f"path_error_px: must be 0 px or more, got {path_error_px:g}")
        if not problem.scenarios:
            raise ValueError("scenarios: need a motion to expect a restoration along")
        self.problem = problem
        rng = np.random.default_rng(0)  # the same draws for all codes: only they differ
        self._motions = [
            [
                _DirectedMotion(problem, directed, path_error_px, rng)
                for directed in directed_scenarios(problem, scenario)
            ]
            for scenario in problem.scenarios
        ]
        motions = [motion for directions in self._motions for motion in directions]
        if sum(motion.kept_bytes for motion in motions) <= most_bytes:
            for motion in motions:
                motion.keep()

    def psnr_db(self, codes: Sequence[ShutterCode], *, noise: ArrayLike) -> FloatArray:
        """Return the PSNR, dB, of the best linear restoration of the scene, (codes, L).

        The worse direction counts.

        Parameters
        ----------
        codes : sequence of ShutterCode
        noise : (L, R) array_like
            Variance through each code, as :func:`light_noise` and :func:`equal_light_noise` give
            it, for L cases.
        """
        chips = np.array([code.array for code in codes])
        variances = np.atleast_2d(np.asarray(noise, dtype=np.float64)).T
        errors = [
            [motion.error(chips, variances) for motion in directions]
            for directions in self._motions
        ]
        return worst_psnr_db(self.problem, errors)


def joint_psnr_db(
    problem: SearchProblem, codes: Sequence[ShutterCode], *, noise: ArrayLike
) -> FloatArray:
    """PSNR, dB, of the best linear restoration from several frames, one through each code, (L,).

    The least mean square error is the mean over the band of ``1 / (1 / S + sum over frames of
    |H|^2 / N)``. M frames through the same code are as good as one with an Mth of the noise.

    Parameters
    ----------
    problem : SearchProblem
        As of :class:`cep.search.expected.ExpectedPsnr`.
    codes : sequence of ShutterCode
        Of each frame.
    noise : (L, R) array_like
        Variance through each code, for L cases.
    """
    chips = np.array([code.array for code in codes])
    variances = np.atleast_2d(np.asarray(noise, dtype=np.float64))

    def error(scenario: Scenario) -> FloatArray:
        samples = motion_samples(scenario.trajectory, exact=True)
        power = np.abs(coded_sum(motion_rows(problem, scenario, samples), chips)) ** 2
        # frames add up as |H|^2 / N: noise of 1 is left
        powers = [(power / variance[:, None]).sum(axis=0) for variance in variances]
        return np.array([wiener_mse(total, samples, 1.0, scene=problem.scene) for total in powers])

    errors = [
        [error(directed) for directed in directed_scenarios(problem, scenario)]
        for scenario in problem.scenarios
    ]
    return worst_psnr_db(problem, errors)


def directed_scenarios(problem: SearchProblem, scenario: Scenario) -> list[Scenario]:
    """Return the scenario in each direction that counts, its path thinned."""
    paths = problem.directed(scenario.trajectory)
    return [replace(scenario, trajectory=path.thinned(_TOLERANCE_PX)) for path in paths]


def worst_psnr_db(problem: SearchProblem, errors: Sequence[Sequence[FloatArray]]) -> FloatArray:
    """Return the PSNR, dB, of errors by motion and direction: the worse direction counts."""
    errors_db = [10 * np.log10(np.max(along, axis=0)) for along in errors]
    if problem.rule == "mean":
        weights = np.array([scenario.weight for scenario in problem.scenarios])
        return -np.tensordot(weights / weights.sum(), np.array(errors_db), axes=1)
    return -np.asarray(np.max(errors_db, axis=0), dtype=np.float64)  # full scale is 1


class _DirectedMotion:
    """Mean square error of codes along a path that is one of those near it, as far as is known."""

    def __init__(
        self,
        problem: SearchProblem,
        scenario: Scenario,
        path_error_px: float,
        rng: np.random.Generator,
    ) -> None:
        self._problem = problem
        self._scenario = scenario
        path = scenario.trajectory
        self._paths = [path]
        if path_error_px > 0:
            self._paths = list(_perturbed_paths(path, path_error_px, rng))
        self._samples = motion_samples(path, exact=len(self._paths) == 1)
        self._otfs: list[NDArray[np.complex64]] | None = None

    @property
    def kept_bytes(self) -> int:
        """Memory of the OTFs if they are kept."""
        states = 1
        if self._problem.response is not None:
            states = 4  # of a chip's two neighbours
        otfs = len(self._paths) * self._problem.chips * states
        return otfs * self._samples.fx.size * np.complex64().itemsize

    def keep(self) -> None:
        """Keep the OTFs of the chips along every path."""
        self._otfs = [rows.astype(np.complex64) for rows in self._all_rows()]

    def error(self, chips: FloatArray, variances: FloatArray) -> FloatArray:
        """Mean square error (R, L) of codes (R, n)."""
        problem = self._problem
        samples = self._samples
        path = self._scenario.trajectory
        mean = np.zeros((len(chips), samples.fx.size), dtype=complex)
        power = np.zeros((len(chips), samples.fx.size))
        otfs: Iterable[NDArray[Any]] = self._otfs or self._all_rows()
        for path_drawn, rows in zip(self._paths, otfs, strict=True):
            otf = coded_sum(rows, chips)
            if path_drawn is not path:
                # each code's light stays in place: a shift of the restored photo is no error
                middles = (np.arange(problem.chips) + 0.5) / problem.chips
                shift = chips @ (path_drawn.at(middles) - path.at(middles))
                shift /= chips.sum(axis=1, keepdims=True)
                turns = np.outer(shift[:, 0], samples.fx) + np.outer(shift[:, 1], samples.fy)
                otf = otf * np.exp(2j * np.pi * turns)
            mean += otf / len(self._paths)
            power += np.abs(otf) ** 2 / len(self._paths)
        # the mean is of the same draws: Bessel's correction; the difference may round below 0
        unbiased = len(self._paths) / max(len(self._paths) - 1, 1)
        scatter = np.maximum(power - np.abs(mean) ** 2, 0.0) * unbiased
        inverse = inverse_scene(samples, scene=problem.scene)  # 1 / S
        errors = []
        for variance in variances.T:
            noise = variance[:, None]
            error = sum(
                samples.radius2_weight[:, q]
                * (scatter / inverse[:, q] + noise)
                / (power + noise * inverse[:, q])
                for q in range(inverse.shape[1])
            )
            errors.append(error @ samples.weight)
        return np.stack(errors, axis=1)

    def _all_rows(self) -> Iterator[NDArray[np.complex128]]:
        for path in self._paths:
            scenario = replace(self._scenario, trajectory=path)
            yield motion_rows(self._problem, scenario, self._samples)


def motion_rows(
    problem: SearchProblem, scenario: Scenario, samples: BandSamples
) -> NDArray[np.complex128]:
    """OTFs of the chips at the samples, (n, V, frequencies)."""
    rows = chip_rows(
        scenario.trajectory, problem.chips, samples.fx, samples.fy, response=problem.response
    )
    return distinct_rows(rows, problem.response)


def motion_samples(path: Trajectory, *, exact: bool) -> BandSamples:
    """Return samples finer than a search's, whose code may have valleys between them.

    An error of a curved path fills such valleys, and the search's samples do. One of a straight
    path bends it, and needs a grid.
    """
    straight = straight_axis(path) is not None
    if straight == exact:
        return band_samples(path, oversampling=_OVERSAMPLING)
    return grid_samples(max(_INTERVALS, 2 * int(np.ceil(path.extent_px))))


def _perturbed_paths(
    path: Trajectory, error_px: float, rng: np.random.Generator
) -> Iterator[Trajectory]:
    for _ in range(_PAIRS):
        seed = int(rng.integers(2**32))
        for sign in (1.0, -1.0):
            yield with_smooth_error(path, error_px, rng=np.random.default_rng(seed), sign=sign)


def _integration_s(codes: Sequence[ShutterCode]) -> FloatArray:
    return np.array([code.integration_ns for code in codes]) * 1e-9
