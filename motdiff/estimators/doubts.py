"""Doubts about the motion found in a photo, from the photo's edges, lights and texture.

A step edge in the scene becomes, in the photo, the kernel's sum along that edge: no edge across a
motion of 20 px can stay 1 px wide. Edges narrower than the path found could leave them contradict
it, whatever kernel a search has found. Where they are narrow in every direction, or the kernel
found is no wider than a lens's spot, the photo shows no motion.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from motdiff.estimators.base import LOST, MotionEstimate
from motdiff.metrics import mnc_subpixel
from motdiff.photo_noise import LEAST_SIGMA, noise_sigma
from motdiff.photo_values import CLIPPED_LEVEL
from motdiff.psf_frame import PSF_PX
from motdiff.trajectory import Trajectory
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
# evidence of no motion, docs/decisions/motion-estimation.md: widths of edges in px, and their
# share of the kernel's
_SPOT_PX = 2.7  # widest edges that a kernel no wider than a lens's spot leaves
_LOST_SPOT_PX = 3.4  # where the search is lost, a wider kernel passes as a spot
_NARROW_PX = 2.5  # and edges up to this width are as sharp as a photo at rest has them
_NARROW_SHARE = 0.55  # of the width that the kernel would give them
_STILL_CONFIDENCE = 0.9
_CLIPPED = 0.02  # share of the pixels
_ROUND_MNC = 0.98  # likeness of a spot with a Gaussian, and the ratio of its widths
_ROUND_RATIO = 2.0  # longer spots may be a short motion
_DOUBTED = 0.5  # most confidence that such a doubt leaves
_CONTRADICTED = 0.25  # and where the photo contradicts the kernel


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
        return float(np.median(self._measured_px)) if self._measured_px.size else np.nan

    @property
    def widest_px(self) -> float:
        """Width in the direction of the widest sharp edges, which bounds motion; NaN without."""
        return float(np.max(self._measured_px)) if self._measured_px.size else np.nan

    @property
    def bound_motion(self) -> bool:
        """Whether edges lie in two directions 45 degrees or more apart: no motion escapes both."""
        directions = np.flatnonzero(np.isfinite(self.widths_px))
        apart = np.abs(directions[:, None] - directions)
        return bool((np.minimum(apart, _DIRECTIONS - apart) >= _DIRECTIONS // 4).any())

    def share_of(self, expected_px: FloatArray) -> float:
        """Geometric mean of the widths over a kernel's ``expected_px`` (8,); NaN without edges."""
        if not self._measured_px.size:
            return np.nan
        is_measured = np.isfinite(self.widths_px)
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


def doubted(
    estimate: MotionEstimate, crops: FloatArray, *, uneven: bool, outgrown: bool
) -> MotionEstimate:
    """Test an estimate on its crops: add its doubts, or find that the photo shows no motion.

    Parameters
    ----------
    estimate : MotionEstimate
        With ``psf_confidence`` and ``path_confidence`` in its details; its PSF at the scale of the
        crops.
    crops : (C, H, W) float, grey, linear light 0..1
    uneven : bool
        Whether the blur was found to differ across the photo.
    outgrown : bool
        Whether the kernel found is about as large as the largest that was searched.
    """
    edges = edge_widths(crops)
    expected_px = kernel_edge_widths(estimate.psf, edges.normals_rad)
    narrow = edges.widest_px <= _NARROW_PX and edges.share_of(expected_px) <= _NARROW_SHARE
    spot_px = _SPOT_PX
    if estimate.confidence < LOST:
        spot_px = _LOST_SPOT_PX
    spot = bool(expected_px.max() <= spot_px)
    if (narrow and edges.bound_motion) or (spot and edges.widest_px <= _NARROW_PX):
        return _still(estimate, edges)
    clipped = float((crops >= CLIPPED_LEVEL).mean())
    doubts = []
    psf_limit = 1.0
    if uneven:
        psf_limit = _DOUBTED
    if outgrown:
        psf_limit = _DOUBTED
        doubts.append(
            f"the path found is as wide as the search reaches ({estimate.best.extent_px:.0f} px):"
            " the true one may be longer"
        )
    if narrow:
        psf_limit = _CONTRADICTED
        doubts.append(
            f"the photo has edges {edges.sharpest_px:.1f} px wide, which a motion along the path"
            " found would have blurred to"
            f" {edges.sharpest_px / edges.share_of(expected_px):.1f} px"
        )
    if np.isnan(edges.widest_px):
        psf_limit = _CONTRADICTED
        doubts.append("the photo has too few steep edges for its motion to show in them")
    if clipped > _CLIPPED:
        psf_limit *= 1 - clipped
        doubts.append(
            f"{100 * clipped:.0f} % of the pixels searched are clipped: their light is not known"
        )
    of_the_path = []
    path_limit = psf_limit
    if spot or _is_round(estimate.psf):
        path_limit = min(psf_limit, _CONTRADICTED)
        of_the_path.append(
            "the blur found is a round spot, as of a lens out of focus: it shows no path of a"
            " motion"
        )
    limited = {
        name: min(float(value), limit)
        for name, limit in (("psf_confidence", psf_limit), ("path_confidence", path_limit))
        if isinstance(value := estimate.details[name], float)
    }
    return replace(
        estimate,
        confidence=min(estimate.confidence, path_limit),
        warnings=(*estimate.warnings, *doubts, *of_the_path),
        psf_warnings=(*estimate.psf_warnings, *doubts),
        details={**estimate.details, **limited, **_edge_figures(edges)},
    )


def _still(estimate: MotionEstimate, edges: EdgeWidths) -> MotionEstimate:
    """Return the estimate of a photo without motion: a path of 0 px, whose PSF is a point."""
    sentence = "This photo shows no motion blur"
    if edges.counts.any():
        sentence += f" (its sharpest edges are {edges.sharpest_px:.1f} px wide)"
    path = Trajectory.from_samples([[0.0, 0.0], [0.0, 0.0]])
    confidences = {
        "psf_confidence": _STILL_CONFIDENCE,
        "path_confidence": _STILL_CONFIDENCE,
        "trajectory_psf_mnc": 1.0,
    }
    return MotionEstimate(
        method=estimate.method,
        trajectories=(path,),
        weights=(1.0,),
        psf=path.psf(PSF_PX),
        confidence=_STILL_CONFIDENCE,
        warnings=(sentence,),
        details={**estimate.details, **confidences, **_edge_figures(edges), "motion_blur": False},
        psf_warnings=(sentence,),
    )


def _is_round(psf: FloatArray) -> bool:
    """Whether a PSF is the Gaussian of its own second moments, about as wide as it is long."""
    light = psf / psf.sum()
    place = np.indices(light.shape).reshape(2, -1)  # (y, x) of each pixel
    middle = place @ light.ravel()
    away = place - middle[:, None]
    spread = (away * light.ravel()) @ away.T  # second moments, px^2
    variances = np.linalg.eigvalsh(spread)
    if variances[1] > _ROUND_RATIO**2 * variances[0]:
        return False
    gaussian = np.exp(-0.5 * (away * np.linalg.solve(spread, away)).sum(axis=0)).reshape(
        light.shape
    )
    return mnc_subpixel(light, gaussian) >= _ROUND_MNC


def _edge_figures(edges: EdgeWidths) -> dict[str, object]:
    sharpest = edges.sharpest_px
    return {
        "sharpest_edges_px": None if np.isnan(sharpest) else sharpest,
        "steep_edges": int(edges.counts.sum()),
    }
