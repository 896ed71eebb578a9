"""A blurred photo whose motion is known, and Levin's photos of real shakes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motdiff.files.mat_files import levin_psf, read_mat
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray


@dataclass(frozen=True)
class Case:
    """A blurred photo with its true kernel and, where known, the sharp photo and the motion.

    Attributes
    ----------
    photo : (H, W) or (H, W, 3) float, linear light 0..1
    psf : (S, S) float
        The true kernel: sum 1, zero displacement at index ``S // 2``.
    sharp : (H, W) or (H, W, 3) float, optional
        The photo without blur, up to a shift of a few pixels.
    trajectory : Trajectory, optional
        The true motion.
    """

    photo: FloatArray
    psf: FloatArray
    sharp: FloatArray | None = None
    trajectory: Trajectory | None = None


def levin_photo(path: Path) -> Case:
    """Read one of Levin's real camera shakes, a ``.mat`` file of ``x`` sharp, ``y`` blurred and
    ``f`` kernel.

    The true PSF is ``f`` turned by 180 degrees, see :func:`motdiff.files.mat_files.levin_psf`.

    Raises
    ------
    ValueError
        If it is no ``.mat`` file, lacks a variable, or one is no table of finite numbers.

    References
    ----------
    Levin, Weiss, Durand, Freeman, "Understanding and evaluating blind deconvolution algorithms",
    CVPR 2009.
    """
    data = read_mat(path, "xyf")
    if missing := [name for name in "xyf" if name not in data]:
        raise ValueError(
            f"{path}: lacks the variable {missing[0]}; wanted x (sharp), y (blurred) and f"
            " (kernel)"
        )
    for name, table in data.items():
        if (
            table.ndim != 2
            or table.dtype.kind not in "fiub"
            or not table.size
            or not np.isfinite(table).all()
        ):
            raise ValueError(f"{path}: its variable {name} must be one table of finite numbers")
    sharp, blurred, kernel = (np.asarray(data[name], dtype=np.float64) for name in "xyf")
    if sharp.shape != blurred.shape or kernel.min() < 0 or not 0 < kernel.sum() < np.inf:
        raise ValueError(
            f"{path}: x and y must have the same size, and f be non-negative and not all zero"
        )
    psf = levin_psf(kernel)
    return Case(np.clip(blurred, 0, 1), psf / psf.sum(), sharp)
