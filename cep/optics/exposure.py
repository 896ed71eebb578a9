"""A code along a trajectory: OTF of its chips, coded OTF and PSF, light-true (DC = open time).

The shutter may have ramps (``response``). With c_k = 0 outside the code, the OTF is
``sum_k c_k B_k + c_k (1 - c_{k-1}) O_k + c_k (1 - c_{k+1}) C_k``: chip k itself, light lost while
the shutter opens (O_k, within chip k), and light passed while it closes (C_k, within chip k + 1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cep.optics.code import ShutterCode
from cep.optics.response import ShutterResponse
from cep.optics.timeline import Timeline, even_edges, timeline
from motdiff.path_psfs import slice_psfs
from motdiff.psf_frame import PSF_PX
from motdiff.trajectory import Trajectory
from motdiff.types import ComplexArray, FloatArray

_CHUNK = 2**18  # complex numbers at once while summing pieces: stays in the cache
_PSF_CHUNK = 2**23  # numbers at once while adding up slices of a PSF: 64 MB


@dataclass(frozen=True)
class OpenPath:
    """Straight pieces of the path that were drawn with the shutter open.

    Attributes
    ----------
    dt : (S,) float
        Durations times transmission, as a fraction of the exposure; they sum to the light: to the
        duty, when the shutter follows at once and on time.
    a, b : (S, 2) float, px
        Starts and ends.
    """

    dt: FloatArray
    a: FloatArray
    b: FloatArray

    def otf(self, fx_cy_px: ArrayLike, fy_cy_px: ArrayLike) -> ComplexArray:
        """Exact OTF at (...) frequencies: sum of ``dt exp(-i pi f.(a + b)) sinc(f.(b - a))``."""
        fx, fy = np.broadcast_arrays(
            np.asarray(fx_cy_px, np.float64), np.asarray(fy_cy_px, np.float64)
        )
        f = np.stack([fx.ravel(), fy.ravel()], axis=1)
        out = np.empty(len(f), dtype=np.complex128)
        phase_px = -np.pi * (self.a + self.b).T
        delta_px = np.pi * (self.b - self.a).T
        step = max(1, _CHUNK // self.dt.size)
        for lo in range(0, len(f), step):
            f_chunk = f[lo : lo + step]
            half = f_chunk @ delta_px
            # numpy's sinc patches 0 with a copy; a tiny offset costs no accuracy and saves a third
            # of the time
            half += 1e-20
            gain = np.sin(half) / half
            phase = f_chunk @ phase_px
            out[lo : lo + step] = (gain * np.cos(phase)) @ self.dt + 1j * (
                (gain * np.sin(phase)) @ self.dt
            )
        return out.reshape(fx.shape)


def open_path(
    trajectory: Trajectory,
    code: ShutterCode,
    *,
    response: ShutterResponse | None = None,
) -> OpenPath:
    """Cut the path at the chips and keep the pieces of open ones.

    A shutter without ``response`` opens and closes at once. With it its chip time counts, not the
    code's. Under the tail of the last chip, beyond the exposure, the motion is extrapolated by
    :func:`cep.optics.timeline.extended`. ValueError if a chip is shorter than the shutter takes to
    open or close.
    """
    # at once, the path needs no extension beyond the exposure
    if response is None:
        pieces = trajectory.segments(np.linspace(0, 1, code.chips + 1))
        is_open = code.array[pieces.slice_index] > 0
        return OpenPath(pieces.dt[is_open], pieces.a[is_open], pieces.b[is_open])
    played = timeline(trajectory, even_edges(code.chips), response, code=code)
    transmission = played.transmission(code)
    is_open = transmission > 0
    return OpenPath((played.dt * transmission)[is_open], played.a[is_open], played.b[is_open])


def chip_basis(
    trajectory: Trajectory, chips: int, fx_cy_px: ArrayLike, fy_cy_px: ArrayLike
) -> ComplexArray:
    """OTF ``B_k(f)`` (n, ...) of each of n chips at (...) frequencies, cycles/px.

    For an instant shutter the coded OTF is ``sum_k c_k B_k``.
    """
    return trajectory.slice_otfs(even_edges(chips), fx_cy_px, fy_cy_px)


def chip_parts(
    trajectory: Trajectory,
    chips: int,
    fx_cy_px: ArrayLike,
    fy_cy_px: ArrayLike,
    *,
    response: ShutterResponse | None = None,
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Terms ``B_k``, ``O_k`` and ``C_k`` of the coded OTF, each (n, ...).

    Parameters and errors are those of :func:`open_path` and :func:`chip_basis`.
    """
    from cep.optics.fourier_kernels import chip_sums

    fx, fy = np.broadcast_arrays(
        np.asarray(fx_cy_px, np.float64), np.asarray(fy_cy_px, np.float64)
    )
    played = timeline(trajectory, even_edges(chips), response)
    weights = np.stack([np.ones(played.dt.size), played.opening - 1, played.closing]) * played.dt
    f = np.stack([fx.ravel(), fy.ravel()])
    # one chip more: the tail of the last
    sums = chip_sums(played.a, played.b, weights, played.chip, chips + 1, f)
    basis = sums[0, :-1]
    opening = sums[1, :-1]
    closing = sums[2, 1:]  # chip k closes within chip k + 1
    return tuple(term.reshape(chips, *fx.shape) for term in (basis, opening, closing))  # type: ignore[return-value]


def chip_rows(
    trajectory: Trajectory,
    chips: int,
    fx_cy_px: ArrayLike,
    fy_cy_px: ArrayLike,
    *,
    response: ShutterResponse | None = None,
) -> ComplexArray:
    """Change of the coded OTF when chip k opens between neighbours in states l and r.

    ``rows[k, l, r] = B_k + (1 - l) O_k + (1 - r) C_k - l C_{k-1} - r O_{k+1}``: an open neighbour
    needs no edge towards chip k any more. Closing chip k is the negative. Outside the code every
    chip is closed.

    Parameters and errors are those of :func:`open_path` and :func:`chip_basis`. Only for an
    instant shutter are the rows of the reversed path those of the path in the opposite order.

    Returned are (n, 2, 2, ...) complex numbers, read-only; without a response the four are one and
    the same memory.
    """
    shape = np.broadcast_shapes(np.shape(fx_cy_px), np.shape(fy_cy_px))
    if response is None or response.instant:
        basis = chip_basis(trajectory, chips, fx_cy_px, fy_cy_px)
        return np.broadcast_to(basis[:, None, None], (chips, 2, 2, *shape))
    basis, opening, closing = chip_parts(trajectory, chips, fx_cy_px, fy_cy_px, response=response)
    # axes: chip, left neighbour, right neighbour; 0 closed, 1 open
    rows = np.repeat(basis[:, None], 4, axis=1).reshape(chips, 2, 2, *shape)
    rows[:, 0] += opening[:, None]
    rows[:, :, 0] += closing[:, None]
    rows[1:, 1] -= closing[:-1, None]
    rows[:-1, :, 1] -= opening[1:, None]
    rows.setflags(write=False)  # as the broadcast ones of an instant shutter
    return rows


def distinct_rows(rows: NDArray[Any], response: ShutterResponse | None) -> NDArray[Any]:
    """Rows (n, V, ...) of those (n, 2, 2, ...) of :func:`chip_rows`.

    V is 4 where the shutter's response makes neighbours matter (2 left + right, 1 for open), else
    1.
    """
    if response is None:
        return rows[:, 0, :1]  # all four are the same
    return rows.reshape(len(rows), 4, *rows.shape[3:])


def coded_sum(rows: NDArray[Any], codes: NDArray[Any]) -> NDArray[Any]:
    """OTFs (R, ...) of (R, n) codes from rows (n, V, ...), as :func:`distinct_rows` gives them."""
    on = codes.astype(rows.real.dtype)
    flat = rows.reshape(*rows.shape[:2], -1)
    if rows.shape[1] == 1:
        total = on @ flat[:, 0]
    else:
        # chips open one after the other from the first: the left neighbour stands, the right one
        # is closed yet
        open_before = np.pad(on, ((0, 0), (1, 0)))[:, :-1]
        total = (on * (1 - open_before)) @ flat[:, 0]
        total += (on * open_before) @ flat[:, 2]
    return np.asarray(total.reshape(len(codes), *rows.shape[2:]))


def chip_psfs(trajectory: Trajectory, chips: int, size: int = PSF_PX) -> FloatArray:
    """PSF of every chip, (n, size, size); each sums to 1/n."""
    return trajectory.slice_psfs(even_edges(chips), size)


def coded_otf(
    trajectory: Trajectory,
    code: ShutterCode,
    fx_cy_px: ArrayLike,
    fy_cy_px: ArrayLike,
    *,
    response: ShutterResponse | None = None,
) -> ComplexArray:
    """Exact, light-true OTF of the coded exposure at (...) frequencies, cycles/px.

    The chips are spread evenly over the exposure; ``chip_ns`` does not count. ``response`` is that
    of :func:`open_path`.
    """
    return open_path(trajectory, code, response=response).otf(fx_cy_px, fy_cy_px)


def mtf(
    trajectory: Trajectory, code: ShutterCode | None, fx_cy_px: ArrayLike, fy_cy_px: ArrayLike
) -> FloatArray:
    """Exact, light-true MTF of the exposure at (...) frequencies, cycles/px.

    Without a code the shutter is open all the time.

    Examples
    --------
    A straight motion of 20 px loses the frequency of 1/20 cycles/px; half of the light in four
    chips keeps it:

    >>> path = Trajectory.straight(20.0)
    >>> code = ShutterCode("1100")
    >>> print(f"{float(mtf(path, None, 0.05, 0.0)):.3f}  {float(mtf(path, code, 0.05, 0.0)):.3f}")
    0.000  0.318
    """
    return np.abs(coded_otf(trajectory, code or ShutterCode("1"), fx_cy_px, fy_cy_px))


def coded_psf(
    trajectory: Trajectory,
    code: ShutterCode,
    size: int = PSF_PX,
    *,
    response: ShutterResponse | None = None,
) -> FloatArray:
    """Light-true coded PSF (size, size), zero displacement at index ``size // 2``.

    ``response`` is that of :func:`open_path`. The ValueError for a path that leaves the frame has
    a sufficient size.

    Examples
    --------
    >>> psf = coded_psf(Trajectory.straight(20.0), ShutterCode("11100101"))
    >>> psf.shape, round(float(psf.sum()), 6)
    ((64, 64), 0.625)
    """
    if response is None:
        psfs = chip_psfs(trajectory, code.chips, size)
        return np.asarray(np.tensordot(code.array, psfs, axes=1))
    played = timeline(trajectory, even_edges(code.chips), response, code=code)
    return played_psf(played, code, size)


def played_psf(played: Timeline, code: ShutterCode, size: int) -> FloatArray:
    """PSF (size, size) of a code as it was played, on time or not; ValueError if it is larger."""
    needed = played.frame_size()
    if size < needed:
        raise ValueError(f"size: the path needs a PSF frame of at least {needed} px, got {size}")
    transmission = played.transmission(code)
    psf = np.zeros((size, size))
    step = max(1, _PSF_CHUNK // size**2)
    for lo in range(0, played.dt.size, step):
        # the pieces are the slices: each has one transmission
        cuts = played.u[lo : lo + step + 1]
        psfs = slice_psfs(played.t, played.xy, cuts, size)
        psf += np.tensordot(transmission[lo : lo + step], psfs, axes=1)
    return psf


def shifted_psf(
    trajectory: Trajectory, code: ShutterCode, shift_px: ArrayLike = (0.0, 0.0)
) -> FloatArray:
    """Light-true coded PSF of a path moved by ``shift_px``, in the odd frame that holds it.

    The shift (2,) is to the right and down.
    """
    xy = trajectory.xy + np.asarray(shift_px)
    frame = 2 * int(np.ceil(np.abs(xy).max())) + 3
    chips = slice_psfs(trajectory.t, xy, np.linspace(0, 1, code.chips + 1), frame)
    return np.asarray(np.tensordot(code.array, chips, axes=1))
