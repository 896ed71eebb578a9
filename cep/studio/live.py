"""Figures, MTFs and photos of one code after another along a motion, fast enough to follow a hand.

What a code does not change is computed once and kept: the OTFs of the chips, and the exposures
without a code.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.exposure import chip_rows, coded_psf, coded_sum, distinct_rows
from cep.optics.path_limits import check_frame, check_resolved
from cep.proofs.audit import with_proven_zero
from cep.proofs.measure import CodeMetrics
from cep.proofs.mtf_curves import main_axis
from cep.restoration.wiener import wiener
from cep.search.expected import ExpectedPsnr
from cep.search.exposures import Exposure, ExposureFinder, check_light, judged_exposures, kind_of
from cep.search.limits import Limits, RunLimits
from cep.search.measured import corrected, shifts_db
from cep.search.problem import SearchProblem
from cep.search.verdict import Verdict, verdict_of
from hw.device import DeviceProfile
from hw.program import Program
from motdiff.simulate import valid_window
from motdiff.types import FloatArray

# frequencies of the MTF's map: x from -0.5 to 0.5, y from 0 to 0.5 cycles/px; |H(-f)| = |H(f)|
MAP_COLUMNS = 97
MAP_ROWS = 49
_CURVE = 241  # frequencies along the main axis, 0..0.5 cycles/px
_BORDER_ROUNDS = 4  # of the filter: the photo is looked at, not measured
# of the OTFs of the paths near one that is not known exactly: 70 chips in both directions
_MOST_BYTES = 96 * 2**20
_BUDGET = 4_000  # cells of the proof of the minimum: milliseconds
_BROKEN = {
    "open_range": "{open} chips are open; the limit is {low} to {high}",
    "min_open": "an opening is shorter than {limit} chips",
    "min_closed": "a gap is shorter than {limit} chips",
    "max_open": "an opening is longer than {limit} chips",
    "max_pulses": "the shutter opens {pulses} times; the limit is {limit}",
    "min_period": "openings begin less than {limit} chips apart",
}


@dataclass(frozen=True)
class LiveFigures:
    """What is shown of a code.

    Attributes
    ----------
    metrics : CodeMetrics
        Worst of each figure over the directions that count. The lower bound of the minimum is
        proven.
    curve : (F,) float
        MTF along the motion's main axis, light-true, at :attr:`LiveBench.freq_cy_px`.
    band : (MAP_ROWS, MAP_COLUMNS) float
        MTF over half of the band.
    psnr_db : float
        About that of a restored photograph: the model's, shifted by what photographs show.
    """

    metrics: CodeMetrics
    curve: FloatArray
    band: FloatArray
    psnr_db: float


class LiveBench:
    """One motion, camera and shutter, at which codes are looked at one after the other.

    Parameters
    ----------
    problem : SearchProblem
        Of a single motion. Its limits count for the verdict alone.

    Attributes
    ----------
    freq_cy_px : (F,) float
        Frequencies of the curves.
    axis : (2,) float
        Unit vector of the main axis.
    along : Trajectory or None
        As :func:`cep.proofs.certify.certificate.certify` takes it.

    Raises
    ------
    ValueError
        If the motion cannot be measured, or is too short for so many chips.

    Examples
    --------
    >>> from motdiff.trajectory import Trajectory
    >>> bench = LiveBench(SearchProblem.along(Trajectory.straight(20.0), chips=8))
    >>> seen = bench.figures(ShutterCode("11100101"))
    >>> f"{seen.curve[0]:.3f} {seen.metrics.min_chip:.3f}"
    '0.625 0.913'
    """

    def __init__(self, problem: SearchProblem) -> None:
        (scenario,) = problem.scenarios
        check_frame(scenario.trajectory)
        check_resolved(scenario.trajectory, problem.chips)
        self.problem = problem
        self.along = None  # what minima are of: the unit circle, for a uniform straight motion
        if not problem.on_circle:
            self.along = scenario.trajectory
        self.freq_cy_px = np.linspace(0, 0.5, _CURVE)
        self.axis = main_axis(scenario.trajectory)
        # what the model's gains lack on photographs, by the kind of exposure
        self._shifts_db = shifts_db(scenario.trajectory, problem.camera)
        # of the latest error of the path
        self._exposures: tuple[float, tuple[Exposure, ...]] | None = None
        self._expected: tuple[float, ExpectedPsnr] | None = None  # of this error
        self._finding = threading.Lock()

    def figures(self, code: ShutterCode) -> LiveFigures:
        """Measure a code; ValueError if it has another number of chips."""
        metrics = with_proven_zero(code, self.along, self.problem.measure(code, budget=_BUDGET))
        modulus = np.abs(coded_sum(self._rows, code.array[None])[0]).astype(np.float64)
        band = modulus[_CURVE:].reshape(MAP_ROWS, MAP_COLUMNS)
        psnr_db = self._shifts_db[kind_of(code)] - metrics.mse_db
        return LiveFigures(metrics, modulus[:_CURVE], band, psnr_db)

    @cached_property
    def _rows(self) -> NDArray[np.complex64]:
        """OTFs of the chips on the curve and the map; photos do without."""
        x, y = np.meshgrid(np.linspace(-0.5, 0.5, MAP_COLUMNS), np.linspace(0, 0.5, MAP_ROWS))
        fx = np.concatenate([self.freq_cy_px * self.axis[0], x.ravel()])
        fy = np.concatenate([self.freq_cy_px * self.axis[1], y.ravel()])
        rows = chip_rows(
            self.problem.scenarios[0].trajectory,
            self.problem.chips,
            fx,
            fy,
            response=self.problem.response,
        )
        return distinct_rows(rows, self.problem.response).astype(np.complex64)

    @cached_property
    def opened(self) -> LiveFigures:
        """The open shutter's."""
        return self.figures(ShutterCode("1" * self.problem.chips))

    def verdict(self, code: ShutterCode, *, path_error_px: float = 0.0) -> Verdict:
        """Judge a code beside the exposures without one.

        The first call for a motion and an error finds and judges these, which takes some
        seconds; later ones judge the code alone.

        Parameters
        ----------
        path_error_px : float
            As of :func:`cep.search.advise.advise`.

        Raises
        ------
        ValueError
            If even the shortest opening saturates at the camera's light, or no exposure keeps the
            limits.
        """
        check_light(self.problem)
        with self._finding:
            if self._exposures is None or self._exposures[0] != path_error_px:
                codes = ExposureFinder(self.problem).ordinary(
                    self.problem.camera, every_length=path_error_px > 0
                )
                self._exposures = path_error_px, self._judged(codes, path_error_px)
            candidates = self._exposures[1]
            if not any(candidate.code.bits == code.bits for candidate in candidates):
                candidates = (*candidates, self._judged([code], path_error_px)[-1])
        return verdict_of(self.problem, candidates, [code], path_error_px=path_error_px)

    def psnr_db(self, codes: Sequence[ShutterCode], *, path_error_px: float = 0.0) -> list[float]:
        """Return the expected PSNR of photos restored along a path known to such an error."""
        with self._finding:
            psnrs = {
                exposure.code.bits: exposure.psnr_db
                for exposure in self._judged(codes, path_error_px)
            }
        return [psnrs[code.bits] for code in codes]

    def forget_otfs(self) -> None:
        """Free the OTFs that verdicts use, tens of MB; the next verdict computes them again."""
        with self._finding:
            self._expected = None

    def _judged(self, codes: Sequence[ShutterCode], path_error_px: float) -> tuple[Exposure, ...]:
        if self._expected is None or self._expected[0] != path_error_px:
            self._expected = None  # before the next one is made
            expected = ExpectedPsnr(
                self.problem, path_error_px=path_error_px, most_bytes=_MOST_BYTES
            )
            self._expected = path_error_px, expected
        problem = self.problem
        expected = self._expected[1]
        (exposures,) = judged_exposures(
            problem, [problem.camera], codes, path_error_px=path_error_px, expected=expected
        )
        return tuple(corrected(exposure, self._shifts_db, 1.0) for exposure in exposures)

    def psf(self, code: ShutterCode) -> FloatArray:
        """Light-true PSF of a code in the smallest odd frame that holds the motion."""
        path = self.problem.scenarios[0].trajectory
        return coded_psf(path, code, size=path.frame_size() | 1, response=self.problem.response)

    def photo(self, code: ShutterCode, scene: LiveScene, *, side_px: int) -> FloatArray:
        """Simulate the photo of the middle of a scene, at most so many px a side."""
        return scene.photo(self.psf(code), self._camera(code), side_px=side_px)

    def restored(self, code: ShutterCode, photo: ArrayLike) -> FloatArray:
        """Restore such a photo by a Wiener filter with its PSF: what a known motion allows."""
        return wiener(
            photo, self.psf(code), camera=self._camera(code), border_rounds=_BORDER_ROUNDS
        )

    def _camera(self, code: ShutterCode) -> Camera:
        return self.problem.camera.with_dark_noise(
            ShutterCode(code.bits, self.problem.chip_ns).integration_ns * 1e-9
        )


class LiveScene:
    """A scene (H, W) or (H, W, 3), linear light, photographed through one code after another.

    Its spectrum and the draws of the noise are kept: a pixel has the same deviates in every photo.
    Photon noise is made of a normal deviate z, as the electrons ``m + z sqrt(m) + (z^2 - 1) / 6``,
    rounded: the mean, variance and skewness are those of the Poisson distribution (Cornish and
    Fisher 1938). Drawing that one takes 15 times as long.
    """

    def __init__(self, light: ArrayLike) -> None:
        pixels = np.asarray(light, dtype=np.float32)
        self._is_grey = pixels.ndim == 2
        layers = np.moveaxis(np.atleast_3d(pixels), 2, 0)
        self.shape = pixels.shape[:2]
        self._spectrum = fft.rfft2(layers)
        rng = np.random.default_rng(0)
        self._photon, self._read = rng.standard_normal((2, *layers.shape), dtype=np.float32)

    def photo(self, psf: FloatArray, camera: Camera, *, side_px: int) -> FloatArray:
        """Return the photo of its middle, at most so many px a side."""
        visible = [_middle(span, side_px) for span in valid_window(self.shape, psf.shape)]
        kernel = fft.rfft2(psf.astype(np.float32), self.shape)
        # lies half a frame further; its wrap is not seen
        blurred = fft.irfft2(self._spectrum * kernel, self.shape)
        below, right = (
            slice(span.start + n // 2, span.stop + n // 2)
            for span, n in zip(visible, psf.shape, strict=True)
        )
        window = (slice(None), *visible)
        full_e = np.float32(camera.noise["photons_full_scale"])
        z = self._photon[window]
        electrons = np.maximum(blurred[:, below, right], 0) * full_e  # FFT leaves values below 0
        electrons += np.sqrt(electrons) * z + (z * z - 1) / 6
        counted = np.maximum(np.rint(electrons), 0)
        light = counted / full_e + camera.noise["read_sigma"] * self._read[window]
        photo = camera.quantise(light)
        if self._is_grey:
            return np.asarray(photo[0])
        return np.ascontiguousarray(np.moveaxis(photo, 0, 2))


def _middle(range_px: slice, most_px: int) -> slice:
    """Middle of a range of pixels, at most so many."""
    size = min(range_px.stop - range_px.start, most_px)
    begin = range_px.start + (range_px.stop - range_px.start - size) // 2
    return slice(begin, begin + size)


def broken_limits(
    problem: SearchProblem, code: ShutterCode, device: DeviceProfile | None = None
) -> tuple[str, ...]:
    """List the limits that a code breaks, one sentence each; none where it can be played.

    Parameters
    ----------
    device : DeviceProfile, optional
        Shutter that plays it; its own sentences come first.

    Examples
    --------
    >>> from motdiff.trajectory import Trajectory
    >>> problem = SearchProblem.along(Trajectory.straight(20.0), chips=8, open_range=(2, 4))
    >>> broken_limits(problem, ShutterCode("11100101"))
    ('5 chips are open; the limit is 2 to 4',)
    """
    reasons: list[str] = []
    if device is not None:
        reasons += device.check(Program(code.bits, chip_ns=problem.chip_ns))
    if reasons or problem.allows(code):
        return tuple(reasons)
    bits = code.array[None].astype(np.int8)
    limits = problem.limits
    low, high = limits.open_range
    for name, words in _BROKEN.items():
        limit: Any = getattr(limits.runs, name, None)
        if name == "open_range":
            single = Limits(limits.chips, limits.open_range)
        else:
            single = Limits(limits.chips, (1, limits.chips), RunLimits(**{name: limit}))
        if not single.satisfied(bits)[0]:
            figures = {"open": code.open_chips, "pulses": code.pulses}
            reasons.append(words.format(**figures, low=low, high=high, limit=limit))
    return tuple(reasons)
