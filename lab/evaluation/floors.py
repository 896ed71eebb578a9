"""Floors and ceilings of the tables: trivial kernels, and kernels made from the truth.

MNC subtracts no mean, so a Gaussian blob scores 0.4 to 0.6. Figures are to be read beside these.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import fft

from lab.evaluation.quadratic_limits import most_alike_quadratic
from motdiff.psf_frame import PSF_PX, centred, in_frame
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

_ROUNDS = 3
_SIGMA_PX = 4.0


def delta(size: int = PSF_PX) -> FloatArray:
    """No motion at all, (size, size)."""
    psf = np.zeros((size, size))
    psf[size // 2, size // 2] = 1.0
    return psf


def gaussian(sigma_px: float = _SIGMA_PX, size: int = PSF_PX) -> FloatArray:
    """Draw a round blob (size, size), sum 1, centred at index ``size // 2``."""
    along = np.exp(-0.5 * ((np.arange(size) - size // 2) / sigma_px) ** 2)
    psf = along[:, None] * along[None, :]
    return np.asarray(psf / psf.sum(), dtype=np.float64)


def mean_psf(psfs: Sequence[FloatArray]) -> FloatArray:
    """Mean of PSFs (S, S) of even size, sum 1, its centroid at index ``S // 2`` to whole pixels.

    MNC ignores shifts, so each motion is laid where it is most like the others (three rounds of
    registration to the mean). With the centroids on each other instead, shakes that dwell in one
    place average to a blur: over 60 gyro motions 0.40 instead of 0.53, a floor that is too easy to
    beat.
    """
    size = len(psfs[0])
    room = len(psfs[0]) // 2
    padded = np.pad(np.asarray(psfs), [(0, 0), (room, room), (room, room)])
    spectra = fft.rfft2(padded)
    mean = padded.mean(axis=0)
    for _ in range(_ROUNDS):
        lags = fft.irfft2(fft.rfft2(mean) * spectra.conj(), s=mean.shape)
        peaks = lags.reshape(len(padded), -1).argmax(axis=1)
        moves = zip(*np.unravel_index(peaks, mean.shape), strict=True)
        mean = np.mean(
            [np.roll(psf, move, axis=(0, 1)) for psf, move in zip(padded, moves, strict=True)],
            axis=0,
        )
    framed = in_frame(centred(mean), size)
    return np.asarray(framed / framed.sum(), dtype=np.float64)


def path_kernel(trajectory: Trajectory) -> FloatArray:
    """PSF (64, 64), sum 1, of the path as a binary map: the limit of an estimate without dwell.

    Seen through the bilinear hat of each PSF pixel, as the trajectory's own PSF is.

    Raises
    ------
    ValueError
        If the path leaves the 64-px field.
    """
    import torch

    from motdiff.network.sampling import psfs_of_maps

    return np.asarray(
        psfs_of_maps(torch.from_numpy(trajectory.hr_map().astype(np.float64))), dtype=np.float64
    )


def quadratic_kernel(trajectory: Trajectory) -> FloatArray:
    """PSF, 64 px or larger, of the quadratic path whose PSF is most like the trajectory's (2
    CPU-s).
    """
    quadratic = most_alike_quadratic(trajectory, size=PSF_PX).trajectory()
    return quadratic.psf(quadratic.frame_size(PSF_PX))


def floors(mean: FloatArray | None = None) -> dict[str, FloatArray]:
    """Kernels independent of the photo, by name: "delta", "gaussian" and, where it is given,
    "mean-kernel".

    Parameters
    ----------
    mean : (S, S) float, optional
        :func:`mean_psf` of other motions of the kind.
    """
    values = {"delta": delta(), "gaussian": gaussian()}
    return values if mean is None else {**values, "mean-kernel": mean}
