"""The chain itself: one blurred photo in, motion, code, shutter program, coded photo and restorations out."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cep.optics.camera import LIGHT_LEVELS, Camera
from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.optics.path_limits import check_resolved
from cep.proofs.measure import CodeMetrics
from cep.restoration import restore
from cep.restoration.direction import DirectionResult, detect_direction
from cep.search.expected import expected_psnr_db, light_noise
from cep.search.problem import SearchProblem, open_range_of_duty
from cep.search.recipe import Found
from cep.workflows.calibrate import estimate_motion
from cep.workflows.compare import BaselineRow, compare
from cep.workflows.optimize import Search, search
from motdiff.crops import luminance
from motdiff.estimators.base import Estimator, MotionEstimate
from motdiff.metrics import psnr_up_to_shift
from motdiff.motions import quadratic
from motdiff.simulate import to_linear, visible
from motdiff.trajectory import Trajectory

__all__ = ["Chain", "Scene", "Shot", "bundled_scene", "own_photo", "run_chain"]


FloatArray = NDArray[np.float64]

_DUTY = (0.35, 0.75)
_MOST_CHIPS = 64
_STEPS = 400_000  # as in the benchmark's protocols
_SEARCH_S = 30.0
_LARGEST_SCENE_PX = 768
_RESTORATION = "wiener"
_CHIP_NS = 1_000_000
_BLIND_SHARE = 0.5  # of the chain's time, as are the others' below
_RESTORED = (0.64, 0.98)


@dataclass(frozen=True)
class Shot:
    """A simulated photo and its restoration.

    Attributes
    ----------
    name : str
    code : ShutterCode
        All open, for the photo that a camera takes anyway.
    photo, restored : float ndarrays, linear light
    psnr_db : float
        Of the restoration, grey, linear light, up to shift.
    """

    name: str
    code: ShutterCode
    photo: FloatArray
    restored: FloatArray
    psnr_db: float


@dataclass(frozen=True)
class Chain:
    """Everything that the demo found, for its files and its report; the first row of ``compared`` is the code's."""

    scene: Scene
    camera: Camera
    seed: int
    estimate: MotionEstimate
    search: Found
    problem: SearchProblem
    code: ShutterCode
    compared: tuple[BaselineRow, ...]
    direction: DirectionResult
    reference: FloatArray
    shots: tuple[Shot, ...]
    expected_db: tuple[tuple[str, tuple[float, ...]], ...]
    seconds: tuple[tuple[str, float], ...]

    @property
    def metrics(self) -> CodeMetrics:
        """Figures of the code."""
        return self.compared[0].metrics

    @property
    def motion(self) -> Trajectory:
        """The most likely motion, as estimated."""
        return self.estimate.trajectories[0]


def run_chain(
    scene: Scene,
    camera: Camera,
    *,
    seed: int = 0,
    estimator: Estimator | None = None,
    chips: int | None = None,
    steps: int = _STEPS,
    tell: Callable[[float, str], None] = lambda _fraction, _what: None,
) -> Chain:
    """Run the chain.

    Parameters
    ----------
    scene : Scene
    camera : Camera
        Takes the simulated photos, and is what the code is designed for.
    seed : int
    estimator : Estimator, optional
        The blind one when omitted.
    chips : int, optional
        One for each px of the path when omitted, at most 64.
    steps : int
        Moves of the search.
    tell : callable
        Called with the fraction done and what is being done.

    Raises
    ------
    ValueError
        If the photo shows nothing to estimate a motion from.
    """
    clock = _Clock(tell)
    clock.begin(0.0, "estimating the motion")
    estimate = estimate_motion(
        scene.photo,
        method=estimator or "motdiff",
        progress=lambda share, what: tell(_BLIND_SHARE * share, what),
    )
    motion = estimate.best

    clock.begin(_BLIND_SHARE, "searching the code")
    count = chips or int(np.clip(round(motion.length_px), 8, _MOST_CHIPS))
    check_resolved(motion, count)
    problem = SearchProblem.along(
        motion, chips=count, objective="mse", camera=camera, open_range=open_range_of_duty(count, *_DUTY)
    )
    found = search(problem, Search(steps=steps, time_s=_SEARCH_S, seed=seed))
    code = replace(found.code, chip_ns=_CHIP_NS)
    clock.begin(0.6, "comparing")
    compared = compare(problem, code, baselines=found.baselines)

    clock.begin(0.62, "exposing the coded photo")
    open_shutter = ShutterCode("1" * count, _CHIP_NS)
    sharp, truth = _sharp_scene(scene, estimate)
    frame = max(truth.frame_size(), motion.frame_size(), motion.reversed().frame_size()) | 1
    rng = np.random.default_rng([seed, 3])
    codes = {"open shutter": open_shutter, "coded": code}
    photos = {name: capture(sharp, coded_psf(truth, one, frame), camera=camera, rng=rng) for name, one in codes.items()}

    clock.begin(_RESTORED[0], "restoring")
    direction = detect_direction(photos["coded"], motion, code, size=frame)
    reference = visible(sharp, frame)
    kernels = {"open shutter": motion.psf(frame), "coded": direction.psf}
    wanted = [(name, codes[name], photos[name], kernels[name]) for name in codes]
    if scene.motion is not None:  # what a perfect estimate would have given
        wanted += [
            (f"{name}, true motion", one, photos[name], coded_psf(truth, one, frame)) for name, one in codes.items()
        ]
    shots = []
    for shot in wanted:
        shots.append(_shot(*shot, camera, reference))
        tell(_RESTORED[0] + (_RESTORED[1] - _RESTORED[0]) * len(shots) / len(wanted), "restoring")

    clock.begin(_RESTORED[1], "judging")
    noise = [light_noise(replace(camera, photons_full_scale=level), count) for level in LIGHT_LEVELS]
    table = expected_psnr_db(problem, [row.code for row in compared], noise=noise)
    expected = tuple((row.name, tuple(values)) for row, values in zip(compared, table.tolist(), strict=True))
    clock.begin(1.0, "done")
    return Chain(
        scene, camera, seed, estimate, found, problem, code, compared, direction, reference, tuple(shots),
        expected, clock.laps,
    )  # fmt: skip


def _sharp_scene(scene: Scene, estimate: MotionEstimate) -> tuple[FloatArray, Trajectory]:
    """Return the scene that the simulated photos show and the motion they see.

    Of one's own photo neither is known: its restoration and the estimate stand in for them.
    """
    if scene.sharp is not None and scene.motion is not None:
        return scene.sharp, scene.motion
    height, width = (min(side, _LARGEST_SCENE_PX) for side in scene.photo.shape[:2])
    top, left = (scene.photo.shape[0] - height) // 2, (scene.photo.shape[1] - width) // 2
    part = scene.photo[top : top + height, left : left + width]
    restored = restore(part, estimate.psf, method="tv").image
    return np.clip(restored, 0, 1), estimate.trajectories[0]


def _shot(
    name: str, code: ShutterCode, photo: FloatArray, kernel: FloatArray, camera: Camera, reference: FloatArray
) -> Shot:
    restored = restore(photo, kernel, method=_RESTORATION, camera=camera)
    crop = min(restored.unreliable_px + 2, min(photo.shape[:2]) // 4)
    psnr = psnr_up_to_shift(_grey(restored.image), _grey(reference), max_shift_px=3.0, crop_px=crop)
    return Shot(name, code, photo, restored.image, psnr)


def _grey(image: FloatArray) -> FloatArray:
    return np.clip(luminance(image), 0, 1)


class _Clock:
    """Notes how long each step took."""

    def __init__(self, tell: Callable[[float, str], None]) -> None:
        self._tell = tell
        self._begun: tuple[str, float] | None = None
        self.laps: tuple[tuple[str, float], ...] = ()

    def begin(self, fraction: float, what: str) -> None:
        now = time.perf_counter()
        if self._begun is not None:
            self.laps += ((self._begun[0], now - self._begun[1]),)
        self._begun = (what, now)
        self._tell(fraction, what)


_LENGTH_PX = (24.0, 28.0)
_BEND = 1.5


@dataclass(frozen=True)
class Scene:
    """Where the demo starts.

    Attributes
    ----------
    name : str
        What the photo shows, and where it comes from.
    photo : (H, W) or (H, W, 3) float
        The blurred calibration photo, linear light 0..1.
    sharp : float ndarray, optional
        The scene without blur, wider than the photo; unknown for one's own photo.
    motion : Trajectory, optional
        The motion that blurred it; unknown for one's own photo.
    warnings : tuple of str
    """

    name: str
    photo: FloatArray
    sharp: FloatArray | None = None
    motion: Trajectory | None = None
    warnings: tuple[str, ...] = ()


def bundled_scene(camera: Camera, *, rng: np.random.Generator) -> Scene:
    """Take a photo of a public-domain picture that scikit-image carries, with a shaking hand.

    Parameters
    ----------
    camera : Camera
    rng : numpy Generator
    """
    from skimage import data

    sharp = to_linear(data.astronaut() / 255)
    # a hand accelerates over a short exposure: a bent path that is slower at one end
    motion = quadratic(rng, min_length_px=_LENGTH_PX[0], max_length_px=_LENGTH_PX[1], max_bend=_BEND)
    photo = capture(sharp, motion.psf(motion.frame_size() | 1), camera=camera, rng=rng)
    name = "Astronaut Eileen Collins (NASA, public domain; skimage.data.astronaut), blurred by a simulated hand shake"
    return Scene(name, photo, sharp, motion)


def own_photo(name: str, photo: FloatArray, *, warnings: tuple[str, ...] = ()) -> Scene:
    """Start from a blurred photo (H, W) or (H, W, 3), linear light 0..1, whose motion nobody knows."""
    return Scene(name, photo, warnings=warnings)
