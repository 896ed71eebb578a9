"""Blind motion estimation at any photo size: crops, kernel search, and halving of the photo."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage, sparse

from motdiff.crops import CROP_PX, best_windows
from motdiff.estimators.base import LOST, FoundKernels, MotionEstimate
from motdiff.estimators.description import described
from motdiff.estimators.doubts import doubted
from motdiff.estimators.fusion import GOOD_MNC, Fusion, cut_alike, fuse
from motdiff.estimators.kernel_score import uneven_blur_warning
from motdiff.metrics import path_distance_px
from motdiff.photo_noise import shared_sigma
from motdiff.photo_values import clipped_mask, exposure_gain, numbered_photo, textured_luminance
from motdiff.progress import Progress
from motdiff.psf_frame import without_faint_parts
from motdiff.threads import one_thread_a_call
from motdiff.tracing.quadratic import simplest_trajectory
from motdiff.types import FloatArray

_LEAST_HALVED_PX = 192  # halved it has 96, not much more than the largest kernel frame, 63
_LARGEST_EXTENT = 0.8  # of what the search can find: beyond, the photo is halved and tried again
_FACTORS = (1, 2, 4)  # by which the photo is made smaller, one after the other
_MOST_CROPS = 12  # of several photos together
_CLEARLY = 0.05  # a halved photo is less noisy, so its confidence comes out higher by itself
MOST_LIGHTS = 0.05
"""Share of clipped pixels up to which they are lights: more are a sky, a wall or paper, whose
edges show the blur."""
_MARGIN_PX = 8  # around clipped pixels: the bright flanks of a streak
_MOST_SPANNED = 0.5  # of a photo: of more, too little is left to search in


class BlindEstimator(ABC):
    """Blind estimator: its subclasses search the kernel of a photo's crops, at one scale.

    Where the blur is lost in a photo with clipped lights, it is searched again without them. Where
    it outgrows the search, or is lost in a large photo, the photo is halved and tried again.

    Parameters
    ----------
    crops : int
        Most crops used of a photo larger than one crop.
    seed : int
        Of the paths that are drawn for the kernel.
    progress : callable, optional
        Called with the finished share 0..1.

    References
    ----------
    Hu and Yang, "Good regions to deblur", ECCV 2012 (crops).
    """

    method: str
    """Its name."""
    largest_px: int
    """Side of the largest frame that it searches, px."""
    smallest_px: int
    """Least side of a photo that it can search, px."""
    plain_mnc = 0.86
    """Likeness with the kernel from which on a quadratic path is taken for it."""

    def __init__(
        self,
        *,
        crops: int = 3,
        seed: int = 0,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        if crops < 1:
            raise ValueError(f"crops: must be at least 1, got {crops}")
        self._crops = crops
        self._seed = seed
        self._tell = progress

    @abstractmethod
    def search(
        self, crops: FloatArray, progress: Progress, halved: Callable[[], FloatArray] | None = None
    ) -> FoundKernels:
        """Search the kernel that the crops (C, H, W), grey, linear light, share.

        Parameters
        ----------
        progress : Progress
            Of the search, which plans it, and what follows it as well.
        halved : callable, optional
            Returns crops (C', h, w) of the photo at half its size, for a search that needs them;
            None where it is too small.
        """

    @abstractmethod
    def single(
        self, crops: FloatArray, candidates: FoundKernels, progress: Progress
    ) -> list[FloatArray]:
        """Search each crop alone, in the cheapest way, to test whether the blur is uniform."""

    def refine(self, crops: FloatArray, kernel: FloatArray) -> FloatArray:
        """Fit one photo's kernel (k, k) to the crops (C, H, W) of several."""
        from motdiff.blind_search.coarse_to_fine import refined

        return refined(crops, kernel, shared_sigma(crops))

    def corrected(
        self,
        crops: FloatArray,  # noqa: ARG002, of the estimators that correct
        candidates: FoundKernels,
        progress: Progress,  # noqa: ARG002
    ) -> FoundKernels:
        """Improve the final kernels of the crops (C, H, W), each in its place; here unchanged."""
        return candidates

    def estimate(self, photo: ArrayLike) -> MotionEstimate:
        """Estimate the motion from a blurred ``photo``: :meth:`estimate_from` with one.

        Parameters
        ----------
        photo : (H, W) or (H, W, 3) array_like, linear light 0..1
        """
        return self.estimate_from([photo])

    def estimate_from(self, photos: Sequence[ArrayLike]) -> MotionEstimate:
        """Estimate the one motion in photos taken of it, of the same scene or of different ones.

        The motion is searched in each photo alone and in all together:
        :func:`motdiff.estimators.fusion.fuse`.

        Parameters
        ----------
        photos : sequence of N (H, W) or (H, W, 3) array_like, linear light 0..1
            Their sizes may differ; where one is small, only the middles of the others are
            searched.

        Returns
        -------
        MotionEstimate with ``direction`` unknown; distinct kernels follow as alternatives. Of
        several photos ``details`` hold ``photos``, their number; for each ``repeatability``, the
        MNC of its own kernel with the shared one, both uncorrected, and ``repeatability_px``, the
        distance of their paths, None where its kernel is another; ``seen_in``, how many kernels
        agree; and ``left_out``, the numbers, from 1, of photos that show another motion.

        Raises
        ------
        ValueError
            If a photo is smaller than ``smallest_px``, not finite, or without texture, or much
            smaller than another.
        """
        with one_thread_a_call():
            progress = Progress(self._tell)
            images = []
            for number, photo in enumerate(photos, 1):
                with numbered_photo(number, count=len(photos)):
                    grey = textured_luminance(photo, least_px=self.smallest_px)
                # thresholds on light and noise then mean the same in a dim photo
                images.append((exposure_gain(photo) * grey, clipped_mask(photo)))
            levels = self._levels(images, progress)
            estimate = self._described(levels, progress)
            progress.finish()
            return estimate

    def _described(self, levels: Sequence[_Level], progress: Progress) -> MotionEstimate:
        """Correct the kernels of the last level, and describe the best with its doubts."""
        best = levels[-1]
        corrected = self.corrected(best.crops, best.candidates, progress)
        # a correction spreads light: extent and evenness are tested on the kernel as searched
        kernel = best.candidates.kernels[corrected.best]
        uneven = None
        photo_count = len(best.fusion.photos) if best.fusion else 1
        if len(best.crops) > photo_count:  # unevenness shows only between crops of one photo
            single_kernels = self.single(best.crops, best.candidates, progress)
            uneven = uneven_blur_warning(best.crops, single_kernels, kernel)
        estimate = described(
            corrected,
            method=self.method,
            factor=best.factor,
            plain_mnc=self.plain_mnc,
            uneven=uneven,
            details={"crops": len(best.crops), **_repeatability(best)},
            rng=np.random.default_rng(self._seed),
        )
        return doubted(
            estimate,
            levels[0].photographed,
            uneven=uneven is not None,
            outgrown=_outgrown(kernel, self.largest_px),
        )

    def _levels(
        self, images: Sequence[tuple[FloatArray, NDArray[np.bool_]]], progress: Progress
    ) -> list[_Level]:
        """Search the photos at their size, and at smaller ones while that finds more."""
        count = min(self._crops, max(1, _MOST_CROPS // len(images)))
        least_px = min(min(grey.shape) for grey, _ in images)
        levels: list[_Level] = []
        for factor in _FACTORS:
            cuts = []
            for number, image in enumerate(images, 1):
                with numbered_photo(number, count=len(images)):
                    cuts.append(_textured_crops(image, factor=factor, count=count))
            if len(cuts) == 1:
                halved = None
                if least_px // factor >= _LEAST_HALVED_PX:
                    halved = partial(_halved_crops, images[0], factor=factor, count=count)
                searched = self._searched(cuts[0], progress, halved=halved)
                level = _Level(factor, *searched, cuts[0].crops)
            else:
                level = self._fused(factor, cuts, progress)
            if levels and level.candidates.confidence < max(
                LOST, levels[-1].candidates.confidence + _CLEARLY
            ):
                break
            levels.append(level)
            if not _wants_halving(level, self.largest_px, least_px):
                break
        return levels

    def _fused(self, factor: int, cuts: Sequence[_Cut], progress: Progress) -> _Level:
        """Search the crops of each of several photos, and those of all together."""
        photographed = cut_alike([cut.crops for cut in cuts])
        sizes = [crop.size for crop in (*(cut.crops for cut in cuts), *photographed)]
        progress.expect(1.0)

        def piece(stack: FloatArray) -> Progress:
            return Progress(progress.piece(stack.size / sum(sizes)))

        def search_jointly(stack: FloatArray) -> FoundKernels:
            of_stack = piece(stack)
            candidates = self.search(stack, of_stack)
            of_stack.finish()
            return candidates

        searches = []
        for cut in cuts:
            of_photo = piece(cut.crops)
            searches.append(self._searched(cut, of_photo))
            of_photo.finish()
        singles = [candidates for _, candidates in searches]
        fusion = fuse(
            cut_alike([crops for crops, _ in searches]),
            singles,
            search=search_jointly,
            refine=self.refine,
        )
        lit_crops = np.concatenate([photographed[i] for i in fusion.photos])
        return _Level(factor, fusion.crops, fusion.joint, lit_crops, fusion, tuple(singles))

    def _searched(
        self, cut: _Cut, progress: Progress, halved: Callable[[], FloatArray] | None = None
    ) -> tuple[FloatArray, FoundKernels]:
        """Search a photo's blur, a lost one again without clipped lights: the likelier one, after
        its crops.
        """
        candidates = self.search(cut.crops, progress, halved=halved)
        if candidates.confidence >= LOST or not 0 < cut.clipped.mean() <= MOST_LIGHTS:
            return cut.crops, candidates
        crops = np.stack(
            [without_lights(crop, mask) for crop, mask in zip(cut.crops, cut.clipped, strict=True)]
        )
        if np.array_equal(crops, cut.crops) or not np.ptp(crops, axis=(1, 2)).all():
            return cut.crops, candidates
        retried = self.search(crops, progress)
        if retried.confidence <= candidates.confidence:
            return cut.crops, candidates
        return crops, replace(retried, details={**retried.details, "lights_left_out": True})


@dataclass(frozen=True)
class _Cut:
    """Crops (C, h, w) of a photo at one scale, and their clipped pixels."""

    crops: FloatArray
    clipped: NDArray[np.bool_]


@dataclass(frozen=True)
class _Level:
    """Result at one scale: the crops as searched, and as photographed, lights included."""

    factor: int
    crops: FloatArray
    candidates: FoundKernels
    photographed: FloatArray
    fusion: Fusion | None = None
    singles: tuple[FoundKernels, ...] = ()


def _textured_crops(
    photo: tuple[FloatArray, NDArray[np.bool_]], *, factor: int, count: int
) -> _Cut:
    """At most ``count`` crops of a photo (H, W) and its clipped pixels, binned by ``factor``."""
    grey, clipped = photo
    if factor > 1:
        # pixels of which any part is clipped
        grey, share = (
            cv2.resize(image, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
            for image in (grey, clipped.astype(np.float64))
        )
        grey = np.asarray(grey, dtype=np.float64)
        clipped = np.asarray(share > 0)
    windows = best_windows(grey, count=count)
    crops, hidden = (np.stack([image[window] for window in windows]) for image in (grey, clipped))
    textured = np.ptp(crops, axis=(1, 2)) > 0  # a clipped sky has no texture and no noise
    if not textured.any():
        raise ValueError(
            "photo: has edges of one direction at most; motion shows only where the scene has"
            " texture"
        )
    return _Cut(crops[textured], hidden[textured])


def _halved_crops(
    photo: tuple[FloatArray, NDArray[np.bool_]], *, factor: int, count: int
) -> FloatArray:
    return _textured_crops(photo, factor=2 * factor, count=count).crops


def _wants_halving(level: _Level, largest_px: int, full_side_px: int) -> bool:
    """Whether the blur is too large for the search, or the search failed in a large photo."""
    side_px = full_side_px // level.factor
    lost = level.candidates.confidence < LOST and side_px >= 2 * CROP_PX
    outgrown = _outgrown(level.candidates.best_kernel, largest_px)
    return (outgrown and side_px >= _LEAST_HALVED_PX) or lost


def _outgrown(kernel: FloatArray, largest_px: int) -> bool:
    """Whether the kernel found is about as large as the largest that is searched."""
    y, x = np.nonzero(kernel)
    return bool(max(np.ptp(y), np.ptp(x)) + 1 > _LARGEST_EXTENT * largest_px)


def _repeatability(level: _Level) -> dict[str, object]:
    """Agreement of each of several photos with their shared motion, before correction."""
    fusion = level.fusion
    if fusion is None:
        return {}
    shared = fusion.joint.best_kernel
    path = simplest_trajectory(without_faint_parts(shared)).scaled(level.factor)
    apart: list[float | None] = []
    for i, (single, alike) in enumerate(zip(level.singles, fusion.repeatability, strict=True)):
        if alike < GOOD_MNC or i not in fusion.photos:
            apart.append(None)
            continue
        single_path = simplest_trajectory(without_faint_parts(single.best_kernel))
        apart.append(path_distance_px(single_path.scaled(level.factor), path))
    return {
        "photos": len(level.singles),
        "seen_in": sum(distance is not None for distance in apart),
        "repeatability": list(fusion.repeatability),
        "repeatability_px": apart,
        "left_out": [i + 1 for i in fusion.left_out],
    }


def without_lights(photo: FloatArray, clipped: NDArray[np.bool_]) -> FloatArray:
    """Span clipped pixels, and 8 px around, by a membrane: no gradients, so no evidence.

    Parameters
    ----------
    photo : (H, W) float, grey
    clipped : (H, W) bool

    Returns
    -------
    (H, W) float ndarray
        The photo itself where nothing, or more than half of it, would be spanned.

    Notes
    -----
    The membrane solves Laplace's equation for the values around it; at the photo's border its
    slope is 0.
    """
    hidden = clipped
    if clipped.any():
        hidden = ndimage.binary_dilation(clipped, np.ones((3, 3)), iterations=_MARGIN_PX)
    if not 0 < hidden.mean() <= _MOST_SPANNED:
        return photo
    rows, columns = np.nonzero(hidden)
    # of each hidden pixel among the unknowns; -1 of a visible one
    number = np.full(photo.shape, -1)
    number[rows, columns] = np.arange(rows.size)
    # Laplace's equation: n_i u_i - sum of hidden neighbours u_j = sum of the visible neighbours
    neighbours = np.zeros(rows.size)
    border_sum = np.zeros(rows.size)
    links = []
    # beyond the photo's border a neighbour does not count, which makes the slope there 0
    for down, across in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        y = rows + down
        x = columns + across
        inside = np.flatnonzero((y >= 0) & (y < photo.shape[0]) & (x >= 0) & (x < photo.shape[1]))
        neighbour = number[y[inside], x[inside]]
        neighbours[inside] += 1
        on_border = inside[neighbour < 0]
        border_sum[on_border] += photo[y[on_border], x[on_border]]
        links.append(np.stack([inside[neighbour >= 0], neighbour[neighbour >= 0]]))
    first, second = np.concatenate(links, axis=1)
    linked = sparse.csr_matrix(
        (np.ones(first.size), (first, second)), shape=(rows.size, rows.size)
    )
    laplacian = sparse.diags(neighbours) - linked
    spanned = photo.copy()
    spanned[rows, columns] = sparse.linalg.spsolve(laplacian.tocsc(), border_sum)
    return spanned
