"""How badly a path explains coded photos: terms of a sum of squares, and its descent for many
paths at once.
"""

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


@dataclass(frozen=True)
class Unknowns:
    """What is fitted, side by side in one vector per candidate: the path, and what differs from
    photo to photo.

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
        """Vectors of paths (B, K, 2), gains (B, I) with 1 first, kernels' shifts (B, I, 2); photos
        are not shifted.
        """
        still = torch.zeros(len(paths), 2 * (self.exposures - 1))
        return torch.cat(
            [paths.flatten(1), still, gains[:, 1:].log(), kernel_shifts.flatten(1)], 1
        )

    def paths(self, x: Tensor) -> Tensor:
        """Paths (B, K, 2), px."""
        return x[:, : 2 * self.knots].reshape(len(x), self.knots, 2)

    def shifts(self, x: Tensor) -> Tensor:
        """Shifts of the photos (B, I, 2), px."""
        others = x[:, self.shift(1) : self.gain(1)].reshape(len(x), -1, 2)
        return torch.cat([torch.zeros(len(x), 1, 2), others], 1)

    def gains(self, x: Tensor) -> Tensor:
        """Gains of the photos (B, I)."""
        return torch.cat(
            [torch.zeros(len(x), 1), x[:, self.gain(1) : self.kernel_shift(0)]], 1
        ).exp()

    def kernel_shifts(self, x: Tensor) -> Tensor:
        """Shifts of the photos' kernels (B, I, 2), px."""
        return x[:, self.kernel_shift(0) :].reshape(len(x), self.exposures, 2)


class Term(Protocol):
    """A part of the sum of squares."""

    def cost(self, x: Tensor) -> Tensor:
        """Sum of squares (B,) of candidates (B, N)."""

    def add_normal(self, x: Tensor, matrix: Tensor, slope: Tensor) -> None:
        """Add the term's Gauss-Newton matrix (B, N, N) and half its gradient (B, N)."""


class Roughness:
    """Squared second differences of the path, scaled to what 53 knots have."""

    def __init__(self, unknowns: Unknowns, weight: float) -> None:
        second = np.diff(np.eye(unknowns.knots), n=2, axis=0)
        scale = ((unknowns.knots - 1) / 52) ** 3
        self._matrix = torch.tensor(weight * scale * second.T @ second, dtype=torch.float32)
        self._unknowns = unknowns

    def cost(self, x: Tensor) -> Tensor:
        """See :class:`Term`."""
        paths = self._unknowns.paths(x)
        return torch.einsum("bkd,kl,bld->b", paths, self._matrix, paths)

    def add_normal(self, x: Tensor, matrix: Tensor, slope: Tensor) -> None:
        """See :class:`Term`."""
        paths = self._unknowns.paths(x)
        end = 2 * self._unknowns.knots
        for axis in (0, 1):
            matrix[:, axis:end:2, axis:end:2] += self._matrix
            slope[:, axis:end:2] += paths[..., axis] @ self._matrix


class KernelTerm:
    """Difference between the path's PSFs and the kernels found in the photos, each on its own,
    through a Gaussian.

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
        seen = np.exp(-2 * (pi * sigma_px) ** 2 * (f**2).sum(axis=1))
        scale = np.sqrt(weights / (np.abs(spectra * seen) ** 2).sum(axis=1))[:, None] * seen
        hat = np.sinc(f[:, 0]) ** 2 * np.sinc(f[:, 1]) ** 2  # PSFs on pixels are seen through it
        self._wanted = torch.tensor(spectra * scale, dtype=torch.complex64)
        self._scale = torch.tensor(scale * hat, dtype=torch.float32)
        self._f = torch.tensor(f, dtype=torch.float32)
        self._unknowns = unknowns
        self._otfs = otfs
        self._saturation = saturation

    def cost(self, x: Tensor) -> Tensor:
        """See :class:`Term`."""
        otfs = self._otfs.otfs(self._unknowns.paths(x), self._unknowns.kernel_shifts(x), self._f)
        squares = (otfs * self._scale - self._wanted).abs().square().sum(2)
        return (
            squares if self._saturation is None else squares / (1 + squares / self._saturation)
        ).sum(1)

    def add_normal(self, x: Tensor, matrix: Tensor, slope: Tensor) -> None:
        """See :class:`Term`."""
        un = self._unknowns
        end = 2 * self._unknowns.knots
        phase = 2 * pi * self._f
        otfs, slopes = self._otfs.with_slopes(un.paths(x), un.kernel_shifts(x), self._f)
        scale = self._scale.expand(len(x), -1, -1)
        residual = otfs * scale - self._wanted
        if self._saturation is not None:
            share = 1 / (1 + residual.abs().square().sum(2, keepdim=True) / self._saturation)
            scale = scale * share
            residual = residual * share
        jacobian = torch.zeros(*residual.shape, end + 2 * un.exposures, dtype=torch.complex64)
        slopes = slopes * scale[..., None]
        drift = -1j * otfs * scale
        for axis in (0, 1):
            jacobian[..., axis:end:2] = slopes * phase[:, axis, None]
            for photo in range(un.exposures):
                jacobian[:, photo, :, end + 2 * photo + axis] = drift[:, photo] * phase[:, axis]
        index = torch.cat([torch.arange(end), torch.arange(un.kernel_shift(0), un.size)])
        rows = torch.view_as_real(jacobian.flatten(1, 2)).transpose(2, 3).flatten(1, 2)
        wrong = torch.view_as_real(residual.flatten(1, 2)).flatten(1, 2)
        matrix[:, index[:, None], index] += rows.transpose(1, 2) @ rows
        slope[:, index] += torch.einsum("bmn,bm->bn", rows, wrong)


@dataclass(frozen=True)
class SceneSpectra:
    """Photos of one scene as spectra on a coarse grid.

    Attributes
    ----------
    side_px, grid : int
        Side N of the photos, and of the grid, n: frequencies below n / (2 N) cycles/px are kept.
    kept : (F,) int
        Which of the grid's half-plane spectrum, flat.
    f : (F, 2) float, cycles/px
    photos : (I, F) complex
    power : (F,) float
        Mean power of the windowed photos around each frequency.
    noise : float
        Of it, the share of the noise.
    window : (n, n) float
        0 where a photo's blurred light comes from beyond its border.
    """

    side_px: int
    grid: int
    kept: Tensor
    f: Tensor
    photos: Tensor
    power: Tensor
    noise: float
    window: Tensor

    def windowed(self, spectra: Tensor) -> Tensor:
        """Spectra (..., F) of images multiplied by the window."""
        whole = torch.zeros(
            *spectra.shape[:-1], self.grid * (self.grid // 2 + 1), dtype=torch.complex64
        )
        whole[..., self.kept] = spectra
        spectra_within: Tensor = torch.fft.rfft2(self.window * self.to_image(whole)).flatten(-2)[
            ..., self.kept
        ]
        return spectra_within

    def to_image(self, whole: Tensor) -> Tensor:
        """Images (..., n, n) of flat half-plane spectra."""
        shaped = whole.reshape(*whole.shape[:-1], self.grid, self.grid // 2 + 1)
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
        How far the blur reaches.
    """
    side = len(photos[0])
    fine = np.stack([photo - ndimage.gaussian_filter(photo, _SLOW_PX) for photo in photos])
    window = _window(side, side, margin_px)
    spectra = fft.rfft2(fine)
    own = np.abs(fft.rfft2(window * fine)) ** 2
    beyond = (
        np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)[None]) > _ONLY_NOISE_CY_PX
    )
    noise = max(float(own[:, beyond].mean()), _LEAST_NOISE**2 * float((window**2).sum()))
    whole = np.concatenate([own[..., :0:-1], own], axis=-1).mean(axis=0)
    power = ndimage.gaussian_filter(whole, 4)[:, side // 2 :]

    def on(grid: int) -> SceneSpectra:
        fy = (np.fft.fftfreq(grid) * grid / side)[:, None]
        fx = (np.fft.rfftfreq(grid) * grid / side)[None]
        radius = np.hypot(fy, fx)
        kept = (radius < 0.48 * grid / side) & (radius > 1 / 64) & ~((fx == 0) & (fy < 0))
        rows, columns = np.nonzero(kept)
        rows_of_photo = np.where(rows > grid // 2, rows - grid + side, rows)
        share = (grid / side) ** 2
        f = np.stack([np.broadcast_to(f, kept.shape)[kept] for f in (fx, fy)], axis=1)
        return SceneSpectra(
            side_px=side,
            grid=grid,
            kept=torch.tensor(np.flatnonzero(kept.ravel())),
            f=torch.tensor(f, dtype=torch.float32),
            photos=torch.tensor(spectra[:, rows_of_photo, columns] * share, dtype=torch.complex64),
            power=torch.tensor(power[rows_of_photo, columns] * share**2, dtype=torch.float32),
            noise=noise * share**2,
            window=torch.tensor(_window(side, grid, margin_px), dtype=torch.float32),
        )

    return [on(grid) for grid in grids]


class SceneTerm:
    """Misfit of photos of one scene, the scene eliminated: what photo i shows through OTF j is
    what j shows through i.

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
        wrong_phase = (2 * pi * path_error_px * spectra.f.norm(dim=1)).clamp(max=1)
        self._variance = spectra.noise + wrong_phase**2 * spectra.power
        self.values = len(spectra.f) * (unknowns.exposures - 1)
        """How many squares are summed: the expected cost of the true path."""

    def cost(self, x: Tensor) -> Tensor:
        """See :class:`Term`."""
        un = self._unknowns
        photos = self.spectra.photos
        parts = []
        for part in torch.split(x, 8):
            otfs = self._otfs.otfs(un.paths(part), un.shifts(part), self.spectra.f)
            seen = otfs * (un.gains(part) * self._open)[..., None]
            products = torch.stack(
                [photos[a] * seen[:, b] - photos[b] * seen[:, a] for a, b in self._pairs], 1
            )
            squares = self.spectra.windowed(products).abs().square().sum(1)
            parts.append((squares / (self._light(seen) * self._variance)).sum(1))
        return torch.cat(parts)

    def add_normal(self, x: Tensor, matrix: Tensor, slope: Tensor) -> None:
        """See :class:`Term`."""
        for i in range(len(x)):
            rows, wrong = self._rows(x[i : i + 1])
            n = len(rows)
            matrix[i, :n, :n] += rows @ rows.T
            slope[i, :n] += rows @ wrong

    def _rows(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Jacobian (parameters, values) and residual (values,) of one candidate (1, N)."""
        un = self._unknowns
        photos = self.spectra.photos
        end = 2 * self._unknowns.knots
        phase = 2 * pi * self.spectra.f
        otfs, slopes = self._otfs.with_slopes(un.paths(x), un.shifts(x), self.spectra.f)
        light = (un.gains(x) * self._open)[0, :, None]
        seen = otfs[0] * light
        slopes = slopes[0] * light[..., None]
        total = self._light(seen[None])[0]
        rows = torch.zeros(un.kernel_shift(0), len(self._pairs), len(phase), dtype=torch.complex64)
        brighter = torch.zeros(len(rows), len(phase))  # relative change of the total
        growing = 2 * (seen.conj()[..., None] * slopes).real.sum(0) / total[:, None]
        for axis in (0, 1):
            brighter[axis:end:2] = (growing * phase[:, axis, None]).T
        for m, (a, b) in enumerate(self._pairs):
            change = photos[a][:, None] * slopes[b] - photos[b][:, None] * slopes[a]
            for axis in (0, 1):
                rows[axis:end:2, m] = (change * phase[:, axis, None]).T
            for photo, product in ((a, -photos[b] * seen[a]), (b, photos[a] * seen[b])):
                if photo:
                    rows[un.gain(photo), m] = product
                    for axis in (0, 1):
                        rows[un.shift(photo) + axis, m] = -1j * phase[:, axis] * product
        for photo in range(1, un.exposures):
            brighter[un.gain(photo)] = 2 * seen[photo].abs().square() / total
        products = torch.stack([photos[a] * seen[b] - photos[b] * seen[a] for a, b in self._pairs])
        residual = self.spectra.windowed(products)
        weight = (total * self._variance).rsqrt()
        for part, grows in zip(
            torch.split(rows, _ROWS_AT_ONCE), torch.split(brighter, _ROWS_AT_ONCE), strict=True
        ):
            # the weight, too, depends on the path: without this the noise would pull it off
            part.copy_((self.spectra.windowed(part) - 0.5 * residual * grows[:, None]) * weight)
        return torch.view_as_real(rows).flatten(1), torch.view_as_real(residual * weight).flatten()

    def registered(self, x: Tensor) -> Tensor:
        """Candidates with the photos' shifts found by correlation."""
        un = self._unknowns
        spectra = self.spectra
        still = x.clone()
        still[:, un.shift(1) : un.gain(1)] = 0
        otfs = self._otfs.otfs(un.paths(still), un.shifts(still), spectra.f)
        for photo in range(1, un.exposures):
            same = spectra.photos[photo] * otfs[:, 0] * (spectra.photos[0] * otfs[:, photo]).conj()
            whole = torch.zeros(
                len(x), spectra.grid * (spectra.grid // 2 + 1), dtype=torch.complex64
            )
            whole[:, spectra.kept] = same / ((otfs[:, 0] * otfs[:, photo]).abs() + _LEAST_PRODUCT)
            for row, image in zip(still, spectra.to_image(whole).numpy(), strict=True):
                dy, dx = _peak(image)
                at = un.shift(photo)
                step_px = spectra.side_px / spectra.grid
                row[at], row[at + 1] = dx * step_px, dy * step_px
        return still

    @staticmethod
    def _light(seen: Tensor) -> Tensor:
        return seen.abs().square().sum(1) + _LEAST_LIGHT


def descend(
    terms: Sequence[Term], x: Tensor, *, steps: int, tolerance: float = 1e-3
) -> tuple[Tensor, Tensor]:
    """Lower the sum of the terms from each candidate, by damped Gauss-Newton steps that never
    raise it.

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
    Levenberg, 1944; Marquardt, 1963.
    """
    halves = torch.split(
        x, max(1, -(-len(x) // 2))
    )  # two however many cores: results depend on the machine least
    found = side_by_side([partial(_descend, terms, half, steps, tolerance) for half in halves])
    return torch.cat([vectors for vectors, _ in found]), torch.cat([costs for _, costs in found])


def _descend(
    terms: Sequence[Term], x: Tensor, steps: int, tolerance: float
) -> tuple[Tensor, Tensor]:
    x, size = x.clone(), x.shape[1]
    damping = torch.full((len(x),), 1e-2)
    costs = _cost(terms, x)
    active = torch.arange(len(x))
    for _ in range(steps):
        moves = []
        for part in torch.split(active, _CANDIDATES_AT_ONCE):
            matrix = torch.zeros(len(part), size, size)
            slope = torch.zeros(len(part), size)
            for term in terms:
                term.add_normal(x[part], matrix, slope)
            diagonal = torch.diagonal(matrix, dim1=1, dim2=2)
            mean = diagonal.mean(1, keepdim=True)
            added = damping[part, None] * (0.1 * mean + diagonal) + 1e-7 * mean
            factor, failed = torch.linalg.cholesky_ex((matrix + torch.diag_embed(added)).double())
            move = -torch.cholesky_solve(slope.double()[..., None], factor)[..., 0].float()
            moves.append(torch.where((failed == 0)[:, None] & move.isfinite(), move, 0.0))
        tried = x[active] + torch.cat(moves)
        reached = _cost(terms, tried)
        lower = reached < costs[active]
        fallen = (costs[active] - reached) / costs[active]
        x[active[lower]], costs[active[lower]] = tried[lower], reached[lower]
        damping[active] = torch.where(lower, 0.2 * damping[active], 5 * damping[active]).clamp(
            min=1e-7
        )
        active = active[~((lower & (fallen < tolerance)) | (damping[active] > _HOPELESS_DAMPING))]
        if not len(active):
            break
    return x, costs


def _cost(terms: Sequence[Term], x: Tensor) -> Tensor:
    return torch.stack([term.cost(x) for term in terms]).sum(0)


_SLOW_PX = 8.0  # slower differences of light (lamps, vignetting) are taken away
_ONLY_NOISE_CY_PX = (
    0.5  # beyond it, in the corners of the spectrum, a blurred photo has nothing but noise
)
_LEAST_LIGHT = 1e-4  # squared and simple: of OTFs at frequencies that no photo holds
_LEAST_PRODUCT = 0.02
_LEAST_NOISE = 1e-3  # of full scale: 8 bits round by that, and files that were smoothed show less
_ROWS_AT_ONCE = 16  # what fits the cache
_CANDIDATES_AT_ONCE = 24
_HOPELESS_DAMPING = 1e2


def _half_plane(most_cy_px: float, side_px: int) -> FloatArray:
    """Frequencies (F, 2) of a frame of ``side_px``, one of each conjugate pair, without 0."""
    count = side_px // 2
    y, x = np.meshgrid(np.arange(-count, count + 1), np.arange(count + 1), indexing="ij")
    f = np.stack([x.ravel(), y.ravel()], axis=1) / side_px
    once = (x.ravel() > 0) | (y.ravel() > 0)
    kept: FloatArray = f[once & (np.hypot(f[:, 0], f[:, 1]) < most_cy_px)]
    return kept


def _spectrum(kernel: FloatArray, f: FloatArray) -> NDArray[np.complex128]:
    """Spectrum (F,) of a kernel whose zero displacement is at index ``size // 2``."""
    down, right = (
        np.exp(-2j * pi * np.outer(f[:, axis], np.arange(n) - n // 2))
        for axis, n in zip((1, 0), kernel.shape, strict=True)
    )
    return np.asarray(np.einsum("fy,yx,fx->f", down, kernel, right, optimize=True))


def _window(side: int, grid: int, margin_px: int) -> FloatArray:
    """Window (grid, grid) over a photo of ``side`` px: 0 within the margin, and rising to 1 over
    as much again.
    """
    at = np.arange(grid) * side / grid
    inside = np.minimum(at, side - side / grid - at)
    edge = np.sin(0.5 * pi * np.clip((inside - margin_px + 0.5) / min(32, side // 8), 0, 1)) ** 2
    return np.outer(edge, edge)


def _peak(image: NDArray[np.float32]) -> tuple[float, float]:
    """Place of the largest value (down, right) in a periodic image, to a fraction of a pixel."""
    index = np.unravel_index(int(image.argmax()), image.shape)
    at = []
    for axis, n in enumerate(image.shape):
        before, here, after = (float(np.roll(image, step, axis)[index]) for step in (1, 0, -1))
        bend = before - 2 * here + after
        place = index[axis] + (0.5 * (before - after) / bend if bend < 0 else 0.0)
        at.append(place - n if place > n / 2 else place)
    return at[0], at[1]
