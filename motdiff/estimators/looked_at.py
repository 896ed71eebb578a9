"""What a learned estimator is told of a photo: crops of it, and what physics says about their blur."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from motdiff.crops import luminance, pick_crops

if TYPE_CHECKING:
    from torch import Tensor

__all__ = ["looked_at"]

_CROP_PX = 256
_LEAST_PX = 64  # of the lag maps
_MOST_CROPS = 3


def looked_at(photo: ArrayLike) -> Tensor:
    """Physics maps (1, 8, 64, 64) of a photo, see :func:`motdiff.conditions.physics_maps`.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light 0..1
        A large one is looked at in its three best crops.

    Raises
    ------
    ValueError
        If the photo is smaller than 64 x 64 px, not finite, or without texture.
    """
    import torch

    from motdiff.conditions import physics_maps
    from motdiff.estimators.judge import noise_sigma
    from motdiff.estimators.motdiff.drawing import searched_quickly

    grey = luminance(photo)
    if min(grey.shape) < _LEAST_PX:
        raise ValueError(f"photo: needs at least {_LEAST_PX} x {_LEAST_PX} px, got {grey.shape[1]} x {grey.shape[0]}")
    if np.ptp(grey) == 0:
        raise ValueError("photo: is constant; motion shows only where the scene has texture")
    crops: NDArray[np.float64] = grey[None]
    if max(grey.shape) > 1.25 * _CROP_PX:
        size = min(_CROP_PX, *grey.shape)
        corners = pick_crops(grey, size=size, count=_MOST_CROPS)
        crops = np.stack([grey[row : row + size, column : column + size] for row, column in corners])
    told = searched_quickly(crops, sigma=noise_sigma(crops[0]))
    light, kernels = (torch.from_numpy(array.astype(np.float32))[None] for array in (crops, told))
    with torch.no_grad():
        return physics_maps(light, kernels)
