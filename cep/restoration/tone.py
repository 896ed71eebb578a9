"""Curve of a photo's file: whether its code values are rather light than sRGB.

Blur adds up light. Read on the wrong curve a photo is no blurred scene any more: its restoration
leaves more of a residual, and more impossible light.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from cep.restoration.sharpen import unexplained
from motdiff.simulate import to_display

# Logarithm of the ratio of what the two readings leave unexplained. On 27 simulated photos along
# motions known to 0 to 0.5 px those in sRGB had 0.02 at most, and 20 linear ones more than this:
# docs/decisions/restoration.md
_CLEARLY = 0.15


def looks_linear(photo: ArrayLike, psf: ArrayLike) -> bool:
    """Whether a file that was read as sRGB fits its blur better if its code values are light.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light 0..1
        As it was read.
    psf : (S, S) array_like
        Light-true.

    Examples
    --------
    >>> from motdiff.simulate import blur_valid, to_linear
    >>> scene = np.kron(np.random.default_rng(0).random((16, 16)), np.ones((10, 10)))
    >>> kernel = np.pad(np.full((1, 9), 1 / 9), ((4, 4), (0, 0)))
    >>> light = blur_valid(scene, kernel)
    >>> looks_linear(light, kernel), looks_linear(to_linear(light), kernel)
    (False, True)
    """
    as_light, explains = unexplained(to_display(np.clip(photo, 0, 1)), psf)
    as_read, _ = unexplained(photo, psf)
    return explains and bool(as_read > np.exp(_CLEARLY) * as_light)  # a wrong PSF fits neither
