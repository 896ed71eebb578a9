"""A small light's trails through known codes: their misfit pixel by pixel, moments and spot."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import pi, sqrt

import numpy as np
import torch
from scipy import ndimage
from torch import Tensor

from motdiff.estimators.coded.codes import middles, open_at
from motdiff.estimators.coded.misfit import Unknowns
from motdiff.types import FloatArray

_LEAST_SPOT_PX = 0.15  # narrower spots look alike on pixels
_STEP = 1.5  # of the pixels compared, in blurs
_AT_ONCE = 2**23  # values of the derivatives held at a time


@dataclass(frozen=True)
class TrailUnknowns(Unknowns):
    """Parameters of a fit to trails: path, shifts, light, offsets, and the spot's width.

    Attributes
    ----------
    knots, exposures : int
        K and I. A vector holds the path's knots (K, 2) px; of every photo but the first its shift
        (2) px; of every photo the logarithm of the light that the whole exposure would have, and
        an offset; the logarithm of the spot's standard deviation, px.
    """

    @property
    def size(self) -> int:
        """Length of the vector."""
        return self.spot + 1

    def gain(self, photo: int) -> int:
        """Index of the logarithm of a photo's light."""
        return self.shift(self.exposures) + photo

    def offset(self, photo: int) -> int:
        """Index of a photo's offset."""
        return self.gain(self.exposures) + photo

    @property
    def spot(self) -> int:
        """Index of the logarithm of the spot's standard deviation."""
        return self.offset(self.exposures)

    def pack_trails(self, paths: Tensor, shifts: Tensor, light: Tensor, spot_px: Tensor) -> Tensor:
        """Vectors of paths (B, K, 2), shifts (B, I, 2), light (B, I) and spots (B,), offsets 0."""
        return torch.cat(
            [
                paths.flatten(1),
                shifts[:, 1:].flatten(1),
                light.log(),
                torch.zeros_like(light),
                spot_px.log()[:, None],
            ],
            1,
        )

    def shifts(self, x: Tensor) -> Tensor:
        """Shifts of the photos (B, I, 2), px."""
        shifts = x[:, self.shift(1) : self.gain(0)].reshape(len(x), -1, 2)
        return torch.cat([torch.zeros(len(x), 1, 2), shifts], 1)

    def light(self, x: Tensor) -> Tensor:
        """Light of the whole exposures (B, I)."""
        return x[:, self.gain(0) : self.offset(0)].exp()

    def spot_px(self, x: Tensor) -> Tensor:
        """Return the standard deviations of the spot (B,), px."""
        return x[:, self.spot].exp()


class TrailTerm:
    """Difference between the trails of a path through codes and the photos, in noise units.

    The light is a Gaussian spot on square pixels. The path is straight between knots, which divide
    each chip evenly, and its light is summed at Gauss-Legendre points: exact as long as a piece is
    no longer than some spots.

    Parameters
    ----------
    codes : sequence of I str
        Of one number of chips, which divides ``unknowns.knots - 1``.
    photos : sequence of I (H, W) float
        The middle of pixel ``(H // 2, W // 2)`` is the origin of the path.
    sigmas : sequence of I (H, W) float
        Standard deviation of each pixel; infinite where it does not count.
    blur_px : float
        Gaussian that both are blurred with: large, the term has few local minima.
    """

    def __init__(
        self,
        unknowns: TrailUnknowns,
        codes: Sequence[str],
        photos: Sequence[FloatArray],
        sigmas: Sequence[FloatArray],
        *,
        blur_px: float = 0.0,
    ) -> None:
        pieces = unknowns.knots - 1
        self._unknowns = unknowns
        self._blur2 = blur_px**2
        step = max(1, round(_STEP * blur_px))
        points = 2 if blur_px > 1 else 3  # of the quadrature: smooth light needs fewer
        self._open = [
            torch.tensor(np.flatnonzero(is_open)) for is_open in open_at(codes, middles(pieces))
        ]
        node, weight = np.polynomial.legendre.leggauss(points)
        self._share = torch.tensor(0.5 + 0.5 * node, dtype=torch.float32)
        self._weight = torch.tensor(0.5 * weight / pieces, dtype=torch.float32)
        self._photos = []
        self._certain = []
        self._rows = []
        self._columns = []
        for photo, sigma in zip(photos, sigmas, strict=True):
            soft = ndimage.gaussian_filter(photo, blur_px, mode="constant") if blur_px else photo
            rows, columns = (np.arange((n // 2) % step, n, step) for n in photo.shape)
            grid = np.ix_(rows, columns)
            self._photos.append(torch.tensor(soft[grid], dtype=torch.float32))
            self._certain.append(torch.tensor(1 / sigma[grid], dtype=torch.float32))
            self._rows.append(torch.tensor(rows - photo.shape[0] // 2, dtype=torch.float32))
            self._columns.append(torch.tensor(columns - photo.shape[1] // 2, dtype=torch.float32))
        self.values = int(sum(int((certain > 0).sum()) for certain in self._certain))
        """Number of pixels that are compared."""

    def cost(self, x: Tensor) -> Tensor:
        """See :class:`motdiff.estimators.coded.misfit.Term`."""
        total = torch.zeros(len(x))
        for residual in self.residuals(x):
            total += residual.square().sum((1, 2))
        return total

    def residuals(self, x: Tensor) -> Iterator[Tensor]:
        """Residuals (B, H, W) of each photo, in units of its noise."""
        for photo in range(self._unknowns.exposures):
            down, across = self._responses(x, photo)[:2]
            shape = torch.einsum("bsqh,q,bsqw->bhw", down, self._weight, across)
            yield self._residual(x, photo, shape)

    def add_normal(self, x: Tensor, JJ: Tensor, Jr: Tensor) -> None:
        """See :class:`motdiff.estimators.coded.misfit.Term`."""
        pixels = max(
            len(rows) * len(columns)
            for rows, columns in zip(self._rows, self._columns, strict=True)
        )
        at_once = max(1, _AT_ONCE // (pixels * self._unknowns.size))
        for start in range(0, len(x), at_once):
            chunk = slice(start, start + at_once)
            for photo in range(self._unknowns.exposures):
                J, r = self._jacobian(x[chunk], photo)
                JJ[chunk] += J @ J.transpose(1, 2)
                Jr[chunk] += torch.einsum("bnm,bm->bn", J, r)

    def _jacobian(self, x: Tensor, photo: int) -> tuple[Tensor, Tensor]:
        """Jacobian (B, N, pixels) and residual (B, pixels) of one photo."""
        un = self._unknowns
        end = 2 * self._unknowns.knots
        down, across, down_slope, across_slope, wider = self._responses(x, photo)
        is_open = self._open[photo]
        light = un.light(x)[:, photo]
        shape = torch.einsum("bsqh,q,bsqw->bhw", down, self._weight, across)
        rows = torch.zeros(len(x), un.size, *shape.shape[1:])
        for axis, (vertical, horizontal) in enumerate(
            [(down, across_slope), (down_slope, across)]
        ):
            for late, share in ((0, 1 - self._share), (1, self._share)):
                weighted = (vertical * (self._weight * share)[:, None]).transpose(2, 3)
                rows[:, axis + 2 * late : end - 2 + axis + 2 * late : 2].index_add_(
                    1, is_open, weighted @ horizontal
                )
        if photo:
            for axis in (0, 1):
                rows[:, un.shift(photo) + axis] = rows[:, axis:end:2].sum(1)
        for vertical, horizontal in ((down, wider[1]), (wider[0], across)):
            rows[:, un.spot] += torch.einsum(
                "bsqh,q,bsqw->bhw", vertical, self._weight, horizontal
            )
        rows[:, un.gain(photo)] = shape
        rows *= light[:, None, None, None]
        rows[:, un.offset(photo)] = 1.0
        rows *= self._certain[photo]
        return rows.flatten(2), self._residual(x, photo, shape).flatten(1)

    def _residual(self, x: Tensor, photo: int, shape: Tensor) -> Tensor:
        light = self._unknowns.light(x)[:, photo]
        offset = x[:, self._unknowns.offset(photo)]
        model = light[:, None, None] * shape + offset[:, None, None]
        return (model - self._photos[photo]) * self._certain[photo]

    def _responses(
        self, x: Tensor, photo: int
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, tuple[Tensor, Tensor]]:
        """Responses of rows (B, S, Q, H) and columns (B, S, Q, W), and their slopes.

        The slopes are by the position, and by the logarithm of the spot's width.
        """
        un = self._unknowns
        paths = un.paths(x) + un.shifts(x)[:, photo, None]
        start = paths[:, self._open[photo]]
        stop = paths[:, self._open[photo] + 1]
        points = start[:, :, None] + self._share[:, None] * (stop - start)[:, :, None]
        spot2 = un.spot_px(x).clamp(min=_LEAST_SPOT_PX).square()
        width = (spot2 + self._blur2).sqrt()[:, None, None, None]
        grows = (spot2 / (spot2 + self._blur2))[:, None, None, None]  # d log width / d log spot
        respond = _blurred_response if self._blur2 else _response
        (across, across_slope, across_wider), (down, down_slope, down_wider) = (
            respond(pixels - points[..., axis, None], width)
            for axis, pixels in ((0, self._columns[photo]), (1, self._rows[photo]))
        )
        return down, across, down_slope, across_slope, (down_wider * grows, across_wider * grows)


def _response(distance: Tensor, width: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Response of a pixel to a Gaussian spot, and its slopes by the position and log width."""
    high = (distance + 0.5) / width
    low = (distance - 0.5) / width
    dense_high, dense_low = (torch.exp(-0.5 * z.square()) / sqrt(2 * pi) for z in (high, low))
    within = 0.5 * (torch.erf(high / sqrt(2)) - torch.erf(low / sqrt(2)))
    return within, (dense_low - dense_high) / width, dense_low * low - dense_high * high


def _blurred_response(distance: Tensor, width: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """:func:`_response` for a spot wider than a pixel."""
    spread = (width.square() + 1 / 12).sqrt()  # the pixel as a Gaussian of its variance
    z = distance / spread
    within = torch.exp(-0.5 * z.square()) / (sqrt(2 * pi) * spread)
    return within, within * z / spread, within * (z.square() - 1) * (width / spread).square()


def trail_moments(image: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centroid (2,) and covariance (2, 2) of a trail, px, (x, y)."""
    weight = np.maximum(image, 0)
    weight = np.where(weight > 0.05 * weight.max(), weight, 0)
    rows, columns = np.indices(image.shape)
    x = columns.ravel() - image.shape[1] // 2
    y = rows.ravel() - image.shape[0] // 2
    points = np.stack([x, y], axis=-1)
    flat = weight.ravel() / weight.sum()
    centre = flat @ points
    offsets = points - centre
    return centre, (offsets * flat[:, None]).T @ offsets


def spot_px(image: FloatArray) -> float:
    """Estimate the standard deviation of the light's spot, px, by the curvature of the ridges."""
    blur_px = 0.7
    soft = ndimage.gaussian_filter(image, blur_px)
    xx, yy, xy = (
        ndimage.gaussian_filter(image, blur_px, order=order) for order in ((0, 2), (2, 0), (1, 1))
    )
    sharpest = 0.5 * (xx + yy) - np.sqrt(0.25 * (xx - yy) ** 2 + xy**2)
    ridge = ((soft == ndimage.maximum_filter(soft, 3)) | (soft > 0.5 * soft.max())) & (
        soft > 0.25 * soft.max()
    )
    ridge &= sharpest < 0
    width2 = float(np.percentile(-soft[ridge] / sharpest[ridge], 20)) if ridge.any() else 1.0
    return float(np.sqrt(np.clip(width2 - blur_px**2 - 1 / 12, 0.3**2, 3.0**2)))
