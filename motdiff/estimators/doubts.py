"""Doubts about the motion found in a photo, from the photo's edges, lights and texture.

Edges narrower than the path found could leave them contradict it, whatever kernel a search has
found. Where they are narrow in every direction, or the kernel found is no wider than a lens's
spot, the photo shows no motion.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motdiff.crops import CLIPPED_LEVEL
from motdiff.estimators.base import LOST, MotionEstimate
from motdiff.estimators.edge_widths import EdgeWidths, edge_widths, kernel_edge_widths
from motdiff.metrics import mnc_subpixel
from motdiff.psf_frame import PSF_PX
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

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
