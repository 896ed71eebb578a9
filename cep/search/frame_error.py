"""Expected error of a photo of finite size along a motion that is straight or not much bent, with
what lies beyond its border.

An objective adds up errors frequency by frequency, as if a photo had no border. But light from
beyond it falls into the photo, and where |H| is small what is unknown there reaches far into the
middle. Codes that an objective puts within 0.1 dB differ by 4 dB for that reason, on photographs
as well: ``python -m lab.studies.frame_error``.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve, toeplitz

from cep.optics.code import ShutterCode
from cep.optics.scene import Scene
from cep.photographs.trial import JUDGED_PX, border_px
from cep.proofs.mtf_curves import main_axis
from cep.search.expected import light_noise, worst_psnr_db
from cep.search.exposures import ExposureFinder, kind_of, recordable
from cep.search.problem import SearchProblem
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

_LONGEST_PX = 128.0  # along the main axis: beyond, the covariances of a photo take long
_SEARCHES = 12
_DESCENTS = 3
# Width over length of a path that is judged as if it were straight: along wider ones codes that an
# objective finds equal are nearly equal on photographs too.
_WIDEST = 1 / 3
_PIXELS = 12  # of the middle, in which the error is evaluated
_PERIOD_PX = 4_096  # of the scene that a covariance is computed of
# frequencies across the motion, denser near 0, where a scene's power is: more rank codes no better
_ACROSS = 3


def is_framed(problem: SearchProblem) -> bool:
    """Whether :class:`FrameError` can judge codes: of one camera, along short narrow paths.

    Narrow is a path up to a third as wide as it is long.
    """
    paths = [scenario.trajectory for scenario in problem.scenarios]
    return problem.frames == 1 and bool(paths) and all(map(_is_narrow, paths))


def codes_of_a_frame(
    problem: SearchProblem,
    starts: Sequence[ShutterCode],
    *,
    seed: int,
    threads: int | None,
    progress: Callable[[float], None] = lambda _share: None,
) -> list[ShutterCode]:
    """Search codes that are the best in photos with borders.

    Several searches by the expected error end at codes that are nearly equal by it; the best of
    them in a photo are improved, and returned as they were as well.

    Parameters
    ----------
    problem : SearchProblem
        One of :func:`is_framed`.
    starts : sequence of ShutterCode
        Those of kind "code" compete with the codes of the searches.
    progress : callable, optional
        Called with the finished share, 0..1.

    Raises
    ------
    KeyboardInterrupt
        After Ctrl-C.
    """
    unsaturated = recordable(problem, single=False)
    if unsaturated is None:
        return []
    # along exact lines the searches are many times as quick
    lines = [replace(s, trajectory=_line(s.trajectory)) for s in unsaturated.scenarios]
    along_lines = replace(unsaturated, scenarios=tuple(lines))
    finder = ExposureFinder(unsaturated if unsaturated.straight else along_lines)
    codes = [*starts]
    for number in range(_SEARCHES):
        codes += finder.codes(problem.camera, (), seed=seed + number, threads=threads, swaps=False)
        progress((number + 1) / (_SEARCHES + _DESCENTS))
    # single exposures need no search; a code backwards in time is no other to begin with
    distinct = {
        min(code.bits, code.bits[::-1]): code
        for code in reversed(codes)
        if kind_of(code) == "code" and unsaturated.allows(code)
    }
    codes = [*distinct.values()]
    in_frame = FrameError(unsaturated)
    order = np.argsort(in_frame.of_codes_db(codes), kind="stable")[:_DESCENTS]
    best = [codes[index] for index in order]
    descended = []
    for number, code in enumerate(best):
        descended.append(in_frame.descended(code))
        share = (number + 1) / len(best)
        progress((_SEARCHES + _DESCENTS * share) / (_SEARCHES + _DESCENTS))
    return [*dict.fromkeys([*descended, *best])]


class FrameError:
    """Least mean square error in the middle of a photo, of codes along narrow paths.

    Each path counts as its projection on its main axis.

    Parameters
    ----------
    problem : SearchProblem
        One of :func:`is_framed`. The ramps of its shutter do not count.

    Notes
    -----
    At a frequency v across the motion the scene is a stationary process x along it, of the
    covariance ``r_v(d) = int S(u, v) cos(2 pi u d) du``, and the photo ``y = A x + n`` has M
    pixels. The error is that of the best linear estimate of x, ``r_v(0) - c^T K^-1 c`` with
    ``K = A R A^T + N`` and ``c = cov(y, x)``, integrated over v. K is Toeplitz, as the photo is
    stationary too.
    """

    def __init__(self, problem: SearchProblem) -> None:
        self.problem = problem
        self._motions = [
            [
                _Projection(path, problem.chips, problem.scene)
                for path in problem.directed(scenario.trajectory)
            ]
            for scenario in problem.scenarios
        ]

    def of_codes_db(self, codes: Sequence[ShutterCode]) -> FloatArray:
        """Error of R codes, dB, (R,): along the worst motion, or as the problem's rule says."""
        if not codes:
            return np.empty(0)
        problem = self.problem
        played = [ShutterCode(code.bits, problem.chip_ns) for code in codes]
        noise = light_noise(problem.camera, played, scene=problem.scene)
        errors = [
            [
                np.array(
                    [motion.error(code.array, N) for code, N in zip(codes, noise, strict=True)]
                )
                for motion in directions
            ]
            for directions in self._motions
        ]
        return -worst_psnr_db(problem, errors)

    def descended(self, code: ShutterCode) -> ShutterCode:
        """Change single chips, and neighbours together, as long as that lowers the error."""
        single = np.eye(code.chips, dtype=np.int8)
        changes = np.concatenate([single, single[:-1] | single[1:]])
        (lowest_db,) = self.of_codes_db([code])
        without_gain = 0
        for change in itertools.cycle(changes):
            bits = code.array.astype(np.int8) ^ change
            without_gain += 1
            if self.problem.satisfied(bits[None])[0]:
                candidate = ShutterCode(bits, code.chip_ns)
                (error_db,) = self.of_codes_db([candidate])
                if error_db < lowest_db:
                    code, lowest_db = candidate, error_db
                    without_gain = 0
            if without_gain == len(changes):
                break
        return code


class _Projection:
    """A path's projection through the chips of a code, and the scene's covariances along it."""

    def __init__(self, path: Trajectory, chips: int, scene: Scene) -> None:
        line = _line(path)
        size = line.frame_size() | 1
        self.kernels = line.slice_psfs(np.linspace(0, 1, chips + 1), size).sum(axis=1)
        self.photo_px = JUDGED_PX + 2 * border_px(int(np.ceil(np.abs(line.x).max())))
        scene_px = self.photo_px + size - 1
        middle = scene_px // 2 + np.linspace(-JUDGED_PX / 2, JUDGED_PX / 2, _PIXELS, dtype=int)
        # lags of the blurred scene at the photo's pixels from those of the middle
        self.lags = size - 1 - (middle[:, None] - np.arange(self.photo_px))
        u = np.fft.fftfreq(_PERIOD_PX)
        places = (np.arange(_ACROSS) + 0.5) / _ACROSS
        self.weights = 3 * places**2 / _ACROSS  # v = t^3 / 2, on both sides of 0
        powers = scene.power(u**2 + (places[:, None] ** 3 / 2) ** 2)
        covariances = np.fft.ifft(powers).real[:, :scene_px]
        self.covariances = np.concatenate([covariances[:, :0:-1], covariances], axis=1)

    def error(self, chips: FloatArray, noise: float) -> float:
        """Error of the best linear estimate through a code, with noise of that variance."""
        M = self.photo_px
        h = chips @ self.kernels
        power = np.convolve(h, h[::-1])
        total = 0.0
        for weight, r in zip(self.weights, self.covariances, strict=True):
            K = toeplitz(np.convolve(r, power, "valid")[M - 1 :])
            K[np.diag_indices(M)] += noise
            c = np.convolve(r, h, "valid")[self.lags + M - 1]
            explained = np.einsum("ij,ji->i", c, cho_solve(cho_factor(K, lower=True), c.T))
            total += weight * float(r[r.size // 2] - explained.mean())
        return total


def _line(path: Trajectory) -> Trajectory:
    """Move along the x axis as a path does along its main axis."""
    along = path.xy @ main_axis(path)
    return replace(path, xy=np.stack([along, np.zeros_like(along)], axis=1))


def _is_narrow(path: Trajectory) -> bool:
    if path.extent_px == 0:
        return False
    x, y = main_axis(path)
    length_px = np.ptp(path.xy @ [x, y])
    width_px = np.ptp(path.xy @ [-y, x])
    return bool(length_px <= _LONGEST_PX and width_px <= _WIDEST * length_px)
