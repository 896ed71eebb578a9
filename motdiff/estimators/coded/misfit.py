"""Misfit of coded photos by a path: terms of a sum of squares, and their Levenberg-Marquardt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from math import pi
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import interpolate

from motdiff.estimators.coded.otfs import CodedOtfs
from motdiff.threads import side_by_side
from motdiff.types import FloatArray

_CANDIDATES_AT_ONCE = 24  # bounds the memory of their normal equations
_LEAST_SECOND_DIFFERENCE_PX = 0.04  # at 53 knots
_HOPELESS_DAMPING = 1e2  # steps so short that the candidate has arrived


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

    def resampled(self, x: Tensor, knots: int) -> Tensor:
        """Vectors of the same paths with so many knots, by straight pieces."""
        paths = interpolate(self.paths(x).mT, size=knots, mode="linear", align_corners=True).mT
        return torch.cat([paths.flatten(1), x[:, 2 * self.knots :]], 1)

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
        self._add_weighted(x, torch.ones(len(x)), JJ, Jr)

    def _add_weighted(self, x: Tensor, weight: Tensor, JJ: Tensor, Jr: Tensor) -> None:
        r = self._differences(x)
        end = 2 * self._unknowns.knots
        for axis in (0, 1):
            JJ[:, axis:end:2, axis:end:2] += weight[:, None, None] * self._matrix
            Jr[:, axis:end:2] += weight[:, None] * (r[..., axis] @ self._matrix)


class Roughness(PathQuadratic):
    """Squared second differences of the path, scaled to those of 53 knots."""

    def __init__(self, unknowns: Unknowns, weight: float) -> None:
        # second differences of neighbouring knots
        D = np.diff(np.eye(unknowns.knots), n=2, axis=0)
        # the integral of |p''|^2, whatever the number of knots
        scale = ((unknowns.knots - 1) / 52) ** 3
        super().__init__(unknowns, weight * scale * D.T @ D)


class SmoothMotion(Roughness):
    """Minus twice the log prior of a path whose second differences share an unknown scale.

    A shake's are 0.01 px at 53 knots, a walk's 0.4: a fixed weight would take a smooth wrong path
    for a rough right one, or leave a shake to the noise. With an inverse-gamma prior on their
    variance the marginal of ``n`` normal differences is ``n log(1 + S / (n s^2))``, ``S`` their
    sum of squares and ``s`` the least scale (Student's t of the whole path).
    """

    def __init__(self, unknowns: Unknowns) -> None:
        super().__init__(unknowns, 1.0)
        self._count = 2 * (unknowns.knots - 2)
        self._least = self._count * _LEAST_SECOND_DIFFERENCE_PX**2

    def cost(self, x: Tensor) -> Tensor:
        """See :class:`Term`."""
        return self._count * torch.log1p(super().cost(x) / self._least)

    def add_normal(self, x: Tensor, JJ: Tensor, Jr: Tensor) -> None:
        """See :class:`Term`."""
        # d log(1 + S / L) = dS / (L + S): iteratively reweighted
        weight = self._count / (self._least + super().cost(x))
        self._add_weighted(x, weight, JJ, Jr)


class KernelTerm:
    """Difference, through a Gaussian, between the path's PSFs and the photos' estimated kernels.

    Parameters
    ----------
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
        J = torch.zeros(len(x), end + 2 * un.exposures, *residual.shape[1:], dtype=torch.complex64)
        slopes = slopes.transpose(1, 2) * scale[:, None]
        by_shift = -1j * otfs * scale
        for axis in (0, 1):
            J[:, axis:end:2] = slopes * phase[:, axis]
            for photo in range(un.exposures):
                J[:, end + 2 * photo + axis, photo] = by_shift[:, photo] * phase[:, axis]
        index = torch.cat([torch.arange(end), torch.arange(un.kernel_shift(0), un.size)])
        flat = torch.view_as_real(J).flatten(2)
        r = torch.view_as_real(residual).flatten(1)
        JJ[:, index[:, None], index] += flat @ flat.transpose(1, 2)
        Jr[:, index] += torch.einsum("bnm,bm->bn", flat, r)


def descend(
    terms: Sequence[Term], x: Tensor, *, steps: int, tolerance: float = 1e-3
) -> tuple[Tensor, Tensor]:
    """Candidates (B, N) and costs (B,) after Levenberg-Marquardt descent; no step raises a sum.

    Parameters
    ----------
    x : (B, N) candidates, see :class:`Unknowns`
    steps : int
        Most steps.
    tolerance : float
        A candidate whose cost falls by a smaller share in a step is finished.

    References
    ----------
    Marquardt, "An algorithm for least-squares estimation of nonlinear parameters", 1963.
    """
    # two, however many cores there are: the batches, hence the last bits, are the same everywhere
    halves = torch.split(x, max(1, -(-len(x) // 2)))
    descents = side_by_side([partial(_descend, terms, half, steps, tolerance) for half in halves])
    candidates, costs = zip(*descents, strict=True)
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
