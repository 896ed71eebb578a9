"""No-reference quality score of blur kernels.

Blind estimation fails silently: a wrong kernel restores to a sparse picture too, so sparsity
cannot choose. Two cues that the sparse search does not use can. The photo's *power spectrum* has
the kernel's zeros in it (no phase), and the *phase* distinguishes a kernel from its point
reflection (same power). Both are compared with nothing but the photo.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage, special

from motdiff.crops import uniformity
from motdiff.metrics import SAME_KERNEL_MNC, mnc_matrix, mnc_subpixel
from motdiff.photo_noise import LEAST_SIGMA, shared_sigma
from motdiff.psf_frame import in_frame
from motdiff.threads import side_by_side
from motdiff.types import FloatArray

_TOP = 3  # how many like-minded candidates count as agreement
_BAND_CY_PX = (0.02, 0.4)  # below, the scene dominates; above, noise
_SPARSE_NORM = 0.8
_CLEARLY = 0.02  # docs/decisions/motion-estimation.md
# One score for all kernels. Its weights choose the kernel with the highest MNC on average, fitted
# on simulated motions over training photos (120 photos, 8 or 9 starts each).
_EVIDENCE_WEIGHTS = np.array([0.8, 2.0, -1.0])
_AGREEMENT_WEIGHT = 0.4
# Log odds that the winner has a sub-pixel MNC of 0.7 or more: slope in its score, and offset.
_LOG_ODDS = (8.3, -5.15)


@dataclass(frozen=True)
class Ranking:
    """Best of several kernels, and the probability of each to be good.

    Attributes
    ----------
    best : int
        Index of the chosen kernel.
    probabilities : (K,) float
        Probability of each that its sub-pixel MNC is 0.7 or more.
    agreement : float
        Mean MNC of the chosen kernel with the candidates most like it.
    """

    best: int
    probabilities: FloatArray
    agreement: float


class Spectrum:
    r"""A photo's power spectrum, prepared to be compared with those of kernels.

    The model of the spectrum is ``A |K(f)|^2 / |f|^2 + sigma^2``, A at its maximum likelihood. A
    smooth scene spectrum (a power law with curvature, and two harmonics of orientation) is
    regressed out of both sides, so that what remains are the dips that only the kernel makes.

    Parameters
    ----------
    photo : (H, W) float
    sigma : float
        Standard deviation of the noise.

    References
    ----------
    Whittle, "Estimation and information in stationary time series", 1953 (likelihood of a
    periodogram).
    """

    def __init__(self, photo: FloatArray, *, sigma: float) -> None:
        height, width = self._shape = photo.shape
        # borders would add a cross to the spectrum
        window = np.hanning(height)[:, None] * np.hanning(width)[None, :]
        window /= np.sqrt(np.mean(window**2))
        centred = (photo - np.average(photo, weights=window)) * window
        power = np.abs(fft.rfft2(centred)) ** 2 / (height * width)
        fy = fft.fftfreq(height)[:, None]
        fx = np.abs(fft.rfftfreq(width))[None, :]
        radius2 = fx**2 + fy**2
        self._in_band = (radius2 > _BAND_CY_PX[0] ** 2) & (radius2 < _BAND_CY_PX[1] ** 2)
        radius2[0, 0] = 1.0  # outside the band: only kept from dividing by 0
        self._radius2 = radius2
        self._floor = max(sigma, LEAST_SIGMA) ** 2
        self._power = power[self._in_band].astype(np.float32)
        self._log_median = float(np.median(_log_power(power)[self._in_band]))
        log_radius = np.log(radius2)[self._in_band]
        angle = np.arctan2(fy, fx)[self._in_band]
        smooth = np.stack(
            [np.ones_like(angle), log_radius, log_radius**2]
            + [wave(order * angle) for order in (2, 4) for wave in (np.cos, np.sin)],
            axis=1,
        )
        self._basis, _ = np.linalg.qr(smooth)
        self._observed = self._ripples(power)

    def fit(self, kernel: FloatArray) -> float:
        """Correlation, -1..1, of the log power spectra of photo and ``kernel`` (k, k), sum 1."""
        scene = np.abs(fft.rfft2(kernel, s=self._shape)) ** 2 / self._radius2
        inside = scene[self._in_band]
        start = np.exp(self._log_median - np.median(np.log(inside + 1e-12)))
        # A has no closed form; a factor of 2.4 apart is fine enough
        amplitudes = start * np.geomspace(0.03, 30, 9)
        misfits = []
        single = inside.astype(np.float32)  # to choose one of nine, in half the time
        for amplitude in amplitudes:
            model = np.float32(amplitude) * single + np.float32(self._floor)
            misfits.append(float(np.mean(np.log(model) + self._power / model, dtype=np.float64)))
        expected = self._ripples(amplitudes[int(np.argmin(misfits))] * scene + self._floor)
        observed = self._observed
        norms = (observed @ observed) * (expected @ expected)
        return float(observed @ expected / np.sqrt(norms + 1e-12))

    def _ripples(self, power: FloatArray) -> FloatArray:
        # 3 x 3 means tame the exponential scatter of a periodogram
        smooth = ndimage.uniform_filter(power, 3, mode=("wrap", "mirror"))
        log_power = _log_power(smooth)[self._in_band]
        return np.asarray(log_power - self._basis @ (self._basis.T @ log_power), dtype=np.float64)


class Phase:
    """Tells kernels from their point reflections, which have the same power spectrum.

    Parameters
    ----------
    photo : (H, W) float
    sigma : float
        Standard deviation of the noise.
    """

    def __init__(self, photo: FloatArray, *, sigma: float) -> None:
        energy = float(np.mean(np.diff(photo, axis=0) ** 2) + np.mean(np.diff(photo, axis=1) ** 2))
        # white noise adds 2 sigma^2 to the mean square difference along each axis
        noise_to_scene = 40 * max(sigma, 2e-3) ** 2 / max(energy - 4 * sigma**2, 1e-6)
        self._margin = min(32, min(photo.shape) // 4)  # the restoration rings at the borders
        # in single precision below, a mean would hide faint contrast
        padded = np.pad(photo - photo.mean(), self._margin, mode="symmetric")
        self._shape = padded.shape
        # half the time of double precision; the evidence changes by 1e-7
        self._spectrum = fft.rfft2(padded).astype(np.complex64)
        radius2 = (
            fft.fftfreq(padded.shape[0])[:, None] ** 2
            + fft.rfftfreq(padded.shape[1])[None, :] ** 2
        )
        self._penalty = (noise_to_scene * radius2 + 1e-12).astype(np.float32)

    def evidence(self, kernel: FloatArray) -> float:
        """Log ratio of gradient sparsity, restored with the reflected kernel over the kernel.

        Positive when the phase of ``kernel``, (k, k) of odd k, is right: the reflected one rings.
        """
        centre = kernel.shape[0] // 2
        frame = np.zeros(self._shape, dtype=np.float32)
        frame[: kernel.shape[0], : kernel.shape[1]] = kernel
        transfer = fft.rfft2(np.roll(frame, (-centre, -centre), axis=(0, 1)))
        quotient = self._spectrum / (transfer.real**2 + transfer.imag**2 + self._penalty)
        # point reflection of a real kernel conjugates its transfer function
        right, reflected = (
            self._sparsity(quotient * response) for response in (transfer.conj(), transfer)
        )
        return reflected - right

    def _sparsity(self, spectrum: NDArray[np.complex64]) -> float:
        # 8 px more than the padding, where ringing decays
        inner = slice(self._margin + 8, -self._margin - 8)
        restored = fft.irfft2(spectrum, s=self._shape)[inner, inner]
        gradients = np.concatenate([np.diff(restored, axis=axis).ravel() for axis in (0, 1)])
        energy = gradients**2
        half = np.float32(_SPARSE_NORM / 2)
        norm = np.mean(energy**half, dtype=np.float64) / np.mean(energy, dtype=np.float64) ** (
            _SPARSE_NORM / 2
        )
        return float(np.log(norm))


class Judge:
    """Scores kernels on a photo's crops by spectrum and phase, which the search does not use.

    Parameters
    ----------
    photos : (C, H, W) float
        Crops that share one blur.
    sigma : float, optional
        Standard deviation of their noise; :func:`motdiff.photo_noise.shared_sigma` when omitted.
    """

    def __init__(self, photos: FloatArray, *, sigma: float | None = None) -> None:
        if sigma is None:
            sigma = shared_sigma(photos)
        self.sigma = sigma
        self._spectra = [Spectrum(photo, sigma=self.sigma) for photo in photos]
        self._phases = [Phase(photo, sigma=self.sigma) for photo in photos]

    def evidence(self, kernels: Sequence[FloatArray]) -> FloatArray:
        """Evidence (K, 3) for kernels (k, k), odd k, sum 1.

        Spectral fit and phase evidence, means over crops; share of light on the frame's rim.
        """
        return np.array(
            side_by_side([partial(self._row, kernel) for kernel in kernels]), dtype=np.float64
        )

    def _row(self, kernel: FloatArray) -> tuple[float, float, float]:
        fit = np.mean([spectrum.fit(kernel) for spectrum in self._spectra])
        phase = np.mean([phase.evidence(kernel) for phase in self._phases])
        return float(fit), float(phase), float(1 - kernel[1:-1, 1:-1].sum() / kernel.sum())


def kernel_score(evidence: FloatArray, agreement: FloatArray | float = 0.0) -> FloatArray:
    """Quality (K,) from :meth:`Judge.evidence` (K, 3) and agreement (K,) with other candidates.

    Agreement is a mean MNC; omit it to compare by the photo alone.
    """
    return np.asarray(
        evidence @ _EVIDENCE_WEIGHTS + _AGREEMENT_WEIGHT * agreement, dtype=np.float64
    )


def rank_kernels(photos: FloatArray, kernels: Sequence[FloatArray]) -> Ranking:
    """Choose among searched kernels; each agrees by its mean MNC with the three most alike.

    Parameters
    ----------
    photos : (C, H, W) float
        Crops that share one blur.
    kernels : sequence of (k, k) float, odd k, sum 1
        Candidates; their frames may differ.
    """
    count = len(kernels)
    alike = mnc_matrix(kernels)
    # a kernel's likeness with itself is no agreement
    np.fill_diagonal(alike, 0)
    top = max(min(_TOP, count - 1), 1)
    agreement = np.ones(1)  # a lone kernel agrees with itself
    if count > 1:
        agreement = np.sort(alike, axis=1)[:, -top:].mean(axis=1)
    slope, offset = _LOG_ODDS
    scores = kernel_score(Judge(photos).evidence(kernels), agreement)
    probabilities = np.asarray(special.expit(slope * scores + offset), dtype=np.float64)
    best = int(np.argmax(probabilities))
    return Ranking(best, probabilities, float(agreement[best]))


def distinct(
    alike: FloatArray, first: Iterable[int], order: Iterable[int], *, count: int
) -> list[int]:
    """Choose ``first``, then those of ``order`` that repeat no kernel chosen before.

    Parameters
    ----------
    alike : (K, K) float
        MNC of every pair.
    count : int
        How many to choose; those of ``first`` at least.
    """
    chosen = list(first)
    for i in order:
        if len(chosen) >= count:
            break
        if all(alike[i, j] < SAME_KERNEL_MNC for j in chosen):
            chosen.append(int(i))
    return chosen


def uneven_blur_warning(
    crops: FloatArray, single_kernels: Sequence[FloatArray], shared: FloatArray
) -> str | None:
    """Return a warning when no kernel explains every crop as well as that crop's own, else None.

    Different kernels of single crops are no evidence: a search in one crop fails more often than a
    blur differs.

    Parameters
    ----------
    crops : (C, H, W) float, grey
    single_kernels : sequence of C (k, k) float
        Kernel found in each crop alone.
    shared : (k, k) float, odd k, sum 1
        Kernel found in all of them together.
    """
    kernels = [shared, *(_odd(kernel) for kernel in single_kernels)]
    scores = np.stack([kernel_score(Judge(crop[None]).evidence(kernels)) for crop in crops])
    alike = np.array(
        [[mnc_subpixel(single, kernel) for kernel in kernels] for single in kernels[1:]]
    )
    # (crops, kernels): how much better a crop's own kernel explains it than another one does
    missing = np.where(
        alike < SAME_KERNEL_MNC, np.diagonal(scores, offset=1)[:, None] - scores, 0.0
    )
    best = int(np.argmin((missing > _CLEARLY).sum(axis=0)))
    differing = np.flatnonzero(missing[:, best] > _CLEARLY)
    if differing.size == 0:
        return None
    mutual = uniformity([kernels[best], *(kernels[1 + i] for i in differing)])
    return (
        f"The blur differs across the photo ({differing.size} of {len(crops)} crops have another"
        f" one, mutual MNC {mutual:.2f}): no single trajectory fits."
    )


def _log_power(power: FloatArray) -> FloatArray:
    """Logarithm of powers, which rounding makes 0 or less where a pattern leaves next to none."""
    return np.asarray(np.log(np.maximum(power, np.finfo(np.float64).eps * power.max())))


def _odd(kernel: FloatArray) -> FloatArray:
    """Cut the first row and column off an even frame, which have no mirror image; sum 1."""
    cut = in_frame(kernel, (len(kernel) - 1) | 1)
    return np.asarray(cut / max(float(cut.sum()), 1e-12), dtype=np.float64)
