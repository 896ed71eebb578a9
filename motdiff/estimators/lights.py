"""Clipped lights taken out of a photo before its blur is searched: they outshine its edges, by an
unknown amount.
"""

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
    """Span the clipped pixels of a photo, and 8 px around them, by a membrane: hardly any
    gradients, so no evidence.

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
    hidden = (
        ndimage.binary_dilation(clipped, np.ones((3, 3)), iterations=_MARGIN_PX)
        if clipped.any()
        else clipped
    )
    if not 0 < hidden.mean() <= _MOST_SPANNED:
        return photo
    rows, columns = np.nonzero(hidden)
    number = np.full(photo.shape, -1)
    number[rows, columns] = np.arange(rows.size)
    neighbours = np.zeros(rows.size)
    known = np.zeros(rows.size)
    links = []
    for down, across in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        y = rows + down
        x = columns + across
        own = np.flatnonzero((y >= 0) & (y < photo.shape[0]) & (x >= 0) & (x < photo.shape[1]))
        other = number[y[own], x[own]]
        neighbours[own] += 1
        given = own[other < 0]
        known[given] += photo[y[given], x[given]]
        links.append(np.stack([own[other >= 0], other[other >= 0]]))
    first, second = np.concatenate(links, axis=1)
    linked = sparse.csr_matrix(
        (np.ones(first.size), (first, second)), shape=(rows.size, rows.size)
    )
    laplacian = sparse.diags(neighbours) - linked
    spanned = photo.copy()
    spanned[rows, columns] = sparse.linalg.spsolve(laplacian.tocsc(), known)
    return spanned
