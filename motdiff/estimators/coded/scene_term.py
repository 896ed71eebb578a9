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
from motdiff.estimators.coded.otfs import CodedOtfs, GridOtfs
from motdiff.types import FloatArray

_SIDE_STEP_PX = 6  # photos are cut to sides that the grids divide
_LARGEST_SIDE_PX = 252
_SLOW_PX = 8.0  # slower differences of light (lamps, vignetting) are taken away
# beyond it, in the corners of the spectrum, a blurred photo has nothing but noise
_ONLY_NOISE_CY_PX = 0.5
# floors of |H|^2 and |H_a H_b|, for frequencies that no photo holds
_LEAST_LIGHT = 1e-6
_LEAST_PRODUCT = 0.02
_LEAST_NOISE = 1e-3  # of full scale: 8 bits round by that, and files that were smoothed show less
_LEAST_WEIGHT = 0.02  # of a frequency that shows nothing but noise
_AT_ONCE = 8  # candidates, as many as fit the cache
_SLOWEST_CY_PX = 1 / 64  # slower light is taken away
# the curvature is summed over a sample of the frequencies, drawn once: for each value that a step
# changes over 6 / (photos - 1), as each frequency has so many independent values, and 4 at least
_VALUES_PER_UNKNOWN = 6
_FREQUENCIES_PER_UNKNOWN = 4


@dataclass(frozen=True)
class SceneSpectra:
    """Photos of one scene as half-plane spectra on a coarse grid.

    Attributes
    ----------
    side_px, grid : int
        Side N of the photos, and of the grid, n: frequencies below n / (2 N) cycles/px are kept.
    fy, fx : (n,) and (n // 2 + 1,) float, cycles/px
        Frequencies of the grid's rows and columns.
    mask : (n, n // 2 + 1) bool
        One of each conjugate pair, without the slow frequencies and those beyond the grid's.
    photos : (I, n, n // 2 + 1) complex
        0 outside the mask.
    power : (n, n // 2 + 1) float
        Mean power of the windowed photos around each frequency.
    noise : float
        Power of the noise alone.
    window : (n, n) float
        0 where a photo's blurred light comes from beyond its border.
    """

    side_px: int
    grid: int
    fy: Tensor
    fx: Tensor
    mask: Tensor
    photos: Tensor
    power: Tensor
    noise: float
    window: Tensor

    @property
    def f(self) -> Tensor:
        """Frequencies (F, 2) of the mask: right and down, cycles/px."""
        rows, columns = torch.nonzero(self.mask, as_tuple=True)
        return torch.stack([self.fx[columns], self.fy[rows]], 1)

    def windowed(self, spectra: Tensor) -> Tensor:
        """Spectra (..., n, n // 2 + 1) of images multiplied by the window."""
        windowed: Tensor = torch.fft.rfft2(self.window * self.images(spectra))
        return windowed

    def images(self, spectra: Tensor) -> Tensor:
        """Images (..., n, n) of spectra (..., n, n // 2 + 1)."""
        images: Tensor = torch.fft.irfft2(spectra, s=(self.grid, self.grid))
        return images


def scene_side_px(shape: tuple[int, ...]) -> int:
    """Side of the square of a photo (H, W) whose spectra are taken: the grids divide it."""
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
    mean_power = ndimage.gaussian_filter(mirrored, 4)[:, side // 2 :]

    def on(grid: int) -> SceneSpectra:
        fy = np.fft.fftfreq(grid) * grid / side
        fx = np.fft.rfftfreq(grid) * grid / side
        radius = np.hypot(fy[:, None], fx)
        mask = (radius < 0.48 * grid / side) & (radius > _SLOWEST_CY_PX)
        mask &= (fx > 0) | (fy[:, None] > 0)
        rows = np.arange(grid)
        rows = np.where(rows > grid // 2, rows - grid + side, rows)[:, None]
        columns = np.arange(grid // 2 + 1)
        share = (grid / side) ** 2
        return SceneSpectra(
            side_px=side,
            grid=grid,
            fy=torch.tensor(fy, dtype=torch.float32),
            fx=torch.tensor(fx, dtype=torch.float32),
            mask=torch.tensor(mask),
            photos=torch.tensor(mask * spectra[:, rows, columns] * share, dtype=torch.complex64),
            power=torch.tensor(mean_power[rows, columns] * share**2, dtype=torch.float32),
            noise=noise * share**2,
            window=torch.tensor(_window(side, grid, margin_px), dtype=torch.float32),
        )

    return [on(grid) for grid in grids]


class SceneTerm:
    """Misfit of photos of one scene, with the scene eliminated: ``B_i H_j = B_j H_i``.

    With equal noise in all photos, the least squares over all scenes leave ``sum over pairs |B_i
    H_j - B_j H_i|^2`` over ``sum |H|^2`` at each frequency (Lagrange's identity): a sum of squares
    of as many values as there are photos less one, which the noise alone makes 1 each. A scene of
    power S gives it the weight ``q = S sum |H|^2 / (S sum |H|^2 + noise)``, which is taken of the
    photos' power, the same for all paths: where they show nothing but noise, a path has nothing to
    explain. Products are taken of whole photos and windowed after, so that nothing from beyond the
    borders counts.

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
        self._spectra = spectra
        self._open = torch.tensor(otfs.open_share, dtype=torch.float32)
        self._pairs = list(combinations(range(unknowns.exposures), 2))
        self._window_rms = float(spectra.window.square().mean().sqrt())
        radius = torch.hypot(spectra.fy[:, None], spectra.fx)
        phase_error = (2 * pi * path_error_px * radius).clamp(max=1)
        q = _scene_weight(spectra)
        self._variance = (spectra.noise + phase_error**2 * spectra.power) / q
        # a half-plane spectrum stands for two frequencies, but where f_x is 0
        self._stands_for = 1 + (spectra.fx != 0).float()
        f = spectra.f
        self.values = float(q[spectra.mask].sum()) * (unknowns.exposures - 1)
        """Number of squares, each by its weight: the expected cost of the true path."""
        index = torch.nonzero(spectra.mask.flatten()).squeeze(1)
        slopes = (_power(spectra.photos).sum(0) * radius**2 / self._variance).flatten()[index]
        per_unknown = max(_FREQUENCIES_PER_UNKNOWN, _VALUES_PER_UNKNOWN / (unknowns.exposures - 1))
        count = per_unknown * unknowns.kernel_shift(0)
        # in proportion to what they tell; half for all alike, so that none counts for many
        chance = (0.5 * count / len(f) * (1 + slopes / slopes.mean())).clamp(max=1).numpy()
        sample = _sampled(chance, np.random.default_rng(0))
        self._sample_f = f[sample]
        self._sample = index[sample]
        self._sample_chance = torch.tensor(chance[sample], dtype=torch.float32)

    def cost(self, x: Tensor) -> Tensor:
        """See :class:`motdiff.estimators.coded.misfit.Term`."""
        return torch.cat([self._cost(chunk) for chunk in torch.split(x, _AT_ONCE)])

    def _cost(self, x: Tensor) -> Tensor:
        H = self._on_grid(x).H * self._light(x)[..., None, None]
        squares = _power(self._spectra.windowed(self._products(H))).sum(1)
        return (squares * self._weight(H)).sum((1, 2))

    def _on_grid(self, x: Tensor) -> GridOtfs:
        un = self._unknowns
        return self._otfs.on_grid(un.paths(x), un.shifts(x), self._spectra.fy, self._spectra.fx)

    def _light(self, x: Tensor) -> Tensor:
        """Factors (B, I) of the OTFs, which are 1 at zero frequency."""
        return self._unknowns.gains(x) * self._open

    def _products(self, H: Tensor) -> Tensor:
        """``B_a H_b - B_b H_a`` (B, pairs, R, C) of OTFs (B, I, R, C)."""
        B = self._spectra.photos
        return torch.stack([B[a] * H[:, b] - B[b] * H[:, a] for a, b in self._pairs], 1)

    def _weight(self, H: Tensor) -> Tensor:
        """Weight (B, R, C) of the products, q over their variance; 0 outside the mask."""
        return self._spectra.mask / ((_power(H).sum(1) + _LEAST_LIGHT) * self._variance)

    def add_normal(self, x: Tensor, JJ: Tensor, Jr: Tensor) -> None:
        """See :class:`motdiff.estimators.coded.misfit.Term`.

        ``J^T r`` is exact. In ``J^T J`` the window is its rms value, and a sample of the
        frequencies stands for all: it shapes the step, and the stated errors of a path.
        """
        for chunk, chunk_JJ, chunk_Jr in zip(
            *(torch.split(values, _AT_ONCE) for values in (x, JJ, Jr)), strict=True
        ):
            self._add_normal(chunk, chunk_JJ, chunk_Jr)

    def _add_normal(self, x: Tensor, JJ: Tensor, Jr: Tensor) -> None:
        un = self._unknowns
        B = self._spectra.photos
        light = self._light(x)[..., None, None]
        grid = self._on_grid(x)
        H = grid.H * light
        r = self._spectra.windowed(self._products(H))
        weight = self._weight(H)
        # the window's transpose is applied to the residual, instead of the window to J
        weighted = r * (weight / self._stands_for)[:, None]
        back = self._spectra.windowed(weighted) * self._stands_for
        # the weight, too, depends on the path: without this the noise would pull it off
        by_power = _power(r).sum(1) * weight**2 * self._variance
        by_H = -by_power[:, None] * H
        for m, (a, b) in enumerate(self._pairs):
            by_H[:, b] += B[a].conj() * back[:, m]
            by_H[:, a] -= B[b].conj() * back[:, m]
        paths, shifts = grid.slopes(by_H * light)
        Jr[:, : un.shift(1)] += paths.flatten(1)
        Jr[:, un.shift(1) : un.gain(1)] += shifts[:, 1:].flatten(1)
        Jr[:, un.gain(1) : un.kernel_shift(0)] += (by_H.conj() * H).real.sum((2, 3))[:, 1:]
        self._add_curvature(x, r.flatten(2)[..., self._sample], JJ)

    def _add_curvature(self, x: Tensor, residual: Tensor, JJ: Tensor) -> None:
        """Add ``J^T J``; the residual (B, pairs, F) is that of the sample's frequencies."""
        un = self._unknowns
        B = self._spectra.photos.flatten(1)[:, self._sample]
        phase = 2 * pi * self._sample_f.T
        end = 2 * un.knots
        size = un.kernel_shift(0)
        otfs, slopes = self._otfs.with_slopes(un.paths(x), un.shifts(x), self._sample_f)
        light = self._light(x)[..., None]
        H = otfs * light
        dH = slopes * light[..., None]
        total = _power(H).sum(1) + _LEAST_LIGHT
        weight = (self._sample_chance * total * self._variance.flatten()[self._sample]).rsqrt()
        windowed = (self._window_rms * weight)[:, None]
        # what the power changes, times half of the residual
        by_power = -0.5 * residual * weight[:, None] / total[:, None]
        dpower = 2 * (H.conj()[:, :, None] * dH).real.sum(1)
        J = torch.zeros(len(x), size, len(self._pairs), phase.shape[1], dtype=torch.complex64)
        for m, (a, b) in enumerate(self._pairs):
            change = (windowed * B[a]) * dH[:, b] - (windowed * B[b]) * dH[:, a]
            change += by_power[:, m, None] * dpower
            for axis in (0, 1):
                torch.mul(change, phase[axis], out=J[:, axis:end:2, m])
            for photo, product in ((a, -B[b] * H[:, a]), (b, B[a] * H[:, b])):
                if photo:
                    product = product * windowed[:, 0]
                    J[:, un.gain(photo), m] = product
                    for axis in (0, 1):
                        J[:, un.shift(photo) + axis, m] = -1j * phase[axis] * product
            for photo in range(1, un.exposures):
                J[:, un.gain(photo), m] += 2 * by_power[:, m] * _power(H[:, photo])
        flat = torch.view_as_real(J).flatten(2)
        JJ[:, :size, :size] += flat @ flat.transpose(1, 2)

    def registered(self, x: Tensor) -> Tensor:
        """Candidates with the photos' shifts by correlation."""
        un = self._unknowns
        B = self._spectra.photos
        step_px = self._spectra.side_px / self._spectra.grid
        x = x.clone()
        x[:, un.shift(1) : un.gain(1)] = 0
        H = torch.cat([self._on_grid(chunk).H for chunk in torch.split(x, _AT_ONCE)])
        for photo in range(1, un.exposures):
            cross = B[photo] * H[:, 0] * (B[0] * H[:, photo]).conj()
            cross = cross / ((H[:, 0] * H[:, photo]).abs() + _LEAST_PRODUCT)
            at = un.shift(photo)
            for row, image in zip(x, self._spectra.images(cross).numpy(), strict=True):
                dy, dx = _peak(image)
                row[at] = dx * step_px
                row[at + 1] = dy * step_px
        return x


def _scene_weight(spectra: SceneSpectra) -> Tensor:
    """Weight q of each frequency, up to 1, by the photos' power around it."""
    light = len(spectra.photos) * (spectra.power - spectra.noise).clamp(min=0)
    return (light / (light + spectra.noise)).clamp(min=_LEAST_WEIGHT)


def _sampled(chance: FloatArray, rng: np.random.Generator) -> NDArray[np.intp]:
    """Draw indices with these chances, as many as their sum: systematic sampling."""
    order = rng.permutation(len(chance))
    steps = np.floor(np.cumsum(chance[order]) + rng.random())
    return np.sort(order[np.diff(steps, prepend=0) > 0])


def _power(values: Tensor) -> Tensor:
    """Squared modulus: ``abs().square()`` takes a root on the way."""
    return values.real**2 + values.imag**2


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
