"""Contrast of orders: how surely photos through codes tell one order in time from another."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from motdiff.crops import pick_crops
from motdiff.estimators.coded.scene_term import scene_side_px, scene_spectra
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

ComplexArray = NDArray[np.complex64]

TOLD = 400.0
"""Chi-square beyond which photos rule an order out, errors of the model too."""
ALIKE_PX = 2.0
"""Rms distance below which taking one order for another does no harm."""
ORDER_KNOTS = 53
"""Positions of an order, at evenly spaced times."""

_BAND_CY_PX = 0.2  # beyond it, blurred photos hold little but noise
_STEPS = 10  # frequencies from 0 to the band's end: 1 / 50 cycles/px apart
_KNOTS = 7  # of a deformation: an error of the path changes over a sixth of the exposure
# expected sizes of what may differ freely; so large a deformation is still nearly linear
_DEFORMED_PX = 2.0
_SHIFTED_PX = 5.0
_GAIN = 0.3  # logarithm
_LEAST_POWER = 1e-4  # floor of |H|^2, for frequencies that no photo holds
_MARGIN_PX = 30  # of a photo whose light comes from beyond its border


@dataclass(frozen=True)
class SceneLight:
    """Power of a scene against the noise: ``strength / f^2`` at f cycles/px.

    Attributes
    ----------
    strength : float
        Power of the sharp scene over that of the noise in one photo, times f^2.
    side_px : float
        Side of a square that holds as many independent values as the photo.
    """

    strength: float = 55.0
    side_px: float = 180.0

    @classmethod
    def of(cls, photo: FloatArray, path: Trajectory) -> SceneLight:
        """Measure it where a photo (H, W) with an open shutter, blurred by a path, has texture."""
        side = scene_side_px(photo.shape)
        row, column = pick_crops(photo, size=side, count=1)[0]
        crop = photo[row : row + side, column : column + side]
        margin = min(_MARGIN_PX, side // 6)
        spectra = scene_spectra([crop], grids=[side // 3], margin_px=margin)[0]
        fx, fy = spectra.f.numpy().T
        radius2 = fx**2 + fy**2
        blurred = np.abs(path.slice_otfs([0.0, 1.0], fx, fy)[0]) ** 2
        power = np.maximum(spectra.power.numpy() / spectra.noise - 1, 0)
        window_share = float((spectra.window**2).mean())
        return cls(
            strength=float(power.sum() / max(float((blurred / radius2).sum()), 1e-12)),
            side_px=side * window_share**0.5,
        )


class OrderContrast:
    """Least chi-square between orders of a path whose geometry may move.

    Photos of order a are explained by order b where ``B_i H_j = B_j H_i``, with B of a and H of b,
    at all frequencies. Order b may be deformed smoothly, and each photo but the first has a shift
    and a gain of its own: one Gauss-Newton step takes away what these explain. What is left, in
    units of the photos' noise, is the chi-square between a and b.

    Parameters
    ----------
    orders : (N, K, 2) float, px
        At evenly spaced times.
    codes : sequence of (n,) of 0 and 1
        Of the photos taken already.
    chips : int
    scene : SceneLight
    pairs : (2, P) int, optional
        Indices of the orders that are compared; all when omitted.

    Examples
    --------
    An open shutter sees no difference between there and back, its second half does:

    >>> there = np.stack([30 * np.linspace(0, 1, 53) ** 2, np.zeros(53)], axis=1)
    >>> contrast = OrderContrast(np.stack([there, there[::-1]]), [np.ones(4)], chips=4)
    >>> flat, half = contrast.of([[1, 1, 1, 1], [0, 0, 1, 1]])[:, 0]
    >>> bool(flat < 0.01), bool(half > 1000)
    (True, True)
    """

    def __init__(
        self,
        orders: FloatArray,
        codes: Sequence[ArrayLike],
        *,
        chips: int,
        scene: SceneLight | None = None,
        pairs: NDArray[np.intp] | None = None,
    ) -> None:
        scene = scene or SceneLight()
        step = _BAND_CY_PX / _STEPS
        down, right = np.mgrid[-_STEPS : _STEPS + 1, : _STEPS + 1] * step
        radius = np.hypot(down, right)
        # photos are real: half of the frequencies hold all
        half_disc = (radius <= _BAND_CY_PX) & ((right > 0) | (down > 0))
        self._f = np.stack([right[half_disc], down[half_disc]], axis=1).astype(np.float32)
        # a frequency stands for so many independent ones, each of a real and an imaginary part
        self._snr = (scene.strength / radius[half_disc] ** 2 * (step * scene.side_px) ** 2).astype(
            np.float32
        )
        edges = np.linspace(0, 1, chips + 1)
        self._slices: ComplexArray = np.stack(
            [
                Trajectory.from_samples(order).slice_otfs(edges, *self._f.T).astype(np.complex64)
                for order in orders
            ]
        )  # (N, n, F)
        middles = 0.5 * (edges[1:] + edges[:-1])
        self._places = np.stack(
            [
                [np.interp(middles, np.linspace(0, 1, len(order)), axis) for axis in order.T]
                for order in orders
            ]
        ).astype(np.float32)  # (N, 2, n)
        knots = np.linspace(0, 1, _KNOTS)
        self._hats = np.stack([np.interp(middles, knots, hat) for hat in np.eye(_KNOTS)]).astype(
            np.float32
        )  # (knots, n)
        self._pairs = np.stack(np.triu_indices(len(orders), 1)) if pairs is None else pairs
        self.codes = [np.asarray(code) for code in codes]
        self._taken = [self._photo(code) for code in self.codes]

    @property
    def count(self) -> int:
        """Number of orders, N."""
        return len(self._slices)

    @property
    def pairs(self) -> NDArray[np.intp]:
        """Indices (2, P) of the orders that are compared."""
        return self._pairs

    def taken(self) -> FloatArray:
        """Chi-square (P,) of each pair by the photos taken already."""
        return self._chi_squares(self._taken)

    def of(self, codes: ArrayLike) -> FloatArray:
        """Chi-square (C, P) of each pair by the photos taken and one more through codes (C, n)."""
        return np.stack(
            [self._chi_squares([*self._taken, self._photo(code)]) for code in np.asarray(codes)]
        )

    def among(self, pairs: NDArray[np.intp]) -> OrderContrast:
        """Return the contrast of some of :attr:`pairs`, by their indices."""
        contrast = copy(self)
        indices_of_orders, indices = np.unique(self._pairs[:, pairs], return_inverse=True)
        contrast._pairs = indices.reshape(2, -1)
        contrast._slices = self._slices[indices_of_orders]
        contrast._places = self._places[indices_of_orders]
        contrast._taken = [
            (otfs[indices_of_orders], slopes[indices_of_orders], centroids[indices_of_orders])
            for otfs, slopes, centroids in self._taken
        ]
        return contrast

    def after(self, code: ArrayLike) -> OrderContrast:
        """Return the contrast of the same orders after one more photo, through a code (n,)."""
        contrast = copy(self)
        contrast.codes = [*self.codes, np.asarray(code)]
        contrast._taken = [*self._taken, self._photo(code)]
        return contrast

    def _photo(self, code: ArrayLike) -> tuple[ComplexArray, ComplexArray, FloatArray]:
        """OTFs (N, F) through a code, their slopes by each knot's move along f, and centroids."""
        bits = np.asarray(code, dtype=np.float32)
        weights = np.concatenate([bits[None], self._hats * bits])
        through = weights.astype(np.complex64) @ self._slices  # (N, 1 + knots, F)
        centroids = self._places @ bits / max(float(bits.sum()), 1.0)
        slopes = (-2j * np.pi * through[:, 1:]).astype(np.complex64)
        return through[:, 0], slopes, np.asarray(centroids, dtype=np.float64)

    def _chi_squares(
        self,
        photos: Sequence[tuple[ComplexArray, ComplexArray, FloatArray]],
    ) -> FloatArray:
        a, b = self._pairs
        observed = [otfs[a] for otfs, _, _ in photos]
        model = []
        slopes = []
        first = photos[0][2][a] - photos[0][2][b]
        for otfs, by_knot, centroids in photos:
            # large shifts are no small step: centroids are laid on each other before it
            shift = centroids[a] - centroids[b] - first
            phase = np.exp(-2j * np.float32(np.pi) * (shift @ self._f.T)).astype(np.complex64)
            model.append(otfs[b] * phase)
            slopes.append(by_knot[b] * phase[:, None])
        power = sum(np.abs(otf) ** 2 for otf in model)
        scale = np.sqrt(self._snr / (power + _LEAST_POWER))
        count = len(photos)
        normal = np.diag(self._stiffness(count))[None].repeat(len(a), axis=0)
        slope = np.zeros(normal.shape[:2])
        total = np.zeros(len(a))
        for i in range(count):
            for j in range(i + 1, count):
                seen_i = observed[i] * scale
                seen_j = observed[j] * scale
                residual = seen_i * model[j] - seen_j * model[i]
                by_knot = seen_i[:, None] * slopes[j] - seen_j[:, None] * slopes[i]
                columns = [by_knot * self._f[:, 0], by_knot * self._f[:, 1]]
                for photo in range(1, count):
                    change = (photo == j) * seen_i * model[j] - (photo == i) * seen_j * model[i]
                    turn = -2j * np.float32(np.pi) * change
                    columns.append(
                        np.stack([turn * self._f[:, 0], turn * self._f[:, 1], change], axis=1)
                    )
                jacobian = _real(np.concatenate(columns, axis=1))  # (P, U, 2 F)
                values = _real(residual)
                normal += jacobian @ jacobian.transpose(0, 2, 1)
                slope += (jacobian @ values[..., None])[..., 0]
                total += (values**2).sum(axis=1)
        explained = (slope * np.linalg.solve(normal, slope[..., None])[..., 0]).sum(axis=1)
        return np.asarray(np.maximum(total - explained, 0.0), dtype=np.float64)

    @staticmethod
    def _stiffness(count: int) -> FloatArray:
        """Inverse variances (U,) of the deformation, and of each photo's shift and gain."""
        shift_and_gain = [_SHIFTED_PX**-2, _SHIFTED_PX**-2, _GAIN**-2]
        return np.array([_DEFORMED_PX**-2] * (2 * _KNOTS) + shift_and_gain * (count - 1))


def _real(values: ComplexArray) -> NDArray[np.float32]:
    """Real and imaginary parts one after the other along the last axis."""
    return np.concatenate([values.real, values.imag], axis=-1)
