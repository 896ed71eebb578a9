"""Misfit of coded photos by a path: terms of a sum of squares, and their Levenberg-Marquardt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from math import pi
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import fft, ndimage
from torch import Tensor

from motdiff.estimators.coded.otfs import CodedOtfs
from motdiff.threads import side_by_side
from motdiff.types import FloatArray

_SLOW_PX = 8.0  # slower differences of light (lamps, vignetting) are taken away
# beyond it, in the corners of the spectrum, a blurred photo has nothing but noise
_ONLY_NOISE_CY_PX = 0.5
_LEAST_LIGHT = 1e-4  # squared and simple: of OTFs at frequencies that no photo holds
_LEAST_PRODUCT = 0.02
_LEAST_NOISE = 1e-3  # of full scale: 8 bits round by that, and files that were smoothed show less
_ROWS_AT_ONCE = 16  # as many as fit the cache
_CANDIDATES_AT_ONCE = 24
_HOPELESS_DAMPING = 1e2


@dataclass(frozen=True)
class Unknowns:
    """Parameters of the fit, one vector per candidate: the path, and each photo's own.

    Attributes
    ----------
    knots, exposures : int
        K and I. A vector holds the path's knots (K, 2) px; of every photo but the first its shift
        (2) px and the logarithm of its gain against the first; of every photo's own kernel its
        shift (2) px.
    """

    knots: int
    exposures: int

    @property
    def size(self) -> int:
        """Length of the vector."""
        return self.kernel_shift(self.exposures)

    def shift(self, photo: int) -> int:
        """Index of a photo's shift; the first photo has none."""
        return 2 * self.knots + 2 * (photo - 1)

    def gain(self, photo: int) -> int:
        """Index of the logarithm of a photo's gain; the first photo has none."""
        return self.shift(self.exposures) + photo - 1

    def kernel_shift(self, photo: int) -> int:
        """Index of the shift of a photo's kernel."""
        return self.gain(self.exposures) + 2 * photo

    def pack(self, paths: Tensor, gains: Tensor, kernel_shifts: Tensor) -> Tensor:
        """Vectors of paths (B, K, 2), gains (B, I), 1 first, and kernels' shifts (B, I, 2)."""
        shifts = torch.zeros(len(paths), 2 * (self.exposures - 1))
        return torch.cat(
            [paths.flatten(1), shifts, gains[:, 1:].log(), kernel_shifts.flatten(1)], 1
        )

    def paths(self, x: Tensor) -> Tensor:
        """Paths (B, K, 2), px."""
        return x[:, : 2 * self.knots].reshape(len(x), self.knots, 2)

    def shifts(self, x: Tensor) -> Tensor:
        """Shifts of the photos (B, I, 2), px."""
        shifts = x[:, self.shift(1) : self.gain(1)].reshape(len(x), -1, 2)
        return torch.cat([torch.zeros(len(x), 1, 2), shifts], 1)

    def gains(self, x: Tensor) -> Tensor:
        """Gains of the photos (B, I)."""
        log_gains = x[:, self.gain(1) : self.kernel_shift(0)]
        return torch.cat([torch.zeros(len(x), 1), log_gains], 1).exp()

    def kernel_shifts(self, x: Tensor) -> Tensor:
        """Shifts of the photos' kernels (B, I, 2), px."""
        return x[:, self.kernel_shift(0) :].reshape(len(x), self.exposures, 2)


class Term(Protocol):
    """A term of the sum of squares."""

    def cost(self, x: Tensor) -> Tensor:
        """Sum of squares (B,) of candidates (B, N)."""

    def add_normal(self, x: Tensor, JJ: Tensor, Jr: Tensor) -> None:
        """Add the term's ``J^T J`` (B, N, N) and ``J^T r`` (B, N), half its gradient."""


class PathQuadratic:
    """Quadratic form of the path's difference from a reference, the same on both axes.

    Parameters
    ----------
    unknowns : Unknowns
    matrix : (K, K) float
    reference : (K, 2) float, px, optional
        0 when omitted.
    """

    def __init__(
        self, unknowns: Unknowns, matrix: FloatArray, reference: FloatArray | None = None
    ) -> None:
        self._matrix = torch.tensor(matrix, dtype=torch.float32)
        self._reference = None
        if reference is not None:
            self._reference = torch.tensor(reference, dtype=torch.float32)
        self._unknowns = unknowns

    def _differences(self, x: Tensor) -> Tensor:
        paths = self._unknowns.paths(x)
        return paths if self._reference is None else paths - self._reference

    def cost(self, x: Tensor) -> Tensor:
        """See :class:`Term`."""
        r = self._differences(x)
        return torch.einsum("bkd,kl,bld->b", r, self._matrix, r)

    def add_normal(self, x: Tensor, JJ: Tensor, Jr: Tensor) -> None:
        """See :class:`Term`."""
        r = self._differences(x)
        end = 2 * self._unknowns.knots
        for axis in (0, 1):
            JJ[:, axis:end:2, axis:end:2] += self._matrix
            Jr[:, axis:end:2] += r[..., axis] @ self._matrix


class Roughness(PathQuadratic):
    """Squared second differences of the path, scaled to those of 53 knots."""

    def __init__(self, unknowns: Unknowns, weight: float) -> None:
        D = np.diff(np.eye(unknowns.knots), n=2, axis=0)
        scale = ((unknowns.knots - 1) / 52) ** 3
        super().__init__(unknowns, weight * scale * D.T @ D)


class KernelTerm:
    """Difference, through a Gaussian, between the path's PSFs and the photos' estimated kernels.

    Parameters
    ----------
    unknowns : Unknowns
    otfs : CodedOtfs
    kernels : sequence of I (S, S) float
    sigma_px : float
        Scale of the Gaussian: large, the term has few local minima.
    weights : (I,) float
        Cost of a kernel that is off by all of itself.
    saturation : float, optional
        Cost that no kernel exceeds, since the search for it may have failed; none when omitted.
    """

    def __init__(
        self,
        unknowns: Unknowns,
        otfs: CodedOtfs,
        kernels: Sequence[FloatArray],
        *,
        sigma_px: float,
        weights: FloatArray,
        saturation: float | None = None,
    ) -> None:
        f = _half_plane(min(0.42, 0.4 / sigma_px), max(len(kernel) for kernel in kernels))
        spectra = np.stack([_spectrum(kernel / kernel.sum(), f) for kernel in kernels])
        gauss = np.exp(-2 * (pi * sigma_px) ** 2 * (f**2).sum(axis=1))
        scale = np.sqrt(weights / (np.abs(spectra * gauss) ** 2).sum(axis=1))[:, None] * gauss
        hat = np.sinc(f[:, 0]) ** 2 * np.sinc(f[:, 1]) ** 2  # of PSFs sampled on pixels
        self._target = torch.tensor(spectra * scale, dtype=torch.complex64)
        self._scale = torch.tensor(scale * hat, dtype=torch.float32)
        self._f = torch.tensor(f, dtype=torch.float32)
        self._unknowns = unknowns
        self._otfs = otfs
        self._saturation = saturation

    def cost(self, x: Tensor) -> Tensor:
        """See :class:`Term`."""
        otfs = self._otfs.otfs(self._unknowns.paths(x), self._unknowns.kernel_shifts(x), self._f)
        squares = (otfs * self._scale - self._target).abs().square().sum(2)
        if self._saturation is not None:
            squares = squares / (1 + squares / self._saturation)
        return squares.sum(1)

    def add_normal(self, x: Tensor, JJ: Tensor, Jr: Tensor) -> None:
        """See :class:`Term`."""
        un = self._unknowns
        end = 2 * self._unknowns.knots
        phase = 2 * pi * self._f
        otfs, slopes = self._otfs.with_slopes(un.paths(x), un.kernel_shifts(x), self._f)
        scale = self._scale.expand(len(x), -1, -1)
        residual = otfs * scale - self._target
        if self._saturation is not None:
            # the derivative of s / (1 + s / c) is the square of this: iteratively reweighted
            share = 1 / (1 + residual.abs().square().sum(2, keepdim=True) / self._saturation)
            scale = scale * share
            residual = residual * share
        jacobian = torch.zeros(*residual.shape, end + 2 * un.exposures, dtype=torch.complex64)
        slopes = slopes * scale[..., None]
        by_shift = -1j * otfs * scale
        for axis in (0, 1):
            jacobian[..., axis:end:2] = slopes * phase[:, axis, None]
            for photo in range(un.exposures):
                jacobian[:, photo, :, end + 2 * photo + axis] = by_shift[:, photo] * phase[:, axis]
        index = torch.cat([torch.arange(end), torch.arange(un.kernel_shift(0), un.size)])
        J = torch.view_as_real(jacobian.flatten(1, 2)).transpose(2, 3).flatten(1, 2)
        r = torch.view_as_real(residual.flatten(1, 2)).flatten(1, 2)
        JJ[:, index[:, None], index] += J.transpose(1, 2) @ J
        Jr[:, index] += torch.einsum("bmn,bm->bn", J, r)


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
    unknowns : Unknowns
    otfs : CodedOtfs
    spectra : SceneSpectra
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
        phase_error = (2 * pi * path_error_px * spectra.f.norm(dim=1)).clamp(max=1)
        self._variance = spectra.noise + phase_error**2 * spectra.power
        self.values = len(spectra.f) * (unknowns.exposures - 1)
        """Number of squares that are summed: the expected cost of the true path."""

    def cost(self, x: Tensor) -> Tensor:
        """See :class:`Term`."""
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
        """See :class:`Term`."""
        for i in range(len(x)):
            J, r = self._jacobian(x[i : i + 1])
            n = len(J)
            JJ[i, :n, :n] += J @ J.T
            Jr[i, :n] += J @ r

    def _jacobian(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Jacobian (parameters, values) and residual (values,) of one candidate (1, N)."""
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
        dpower = torch.zeros(len(J), len(phase))  # relative
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
        weight = (power * self._variance).rsqrt()
        chunks = (torch.split(rows, _ROWS_AT_ONCE) for rows in (J, dpower))
        for J_rows, change in zip(*chunks, strict=True):
            # the weight, too, depends on the path: without this the noise would pull it off
            J_rows.copy_(
                (self.spectra.windowed(J_rows) - 0.5 * residual * change[:, None]) * weight
            )
        return torch.view_as_real(J).flatten(1), torch.view_as_real(residual * weight).flatten()

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


def descend(
    terms: Sequence[Term], x: Tensor, *, steps: int, tolerance: float = 1e-3
) -> tuple[Tensor, Tensor]:
    """Lower the sum of the terms from each candidate by Levenberg-Marquardt; no step raises it.

    Parameters
    ----------
    terms : sequence of Term
    x : (B, N) candidates, see :class:`Unknowns`
    steps : int
        Most steps.
    tolerance : float
        A candidate whose cost falls by a smaller share in a step is finished.

    Returns
    -------
    (B, N) candidates and their (B,) costs

    References
    ----------
    Marquardt, "An algorithm for least-squares estimation of nonlinear parameters", 1963.
    """
    # two, however many cores there are: the batches, hence the last bits, are the same everywhere
    halves = torch.split(x, max(1, -(-len(x) // 2)))
    ends = side_by_side([partial(_descend, terms, half, steps, tolerance) for half in halves])
    candidates, costs = zip(*ends, strict=True)
    return torch.cat(candidates), torch.cat(costs)


def _descend(
    terms: Sequence[Term], x: Tensor, steps: int, tolerance: float
) -> tuple[Tensor, Tensor]:
    x = x.clone()
    size = x.shape[1]
    lam = torch.full((len(x),), 1e-2)  # Marquardt's lambda, one per candidate
    costs = _cost(terms, x)
    active = torch.arange(len(x))
    for _ in range(steps):
        moves = []
        for chunk in torch.split(active, _CANDIDATES_AT_ONCE):
            JJ = torch.zeros(len(chunk), size, size)
            Jr = torch.zeros(len(chunk), size)
            for term in terms:
                term.add_normal(x[chunk], JJ, Jr)
            diagonal = torch.diagonal(JJ, dim1=1, dim2=2)
            mean = diagonal.mean(1, keepdim=True)
            # the mean beside Marquardt's diagonal bounds the parameters that hardly count
            damping = lam[chunk, None] * (0.1 * mean + diagonal) + 1e-7 * mean
            factor, failed = torch.linalg.cholesky_ex((JJ + torch.diag_embed(damping)).double())
            move = -torch.cholesky_solve(Jr.double()[..., None], factor)[..., 0].float()
            moves.append(torch.where((failed == 0)[:, None] & move.isfinite(), move, 0.0))
        x_new = x[active] + torch.cat(moves)
        new_costs = _cost(terms, x_new)
        lower = new_costs < costs[active]
        decrease = (costs[active] - new_costs) / costs[active]
        x[active[lower]] = x_new[lower]
        costs[active[lower]] = new_costs[lower]
        lam[active] = torch.where(lower, 0.2 * lam[active], 5 * lam[active]).clamp(min=1e-7)
        active = active[~((lower & (decrease < tolerance)) | (lam[active] > _HOPELESS_DAMPING))]
        if not len(active):
            break
    return x, costs


def _cost(terms: Sequence[Term], x: Tensor) -> Tensor:
    return torch.stack([term.cost(x) for term in terms]).sum(0)


def _half_plane(most_cy_px: float, side_px: int) -> FloatArray:
    """Frequencies (F, 2) of a frame of ``side_px``, one of each conjugate pair, without 0."""
    count = side_px // 2
    y, x = np.meshgrid(np.arange(-count, count + 1), np.arange(count + 1), indexing="ij")
    f = np.stack([x.ravel(), y.ravel()], axis=1) / side_px
    once = (x.ravel() > 0) | (y.ravel() > 0)
    half_plane: FloatArray = f[once & (np.hypot(f[:, 0], f[:, 1]) < most_cy_px)]
    return half_plane


def _spectrum(kernel: FloatArray, f: FloatArray) -> NDArray[np.complex128]:
    """Spectrum (F,) of a kernel whose zero displacement is at index ``size // 2``."""
    down, right = (
        np.exp(-2j * pi * np.outer(f[:, axis], np.arange(n) - n // 2))
        for axis, n in zip((1, 0), kernel.shape, strict=True)
    )
    return np.asarray(np.einsum("fy,yx,fx->f", down, kernel, right, optimize=True))


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
