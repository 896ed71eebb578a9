"""Misfit of photos of one scene through known codes, with the scene eliminated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import pi

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import fft, ndimage
from torch import Tensor

from motdiff.estimators.coded.misfit import Unknowns
from motdiff.estimators.coded.otfs import CodedOtfs
from motdiff.types import FloatArray

_SIDE_STEP_PX = 6  # photos are cut to sides that the three grids divide
_LARGEST_SIDE_PX = 252
_SLOW_PX = 8.0  # slower differences of light (lamps, vignetting) are taken away
# beyond it, in the corners of the spectrum, a blurred photo has nothing but noise
_ONLY_NOISE_CY_PX = 0.5
# floors of |H|^2 and |H_a H_b|, for frequencies that no photo holds
_LEAST_LIGHT = 1e-4
_LEAST_PRODUCT = 0.02
_LEAST_NOISE = 1e-3  # of full scale: 8 bits round by that, and files that were smoothed show less


@dataclass(frozen=True)
class SceneSpectra:
    """Photos of one scene as spectra on a coarse grid.

    Attributes
    ----------
    side_px, grid : int
        Side N of the photos, and of the grid, n: frequencies below n / (2 N) cycles/px are kept.
    index : (F,) int
        Of the frequencies in the grid's half-plane spectrum, flat.
    f : (F, 2) float, cycles/px
    photos : (I, F) complex
    power : (F,) float
        Mean power of the windowed photos around each frequency.
    noise : float
        Power of the noise alone.
    window : (n, n) float
        0 where a photo's blurred light comes from beyond its border.
    """

    side_px: int
    grid: int
    index: Tensor
    f: Tensor
    photos: Tensor
    power: Tensor
    noise: float
    window: Tensor

    def windowed(self, spectra: Tensor) -> Tensor:
        """Spectra (..., F) of images multiplied by the window."""
        windowed: Tensor = torch.fft.rfft2(self.window * self.images(spectra)).flatten(-2)
        return windowed[..., self.index]

    def images(self, spectra: Tensor) -> Tensor:
        """Images (..., n, n) of spectra (..., F)."""
        half_plane = torch.zeros(
            *spectra.shape[:-1], self.grid * (self.grid // 2 + 1), dtype=torch.complex64
        )
        half_plane[..., self.index] = spectra
        shaped = half_plane.reshape(*spectra.shape[:-1], self.grid, self.grid // 2 + 1)
        images: Tensor = torch.fft.irfft2(shaped, s=(self.grid, self.grid))
        return images


def scene_side_px(shape: tuple[int, ...]) -> int:
    """Side of the square of a photo (H, W) whose spectra are taken: the three grids divide it."""
    return min(_LARGEST_SIDE_PX, *(n // _SIDE_STEP_PX * _SIDE_STEP_PX for n in shape))


def scene_spectra(
    photos: Sequence[FloatArray], *, grids: Sequence[int], margin_px: int
) -> list[SceneSpectra]:
    """Spectra of photos (N, N) of one scene, on each of several grids that divide N.

    Parameters
    ----------
    photos : sequence of I (N, N) float, linear light
    grids : sequence of int
    margin_px : int
        Reach of the blur.
    """
    side = len(photos[0])
    detail = np.stack([photo - ndimage.gaussian_filter(photo, _SLOW_PX) for photo in photos])
    window = _window(side, side, margin_px)
    spectra = fft.rfft2(detail)
    powers = np.abs(fft.rfft2(window * detail)) ** 2
    radius = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)[None])
    corner_power = float(powers[:, radius > _ONLY_NOISE_CY_PX].mean())
    noise = max(corner_power, _LEAST_NOISE**2 * float((window**2).sum()))
    mirrored = np.concatenate([powers[..., :0:-1], powers], axis=-1).mean(axis=0)
    power = ndimage.gaussian_filter(mirrored, 4)[:, side // 2 :]

    def on(grid: int) -> SceneSpectra:
        fy = (np.fft.fftfreq(grid) * grid / side)[:, None]
        fx = (np.fft.rfftfreq(grid) * grid / side)[None]
        radius = np.hypot(fy, fx)
        # one of each conjugate pair, without the slow frequencies that the filter took away
        mask = (radius < 0.48 * grid / side) & (radius > 1 / 64) & ~((fx == 0) & (fy < 0))
        rows, columns = np.nonzero(mask)
        rows_of_photo = np.where(rows > grid // 2, rows - grid + side, rows)
        share = (grid / side) ** 2
        f = np.stack([np.broadcast_to(f, mask.shape)[mask] for f in (fx, fy)], axis=1)
        return SceneSpectra(
            side_px=side,
            grid=grid,
            index=torch.tensor(np.flatnonzero(mask.ravel())),
            f=torch.tensor(f, dtype=torch.float32),
            photos=torch.tensor(spectra[:, rows_of_photo, columns] * share, dtype=torch.complex64),
            power=torch.tensor(power[rows_of_photo, columns] * share**2, dtype=torch.float32),
            noise=noise * share**2,
            window=torch.tensor(_window(side, grid, margin_px), dtype=torch.float32),
        )

    return [on(grid) for grid in grids]


class SceneTerm:
    """Misfit of photos of one scene, with the scene eliminated: ``B_i H_j = B_j H_i``.

    With equal noise in all photos, the least squares over all scenes leave ``sum over pairs |B_i
    H_j - B_j H_i|^2`` over ``sum |H|^2`` at each frequency (Lagrange's identity): a sum of squares
    of as many values as there are photos less one, which the noise alone makes 1 each. Products
    are taken of whole photos and windowed after, so that nothing from beyond the borders counts.

    Parameters
    ----------
    path_error_px : float
        Error of the path that the misfit allows for; large, it has few local minima.

    References
    ----------
    Harikumar and Bresler, "Perfect blind restoration of images blurred by multiple filters", IEEE
    TIP 8(2), 1999 (the products of pairs).
    """

    def __init__(
        self, unknowns: Unknowns, otfs: CodedOtfs, spectra: SceneSpectra, *, path_error_px: float
    ) -> None:
        self._unknowns = unknowns
        self._otfs = otfs
        self.spectra = spectra
        self._open = torch.tensor(otfs.open_share, dtype=torch.float32)
        self._pairs = list(combinations(range(unknowns.exposures), 2))
        self._stands_for = 1 + (spectra.f[:, 0] != 0).float()
        self._window_rms = float(spectra.window.square().mean().sqrt())
        phase_error = (2 * pi * path_error_px * spectra.f.norm(dim=1)).clamp(max=1)
        self._variance = spectra.noise + phase_error**2 * spectra.power
        self.values = len(spectra.f) * (unknowns.exposures - 1)
        """Number of squares that are summed: the expected cost of the true path."""

    def cost(self, x: Tensor) -> Tensor:
        """See :class:`motdiff.estimators.coded.misfit.Term`."""
        un = self._unknowns
        costs = []
        for chunk in torch.split(x, 8):  # as many as fit the cache
            otfs = self._otfs.otfs(un.paths(chunk), un.shifts(chunk), self.spectra.f)
            H = otfs * (un.gains(chunk) * self._open)[..., None]
            squares = self.spectra.windowed(self._products(H)).abs().square().sum(1)
            costs.append((squares / (self._power(H) * self._variance)).sum(1))
        return torch.cat(costs)

    def _products(self, H: Tensor) -> Tensor:
        """``B_a H_b - B_b H_a`` (B, pairs, F) of OTFs (B, I, F)."""
        B = self.spectra.photos
        return torch.stack([B[a] * H[:, b] - B[b] * H[:, a] for a, b in self._pairs], 1)

    def add_normal(self, x: Tensor, JJ: Tensor, Jr: Tensor) -> None:
        """See :class:`motdiff.estimators.coded.misfit.Term`.

        ``J^T r`` is exact. In ``J^T J`` the window is its rms value: to window each row of J would
        make a step half as long again.
        """
        for i in range(len(x)):
            J, dpower, residual, weight = self._derivatives(x[i : i + 1])
            n = len(J)
            r = residual * weight
            # the window's transpose is applied to the residual, instead of the window to J; a
            # half-plane spectrum stands for two frequencies, but where f_x is 0
            back = _flat(self.spectra.windowed(r * weight / self._stands_for) * self._stands_for)
            Jr[i, :n] += _flat(J) @ back
            # the weight, too, depends on the path: without this the noise would pull it off
            Jr[i, :n] -= 0.5 * dpower @ r.abs().square().sum(0)
            J_windowed = _flat((self._window_rms * J - 0.5 * residual * dpower[:, None]) * weight)
            JJ[i, :n, :n] += J_windowed @ J_windowed.T

    def _derivatives(self, x: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return what a candidate (1, N) changes with its parameters.

        Returns
        -------
        (parameters, pairs, F) of the products, not windowed; (parameters, F) of the power,
        relative; the products (pairs, F), windowed; their weight (F,)
        """
        un = self._unknowns
        B = self.spectra.photos
        end = 2 * self._unknowns.knots
        phase = 2 * pi * self.spectra.f
        otfs, slopes = self._otfs.with_slopes(un.paths(x), un.shifts(x), self.spectra.f)
        light = (un.gains(x) * self._open)[0, :, None]
        H = otfs[0] * light
        dH = slopes[0] * light[..., None]
        power = self._power(H[None])[0]
        J = torch.zeros(un.kernel_shift(0), len(self._pairs), len(phase), dtype=torch.complex64)
        dpower = torch.zeros(len(J), len(phase))
        by_knot = 2 * (H.conj()[..., None] * dH).real.sum(0) / power[:, None]
        for axis in (0, 1):
            dpower[axis:end:2] = (by_knot * phase[:, axis, None]).T
        for m, (a, b) in enumerate(self._pairs):
            change = B[a][:, None] * dH[b] - B[b][:, None] * dH[a]
            for axis in (0, 1):
                J[axis:end:2, m] = (change * phase[:, axis, None]).T
            for photo, product in ((a, -B[b] * H[a]), (b, B[a] * H[b])):
                if photo:
                    J[un.gain(photo), m] = product
                    for axis in (0, 1):
                        J[un.shift(photo) + axis, m] = -1j * phase[:, axis] * product
        for photo in range(1, un.exposures):
            dpower[un.gain(photo)] = 2 * H[photo].abs().square() / power
        residual = self.spectra.windowed(self._products(H[None])[0])
        return J, dpower, residual, (power * self._variance).rsqrt()

    def registered(self, x: Tensor) -> Tensor:
        """Candidates with the photos' shifts by correlation."""
        un = self._unknowns
        B = self.spectra.photos
        step_px = self.spectra.side_px / self.spectra.grid
        x = x.clone()
        x[:, un.shift(1) : un.gain(1)] = 0
        H = self._otfs.otfs(un.paths(x), un.shifts(x), self.spectra.f)
        for photo in range(1, un.exposures):
            cross = B[photo] * H[:, 0] * (B[0] * H[:, photo]).conj()
            cross = cross / ((H[:, 0] * H[:, photo]).abs() + _LEAST_PRODUCT)
            at = un.shift(photo)
            for row, image in zip(x, self.spectra.images(cross).numpy(), strict=True):
                dy, dx = _peak(image)
                row[at] = dx * step_px
                row[at + 1] = dy * step_px
        return x

    @staticmethod
    def _power(H: Tensor) -> Tensor:
        return H.abs().square().sum(1) + _LEAST_LIGHT


def _flat(values: Tensor) -> Tensor:
    """Real and imaginary parts of the last two axes (pairs, F), as one axis."""
    return torch.view_as_real(values).flatten(-3)


def _window(side: int, grid: int, margin_px: int) -> FloatArray:
    """Window (grid, grid) over a photo of ``side`` px: 0 within the margin, then rising to 1."""
    at = np.arange(grid) * side / grid
    inside = np.minimum(at, side - side / grid - at)
    edge = np.sin(0.5 * pi * np.clip((inside - margin_px + 0.5) / min(32, side // 8), 0, 1)) ** 2
    return np.outer(edge, edge)


def _peak(image: NDArray[np.float32]) -> tuple[float, float]:
    """Position of the largest value (down, right) in a periodic image, by parabolas through it."""
    index = np.unravel_index(int(image.argmax()), image.shape)
    position = []
    for axis, n in enumerate(image.shape):
        before, peak, after = (float(np.roll(image, step, axis)[index]) for step in (1, 0, -1))
        bend = before - 2 * peak + after
        offset = index[axis] + (0.5 * (before - after) / bend if bend < 0 else 0.0)
        position.append(offset - n if offset > n / 2 else offset)
    return position[0], position[1]
