"""Motion from the streak of a point light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.point import Point
from motdiff.metrics import mnc_subpixel, register_shift
from motdiff.photo_values import clipped_mask, luminance
from motdiff.psf_frame import PSF_PX, centred, in_frame
from motdiff.tracing.path import trace_psf_to_trajectory
from motdiff.types import BoolArray, FloatArray

_GAP_PX = 2  # breaks in a streak up to twice this are bridged: noise where the light ran fast
_KEPT_SIGMA = 3.0  # of the noise: what belongs to a streak
_FOUND_SIGMA = 5.0  # and what shows that there is one
_LOST_TO_CLIPPING = 0.02  # share of a streak's pixels
_AGREED_MNC = 0.9  # with the best streak, for another one to count
_MOST_LIGHTS = 8  # averaged


@dataclass(frozen=True)
class _Streak:
    psf: FloatArray
    flux: float
    noise: float
    clipped_share: float
    box: tuple[int, int, int, int]  # row, column, height, width


class PointEstimator:
    """Take the streak of a point light, on a darker background, as the PSF.

    Assumes that the light is small against a pixel (a distant lamp, a laser spot, a star): nothing
    is deconvolved, so a light d px wide widens the path by d. The background is the local median;
    a streak is an area above its noise. Streaks that touch the photo's border are left out,
    saturated ones come after all others, as their dwell is cut. Several lights that agree with the
    best one (sub-pixel MNC) are averaged, weighted by their signal-to-noise ratio.

    The PSF's centroid lies within half a pixel of the frame's centre.

    ``confidence`` is the share of the streak that its noise leaves certain, ``snr^2 / (1 +
    snr^2)`` with the SNR of the whole PSF (its norm over the noise in its support), times the
    unsaturated share of the streak's pixels, times the share of comparable streaks that agree:
    things in an ordinary photo are no lights, and do not.
    """

    def estimate(self, photo: ArrayLike) -> MotionEstimate:
        """Estimate the motion from ``photo``, (H, W) or (H, W, C) float, linear light 0..1.

        ValueError if the photo shows no streak that fits the frame.
        """
        light = luminance(photo)
        streaks, too_long, cut_off = _streaks(light, clipped_mask(photo))
        if not streaks:
            why = ""
            if too_long:
                why += f"; {too_long} longer than the {PSF_PX} px frame"
            if cut_off:
                why += f"; {cut_off} cut off by the photo's border"
            raise ValueError(f"photo: shows no light streak above its background{why}")
        # a clipped streak, however bright, has lost its dwell
        best = max(streaks, key=lambda s: (s.clipped_share <= _LOST_TO_CLIPPING, _snr(s)))
        rivals = sorted((s for s in streaks if s is not best), key=_snr, reverse=True)
        # faint streaks add nothing to the average or to the test of uniform blur
        comparable = [
            s
            for s in rivals
            if _snr(s) > 0.2 * _snr(best) and s.clipped_share <= _LOST_TO_CLIPPING
        ]
        agreeing = [s for s in comparable if mnc_subpixel(best.psf, s.psf) >= _AGREED_MNC]
        agreeing = agreeing[: _MOST_LIGHTS - 1]
        psf = in_frame(centred(_average([best, *agreeing])))
        psf = psf / psf.sum()
        warnings = []
        if best.clipped_share > _LOST_TO_CLIPPING:
            warnings.append(
                f"The light is saturated on {100 * best.clipped_share:.0f} % of its streak: "
                "the dwell there is cut off; expose less or dim the light."
            )
        if len(comparable) >= 2 and len(agreeing) < len(comparable) / 2:
            warnings.append(
                f"Of {1 + len(comparable)} streaks only {1 + len(agreeing)} agree: the blur"
                " differs across the photo, or some are not lights."
            )
        details: dict[str, object] = {
            "streaks": len(streaks),
            "averaged": 1 + len(agreeing),
            "snr": _snr(best),
            "clipped_share": best.clipped_share,
            "box_row_col_height_width": list(best.box),
        }
        snr = _snr(best)
        agreed = (1 + len(agreeing)) / (1 + min(len(comparable), _MOST_LIGHTS - 1))
        confidence = snr**2 / (1 + snr**2) * (1 - best.clipped_share) * agreed
        return MotionEstimate(
            Point.name,
            (trace_psf_to_trajectory(psf),),
            (1.0,),
            psf,
            confidence,
            tuple(warnings),
            details,
        )


def _snr(streak: _Streak) -> float:
    """Norm of the streak over that of the noise in its support."""
    support = max(1, int((streak.psf > 0).sum()))
    return float(
        np.linalg.norm(streak.psf) * streak.flux / (max(streak.noise, 1e-6) * np.sqrt(support))
    )


def _streaks(light: FloatArray, clipped: BoolArray) -> tuple[list[_Streak], int, int]:
    """Streaks found, and how many were too long for the frame or cut off by the border."""
    background = background_light(light, PSF_PX)
    above = light - background
    # 1.4826: sigma over the median of |x|, which the few bright pixels hardly move
    noise = float(1.4826 * np.median(np.abs(above - np.median(above))))
    noise = max(noise, 1e-6)
    # a 3 x 3 mean, of a third of the noise, finds the faint, fast parts of a streak
    smooth = ndimage.uniform_filter(above, 3)
    bright = smooth > _KEPT_SIGMA * noise / 3 + 1e-4
    joined = ndimage.binary_closing(np.pad(bright, _GAP_PX), iterations=_GAP_PX)[
        _GAP_PX:-_GAP_PX, _GAP_PX:-_GAP_PX
    ]
    labels, _ = ndimage.label(joined | bright, structure=np.ones((3, 3)))
    streaks: list[_Streak] = []
    too_long = cut_off = 0
    for index, window in enumerate(ndimage.find_objects(labels), 1):
        is_streak = labels[window] == index
        values = np.where(is_streak, above[window], 0)
        if values.max() < _FOUND_SIGMA * noise or values.sum() < _FOUND_SIGMA * noise * np.sqrt(
            is_streak.sum()
        ):
            continue
        rows, columns = window
        borders = zip((rows.stop, columns.stop), light.shape, strict=True)
        if 0 in (rows.start, columns.start) or any(stop == size for stop, size in borders):
            cut_off += 1
            continue
        if max(values.shape) > PSF_PX:
            too_long += 1
            continue
        values = np.maximum(values, 0)  # noise below the background is no dwell
        frame = np.zeros((PSF_PX, PSF_PX))
        frame[: values.shape[0], : values.shape[1]] = values
        share = float(clipped[window][is_streak].sum()) / max(
            1, int((values > 0.1 * values.max()).sum())
        )
        box = (rows.start, columns.start, values.shape[0], values.shape[1])
        streaks.append(
            _Streak(frame / values.sum(), float(values.sum()), noise, min(1.0, share), box)
        )
    return streaks, too_long, cut_off


def background_light(light: FloatArray, size: int) -> FloatArray:
    """Light behind the streaks: medians of blocks a few frames wide, joined smoothly."""
    block = 2 * size
    rows, columns = (np.array_split(np.arange(n), max(1, n // block)) for n in light.shape)
    medians = np.array(
        [[np.median(light[r[0] : r[-1] + 1, c[0] : c[-1] + 1]) for c in columns] for r in rows]
    )
    row_at = np.interp(np.arange(light.shape[0]), [r.mean() for r in rows], np.arange(len(rows)))
    column_at = np.interp(
        np.arange(light.shape[1]), [c.mean() for c in columns], np.arange(len(columns))
    )
    grid = np.meshgrid(row_at, column_at, indexing="ij")
    return np.asarray(
        ndimage.map_coordinates(medians, grid, order=1, mode="nearest"), dtype=np.float64
    )


def _average(streaks: list[_Streak]) -> FloatArray:
    """Mean of the streaks, registered on the first, weighted by SNR squared."""
    first = streaks[0]
    # PSFs of sum 1 have a noise variance of about 1 / SNR^2: the least-noise weights
    total = _snr(first) ** 2 * np.maximum(first.psf, 0)
    for streak in streaks[1:]:
        dx, dy = register_shift(first.psf, streak.psf)
        registered = ndimage.shift(streak.psf, (dy, dx), order=3)
        total += _snr(streak) ** 2 * np.maximum(registered, 0)
    return np.asarray(total / total.sum(), dtype=np.float64)
