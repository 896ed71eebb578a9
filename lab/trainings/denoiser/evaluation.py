"""PSNR of photos outside the training set, restored with a denoiser and by the Wiener filter."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from torch import Tensor

from cep.optics.camera import Camera
from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.restoration.plug_and_play import pnp
from cep.restoration.wiener import wiener
from motdiff.metrics import psnr
from motdiff.motions import boracchi_foi
from motdiff.photo_values import to_linear
from motdiff.simulate import visible
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

_SIDE_PX = 330
_BORDER_PX = 25  # left out: half of what a border shows is a guess
_CODE = ShutterCode("1110000111000000000110110110011001110011")
SHUTTERS = {
    "open": ShutterCode("1" * _CODE.chips),
    "coded": _CODE,
    "snapshot": ShutterCode("0" * 18 + "1" * 5 + "0" * 17),
}
NOISE = ((2.0, 100_000.0), (2.0, 10_000.0), (50.0, 10_000.0), (10.0, 1000.0))
"""Read noise, e-, and photo-electrons at full scale."""


def restoration_rows(
    photos: Sequence[Tensor],
    denoiser: Callable[[FloatArray, FloatArray], FloatArray],
    *,
    seed: int = 0,
) -> Iterator[tuple[str, str, float, float, float, float]]:
    """Yield motion, shutter, read noise, photo-electrons, and the mean PSNR, dB, of the Wiener
    filter and of pnp with the denoiser; true path and camera known, linear light, real borders.

    Parameters
    ----------
    photos : sequence of (3, H, W) uint8 tensors, display values
    denoiser : callable
        Of :func:`cep.restoration.denoiser.network.load_denoiser`.
    seed : int
    """
    motions = {
        "straight 25 px": Trajectory.straight(25.0, angle_rad=0.4),
        "straight 40 px": Trajectory.straight(40.0),
        "walk 40 px": boracchi_foi(np.random.default_rng(3), max_length_px=40.0),
    }
    scenes = [_middle(to_linear(photo.numpy().transpose(1, 2, 0) / 255)) for photo in photos]
    inner = (slice(_BORDER_PX, -_BORDER_PX),) * 2
    for motion_name, motion in motions.items():
        for shutter, code in SHUTTERS.items():
            psf = coded_psf(motion, code)
            for read_noise_e, photons in NOISE:
                camera = Camera(photons_full_scale=photons, read_noise_e=read_noise_e)
                wiener_db, pnp_db = [], []
                for scene in scenes:
                    photo = capture(scene, motion, code, camera, rng=np.random.default_rng(seed))
                    truth = visible(scene, motion.frame_size() | 1)[inner]
                    restored = pnp(photo, psf, camera=camera, denoiser=denoiser)
                    wiener_db.append(psnr(wiener(photo, psf, camera=camera)[inner], truth))
                    pnp_db.append(psnr(restored[inner], truth))
                mean_db = (float(np.mean(wiener_db)), float(np.mean(pnp_db)))
                yield motion_name, shutter, read_noise_e, photons, *mean_db


def _middle(scene: FloatArray) -> FloatArray:
    height, width = scene.shape[:2]
    rows, columns = (
        slice((side - cut) // 2, (side + cut) // 2)
        for side, cut in ((height, min(height, _SIDE_PX)), (width, min(width, _SIDE_PX)))
    )
    return scene[rows, columns]
