"""The code and the network in the package: one code for all motions, and a restoration that is told no motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cep.codes.dce.card import read_card
from cep.optics.code import ShutterCode
from cep.restoration.spectral import channels_first, channels_last

__all__ = ["SHIPPED", "dce_code", "restore"]

FloatArray = NDArray[np.float64]
SHIPPED = Path(__file__).with_name("dce.safetensors")
"""The weights in the package."""


def dce_code(path: Path = SHIPPED) -> ShutterCode:
    """Return the learned code of a weights file.

    Raises
    ------
    ValueError
        If the file is not one of ours.
    """
    return read_card(path).code


def restore(photo: ArrayLike, *, code: ShutterCode | None = None, path: Path = SHIPPED) -> FloatArray:
    """Restore a coded photo with the network alone; it is not told the motion.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light
        Light-true: a scene of value 1 is recorded as the code's duty.
    code : ShutterCode, optional
        The code it was taken with; the file's own when omitted. Only its duty counts.
    path : path
        Weights file; the shipped one when omitted.

    Returns
    -------
    float ndarray like ``photo``
        At the scale of the full open exposure, not clipped. Each channel is restored by itself, in about 1.2 s and
        120 MiB per megapixel on one core.

    Raises
    ------
    ValueError
        If the photo is malformed or the file is not one of ours.
    """
    import torch

    from cep.codes.dce.weights import load_network

    channels = channels_first(photo) / (code or dce_code(path)).duty
    network = load_network(path)
    with torch.inference_mode():
        restored = [network(torch.from_numpy(channel[None, None]).float())[0, 0].numpy() for channel in channels]
    return channels_last(np.stack(restored).astype(np.float64))
