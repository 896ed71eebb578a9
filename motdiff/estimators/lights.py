"""Removal of clipped lights, which outshine a photo's edges by an unknown amount."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse

from motdiff.types import FloatArray

MOST_LIGHTS = 0.05
"""Share of clipped pixels up to which they are lights: more are a sky, a wall or paper, whose
edges show the blur."""
_MARGIN_PX = 8  # around clipped pixels: the bright flanks of a streak
_MOST_SPANNED = 0.5  # of a photo: of more, too little is left to search in


def without_lights(photo: FloatArray, clipped: NDArray[np.bool_]) -> FloatArray:
    """Span clipped pixels, and 8 px around, by a membrane: no gradients, so no evidence.

    Parameters
    ----------
    photo : (H, W) float, grey
    clipped : (H, W) bool

    Returns
    -------
    (H, W) float ndarray
        The photo itself where nothing, or more than half of it, would be spanned.

    Notes
    -----
    The membrane solves Laplace's equation for the values around it; at the photo's border its
    slope is 0.
    """
    hidden = clipped
    if clipped.any():
        hidden = ndimage.binary_dilation(clipped, np.ones((3, 3)), iterations=_MARGIN_PX)
    if not 0 < hidden.mean() <= _MOST_SPANNED:
        return photo
    rows, columns = np.nonzero(hidden)
    # of each hidden pixel among the unknowns; -1 of a visible one
    number = np.full(photo.shape, -1)
    number[rows, columns] = np.arange(rows.size)
    # Laplace's equation: n_i u_i - sum of hidden neighbours u_j = sum of the visible neighbours
    neighbours = np.zeros(rows.size)
    border_sum = np.zeros(rows.size)
    links = []
    # beyond the photo's border a neighbour does not count, which makes the slope there 0
    for down, across in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        y = rows + down
        x = columns + across
        inside = np.flatnonzero((y >= 0) & (y < photo.shape[0]) & (x >= 0) & (x < photo.shape[1]))
        neighbour = number[y[inside], x[inside]]
        neighbours[inside] += 1
        on_border = inside[neighbour < 0]
        border_sum[on_border] += photo[y[on_border], x[on_border]]
        links.append(np.stack([inside[neighbour >= 0], neighbour[neighbour >= 0]]))
    first, second = np.concatenate(links, axis=1)
    linked = sparse.csr_matrix(
        (np.ones(first.size), (first, second)), shape=(rows.size, rows.size)
    )
    laplacian = sparse.diags(neighbours) - linked
    spanned = photo.copy()
    spanned[rows, columns] = sparse.linalg.spsolve(laplacian.tocsc(), border_sum)
    return spanned
