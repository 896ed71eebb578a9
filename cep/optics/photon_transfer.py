"""Photon-transfer curve: gain, read noise and full well of a camera from pairs of flat frames.

The difference of two frames of the same light, scaled to the same mean, holds noise alone: what is
fixed to the pixels cancels. Over the mean the variance is a line, ``variance = (mean - black) /
gain + read noise^2``, until the pixels saturate.

References
----------
Janesick, "Photon Transfer", SPIE Press, 2007. EMVA Standard 1288, release 3.1, sections 6.6 and
6.7.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cep.optics.camera import Camera
from cep.optics.frame_pairs import CodeRange, FramePair
from motdiff.photo_values import to_display, to_linear
from motdiff.types import FloatArray

_FIT_SHARE = 0.7  # of saturation: above it the response bends, EMVA 1288
_CLIPPED = 0.005  # share of pixels at the end of the codes that makes a variance too small
_BLACK_CLIPPED = 0.1  # share of dark pixels at 0 from which the dark noise is not there to be seen
_FALLEN = 0.1  # a brighter pair with so much less variance than a darker one is saturated
# share by which the light of a pair's frames may differ: scaling them mends that to 0.1 %
_UNEQUAL = 0.05
_BANDED = 0.01  # part of a pair's variance that differences between lines may make up
_UNSURE = 0.25  # relative error from which a gain is no result
_EMVA_LEAST_NOISE_DN = 0.24  # below it quantisation hides the noise


@dataclass(frozen=True)
class TransferPoint:
    """One pair of flat frames on the curve.

    Attributes
    ----------
    signal_dn : float
        Mean above black, code values.
    variance_dn2 : float
        Variance of one frame over time, without that of the quantisation.
    use : {"fitted", "above the fit", "saturated"}
    """

    signal_dn: float
    variance_dn2: float
    use: Literal["fitted", "above the fit", "saturated"]


@dataclass(frozen=True)
class PhotonTransfer:
    """A camera's photon-transfer curve.

    Attributes
    ----------
    gain_e_per_dn, gain_error : float
        Electrons per code value, and its standard error.
    read_noise_e, read_noise_error : float
        Electrons rms, and its standard error.
    full_well_e : float or None
        Electrons at which the brightest frames saturate; None where none does.
    full_well_is : {"", "pixel", "code range"}
        What is full there.
    black_dn : float
        Code value without light.
    response : {"linear", "srgb"}
    points : tuple of TransferPoint
        By rising light.
    """

    gain_e_per_dn: float
    gain_error: float
    read_noise_e: float
    read_noise_error: float
    full_well_e: float | None
    full_well_is: Literal["", "pixel", "code range"]
    black_dn: float
    codes: CodeRange
    response: Literal["linear", "srgb"]
    points: tuple[TransferPoint, ...]
    dark_variance_dn2: float | None = None
    warnings: tuple[str, ...] = ()

    @property
    def summary(self) -> str:
        """What was found, in one sentence."""
        well = "the full well was not reached"
        if self.full_well_e is not None:
            end = f"the {self.codes.bits}-bit range ends"
            if self.full_well_is == "pixel":
                end = "the pixel is full"
            well = f"{end} at {_round(self.full_well_e, 4):.0f} e-"
        return (
            f"{self.gain_e_per_dn:.3g} e- per code value, read noise {self.read_noise_e:.3g} e-,"
            f" {well}; standard errors {self.gain_error / self.gain_e_per_dn:.1%} and"
            f" {self.read_noise_error:.2g} e-."
        )

    def camera(self, *, name: str = "", source: str = "") -> Camera:
        """Make the camera with these figures; value 1 is where it saturates."""
        black_dn = 0.0  # on a curve code values differ in electrons: neither pedestal nor gain
        gain_e_per_dn = None
        if self.response == "linear":
            black_dn = self.black_dn
            gain_e_per_dn = _round(self.gain_e_per_dn)
        range_e = (self.codes.top_dn - black_dn) * self.gain_e_per_dn
        # what is full first: the pixel or the code
        full_e = min(range_e, self.full_well_e or range_e)
        return Camera(
            photons_full_scale=_round(full_e),
            read_noise_e=_round(self.read_noise_e),
            bits=self.codes.bits,
            response=self.response,
            black_level=_round(min(black_dn * self.gain_e_per_dn / full_e, 1.0)),
            name=name,
            source=source,
            full_well_e=self.full_well_e and _round(self.full_well_e),
            gain_e_per_dn=gain_e_per_dn,
        )

    def to_dict(self) -> dict[str, Any]:
        """Figures for JSON."""
        return {
            "gain_e_per_dn": self.gain_e_per_dn,
            "gain_error_e_per_dn": self.gain_error,
            "read_noise_e": self.read_noise_e,
            "read_noise_error_e": self.read_noise_error,
            "full_well_e": self.full_well_e,
            "full_well_is": self.full_well_is or None,
            "black_dn": self.black_dn,
            "bits": self.codes.bits,
            "points": [asdict(point) for point in self.points],
        }


def photon_transfer(
    flats: Sequence[FramePair],
    *,
    codes: CodeRange,
    dark: FramePair | None = None,
    black_dn: float | None = None,
    response: Literal["linear", "srgb"] = "linear",
) -> PhotonTransfer:
    """Fit a photon-transfer curve.

    ValueError if the frames do not show a camera's noise; the line names the pair, counted from 1.

    Parameters
    ----------
    flats : sequence of FramePair
        Evenly lit; several levels of light up to saturation.
    dark : FramePair, optional
        Without light, of the same exposure and gain.
    black_dn : float, optional
        Code value without light, where there are no dark frames; 0 when omitted.
    response : {"linear", "srgb"}
        Curve on which the code values are evenly spaced; the pairs are of linear light.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> def frame(electrons):  # 2 electrons per code value, read noise 6 electrons, black at 100
    ...     noisy = rng.poisson(electrons, (200, 200)) + rng.normal(0, 6, (200, 200))
    ...     return np.clip(np.rint(noisy / 2 + 100), 0, 4095).astype(np.uint16)
    >>> flats = [FramePair.of(frame(level), frame(level)) for level in (500, 2000, 5000)]
    >>> found = photon_transfer(flats, codes=CodeRange(12), dark=FramePair.of(frame(0), frame(0)))
    >>> print(f"{found.gain_e_per_dn:.1f} e-/DN, {found.read_noise_e:.1f} e-")
    2.0 e-/DN, 6.0 e-
    """
    warnings = [codes.assumed] if codes.assumed else []
    if dark is not None:
        black = dark.mean / codes.spacing
        dark_variance = _variance(dark, codes, response)
        warnings += _check_dark(dark, dark_variance)
    else:
        black = black_dn or 0.0
        dark_variance = None
        if black_dn is None:
            warnings.append(
                "no dark frames: black is taken as code value 0, on which the read noise depends"
            )
    for number, pair in enumerate(flats, 1):
        if pair.variance() == 0 and not _is_clipped(pair, codes):
            raise ValueError(
                f"pair {number}: its frames are the same in every pixel; two exposures are needed"
            )
        _check_flat(number, pair, black * codes.spacing, dark)
        if (banding := pair.banding(black * codes.spacing)) > _BANDED and not _is_clipped(
            pair, codes
        ):
            warnings.append(
                f"pair {number}: the light of its frames differs from line to line, by"
                f" {banding:.0%} of their noise: the light flickers, and the gain is too small"
            )
    # the curve by rising light, in the camera's code values above black
    order = sorted(flats, key=lambda pair: pair.mean)
    signal = np.array([pair.mean for pair in order]) / codes.spacing - black
    variance = np.array(
        [_variance(pair, codes, response, black * codes.spacing) for pair in order]
    )
    pixels = np.array([pair.pixels for pair in order])
    saturated = _saturated(order, variance, codes)
    if saturated.all():
        raise ValueError("the frames are saturated throughout: expose some for less")
    fitted = ~saturated
    if saturated.any():
        # EMVA 1288 fits up to 70 % of saturation; all that is left where nothing is below
        low = fitted & (signal <= _FIT_SHARE * signal[saturated].max())
        if low.any():
            fitted = low
    x = signal[fitted]
    y = variance[fitted]
    n = pixels[fitted]
    if dark is not None and dark_variance is not None:
        x = np.append(x, 0.0)
        y = np.append(y, dark_variance)
        n = np.append(n, dark.pixels)
    # variance = signal / gain + read noise^2, both in code values: the light's noise is Poisson
    slope, floor, slope_error, floor_error, bent = _line(x, y, n)
    gain = 1 / slope
    if floor < -4 * floor_error:  # 4 standard errors: no accident of noise
        raise ValueError(
            f"the noise at black would be below 0: black is not code value {black:g}; give dark"
            " frames or its value"
        )
    if floor_error > 0.2 * max(floor, 0.0):
        warnings.append(
            "the read noise is hardly seen beside the light's: give dark frames, or darker ones"
        )
    if bent:
        warnings.append(
            f"the noise is off the line by up to {bent:.0%}: the response is bent or noise was"
            " filtered"
        )
    noise_dn2 = max(floor, floor_error)  # a floor at or below 0 is unknown, to its error
    full_well, kind = _full_well(
        order, saturated, variance, slope * signal + floor, codes, black, gain, response
    )
    uses = np.select([saturated, fitted], ["saturated", "fitted"], "above the fit").tolist()
    return PhotonTransfer(
        gain_e_per_dn=gain,
        gain_error=gain**2 * slope_error,  # of 1 / slope
        read_noise_e=gain * math.sqrt(noise_dn2),
        # of a root: d sqrt(v) = dv / (2 sqrt(v))
        read_noise_error=gain * floor_error / (2 * math.sqrt(noise_dn2)),
        full_well_e=full_well,
        full_well_is=kind,
        black_dn=black,
        codes=codes,
        response=response,
        points=tuple(
            map(TransferPoint, signal.tolist(), np.maximum(variance, 0.0).tolist(), uses)
        ),
        dark_variance_dn2=dark_variance,
        warnings=tuple(warnings),
    )


def _variance(
    pair: FramePair, codes: CodeRange, response: str, black: float | None = None
) -> float:
    """Variance over time at equal light, without the quantisation's, code values squared."""
    step = 1.0
    if response == "srgb":
        # a step of a curved response holds more light where it is bright: its width at this mean
        half = 0.5 / codes.top_dn
        value = float(to_display(pair.mean / codes.spacing / codes.top_dn))
        low, high = to_linear(np.clip([value - half, value + half], 0, 1))
        step = float(high - low) * codes.top_dn
    # rounding to steps of width q adds q^2 / 12 to a variance (EMVA 1288)
    return pair.variance(black) / codes.spacing**2 - step**2 / 12


def _check_dark(dark: FramePair, variance_dn2: float) -> list[str]:
    """Warnings of dark frames; raises ValueError where they show no noise."""
    at_zero = dark.histogram[0] / (2 * dark.pixels)  # of both frames
    if at_zero > _BLACK_CLIPPED:
        raise ValueError(
            f"dark: {at_zero:.0%} of its pixels are at code value 0; raise the camera's black"
            " level"
        )
    if dark.variance() == 0:
        raise ValueError("dark: its frames are the same in every pixel; two exposures are needed")
    if at_zero > _CLIPPED:
        return [
            f"{at_zero:.1%} of the dark pixels are at code value 0: the read noise is larger than"
            " stated"
        ]
    if variance_dn2 < _EMVA_LEAST_NOISE_DN**2:
        return [
            "the dark noise is below a quarter of a code value: quantisation hides the read noise"
        ]
    return []


def _check_flat(number: int, pair: FramePair, black: float, dark: FramePair | None) -> None:
    light = pair.mean - black
    error = math.sqrt(2 * pair.variance() / pair.pixels)  # of the difference of two means
    if light <= 5 * error:
        source = "black" if dark is None else "the dark frames"
        raise ValueError(
            f"pair {number}: its mean of {pair.mean:.5g} is not above that of {source},"
            f" {black:g}; flats need light"
        )
    if abs(pair.difference) > _UNEQUAL * light + 5 * error:
        raise ValueError(
            f"pair {number}: its frames differ in light by {abs(pair.difference) / light:.0%};"
            " give the two frames of each level one after the other"
        )


def _is_clipped(pair: FramePair, codes: CodeRange) -> bool:
    end = math.ceil((codes.top_dn - 0.5) * codes.spacing)
    return bool(pair.histogram[end:].sum() > _CLIPPED * 2 * pair.pixels)


def _saturated(
    order: Sequence[FramePair], variance: FloatArray, codes: CodeRange
) -> NDArray[np.bool_]:
    """Which pairs, by rising light, are clipped or have less noise than a darker one."""
    clipped = np.array([_is_clipped(pair, codes) for pair in order])
    # a full pixel no longer shows the photons' noise: from there on the variance falls
    peak = int(np.argmax(np.where(clipped, -np.inf, variance)))
    scatter = 5 * math.sqrt(4 / min(pair.pixels for pair in order))  # of a ratio of two variances
    fallen = (np.arange(len(order)) > peak) & (
        variance < (1 - max(_FALLEN, scatter)) * variance[peak]
    )
    return np.asarray(clipped | fallen)


def _line(
    x: FloatArray, y: FloatArray, n: NDArray[np.int64]
) -> tuple[float, float, float, float, float]:
    """Fit ``y = slope x + floor`` to variances: both, their errors, and the worst misfit."""
    # it takes two levels of light to tell slope and floor apart
    if x.size < 2 or np.ptp(x) < 0.1 * x.max():
        raise ValueError(
            "the frames have one level of light: give dark frames, or flats of other levels too"
        )
    error = _scatter(y, n)
    # errors by the fit: those by the measured variances would favour the low ones
    for _ in range(4):
        line, covariance = np.polyfit(x, y, 1, w=1 / error, cov="unscaled")
        # a fit that crosses 0 near black would give its variances a weight without bound
        error = _scatter(np.maximum(np.polyval(line, x), 0.1 * np.abs(y)), n)
    slope, floor = line.tolist()
    slope_error, floor_error = (float(value) for value in np.sqrt(np.diag(covariance)))
    # the slope is the gain's reciprocal: without photon noise there is none
    if slope <= 0:
        raise ValueError(
            "the noise does not grow with the light: these are no frames as the sensor made them"
        )
    if slope_error > _UNSURE * slope:
        raise ValueError(
            "the noise hardly grows with the light: its levels are too alike, or the frames too"
            " small, for a gain"
        )
    off = np.abs(np.polyval(line, x) - y)
    is_bent = (off > 5 * error) & (off > 0.05 * y)  # significant, and large enough to matter
    bent = off[is_bent] / y[is_bent]
    return slope, floor, slope_error, floor_error, float(bent.max(initial=0.0))


def _scatter(variance: FloatArray, n: NDArray[np.int64]) -> FloatArray:
    """Return the standard error of variances of ``n`` pixels, rounding included.

    Rounding adds 1/12 to a variance, and for a Gaussian of variance v up to (4 v + 1 / pi^2)
    exp(-2 pi^2 v) more or less, by where its mean lies between two code values.
    """
    v = np.maximum(variance, 1e-3)
    rounding = (4 * v + 1 / np.pi**2) * np.exp(-2 * np.pi**2 * v)
    # a variance v of n Gaussian samples scatters by v sqrt(2 / n)
    return np.asarray(np.hypot(v * np.sqrt(2 / n), rounding))


def _full_well(
    order: Sequence[FramePair],
    saturated: NDArray[np.bool_],
    variance: FloatArray,
    expected: FloatArray,
    codes: CodeRange,
    black: float,
    gain: float,
    response: str,
) -> tuple[float | None, Literal["", "pixel", "code range"]]:
    """Electrons at which the brightest pair saturates, and what is full there."""
    if not saturated[-1]:
        return None, ""
    share = 0.999  # of pixels, that a few hot ones do not count
    # frames that are full everywhere have the noise of reading alone: their median is the level
    if variance[-1] < 0.2 * expected[-1]:
        share = 0.5
    value = order[-1].quantile(share) / codes.spacing
    kind: Literal["pixel", "code range"] = "pixel"
    if value > codes.top_dn - 1:
        kind = "code range"
    if response == "srgb":
        value = float(to_linear(value / codes.top_dn)) * codes.top_dn
    return gain * (value - black), kind


def _round(value: float, digits: int = 6) -> float:
    return float(f"{value:.{digits}g}")
