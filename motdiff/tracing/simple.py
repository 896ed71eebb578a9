"""Ockham's razor for blind kernels: where a plain arc explains one, no walk through its noise is believed."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from motdiff.metrics import mnc_subpixel
from motdiff.psf_frame import PSF_PX
from motdiff.quadratic import quadratic_of_psf
from motdiff.tracing.path import trace_psf_to_trajectory
from motdiff.trajectory import Trajectory

__all__ = ["simplest_trajectory"]

_EXPLAINED_MNC = 0.86  # docs/decisions/tracing.md


def simplest_trajectory(psf: ArrayLike) -> Trajectory:
    """Turn an estimated PSF into a trajectory: a quadratic path where that explains the PSF, else a walk.

    A walk covers all that is drawn, so the blotches of a blind kernel make it several times too long and lose its order
    in time, which is what a shutter code is made for. A straight or evenly bent path cannot follow them.

    Parameters
    ----------
    psf : (H, W) array_like
        As :func:`motdiff.tracing.trace_psf`, to which what no quadratic path explains is left.
    """
    light = np.asarray(psf, dtype=np.float64)
    plain = quadratic_of_psf(light).trajectory()
    drawn = plain.psf(plain.frame_size(PSF_PX))
    return plain if mnc_subpixel(drawn, light) >= _EXPLAINED_MNC else trace_psf_to_trajectory(light)
