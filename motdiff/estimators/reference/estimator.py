"""Motion from a pair of photos: blurred and sharp, of the same scene."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import fft, ndimage

from motdiff import crops
from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.reference import Reference, psf_fit
from motdiff.metrics import mnc_subpixel
from motdiff.photo_values import CLIPPED_LEVEL, clipped_mask, luminance
from motdiff.psf_frame import PSF_PX, centroid_px, without_faint_light
from motdiff.tracing.path import trace_psf_to_trajectory
from motdiff.types import BoolArray, FloatArray

# sigma; slower differences (vignetting, lamps, haze) say little about a kernel and mislead it
_HIGH_PASS_PX = 4.0
_RIM_PX = int(3 * _HIGH_PASS_PX)  # the high-passed photo is not trusted this close to its border
_LARGE_PX = 1_500_000  # photos with more pixels are first registered binned
_WINDOW_PX = 768  # px: enough texture for a peak, at a fraction of the time of the whole photo
_SPLINE_MARGIN_PX = 8  # beyond, a spline of order 5 has forgotten the border
_LEAST_CROP_PX = 32
_LAMP_REACH = 0.005  # share of a lamp's light that spoils a pixel
# share of the peak: a lamp must not spoil the photo through noise in the first kernel
_LAMP_FAINT = 0.05
_SPECK_FAINT = 0.03  # share of the peak: fainter light joins no parts of the kernel
_SPECK_SHARE = 0.02  # of all light: a part with less is noise
# a channel with this share of clipped pixels is worth nothing beside others
_CHANNEL_CLIPPED = 0.1
_LOST = 0.6  # share explained: below, the pair is hardly one scene


@dataclass(frozen=True)
class ReferenceEstimator:
    """Find the kernel that turns a sharp photo into the blurred one.

    The least clipped colour channels of both photos are averaged, high-passed (which removes
    offset and slow differences of light), registered by cross-correlation and then to a fraction
    of a pixel by the kernel's own centroid, and compared in textured, unsaturated crops. The
    kernel is the non-negative least-squares fit over all pixels whose light comes from known
    pixels, with the exponential prior whose mean is that of a spread-out kernel; the fit's own
    residual gives the noise that weighs it. The gain between the photos is the kernel's sum.

    ``confidence`` is the share of the high-passed photo's variance, less its noise, that sharp *
    PSF explains, times the MNC with the truth that the agreement of two fits, each to half of the
    pixels, lets expect.

    Parameters
    ----------
    sharp : (H, W) or (H, W, C) float, linear light 0..1
        Photo of the same scene in the same scale and orientation; its size may differ from the
        blurred photo's.
    size : int, px
        Frame of the PSF.
    crop_px, crop_count : int
        Side and number of the crops compared.

    Raises
    ------
    ValueError
        If the sharp photo is not an image, or ``size`` is below 3.
    """

    sharp: ArrayLike
    size: int = PSF_PX
    crop_px: int = crops.CROP_PX
    crop_count: int = 4

    def __post_init__(self) -> None:
        if self.size < 3:
            raise ValueError(f"size: must be at least 3 px, got {self.size}")
        luminance(self.sharp)

    def estimate(self, photo: ArrayLike) -> MotionEstimate:
        """Estimate the motion in ``photo``, (H, W) or (H, W, C) float, linear light 0..1.

        ValueError if a photo has no texture, or the two overlap too little for the PSF's frame.
        """
        sharp, blurred = (
            _Photo.of(*named_photo) for named_photo in _clean_channels(self.sharp, photo)
        )
        shift = coarse_shift(sharp.light, blurred.light)
        places = self._places(sharp, blurred, shift)
        pairs = [self._pair(sharp, blurred, place, shift, None) for place in places]
        noise = psf_fit.residual_variance(pairs, psf_fit.fit_psf(pairs, self.size, steps=4))
        sparse = noise * self.size**2  # 1 / size^2 is the mean of a PSF of sum 1
        psf = psf_fit.fit_psf(pairs, self.size, sparse=sparse)
        for _ in range(2):  # the second time only where the first fit was cut by the frame
            offset = centroid_px(psf)
            refined_shift = (shift[0] + offset[0], shift[1] + offset[1])
            places = self._places(sharp, blurred, refined_shift)
            pairs = [self._pair(sharp, blurred, place, refined_shift, psf) for place in places]
            psf = psf_fit.fit_psf(pairs, self.size, sparse=sparse)
            shift = refined_shift
            if math.hypot(*centroid_px(psf)) < 0.1:
                break
        psf = _without_specks(psf)
        gain = float(psf.sum())
        if gain <= 0:
            raise ValueError(
                "photo: nothing of it follows from the sharp photo; is it the same scene?"
            )
        crop_psfs = [
            psf_fit.fit_psf([pair], self.size, sparse=sparse, start=psf, steps=3) for pair in pairs
        ]
        halves = [
            psf_fit.fit_psf(_half(pairs, side), self.size, sparse=sparse, start=psf, steps=3)
            for side in (0, 1)
        ]
        agreement = 0.0
        if all(half.any() for half in halves):
            agreement = mnc_subpixel(*halves)
        details = {
            "gain": gain,
            "noise_sigma": math.sqrt(noise),
            "shift_px": [float(shift[1]), float(shift[0])],
            "crops_row_col": [[place.row, place.column] for place in places],
            "crop_px": [places[0].height, places[0].width],
        }
        lit_psfs = [kernel for kernel in crop_psfs if kernel.any()]
        return self._report(blurred, pairs, psf / gain, lit_psfs, agreement, details)

    def _report(
        self,
        blurred: _Photo,
        pairs: Sequence[psf_fit.PatchPair],
        psf: FloatArray,
        crop_psfs: Sequence[FloatArray],
        agreement: float,
        figures: Mapping[str, Any],
    ) -> MotionEstimate:
        explained = _explained_beyond_noise(pairs, figures["gain"] * psf, blurred.noise_variance)
        # of two fits to half of the pixels: the error energy of one, from which that of others
        # follows
        half_error = 1 / max(agreement, 1e-3) - 1
        # MNC at error energy e: of two fits 1 / (1 + e), of a fit and the truth 1 / sqrt(1 + e)
        expected_mnc = 1 / math.sqrt(1 + half_error / 2)
        warnings = []
        if explained < _LOST:
            warnings.append(
                f"The sharp photo explains only {100 * explained:.0f} % of the blurred one: "
                "other scene, scale or focus, or something moved."
            )
        # single crops may disagree through noise alone
        by_noise = 1 / (1 + half_error * len(pairs) / 2)
        limit = min(0.75, 0.85 * by_noise)
        if len(crop_psfs) > 1 and (differs := crops.blur_differs_warning(crop_psfs, limit=limit)):
            warnings.append(differs)
        rim = 1 - float(psf[2:-2, 2:-2].sum())
        if rim > 0.02:
            warnings.append(
                f"The PSF reaches the rim of its {self.size} px frame: give a larger size."
            )
        clipped = 1 - sum(pair.pixels for pair in pairs) / sum(pair.weight.size for pair in pairs)
        if clipped > 0.05:
            warnings.append(
                f"{100 * clipped:.0f} % of the compared pixels are saturated and were left out."
            )
        details: dict[str, object] = {
            "explained_share": explained,
            "expected_mnc": expected_mnc,
            "left_out_share": clipped,
            **figures,
            "uniformity": 0.0,
        }
        if crop_psfs:
            details["uniformity"] = crops.uniformity(crop_psfs)
        confidence = min(1.0, max(0.0, explained)) * expected_mnc
        return MotionEstimate(
            Reference.name,
            (trace_psf_to_trajectory(psf),),
            (1.0,),
            psf,
            confidence,
            tuple(warnings),
            details,
        )

    def _places(self, sharp: _Photo, blurred: _Photo, shift: tuple[float, float]) -> list[_Place]:
        """Choose crops of the blurred photo whose light all comes from within the sharp one."""
        # reach of the PSF to the top and left of a crop
        before = self.size - 1 - self.size // 2 + _SPLINE_MARGIN_PX + _RIM_PX
        after = self.size // 2 + _SPLINE_MARGIN_PX + _RIM_PX
        low = [max(_RIM_PX, math.ceil(before + d)) for d in shift]
        high = [
            min(b - _RIM_PX, math.floor(s - after + d))
            for b, s, d in zip(blurred.detail.shape, sharp.detail.shape, shift, strict=True)
        ]
        extent = [h - lo for h, lo in zip(high, low, strict=True)]
        if min(extent) < _LEAST_CROP_PX:
            raise ValueError(
                f"sharp: overlaps the photo by {max(0, extent[1])} x {max(0, extent[0])} px inside"
                f" margins, wanted at least {_LEAST_CROP_PX} each way; give larger photos or a"
                f" smaller size than {self.size}"
            )
        rows = slice(low[0], high[0])
        columns = slice(low[1], high[1])
        dy, dx = (round(d) for d in shift)
        beneath = (slice(low[0] - dy, high[0] - dy), slice(low[1] - dx, high[1] - dx))
        scene = np.where(
            blurred.clipped[rows, columns] | sharp.clipped[beneath],
            1.0,
            0.5 * sharp.light[beneath],
        )
        corners = crops.pick_crops(scene, size=self.crop_px, count=self.crop_count)
        height, width = (min(self.crop_px, n) for n in extent)
        return [_Place(low[0] + r, low[1] + c, height, width) for r, c in corners]

    def _pair(
        self,
        sharp: _Photo,
        blurred: _Photo,
        place: _Place,
        shift: tuple[float, float],
        psf: FloatArray | None,
    ) -> psf_fit.PatchPair:
        # indices move by whole pixels; only the rest, 0..1, is interpolated
        whole_px = [math.floor(d) for d in shift]
        margin = _SPLINE_MARGIN_PX
        first = [
            start - d - (self.size - 1 - self.size // 2) - margin
            for start, d in zip((place.row, place.column), whole_px, strict=True)
        ]
        lengths = [n + self.size - 1 + 2 * margin for n in (place.height, place.width)]
        cut = tuple(slice(f, f + n) for f, n in zip(first, lengths, strict=True))
        fraction_px = [d - w for d, w in zip(shift, whole_px, strict=True)]
        patch = sharp.detail[cut]
        if max(fraction_px) > 1e-3:
            patch = ndimage.shift(patch, fraction_px, order=5, mode="nearest")
        inner = (slice(margin, -margin),) * 2
        window = (
            slice(place.row, place.row + place.height),
            slice(place.column, place.column + place.width),
        )
        good = ~ndimage.binary_dilation(blurred.clipped[window], iterations=2)
        lamps = sharp.clipped[cut][inner]
        if psf is not None and lamps.any():
            # light of unknown strength: leave out what it reaches
            solid = without_faint_light(psf, below=_LAMP_FAINT)
            spread = tuple(fft.next_fast_len(n, real=True) for n in lamps.shape)
            spectrum = fft.rfft2(lamps.astype(np.float64), spread) * fft.rfft2(
                solid / solid.sum(), spread
            )
            reach = fft.irfft2(spectrum, spread)
            start = self.size - 1
            good &= reach[start : lamps.shape[0], start : lamps.shape[1]] < _LAMP_REACH
        weight = good.astype(np.float64)
        return psf_fit.PatchPair(
            np.asarray(patch[inner], np.float64), blurred.detail[window], weight
        )


@dataclass(frozen=True)
class _Place:
    row: int
    column: int
    height: int
    width: int


@dataclass(frozen=True)
class _Photo:
    light: FloatArray
    detail: FloatArray
    clipped: BoolArray
    noise_variance: float

    @classmethod
    def of(cls, name: str, photo: ArrayLike) -> _Photo:
        light = luminance(photo)
        if min(light.shape) < _LEAST_CROP_PX:
            raise ValueError(
                f"{name}: {light.shape[1]} x {light.shape[0]} px is too small to compare, "
                f"at least {_LEAST_CROP_PX} x {_LEAST_CROP_PX} px are needed"
            )
        detail = high_passed(light)
        if float(detail.std()) < 1e-6:
            raise ValueError(f"{name}: has no texture to compare (constant image?)")
        return cls(light, detail, clipped_mask(photo), _noise_variance(light))


def high_passed(light: FloatArray) -> FloatArray:
    """Take away the light (H, W) that varies slowly (a Gaussian mean), and with it any offset."""
    slow = ndimage.gaussian_filter(light, _HIGH_PASS_PX, truncate=3)
    return np.asarray(light - slow, dtype=np.float64)


def coarse_shift(sharp: FloatArray, blurred: FloatArray) -> tuple[float, float]:
    """Whole-pixel (dy, dx) that moves ``sharp`` onto ``blurred``, by correlation of fine detail.

    Parameters
    ----------
    sharp, blurred : (H, W) float
        Photos of one scene, in the same scale and orientation; their sizes may differ.
    """
    pixels = max(sharp.size, blurred.size)
    if pixels <= _LARGE_PX:
        return _peak(high_passed(sharp), high_passed(blurred))
    factor = int(np.ceil(np.sqrt(pixels / _LARGE_PX)))
    dy, dx = (factor * d for d in coarse_shift(_binned(sharp, factor), _binned(blurred, factor)))
    # the middle of the overlap, at full size, with room for what binning left open
    starts = []
    lengths = []
    for s, b, d in zip(sharp.shape, blurred.shape, (round(dy), round(dx)), strict=True):
        low = max(0, d)
        high = min(b, s + d)
        length = max(2, min(_WINDOW_PX, high - low))
        starts.append((low + high - length) // 2)
        lengths.append(length)
    windows = [slice(f, f + n) for f, n in zip(starts, lengths, strict=True)]
    firsts = [max(0, f - round(d)) for f, d in zip(starts, (dy, dx), strict=True)]
    beneath = [slice(f, f + n) for f, n in zip(firsts, lengths, strict=True)]
    fine = _peak(
        high_passed(sharp[beneath[0], beneath[1]]), high_passed(blurred[windows[0], windows[1]])
    )
    return starts[0] - firsts[0] + fine[0], starts[1] - firsts[1] + fine[1]


def _binned(image: FloatArray, factor: int) -> FloatArray:
    rows, columns = (n // factor for n in image.shape)
    blocks = image[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor)
    return np.asarray(blocks.mean(axis=(1, 3)), dtype=np.float64)


def _peak(sharp: FloatArray, blurred: FloatArray) -> tuple[float, float]:
    # padded to both sizes together, so that no lag wraps onto another
    size = tuple(
        fft.next_fast_len(a + b, real=True)
        for a, b in zip(sharp.shape, blurred.shape, strict=True)
    )
    product = fft.rfft2(blurred, size) * np.conj(fft.rfft2(sharp, size))
    peak = np.unravel_index(int(fft.irfft2(product, size).argmax()), size)
    # lags from the blurred photo's size on are negative ones, wrapped round
    dy, dx = (float(p - n * (p >= b)) for p, n, b in zip(peak, size, blurred.shape, strict=True))
    return dy, dx


def _clean_channels(
    sharp: ArrayLike, photo: ArrayLike
) -> tuple[tuple[str, FloatArray], tuple[str, FloatArray]]:
    """Leave out channels that are clipped more than others and not much richer in texture."""
    a = np.asarray(sharp, dtype=np.float64)
    b = np.asarray(photo, dtype=np.float64)
    if a.ndim == b.ndim == 3 and a.shape[2] == b.shape[2] and a.size and b.size:
        share = np.maximum(*((image >= CLIPPED_LEVEL).mean(axis=(0, 1)) for image in (a, b)))
        contrast = np.abs(np.diff(b, axis=1)).mean(axis=(0, 1)) * np.maximum(
            1 - share / _CHANNEL_CLIPPED, 0
        )
        is_clean = contrast >= 0.5 * contrast.max()
        a = a[..., is_clean]
        b = b[..., is_clean]
    return ("sharp", a), ("photo", b)


def _noise_variance(light: FloatArray) -> float:
    """Variance of white noise from the finest diagonal detail, which most of a scene lacks."""
    diagonal = 0.5 * (light[1:, 1:] - light[:-1, 1:] - light[1:, :-1] + light[:-1, :-1])
    # 0.6745: median of |x| for a standard normal x; 0.5 above keeps the variance of white noise
    return float((np.median(np.abs(diagonal)) / 0.6745) ** 2)


def _explained_beyond_noise(
    pairs: Sequence[psf_fit.PatchPair], psf: FloatArray, noise_variance: float
) -> float:
    pixels = max(1.0, sum(pair.pixels for pair in pairs))
    variance = sum(float((pair.weight * pair.blurred**2).sum()) for pair in pairs) / pixels
    unexplained = max(0.0, psf_fit.residual_variance(pairs, psf) - noise_variance)
    signal = variance - noise_variance
    if signal <= 0.02 * variance:  # all but noise: the ratio would mean nothing
        return 0.0
    return float(1 - unexplained / signal)


def _without_specks(psf: FloatArray) -> FloatArray:
    """Drop parts apart from the path with little light: noise scattered over the frame."""
    solid = psf > _SPECK_FAINT * psf.max()
    labels, count = ndimage.label(
        ndimage.binary_dilation(solid, np.ones((3, 3)), iterations=2), np.ones((3, 3))
    )
    light = ndimage.sum_labels(psf, labels, np.arange(count + 1))
    light[0] = 0
    return np.where((light >= _SPECK_SHARE * psf.sum())[labels], psf, 0)


def _half(pairs: Sequence[psf_fit.PatchPair], side: int) -> list[psf_fit.PatchPair]:
    """Keep the left (0) or right (1) half of the pixels of every pair."""
    halves = []
    for pair in pairs:
        right = np.arange(pair.weight.shape[1]) >= pair.weight.shape[1] // 2
        halves.append(replace(pair, weight=pair.weight * (right == bool(side))))
    return halves
