"""A code along a trajectory: the chip basis, and the coded OTF and PSF (light-true: their DC is the duty)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cep.code import ShutterCode
from motdiff.trajectory import Trajectory

__all__ = ["OpenPath", "chip_basis", "chip_psfs", "coded_otf", "coded_psf", "open_path"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
_CHUNK = 2**18  # complex numbers at once while summing pieces: stays in the cache


@dataclass(frozen=True)
class OpenPath:
    """Straight pieces of the path that were drawn with the shutter open.

    Attributes
    ----------
    dt : (S,) float
        Durations, as a fraction of the exposure; they sum to the duty.
    a, b : (S, 2) float, px
        Starts and ends.
    """

    dt: FloatArray
    a: FloatArray
    b: FloatArray

    def otf(self, fx_cy_px: ArrayLike, fy_cy_px: ArrayLike) -> ComplexArray:
        """Exact OTF at (...) frequencies: the sum of ``dt exp(-i pi f.(a + b)) sinc(f.(b - a))``."""
        fx, fy = np.broadcast_arrays(np.asarray(fx_cy_px, np.float64), np.asarray(fy_cy_px, np.float64))
        f = np.stack([fx.ravel(), fy.ravel()], axis=1)
        out = np.empty(len(f), dtype=np.complex128)
        phase_px, delta_px = -np.pi * (self.a + self.b).T, np.pi * (self.b - self.a).T
        step = max(1, _CHUNK // self.dt.size)
        for lo in range(0, len(f), step):
            part = f[lo : lo + step]
            half = part @ delta_px
            # numpy's sinc patches 0 with a copy; a tiny offset costs no accuracy and saves a third of the time
            half += 1e-20
            gain = np.sin(half) / half
            phase = part @ phase_px
            out[lo : lo + step] = (gain * np.cos(phase)) @ self.dt + 1j * ((gain * np.sin(phase)) @ self.dt)
        return out.reshape(fx.shape)


def open_path(trajectory: Trajectory, code: ShutterCode) -> OpenPath:
    """Cut the path at the chips and keep what is drawn while the shutter is open."""
    edges = np.linspace(0, 1, code.chips + 1)
    pieces = trajectory.segments(edges)
    seen = code.array[pieces.slice_index] > 0
    return OpenPath(pieces.dt[seen], pieces.a[seen], pieces.b[seen])


def chip_basis(trajectory: Trajectory, chips: int, fx_cy_px: ArrayLike, fy_cy_px: ArrayLike) -> ComplexArray:
    """OTF of every chip, ``B_k(f)``: the coded OTF is ``sum_k c_k B_k(f)``.

    Parameters
    ----------
    trajectory : Trajectory
    chips : int
        Number n of equal chips in the exposure.
    fx_cy_px, fy_cy_px : (...) array_like, cycles/px

    Returns
    -------
    (n, ...) complex ndarray
    """
    return trajectory.slice_otfs(_edges(chips), fx_cy_px, fy_cy_px)


def chip_psfs(trajectory: Trajectory, chips: int, size: int = 64) -> FloatArray:
    """PSF of every chip, (n, size, size); each sums to 1/n. Raises ValueError if the path leaves the frame."""
    return trajectory.slice_psfs(_edges(chips), size)


def coded_otf(trajectory: Trajectory, code: ShutterCode, fx_cy_px: ArrayLike, fy_cy_px: ArrayLike) -> ComplexArray:
    """Exact OTF of the coded exposure at (...) frequencies; at zero frequency it is the duty.

    Parameters
    ----------
    trajectory : Trajectory
    code : ShutterCode
        Its chips are spread evenly over the exposure, whatever ``chip_ns`` says.
    fx_cy_px, fy_cy_px : (...) array_like, cycles/px
    """
    return open_path(trajectory, code).otf(fx_cy_px, fy_cy_px)


def coded_psf(trajectory: Trajectory, code: ShutterCode, size: int = 64) -> FloatArray:
    """Light-true coded PSF (size, size): it sums to the duty, zero displacement at index ``size // 2``.

    Raises
    ------
    ValueError
        If the path leaves the frame; the message says which size would do.
    """
    return np.asarray(np.tensordot(code.array, chip_psfs(trajectory, code.chips, size), axes=1), dtype=np.float64)


def _edges(chips: int) -> FloatArray:
    if chips < 1:
        raise ValueError(f"chips: must be at least 1, got {chips}")
    return np.linspace(0, 1, chips + 1)
