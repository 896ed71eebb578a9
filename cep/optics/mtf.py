"""What a code is worth along a trajectory: MTF, its minimum over the continuum, flatness, noise gain, Wiener error."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cep.optics.band import BandSamples, band, band_samples, uniform_length_px
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.exposure import open_path
from cep.optics.response import ShutterResponse
from cep.proofs.certify.minimum import min_chip, mtf_minimum
from motdiff.trajectory import Trajectory

__all__ = [
    "HOPELESS_DB",
    "SCENE_MEAN",
    "SCENE_STD",
    "CodeMetrics",
    "band",
    "chip_noise_db",
    "inverse_scene",
    "measure",
    "min_chip",
    "noise_variance",
    "scene_strength",
    "wiener_mse",
    "worst_of",
]

FloatArray = NDArray[np.float64]

SCENE_MEAN = 0.25  # linear light that an all-open exposure records of the reference scene: sRGB mid-tone 0.54
SCENE_STD = 0.2
HOPELESS_DB = 100.0
"""Noise gains above this say that a sample met a zero, and how closely rounding let it: tables print "> 100"."""

_ZERO = 1e-12  # |H| below this is rounding
_LOWEST_CY_PX = 1 / 256  # the 1/f^2 law stops here, or its variance would be infinite


@dataclass(frozen=True)
class CodeMetrics:
    """Figures of one code along one trajectory, light-true: an all-open code has H(0) = 1.

    Attributes
    ----------
    min_mtf, min_mtf_lower : float
        Smallest |H| over the band's continuum: the value reached, and a proven lower bound.
    min_over_duty : float
        ``min_mtf`` relative to DC.
    min_chip : float or None
        Smallest |P| over the unit circle, in chips; uniform straight motion only.
    flatness_var : float
        Variance of |H| over the band.
    flatness_ratio : float
        Smallest over largest |H|, 0..1; the largest is the duty, at DC.
    noise_gain_db : float
        ``10 log10 mean 1/|H|^2``: noise of the inverse filter relative to a still, all-open exposure's. Infinite when a
        sample falls on a zero.
    dnf_db : float
        The same relative to DC, 20 log10 of the deconvolution noise factor.
    mse_db : float
        ``10 log10`` of the expected mean square error of the Wiener restoration of a 1/f^2 scene; full scale is 1, so
        its negative is the expected PSNR.
    """

    min_mtf: float
    min_mtf_lower: float
    min_over_duty: float
    min_chip: float | None
    flatness_var: float
    flatness_ratio: float
    noise_gain_db: float
    dnf_db: float
    mse_db: float

    def to_dict(self) -> dict[str, float | None]:
        """Fields for JSON; noise gains above :data:`HOPELESS_DB` are None, which JSON writes as null."""
        figures = asdict(self)
        for name in ("noise_gain_db", "dnf_db"):
            if not figures[name] <= HOPELESS_DB:
                figures[name] = None
        return figures

    def in_words(self, name: str) -> float | str | None:
        """One field for a table: "> 100" for a noise gain above :data:`HOPELESS_DB`."""
        value: float | None = getattr(self, name)
        hopeless = name in ("noise_gain_db", "dnf_db") and value is not None and not value <= HOPELESS_DB
        return f"> {HOPELESS_DB:.0f}" if hopeless else value


def measure(
    trajectory: Trajectory,
    code: ShutterCode,
    *,
    camera: Camera | None = None,
    budget: int = 20_000,
    response: ShutterResponse | None = None,
    edges: ArrayLike | None = None,
) -> CodeMetrics:
    """Measure a code along a trajectory taken as given; measure ``trajectory.reversed()`` for the other direction.

    Parameters
    ----------
    trajectory : Trajectory
    code : ShutterCode
    camera : Camera, optional
        For ``mse_db``; ``Camera()`` when omitted.
    budget : int
        Frequencies that the lower bound of the minimum may look at.
    response : ShutterResponse, optional
        How the shutter opens and closes; at once when omitted.
    edges : (n + 1,) array_like, optional
        Chip boundaries as fractions of the exposure; evenly spread over it when omitted. With either, the duty that
        the figures are relative to is the light that came through, and ``min_chip`` is None.

    References
    ----------
    Agrawal and Raskar, "Optimal single image capture for motion deblurring", CVPR 2009: deconvolution noise.
    """
    samples = band_samples(trajectory)
    on_time = response is None and edges is None
    path = open_path(trajectory, code, response=response, edges=edges)
    duty = code.duty if on_time else float(path.dt.sum())
    modulus = np.abs(path.otf(samples.fx, samples.fy))
    minimum = mtf_minimum(trajectory, code, budget=budget, response=response, edges=edges)
    lowest = min(minimum.upper, float(modulus.min()))
    mean = float(samples.weight @ modulus)
    with np.errstate(divide="ignore"):
        noise_gain_db = float(10 * np.log10(samples.weight @ (1 / np.where(modulus < _ZERO, 0.0, modulus) ** 2)))
    mse = wiener_mse(modulus**2, samples, noise_variance(camera or Camera(), duty))
    return CodeMetrics(
        min_mtf=lowest,
        min_mtf_lower=min(minimum.lower, lowest),
        min_over_duty=lowest / duty,
        min_chip=min_chip(code) if on_time and uniform_length_px(trajectory) is not None else None,
        flatness_var=float(samples.weight @ (modulus - mean) ** 2),
        flatness_ratio=lowest / duty,
        noise_gain_db=noise_gain_db,
        dnf_db=noise_gain_db + 20 * float(np.log10(duty)),
        mse_db=10 * float(np.log10(mse)),
    )


def worst_of(*metrics: CodeMetrics) -> CodeMetrics:
    """Worst of each figure on its own, as over the two directions of one path."""
    if not metrics:
        raise ValueError("metrics: needs at least one")
    higher_is_better = {"min_mtf", "min_mtf_lower", "min_over_duty", "min_chip", "flatness_ratio"}

    def worst(name: str) -> Any:
        values = [value for item in metrics if (value := getattr(item, name)) is not None]
        if not values:
            return None
        return float(min(values) if name in higher_is_better else max(values))

    return CodeMetrics(**{field.name: worst(field.name) for field in fields(CodeMetrics)})


def chip_noise_db(code: ShutterCode) -> float:
    """``10 log10 mean 1/|P|^2`` over the unit circle on 512 points a chip; add 20 log10 k for the DC-normalised one.

    A zero on the circle makes it infinite; a grid near one gives a finite figure that proves nothing: see
    :func:`min_chip`.
    """
    size = 512 * code.chips
    power = np.abs(np.fft.rfft(code.array, size)) ** 2
    weight = np.full(power.size, 2.0)
    weight[[0, -1]] = 1.0  # frequencies that are their own mirror
    with np.errstate(divide="ignore"):
        return float(10 * np.log10(weight @ (1 / power) / size))


def noise_variance(camera: Camera, duty: float) -> float:
    """Variance per pixel of a photo of the reference scene through a shutter open for ``duty`` of the exposure."""
    return float(camera.noise_variance(SCENE_MEAN * duty))


@lru_cache(maxsize=1)
def scene_strength() -> float:
    """Constant A of the reference scene's power spectrum ``A / (f^2 + f0^2)``, which integrates to its variance."""
    # the inner integral of 1 / (f^2 + f0^2) has a closed form; u = asinh(fx / f0) makes the outer one smooth
    u = np.linspace(0, np.arcsinh(0.5 / _LOWEST_CY_PX), 2001)
    rest = np.sqrt((_LOWEST_CY_PX * np.sinh(u)) ** 2 + _LOWEST_CY_PX**2)
    return SCENE_STD**2 / float(4 * np.trapezoid(np.arctan(0.5 / rest), u))


def inverse_scene(samples: BandSamples) -> FloatArray:
    """1 / S, (F, Q): the reference scene's inverse power spectrum at the samples."""
    return np.asarray((samples.radius2 + _LOWEST_CY_PX**2) / scene_strength(), dtype=np.float64)


def wiener_mse(power: FloatArray, samples: BandSamples, noise: float) -> float:
    r"""Mean over the band of ``S N / (S |H|^2 + N)``, the least mean square error of any linear restoration.

    Parameters
    ----------
    power : (F,) float
        |H|^2 at the samples.
    samples : BandSamples
    noise : float
        Variance N of the noise per pixel.
    """
    per_noise = power[:, None] / noise + inverse_scene(samples)
    return float(samples.weight @ (samples.radius2_weight / per_noise).sum(axis=1))
