"""Figures of a code along a trajectory: smallest MTF, noise gain, Wiener error, and others."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from cep.files.formatting import number
from cep.optics.band import band_samples
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.exposure import open_path
from cep.optics.response import ShutterResponse
from cep.optics.scene import PHOTO, Scene, noise_variance, wiener_mse
from cep.optics.straight_motion import uniform_length_px
from cep.proofs.certify.certificate import paths_by_direction
from cep.proofs.certify.minimum import min_chip, mtf_minimum
from motdiff.files.inputs import one_line
from motdiff.files.plugins import load_object
from motdiff.trajectory import Trajectory

HOPELESS_DB = 100.0
"""Noise gains above this say that a sample met a zero, and how closely rounding let it: tables
print "> 100"."""
_ZERO = 1e-12  # |H| below this is rounding
_GAINS = ("noise_gain_db", "dnf_db")  # infinite at a zero, which JSON cannot say
_HIGHER_IS_BETTER = {"min_mtf", "min_mtf_lower", "min_over_duty", "min_chip"}
FigureOfMerit = Callable[[Trajectory, ShutterCode], float]
"""A user-defined figure of merit, along a trajectory taken as given."""
OwnFigure = float | tuple[float, float]
"""Its value, or its values forward and backward where the direction is unknown."""


@dataclass(frozen=True)
class _Figures:
    """Fields of figures for JSON and for tables, in which infinite noise gains are no numbers."""

    def to_dict(self) -> dict[str, float | None]:
        """Fields for JSON; noise gains above :data:`HOPELESS_DB` are None, null in JSON."""
        figures: dict[str, float | None] = asdict(self)
        return {
            name: None if self._is_hopeless(name) else value for name, value in figures.items()
        }

    def in_words(self, name: str) -> float | str | None:
        """One field for a table: "> 100" for a noise gain above :data:`HOPELESS_DB`."""
        if self._is_hopeless(name):
            return f"> {HOPELESS_DB:.0f}"
        value: float | None = getattr(self, name)
        return value

    def _is_hopeless(self, name: str) -> bool:
        return name in _GAINS and not getattr(self, name) <= HOPELESS_DB


@dataclass(frozen=True)
class CodeMetrics(_Figures):
    """Figures of one code along one trajectory, light-true: an all-open code has H(0) = 1.

    Attributes
    ----------
    min_mtf, min_mtf_lower : float
        Smallest |H| over the band's continuum: the value reached, and a proven lower bound.
    min_over_duty : float
        ``min_mtf`` relative to DC, where |H| is the largest.
    min_chip : float or None
        Smallest |P| over the unit circle, in chips; uniform straight motion only.
    flatness_var : float
        Variance of |H| over the band.
    noise_gain_db : float
        ``10 log10 mean 1/|H|^2``: noise of the inverse filter relative to a still, all-open
        exposure's. Infinite when a sample falls on a zero.
    dnf_db : float
        The same relative to DC, 20 log10 of the deconvolution noise factor.
    mse_db : float
        ``10 log10`` of the mean square error of the Wiener restoration that a model of photographs
        expects (:mod:`cep.optics.scene`); full scale is 1, so its negative is the expected PSNR.
    """

    min_mtf: float
    min_mtf_lower: float
    min_over_duty: float
    min_chip: float | None
    flatness_var: float
    noise_gain_db: float
    dnf_db: float
    mse_db: float


@dataclass(frozen=True)
class PairMetrics(_Figures):
    """Figures of two cameras restored together, the worst of scenarios and directions.

    Attributes
    ----------
    min_mtf : float
        Smallest root of the mean of both ``|H|^2``, as sampled: no proof covers two codes.
    noise_gain_db : float
        ``10 log10 mean 1 / sum |H|^2``; infinite where a sample falls on a common zero.
    mse_db : float
        ``10 log10`` of the mean square error that a model of photographs expects of the best
        linear restoration, with each camera's own noise.
    """

    min_mtf: float
    noise_gain_db: float
    mse_db: float


def measure(
    trajectory: Trajectory,
    code: ShutterCode,
    *,
    camera: Camera | None = None,
    budget: int = 20_000,
    response: ShutterResponse | None = None,
    scene: Scene = PHOTO,
) -> CodeMetrics:
    """Measure a code along a trajectory taken as given; its reverse is another one.

    Parameters
    ----------
    camera : Camera, optional
        For ``mse_db``; ``Camera()`` when omitted. Its dark current counts for the code's
        integration time.
    budget : int
        Largest number of frequencies evaluated for the lower bound of the minimum.
    response : ShutterResponse, optional
        How the shutter opens and closes; at once when omitted. With it the duty that the figures
        are relative to is the light that came through, and ``min_chip`` is None.
    scene : Scene
        For ``mse_db``.

    References
    ----------
    Agrawal and Raskar, "Optimal single image capture for motion deblurring", CVPR 2009:
    deconvolution noise.
    """
    samples = band_samples(trajectory)
    path = open_path(trajectory, code, response=response)
    duty = float(path.dt.sum())
    chip_units = None
    if response is None:
        duty = code.duty  # not the sum, which rounding puts a hair off
        if uniform_length_px(trajectory) is not None:
            chip_units = min_chip(code)
    modulus = np.abs(path.otf(samples.fx, samples.fy))
    minimum = mtf_minimum(trajectory, code, budget=budget, response=response)
    # a quick search over the continuum may miss a valley that a sample happens to hit
    lowest = min(minimum.upper, float(modulus.min()))
    mean = float(samples.weight @ modulus)
    with np.errstate(divide="ignore"):
        inverse_power = 1 / np.where(modulus < _ZERO, 0.0, modulus) ** 2
        noise_gain_db = float(10 * np.log10(samples.weight @ inverse_power))
    noise = noise_variance(
        camera or Camera(), duty, integration_s=code.integration_ns * 1e-9, scene=scene
    )
    mse = wiener_mse(modulus**2, samples, float(noise), scene=scene)
    return CodeMetrics(
        min_mtf=lowest,
        min_mtf_lower=min(minimum.lower, lowest),
        min_over_duty=lowest / duty,
        min_chip=chip_units,
        flatness_var=float(samples.weight @ (modulus - mean) ** 2),
        noise_gain_db=noise_gain_db,
        dnf_db=noise_gain_db + 20 * float(np.log10(duty)),
        mse_db=10 * float(np.log10(mse)),
    )


def worst_of(*metrics: CodeMetrics) -> CodeMetrics:
    """Worst of each figure on its own, as over the two directions of one path."""

    def worst(name: str) -> Any:
        values = [value for item in metrics if (value := getattr(item, name)) is not None]
        extreme = min if name in _HIGHER_IS_BETTER else max
        return extreme(values, default=None)

    return CodeMetrics(**{field.name: worst(field.name) for field in fields(CodeMetrics)})


def measure_worst(
    trajectory: Trajectory,
    code: ShutterCode,
    *,
    camera: Camera | None = None,
    scene: Scene = PHOTO,
) -> CodeMetrics:
    """Measure a code along a trajectory; where its direction is unknown, the worse one counts."""
    paths = [*paths_by_direction(trajectory).values()]
    # the reverse of a uniform straight motion, or of a code that is its own mirror image, sees
    # the same |H|
    if uniform_length_px(trajectory) is not None or code.bits == code.bits[::-1]:
        paths = paths[:1]
    return worst_of(*(measure(path, code, camera=camera, scene=scene) for path in paths))


def find_figures(references: Iterable[str]) -> dict[str, FigureOfMerit]:
    """Import user-defined figures of merit, each ``module:name``, and key them by these names.

    ValueError if there is no such object, or it is no function.
    """
    figures = {reference: load_object(reference) for reference in references}
    for reference, figure in figures.items():
        if not callable(figure):
            raise ValueError(f"figure {reference}: is no function of a trajectory and a code")
    return figures


def own_figures(
    figures: Mapping[str, FigureOfMerit], trajectory: Trajectory, code: ShutterCode
) -> dict[str, OwnFigure]:
    """Evaluate user-defined figures of merit; in both directions where it is unknown.

    A function takes (trajectory, code), the trajectory with a known direction, and returns a
    number. ValueError, which names it, if it fails or returns none.

    Examples
    --------
    >>> path = Trajectory.straight(4.0, direction="known")
    >>> own_figures({"light": lambda path, code: code.duty}, path, ShutterCode("10"))
    {'light': 0.5}
    """
    # both are listed: whether a figure of the user's is better high or low is not known
    paths = [replace(path, direction="known") for path in paths_by_direction(trajectory).values()]
    by_name: dict[str, OwnFigure] = {}
    for name, figure in figures.items():
        values = [_number(name, figure, path, code) for path in paths]
        by_name[name] = values[0]
        if len(values) > 1:
            by_name[name] = (values[0], values[1])
    return by_name


def _number(name: str, figure: FigureOfMerit, path: Trajectory, code: ShutterCode) -> float:
    try:
        value = np.asarray(figure(path, code))
    except Exception as error:  # whatever the user's function raises
        raise ValueError(
            f"figure {name}: failed ({type(error).__name__}: {one_line(error)})"
        ) from None
    if value.shape or value.dtype.kind not in "iuf" or np.isnan(value):
        raise ValueError(
            f"figure {name}: must return a number, got {one_line(value.tolist())[:40]}"
        )
    return float(value)


def figure_head(name: str, value: OwnFigure) -> str:
    """Head of a user-defined figure in a table."""
    if isinstance(value, tuple):
        return f"{name}, forward / backward"
    return name


def figure_in_words(value: OwnFigure) -> float | str:
    """User-defined figure for a table."""
    if isinstance(value, tuple):
        return " / ".join(map(number, value))
    return value
