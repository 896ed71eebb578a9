"""Estimator for a small light's trails through known codes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from motdiff import crops
from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.coded.candidates import CandidatePath, explained_share, motion_of_paths
from motdiff.estimators.coded.codes import check_codes
from motdiff.estimators.coded.starts import orders
from motdiff.estimators.coded.trail_search import Trails, find_trail_paths
from motdiff.estimators.point.estimator import background_light
from motdiff.progress import Progress
from motdiff.psf_frame import PSF_PX
from motdiff.threads import one_thread_a_call
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

_GAP_PX = 12  # within a trail, where the shutter was closed
_MARGIN_PX = 7  # around a trail: the spot's flanks
_MOST_PX = 160  # time and memory grow with the area
_TRAIL_SIGMA = 4.0  # of a 3 x 3 mean's noise
_PEAK_SIGMA = 12.0  # a trail's brightest pixel, against noise alone
_LEAST_NOISE = 1 / 255 / np.sqrt(12)  # 8 bits round by that
_MODEL_ERROR = 0.02  # of a pixel's light: the spot is no Gaussian, the pixels differ
_MOST_CLIPPED = 0.2  # share of a trail's pixels
# on simulated motions: docs/decisions/motion-estimation.md
_AGREED = 0.95
_ALONE = 0.3
_FOLDED = 0.6  # one photo of a path that meets itself, where two searches agree
_ERROR_RATIO = 1.5


class TrailEstimator:
    """Find the motion, with its order in time, of a small light's trail through a known code.

    The light, on a darker background and apart from others, is a Gaussian spot of fitted width.
    Each chip carries the same light, so one path must explain every pixel of the trail. Paths are
    searched from random walks, coarse to fine, until two searches end at one path.

    ``confidence`` is the probability that the order is right: the share of simulated motions of
    which it was, where two searches agreed or none did; lower on one photo of a path that meets
    itself, and where other paths explain the trails as well. ``details`` are as those of
    :class:`motdiff.estimators.coded.estimator.CodedEstimator`.

    Parameters
    ----------
    codes : sequence of str
        Bits of each photo's code, in the order of the photos; "1" throughout for an open shutter.
    seed : int
        Of the random starts.
    progress : callable, optional
        Called with the finished share 0..1.

    Raises as :func:`check_codes`.

    References
    ----------
    Howie et al., "Submillisecond fireball timing using de Bruijn timecodes", Meteoritics &
    Planetary Science 52, 2017.
    """

    method = "point"

    def __init__(
        self,
        codes: Sequence[str],
        *,
        seed: int = 0,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        check_codes(codes)
        self._codes = tuple(codes)
        self._seed = seed
        self._tell = progress

    def estimate(self, photo: ArrayLike) -> MotionEstimate:
        """Estimate the motion of one coded photo, (H, W) or (H, W, 3), linear light 0..1."""
        return self.estimate_from([photo])

    def estimate_from(self, photos: Sequence[ArrayLike]) -> MotionEstimate:
        """Estimate the motion from as many photos as there are codes.

        Parameters
        ----------
        photos : sequence of I (H, W) or (H, W, 3) array_like, linear light 0..1
            Where the light is in them, and how bright, may differ.

        Returns
        -------
        MotionEstimate with ``direction`` known; other explanations follow with their weights.

        Raises
        ------
        ValueError
            If the numbers of photos and codes differ, or a photo shows no light, or one that is
            cut off or saturated.
        """
        check_codes(self._codes, photos=len(photos))
        with one_thread_a_call():
            progress = Progress(self._tell)
            progress.expect(1.0)
            order = sorted(range(len(photos)), key=lambda i: -self._codes[i].count("1"))
            cut = []
            for i in order:
                try:
                    cut.append(_trail(photos[i]))
                except ValueError as error:
                    name = f"photo {i + 1}" if len(photos) > 1 else "photo"
                    raise ValueError(f"{name}: {error}") from None
            trails = Trails(
                codes=tuple(self._codes[i] for i in order),
                images=tuple(image for image, _ in cut),
                sigmas=tuple(sigma for _, sigma in cut),
            )
            paths, times = find_trail_paths(
                trails, rng=np.random.default_rng(self._seed), progress=progress
            )
            estimate = _described(paths, times, photos=len(photos))
            progress.finish()
            return estimate


def _trail(photo: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Trail of the brightest light without the background, and each pixel's standard deviation."""
    light = crops.luminance(photo)
    above = light - background_light(light, PSF_PX)
    above = above - np.median(above)
    noise = max(float(1.4826 * np.median(np.abs(above))), _LEAST_NOISE)
    bright = ndimage.uniform_filter(above, 3) > _TRAIL_SIGMA * noise / 3
    joined = ndimage.binary_dilation(bright, iterations=_GAP_PX // 2)
    labels, count = ndimage.label(joined)
    if not count or above[bright].max() < _PEAK_SIGMA * noise:
        raise ValueError("shows no light above its background")
    sums = ndimage.sum_labels(np.where(bright, above, 0), labels, np.arange(1, count + 1))
    trail = bright & (labels == 1 + int(np.argmax(sums)))
    rows, columns = (np.flatnonzero(trail.any(axis=axis)) for axis in (1, 0))
    height, width = light.shape
    if rows[0] == 0 or columns[0] == 0 or rows[-1] == height - 1 or columns[-1] == width - 1:
        raise ValueError("the light's trail is cut off by the border")
    if max(np.ptp(rows), np.ptp(columns)) > _MOST_PX:
        raise ValueError(
            f"the light's trail is longer than {_MOST_PX} px; give the photo at a smaller size"
        )
    clipped = crops.clipped_mask(photo)
    if clipped[trail].mean() > _MOST_CLIPPED:
        raise ValueError("the light is saturated on its trail; expose less or dim the light")
    crop = tuple(
        slice(max(0, index[0] - _MARGIN_PX), min(n, index[-1] + _MARGIN_PX + 1))
        for index, n in ((rows, height), (columns, width))
    )
    image = above[crop]
    sigma = np.sqrt(noise**2 + (_MODEL_ERROR * np.maximum(image, 0)) ** 2)
    other_lights = ndimage.binary_dilation(bright & ~trail, iterations=3)[crop]
    sigma[other_lights | clipped[crop]] = np.inf
    return np.where(other_lights, 0.0, image), sigma


def _described(paths: Sequence[CandidatePath], times: int, *, photos: int) -> MotionEstimate:
    best = paths[0]
    share = _ALONE
    if times > 1:
        folded = len(orders(Trajectory.from_samples(best.path), knots=len(best.path), count=4)) > 2
        share = _FOLDED if folded and photos == 1 else _AGREED
    excess = np.array(
        [0.5 * (path.cost - best.cost) / max(1.0, best.misfit) for path in paths[1:]]
    )
    likelihoods = np.exp(-np.minimum(excess, 700))  # against the best path's; 1e-304 at least
    share *= explained_share(best.misfit)
    return motion_of_paths(
        "point",
        paths,
        probability=float(share / (1 + likelihoods.sum())),
        shares=np.maximum(likelihoods, 1e-9),
        deviation_px=_ERROR_RATIO * best.deviation_px,
        details={"searches_agreeing": times},
    )
