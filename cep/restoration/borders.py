"""Periodic extension of a photo beyond its real borders, by a membrane between opposite edges."""

from __future__ import annotations

import numpy as np
from scipy import fft

from motdiff.types import FloatArray

_SMALLEST_GAP_PX = 16  # a membrane over fewer pixels is a step at the seam, which rings


def extended_shape(shape: tuple[int, int], psf_shape: tuple[int, int]) -> tuple[int, int]:
    """FFT-friendly size, with a gap of at least the PSF's reach on both sides of the photo."""
    rows, columns = (
        int(fft.next_fast_len(side + max(psf_side - 1, _SMALLEST_GAP_PX), real=True))
        for side, psf_side in zip(shape, psf_shape, strict=True)
    )
    return rows, columns


def membrane_extension(image: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Extend ``image`` to ``shape`` by a membrane that spans from each edge to the opposite one.

    Parameters
    ----------
    image : (H, W) float
    shape : (H', W') at least (H, W)

    Returns
    -------
    (H', W') float ndarray
        ``image`` at the top left; below and to the right of it, values that join up periodically.

    References
    ----------
    Liu and Jia, "Reducing boundary artifacts in image deconvolution", ICIP 2008: the three tiles;
    here each one is harmonic (solved with the DST).
    """
    height, width = image.shape
    rows = shape[0] - height
    columns = shape[1] - width
    out = np.empty(shape)
    out[:height, :width] = image
    below = _tile(image[-1], image[0], rows)  # (rows + 2, W), with the photo's own edge rows
    right = _tile(image[:, -1], image[:, 0], columns).T  # (H, columns + 2)
    out[height:, :width] = below[1:-1]
    out[:height, width:] = right[:, 1:-1]
    if rows and columns:
        corner = np.zeros((rows + 2, columns + 2))
        corner[0], corner[-1] = right[-1], right[0]
        corner[:, 0], corner[:, -1] = below[:, -1], below[:, 0]
        out[height:, width:] = _harmonic(corner)[1:-1, 1:-1]
    return out


def _tile(first: FloatArray, last: FloatArray, gap: int) -> FloatArray:
    """Harmonic strip (gap + 2, N) from row ``first`` to row ``last``, its two sides linear."""
    strip = np.zeros((gap + 2, first.size))
    strip[0], strip[-1] = first, last
    ramp = np.linspace(0, 1, gap + 2)
    for column in (0, -1):
        strip[:, column] = (1 - ramp) * first[column] + ramp * last[column]
    return _harmonic(strip)


def _harmonic(tile: FloatArray) -> FloatArray:
    """Solve the 5-point Laplace equation inside ``tile`` for the values on its frame."""
    rows = tile.shape[0] - 2
    columns = tile.shape[1] - 2
    if rows < 1 or columns < 1:
        return tile
    source = np.zeros((rows, columns))
    source[0] += tile[0, 1:-1]
    source[-1] += tile[-1, 1:-1]
    source[:, 0] += tile[1:-1, 0]
    source[:, -1] += tile[1:-1, -1]
    spectrum = fft.dstn(source, type=1)
    k = np.arange(1, rows + 1)[:, None]
    m = np.arange(1, columns + 1)[None, :]
    eigenvalues = 4 - 2 * np.cos(np.pi * k / (rows + 1)) - 2 * np.cos(np.pi * m / (columns + 1))
    solved = tile.copy()
    solved[1:-1, 1:-1] = fft.idstn(spectrum / eigenvalues, type=1)
    return solved
