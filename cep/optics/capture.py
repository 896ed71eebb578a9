"""Simulated photo of a scene, through a coded shutter while the camera moves."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from motdiff.simulate import photograph
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray


def capture(
    scene: ArrayLike,
    motion: Trajectory | ArrayLike,
    code: ShutterCode | None = None,
    camera: Camera | None = None,
    *,
    rng: np.random.Generator,
    borders: str = "real",
) -> FloatArray:
    """Simulate the photo of a scene: motion, code, photon and read noise, clipping, quantisation.

    Parameters
    ----------
    scene : (H, W) or (H, W, 3) array_like, linear light
        As an exposure with the shutter open all the time would record it at rest, 0..1.
    motion : Trajectory or (S, S) array_like
        The camera's path, drawn in the smallest odd frame that holds it; or a light-true PSF,
        which sums to the open fraction of the exposure and holds its code already.
    code : ShutterCode, optional
        Of an exposure along a trajectory; the open shutter when omitted. A coded photo is darker.
    borders : {"real", "symmetric"}
        As of :func:`motdiff.simulate.photograph`, which takes the photo.

    Returns
    -------
    (H - S + 1, W - S + 1[, 3]) float ndarray, linear light 0..1, or with symmetric borders of the
    scene's shape
        It shows :func:`motdiff.simulate.visible` of the scene.

    Raises
    ------
    ValueError
        If the scene or PSF is malformed, the scene is smaller than the PSF, or a code is given
        with a PSF.

    Examples
    --------
    >>> path = Trajectory.straight(20.0)
    >>> rng = np.random.default_rng(0)
    >>> photo = capture(np.full((64, 64), 0.8), path, ShutterCode("1010"), rng=rng)
    >>> photo.shape, round(float(photo.mean()), 2)
    ((42, 42), 0.4)
    """
    sensor = camera or Camera()
    light = np.asarray(scene, dtype=np.float64)
    if light.ndim not in (2, 3) or not np.isfinite(light).all() or light.min(initial=0.0) < 0:
        raise ValueError(
            f"scene: must be finite, non-negative (H, W) or (H, W, 3), got shape {light.shape}"
        )
    if isinstance(motion, Trajectory):
        # an odd frame: its zero displacement is the middle pixel, so the photo is not shifted
        kernel = coded_psf(motion, code or ShutterCode("1"), size=motion.frame_size() | 1)
    elif code is not None:
        raise ValueError("code: goes with a trajectory; a PSF holds its code already")
    else:
        kernel = np.asarray(motion, dtype=np.float64)
    if kernel.ndim != 2 or not np.isfinite(kernel).all() or kernel.min(initial=0.0) < 0:
        raise ValueError(f"psf: must be finite, non-negative (S, S), got shape {kernel.shape}")
    if min(light.shape[:2]) < max(kernel.shape):
        raise ValueError(
            f"scene: {light.shape[1]} x {light.shape[0]} px is smaller than the PSF frame of"
            f" {kernel.shape[0]} px"
        )
    # the light is that of the open shutter: a light-true PSF darkens it
    return photograph(
        light, kernel, rng=rng, borders=borders, record=sensor.quantise, **sensor.noise
    )
