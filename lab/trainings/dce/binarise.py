"""A binary code that can be trained: open or closed forward, the gradient of the relaxed code
backward.

Straight-through estimator: Bengio, Leonard and Courville, arXiv:1308.3432, 2013.
"""

from __future__ import annotations

import torch
from torch import Tensor

from cep.optics.code import ShutterCode

_THRESHOLD = 0.5


def binarise(weights: Tensor) -> Tensor:
    """Open the chips whose weight is above one half; if none is, the one of the largest weight.

    Backward, the gradient by a weight is the gradient by its chip as if that could be open in
    part. Weights outside 0..1 have none; training keeps them within, or those far outside could
    never come back.

    Parameters
    ----------
    weights : (n,) float

    Returns
    -------
    (n,) tensor of 0 and 1, at least one of them 1
    """
    relaxed = weights.clamp(0, 1)
    is_open = weights > _THRESHOLD
    is_open = is_open | ((torch.arange(weights.numel()) == weights.argmax()) & ~is_open.any())
    return is_open.to(weights.dtype) + (relaxed - relaxed.detach())


def code_of(weights: Tensor, *, chip_ns: int = 1_000_000) -> ShutterCode:
    """Shutter code that the weights (n,) stand for."""
    return ShutterCode.from_array(binarise(weights.detach()).numpy(), chip_ns=chip_ns)


def weights_of(code: ShutterCode, *, margin: float) -> Tensor:
    """Weights (n,) float32 that stand for ``code``, each ``margin`` from the threshold.

    Raises
    ------
    ValueError
        If the margin is not within 0..0.5, above 0.
    """
    if not 0 < margin <= _THRESHOLD:
        raise ValueError(f"margin: must be above 0 and at most {_THRESHOLD}, got {margin}")
    return torch.from_numpy(_THRESHOLD + margin * (2 * code.array - 1)).float()
