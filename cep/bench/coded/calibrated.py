"""First stage of the coded-exposure table, a pure function: the calibration photo and the motion in it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cep.bench.coded.paths import paths_from, paths_to
from cep.camera import Camera, capture
from motdiff.metrics import mnc_subpixel
from motdiff.psf_frame import PSF_PX

__all__ = ["estimate_motion"]


def estimate_motion(
    scene: ArrayLike, motion: str, *, method: str, borders: str, camera: Mapping[str, Any], seed: int
) -> dict[str, float | str]:
    """Take the calibration photo, shutter open, and estimate the motion from it.

    Parameters
    ----------
    scene : (H, W) array_like, linear light 0..1
    motion : str
        True path, of :func:`cep.bench.coded.paths.paths_to`.
    method : str
        Name of an estimator of :mod:`motdiff.evaluation.methods`.
    borders : {"real", "symmetric"}
    camera : mapping
        Of :meth:`cep.camera.Camera.to_dict`.
    seed : int

    Returns
    -------
    dict with ``paths``, ``mnc`` (sub-pixel, of the path's own PSF), ``cpu_s``
    """
    from motdiff.evaluation.methods import named_estimators

    truth = paths_from(motion)[0][0]
    rng = np.random.default_rng([seed, 1])
    photo = capture(scene, truth.psf(PSF_PX), Camera.from_dict(camera), rng=rng, borders=borders)
    estimator = named_estimators([method])[method]
    started = time.process_time()
    estimate = estimator.estimate(np.clip(photo, 0, 1))
    seconds = time.process_time() - started
    found = estimate.trajectories[0]
    return {
        "paths": paths_to(estimate.trajectories, estimate.weights),
        "mnc": mnc_subpixel(found.psf(found.frame_size(PSF_PX)), truth.psf(PSF_PX)),
        "cpu_s": seconds,
    }
