"""Photos of photographs, simulated along a motion, and the PSNR of their restoration.

A photo is taken through a code, or several at the same time by cameras with a code each, which are
restored together.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass
from functools import partial

import numpy as np

from cep.optics.camera import Camera
from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.optics.response import ShutterResponse
from cep.restoration.blur import trimmed_psf
from cep.restoration.clipping import fill_clipped
from cep.restoration.plug_and_play import pnp, pnp_together
from motdiff.crops import centre_crop
from motdiff.metrics import psnr, psnr_up_to_shift
from motdiff.motions import with_smooth_error
from motdiff.psf_frame import in_frame
from motdiff.threads import side_by_side
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

JUDGED_PX = 96
"""Side of the middle of each photo that is judged, for an estimate in seconds."""

# Left out around it, besides the reach of the PSF along each axis: what lies beyond the border is
# unknown, and that costs a sparse code 5 dB at 20 px and little at 60 px, a snapshot nothing.
# Most of a photo of some megapixels is farther in.
_LEAST_BORDER_PX = 8
_MOST_BORDER_PX = 40
_MOST_SHIFT_PX = 3.0  # of a photo restored along a path with an error


def restored(photo: FloatArray, psf: FloatArray, *, camera: Camera) -> FloatArray:
    """Restore a photo as :func:`cep.restoration.restore.restore` does along a known motion."""
    return pnp(fill_clipped(photo, psf), psf, camera=camera)


@dataclass(frozen=True)
class PhotoTrial:
    """Photos of photographs along motions, each through any code, restored as by default.

    The photographs are dealt to the motions. Noise and error of the path are the same for every
    code, so that the differences between codes are the codes' own.

    Parameters
    ----------
    motions : sequence of Trajectory
    photographs : sequence of (H, W) float ndarrays, linear light
    response : ShutterResponse, optional
        Rise and fall of the shutter.
    chip_ns : int
        Duration of a chip, ns, for the dark current.
    path_error_px : float
        Rms error of the path that a photo is restored along.
    seed : int
        Of the noise and of the paths' errors.
    judged_px : int
        Side of the middle of each photo that is judged.
    restore : callable
        Takes (photo, psf, camera=...), of one photo.
    """

    motions: Sequence[Trajectory]
    photographs: Sequence[FloatArray]
    _: KW_ONLY
    camera: Camera
    response: ShutterResponse | None = None
    chip_ns: int = 1_000_000
    path_error_px: float = 0.0
    seed: int = 0
    judged_px: int = JUDGED_PX
    restore: Callable[..., FloatArray] = restored

    def psnr_db(
        self,
        codes: Sequence[ShutterCode | tuple[ShutterCode, ...]],
        numbers: Sequence[int] | None = None,
        *,
        tell: Callable[[int], None] = lambda _finished: None,
    ) -> FloatArray:
        """PSNR, dB, of the restored photos in linear light, (codes, photographs).

        A tuple of codes holds those of cameras side by side. ``numbers`` say which photographs,
        all when omitted; ``tell`` gets the number of finished photos.
        """
        if numbers is None:
            numbers = range(len(self.photographs))
        jobs = [partial(self._measured, code, number) for code in codes for number in numbers]
        return np.array(side_by_side(jobs, tell=tell)).reshape(len(codes), len(numbers))

    def _measured(self, codes: ShutterCode | tuple[ShutterCode, ...], number: int) -> float:
        if isinstance(codes, ShutterCode):
            codes = (codes,)
        path = true_path = self.motions[number % len(self.motions)]
        if self.path_error_px > 0:
            rng = np.random.default_rng([self.seed, number, 1])
            true_path = with_smooth_error(path, self.path_error_px, rng=rng)
        psfs = self._psfs(path, codes)
        true_psfs = psfs if true_path is path else self._psfs(true_path, codes)
        side_px = self.judged_px
        reaches_px = np.max([_reaches_px(psf) for psf in psfs], axis=0).tolist()
        scene_side = len(true_psfs[0]) - 1
        photo_shape = [side_px + 2 * border_px(reach) for reach in reaches_px]
        scene = _middle(self.photographs[number], *(side + scene_side for side in photo_shape))
        rng = np.random.default_rng([self.seed, number, 2])
        cameras = [
            self.camera.with_dark_noise(code.integration_ns * 1e-9)
            for code in (ShutterCode(code.bits, self.chip_ns) for code in codes)
        ]
        photos = [
            capture(scene, psf, camera=camera, rng=rng)
            for psf, camera in zip(true_psfs, cameras, strict=True)
        ]
        if len(codes) == 1:
            image = self.restore(photos[0], psfs[0], camera=cameras[0])
        else:
            light = [fill_clipped(photo, psf) for photo, psf in zip(photos, psfs, strict=True)]
            image = pnp_together(light, psfs, cameras=cameras)
        compared = _middle(np.clip(image, 0, 1), side_px, side_px)
        truth = _middle(scene, side_px, side_px)
        if true_path is path:
            return psnr(compared, truth)
        # a shift of the restored photo is no error
        return psnr_up_to_shift(compared, truth, max_shift_px=_MOST_SHIFT_PX)

    def _psfs(self, path: Trajectory, codes: Sequence[ShutterCode]) -> list[FloatArray]:
        """PSF of each code along a path, all of one size."""
        size = (path.frame_size() + 4) | 1  # the shutter's ramps may reach beyond the path
        psfs = [trimmed_psf(coded_psf(path, code, size, response=self.response)) for code in codes]
        return [in_frame(psf, max(map(len, psfs))) for psf in psfs]


def grid_px(paths: Sequence[Trajectory]) -> int:
    """Pixels that a restoration of the largest photo has, of the open shutter along paths."""
    return max(
        math.prod(JUDGED_PX + 2 * (border_px(reach) + reach) for reach in _path_reaches_px(path))
        for path in paths
    )


def needed_px(paths: Sequence[Trajectory]) -> tuple[int, int]:
    """Height and width of the scene that photos along paths show, of the open shutter."""
    sides = []
    for path in paths:
        reaches = _path_reaches_px(path)
        sides.append([JUDGED_PX + 2 * (border_px(reach) + max(reaches)) for reach in reaches])
    height, width = np.max(sides, axis=0).tolist()
    return height, width


def _path_reaches_px(path: Trajectory) -> tuple[int, int]:
    """Farthest row and column of a path from its middle."""
    columns, rows = np.ceil(np.abs(path.xy).max(axis=0)).astype(int).tolist()
    return rows, columns


def _reaches_px(psf: FloatArray) -> tuple[int, int]:
    """Farthest row and column of a PSF's light from its middle."""
    rows, columns = (np.abs(axis - len(psf) // 2).max() for axis in np.nonzero(psf))
    return int(rows), int(columns)


def border_px(reach_px: int) -> int:
    """Pixels around what is judged, on each side, along an axis on which a PSF reaches so far."""
    return reach_px + min(_MOST_BORDER_PX, _LEAST_BORDER_PX + 2 * reach_px)


def _middle(image: FloatArray, height: int, width: int) -> FloatArray:
    """Middle of an image, which is mirrored at its borders where it is too small."""
    rows, columns = (max(0, height - image.shape[0]), max(0, width - image.shape[1]))
    if rows or columns:
        paddings = [((missing + 1) // 2,) * 2 for missing in (rows, columns)]
        image = np.pad(image, paddings, mode="symmetric")
    return centre_crop(image, height, width)
