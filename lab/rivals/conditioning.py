"""Conditioning inputs of the learned estimators: physics maps of a photo's crops."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from motdiff.crops import best_windows
from motdiff.photo_values import textured_luminance
from motdiff.psf_frame import PSF_PX

if TYPE_CHECKING:
    from torch import Tensor

_MOST_CROPS = 3


def conditioning_maps(photo: ArrayLike) -> Tensor:
    """Compute a photo's :func:`motdiff.network.physics_maps.physics_maps`, (1, 8, 64, 64).

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light 0..1
        Of a large one its three best crops are used.

    Raises
    ------
    ValueError
        If the photo is smaller than 64 x 64 px, not finite, or without texture.
    """
    import torch

    from motdiff.estimators.motdiff.drawing import quick_search
    from motdiff.network.physics_maps import physics_maps
    from motdiff.photo_noise import noise_sigma

    grey = textured_luminance(photo, least_px=PSF_PX)  # of the lag maps
    crops = np.stack([grey[window] for window in best_windows(grey, count=_MOST_CROPS)])
    classical = quick_search(crops, sigma=noise_sigma(crops[0]))
    light, kernels = (
        torch.from_numpy(array.astype(np.float32))[None] for array in (crops, classical)
    )
    with torch.no_grad():
        return physics_maps(light, kernels)
