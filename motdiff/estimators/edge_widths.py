"""Widths of a photo's edges, and those that a blur kernel would give them.

A step edge in the scene becomes, in the photo, the kernel's sum along that edge: no edge across a
motion of 20 px can stay 1 px wide.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from motdiff.crops import CLIPPED_LEVEL
from motdiff.photo_noise import LEAST_SIGMA, noise_sigma
from motdiff.types import FloatArray

_DIRECTIONS = 8  # of edge normals, evenly spaced over half a turn
_REACH_PX = 10.0  # a profile's half length; where its plateaus begin; its pitch
_PLATEAU_PX = 3.0
_STEP_PX = 0.5
_ALONG_PX = (-2, -1, 0, 1, 2)  # profiles averaged along the edge, against noise
_STEEPEST = 75  # edges measured in each direction
_LEAST_EDGES = 6  # in a direction, to say anything
_QUANTILE = 0.25  # of the widths in a direction: a scene has wide edges of its own
_STEP_SHARE = 0.6  # of a profile's range: a line, or the end of one, is no step
_OVER_NOISE = 12.0  # contrast of an edge, in sigmas: fainter ones look wide or narrow by chance
_LENS_PX = 0.6  # sigma of the sharpest photo's edges, sampling included


@dataclass(frozen=True)
class EdgeWidths:
    """Widths of the steep edges of a photo.

    Attributes
    ----------
    widths_px : (8,) float
        Contrast over steepest slope, of the steep edges with a normal in each eighth of half a
        turn; NaN where a direction has too few.
    counts : (8,) int
        Step edges that were measured in each direction.
    normals_rad : (8,) float
        Mean angle of their normals, 0..pi; the middle of the eighth where there are none.
    """

    widths_px: FloatArray
    counts: NDArray[np.intp]
    normals_rad: FloatArray

    @property
    def sharpest_px(self) -> float:
        """Width of the sharpest edges, the median of the directions that have any; NaN without."""
        if not self._measured_px.size:
            return float("nan")
        return float(np.median(self._measured_px))

    @property
    def widest_px(self) -> float:
        """Width in the direction of the widest sharp edges, which bounds motion; NaN without."""
        if not self._measured_px.size:
            return float("nan")
        return float(self._measured_px.max())

    @property
    def bound_motion(self) -> bool:
        """Whether edges lie in two directions 45 degrees or more apart: no motion escapes both."""
        directions = np.flatnonzero(np.isfinite(self.widths_px))
        apart = np.abs(directions[:, None] - directions)
        return bool((np.minimum(apart, _DIRECTIONS - apart) >= _DIRECTIONS // 4).any())

    def share_of(self, expected_px: FloatArray) -> float:
        """Geometric mean of the widths over a kernel's ``expected_px`` (8,); NaN without edges."""
        is_measured = np.isfinite(self.widths_px)
        if not is_measured.any():
            return float("nan")
        return float(np.exp(np.mean(np.log(self._measured_px / expected_px[is_measured]))))

    @property
    def _measured_px(self) -> FloatArray:
        return self.widths_px[np.isfinite(self.widths_px)]


def edge_widths(crops: Iterable[ArrayLike]) -> EdgeWidths:
    """Measure the steepest step edges of a photo's crops, each (H, W), linear light.

    The profile across an edge, averaged along 5 px of it, is a step where the levels beyond 3 px
    on its two sides differ by most of its range, none of it clipped. The width is that difference
    over the steepest slope, at most about 10 px.

    References
    ----------
    Marziliano, Dufaux, Winkler, Ebrahimi, "A no-reference perceptual blur metric", ICIP 2002:
    edges' widths as blur.
    """
    edges = [_edges(np.asarray(crop, dtype=np.float64)) for crop in crops]
    normal = np.concatenate([normals for normals, _ in edges])
    width = np.concatenate([widths for _, widths in edges])
    direction = _eighth(normal)
    counts = np.bincount(direction, minlength=_DIRECTIONS)
    widths = np.full(_DIRECTIONS, np.nan)
    for d in np.flatnonzero(counts >= _LEAST_EDGES):
        widths[d] = np.quantile(width[direction == d], _QUANTILE)
    normals = (np.arange(_DIRECTIONS) + 0.5) * np.pi / _DIRECTIONS
    occupied = np.flatnonzero(counts)
    normals[occupied] = [normal[direction == d].mean() for d in occupied]
    return EdgeWidths(widths, counts, normals)


def kernel_edge_widths(psf: ArrayLike, normals_rad: ArrayLike) -> FloatArray:
    """Widths (N,), px, of sharp edges blurred by a PSF, measured as by :func:`edge_widths`.

    Parameters
    ----------
    psf : (S, S) array_like
    normals_rad : (N,) array_like
        Angles of the edges' normals.

    Examples
    --------
    >>> from motdiff.trajectory import Trajectory
    >>> kernel_edge_widths(Trajectory.straight(8.0).psf(33), [0, np.pi / 2]).round().tolist()
    [8.0, 2.0]
    """
    light = np.asarray(psf, dtype=np.float64)
    down, right = np.indices(light.shape) - np.array(light.shape)[:, None, None] // 2
    half_px = float(max(light.shape)) + 2 * _REACH_PX
    bins = np.arange(-half_px, half_px + _STEP_PX, _STEP_PX)
    offsets = np.arange(-_REACH_PX, _REACH_PX + _STEP_PX / 2, _STEP_PX)
    widths = []
    for angle in np.asarray(normals_rad, dtype=np.float64):
        spread, _ = np.histogram(
            right * np.cos(angle) + down * np.sin(angle), bins=bins, weights=light
        )
        edge = np.cumsum(ndimage.gaussian_filter1d(spread / light.sum(), _LENS_PX / _STEP_PX))
        slope = edge[2:] - edge[:-2]  # central differences, as in a photo's profile
        steepest = int(np.argmax(slope)) + 1
        reach = round(_REACH_PX / _STEP_PX)
        profile = edge[np.clip(np.arange(-reach, reach + 1) + steepest, 0, edge.size - 1)]
        widths.append(float(_contrast(profile[None], offsets)[0] / slope.max()))
    return np.array(widths)


def _eighth(normal_rad: FloatArray) -> NDArray[np.intp]:
    """Index of the eighth of half a turn that each normal lies in."""
    return np.asarray(np.floor(normal_rad / (np.pi / _DIRECTIONS)).astype(np.intp) % _DIRECTIONS)


def _edges(grey: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Measure the normal, 0..pi, and the width of each step edge of a crop."""
    sigma = max(noise_sigma(grey), LEAST_SIGMA)
    down, right = np.gradient(ndimage.gaussian_filter(grey, 1.0))
    steepness = np.hypot(down, right)
    peak = steepness == ndimage.maximum_filter(steepness, 5)
    rim = int(_REACH_PX) + 4  # profiles and their neighbours stay within the crop
    inside = np.zeros_like(peak)
    inside[rim:-rim, rim:-rim] = True
    y, x = np.nonzero(peak & inside)
    angle = np.arctan2(down[y, x], right[y, x])
    direction = _eighth(angle % np.pi)
    order = np.argsort(-steepness[y, x], kind="stable")
    chosen = np.concatenate([order[direction[order] == d][:_STEEPEST] for d in range(_DIRECTIONS)])
    y = y[chosen]
    x = x[chosen]
    angle = angle[chosen]
    offsets = np.arange(-_REACH_PX, _REACH_PX + _STEP_PX / 2, _STEP_PX)
    c = np.cos(angle)[:, None]
    s = np.sin(angle)[:, None]
    lines = [
        ndimage.map_coordinates(
            grey, [y[:, None] + offsets * s + o * c, x[:, None] + offsets * c - o * s], order=1
        )
        for o in _ALONG_PX
    ]
    profile = np.mean(lines, axis=0)
    middle = np.abs(offsets[1:-1]) <= 2 + _STEP_PX / 2
    slope = (profile[:, 2:] - profile[:, :-2])[:, middle].max(axis=1, initial=1e-12)
    contrast = _contrast(profile, offsets)
    step = (contrast > _STEP_SHARE * np.ptp(profile, axis=1)) & (contrast > _OVER_NOISE * sigma)
    step &= profile.max(axis=1) < CLIPPED_LEVEL  # clipping makes an edge narrower
    return angle[step] % np.pi, contrast[step] / slope[step]


def _contrast(profiles: FloatArray, offsets: FloatArray) -> FloatArray:
    """Difference (N,) of the levels on the two sides of profiles (N, T)."""
    above = offsets >= _PLATEAU_PX
    below = offsets <= -_PLATEAU_PX
    return np.asarray(
        profiles[:, above].mean(axis=1) - profiles[:, below].mean(axis=1), dtype=np.float64
    )
