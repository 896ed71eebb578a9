"""Simulated photos of photographs, through codes, and the PSNR of their restoration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.restoration.blur import trimmed_psf
from cep.search.problem import SearchProblem
from motdiff.crops import centre_crop
from motdiff.metrics import psnr, psnr_up_to_shift
from motdiff.motions import with_smooth_error
from motdiff.threads import side_by_side
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

JUDGED_PX = 128
"""Side of the middle of each photo that is judged."""

# left out around it, besides the reach of the PSF: a border costs a code 2 dB at 20 px and nothing
# at 60 px (docs/decisions/restoration.md), and most of a photo of some megapixels is farther in
_BORDER_PX = 40


class Trial:
    """Photos of given scenes along a problem's motion, and their restoration.

    The scenes are dealt to the motions and directions of the problem. The noise and the error of
    the path are the same for every code, so that differences between codes are the codes' own.

    Parameters
    ----------
    problem : SearchProblem
        Its motions, shutter and camera count.
    scenes : sequence of (H, W) float ndarrays, linear light
    restore : callable
        Takes (photo, psf, camera=...), as :func:`cep.restoration.pnp.pnp` does.
    path_error_px : float
        Rms error of the path that a photo is restored along.
    """

    def __init__(
        self,
        problem: SearchProblem,
        scenes: Sequence[FloatArray],
        restore: Callable[..., FloatArray],
        *,
        path_error_px: float = 0.0,
    ) -> None:
        self._problem = problem
        self._scenes = scenes
        self._restore = restore
        self._path_error_px = path_error_px
        self._paths = [
            scenario.path(reversed_path=reversed_path)
            for scenario in sorted(problem.scenarios, key=lambda scenario: -scenario.weight)
            for reversed_path in problem.directions(scenario)
        ]

    def psnr_db(self, codes: Sequence[ShutterCode]) -> FloatArray:
        """PSNR, dB, of each restored photo in linear light, (codes, scenes)."""
        jobs = [
            partial(self._measured, code, number)
            for code in codes
            for number in range(len(self._scenes))
        ]
        return np.array(side_by_side(jobs)).reshape(len(codes), len(self._scenes))

    def _measured(self, code: ShutterCode, number: int) -> float:
        path = self._paths[number % len(self._paths)]
        true_path = path
        if self._path_error_px > 0:
            rng = np.random.default_rng([number, 1])
            true_path = with_smooth_error(path, self._path_error_px, rng=rng)
        psf = self._psf(path, code)
        true_psf = self._psf(true_path, code)
        camera = self._problem.camera.with_dark_noise(code.integration_ns * 1e-9)
        photo_px = JUDGED_PX + 2 * (len(psf) // 2 + _BORDER_PX)
        scene = _middle(self._scenes[number], photo_px + len(true_psf) - 1)
        photo = capture(scene, true_psf, camera=camera, rng=np.random.default_rng([number, 2]))
        restored = _middle(np.clip(self._restore(photo, psf, camera=camera), 0, 1), JUDGED_PX)
        truth = _middle(scene, JUDGED_PX)
        if true_path is path:
            return psnr(restored, truth)
        return psnr_up_to_shift(restored, truth)  # a shift of the restored photo is no error

    def _psf(self, path: Trajectory, code: ShutterCode) -> FloatArray:
        size = (path.frame_size() + 4) | 1  # the shutter's ramps may reach beyond the path
        return trimmed_psf(coded_psf(path, code, size, response=self._problem.response))


def _middle(image: FloatArray, side_px: int) -> FloatArray:
    """Middle of an image, which is mirrored at its borders where it is too small."""
    missing = max(0, side_px - min(image.shape))
    wide = np.pad(image, (missing + 1) // 2, mode="symmetric")
    return centre_crop(wide, side_px, side_px)
