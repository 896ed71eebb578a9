"""The chain itself: photos of a motion in, verdict, exposures, restorations and, where it pays, a
code out.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cep.optics.camera import LIGHT_LEVELS, Camera
from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.optics.path_limits import check_resolved
from cep.proofs.certify.certificate import Certificate, certify
from cep.report.demo_scene import FoundMotion, Scene, find_motion
from cep.restoration.methods import Restoration, restore
from cep.search.advise import LEVELS, Advice, advise
from cep.search.chip_count import suited_chips
from cep.search.problem import SearchProblem
from cep.search.ways import Choice, Way
from hw.device import DeviceProfile
from motdiff.crops import luminance
from motdiff.estimators.base import MotionEstimate
from motdiff.metrics import psnr_up_to_shift
from motdiff.simulate import visible
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

STANDARD_CAMERA = "video-8bit"
"""Profile of the bundled case: its fixed noise is large enough for a code to be the best
exposure."""
CONTRAST = "sony-imx250"
"""Profile that a code is compared on as well: a modern sensor whose fixed noise is small."""
EXPOSURE_S = 1 / 30
"""Length of the exposure where none is given."""

_MOST_CHIPS = 64
_LARGEST_SCENE_PX = 768
_RESTORATION = "wiener"
_FOUND = 0.68  # shares of the time when each is done
_ADVISED = 0.82
_RESTORED = 0.95


@dataclass(frozen=True)
class Shot:
    """A simulated photo and its restoration.

    Attributes
    ----------
    kind : {"open", "snapshot", "coded"}
    way : Way
        How it was exposed.
    photo, restored : float ndarrays, linear light
        The restoration is at the brightness of the open exposure.
    psnr_db : float
        Of the restoration, grey, linear light, up to shift.
    known_psnr_db : float or None
        The same where the true motion is known exactly; None where it is not known.
    """

    kind: str
    way: Way
    photo: FloatArray
    restored: FloatArray
    psnr_db: float
    known_psnr_db: float | None = None


@dataclass(frozen=True)
class Chain:
    """Everything that the demo found, for its files and its report.

    Attributes
    ----------
    scene : Scene
    camera : Camera
        Takes the simulated photos, and is what the exposure is chosen for.
    exposure_s : float
    device : DeviceProfile or None
    seed : int
    found : FoundMotion
    problem : SearchProblem
        Along the motion found.
    advice : Advice
        For this camera, over the light.
    contrast : Advice or None
        For :data:`CONTRAST`, where this camera's exposure is coded.
    alone : Shot or None
        What is advised along the motion that the open photo alone shows, taken and restored so.
    certificates : tuple of (str, Certificate)
        Smallest MTF of each shot's exposure, along the motion as estimated.
    reference : float ndarray
        The scene at rest, as large as the photos.
    shots : tuple of Shot
        Open shutter first, then the best single exposure and the best code, where the limits leave
        them.
    seconds : tuple of (str, float)
    """

    scene: Scene
    camera: Camera
    exposure_s: float
    device: DeviceProfile | None
    seed: int
    found: FoundMotion
    problem: SearchProblem
    advice: Advice
    contrast: Advice | None
    alone: Shot | None
    certificates: tuple[tuple[str, Certificate], ...]
    reference: FloatArray
    shots: tuple[Shot, ...]
    seconds: tuple[tuple[str, float], ...]

    @property
    def choice(self) -> Choice:
        """Kind of exposure that is advised."""
        return self.advice.choice

    @property
    def coded(self) -> bool:
        """Whether the shutter is to open more than once."""
        return self.choice in ("strobe", "code")

    @property
    def code(self) -> ShutterCode | None:
        """The code, where one is advised."""
        return self.advice.here.advised.code if self.coded else None

    @property
    def estimate(self) -> MotionEstimate:
        """The motion that the exposure is chosen for, and the photos are restored along."""
        return self.found.estimate

    @property
    def advised_shot(self) -> Shot:
        """The photo taken as advised."""
        kind = "coded" if self.coded else self.choice
        return next(shot for shot in self.shots if shot.kind == kind)

    def shot(self, kind: str) -> Shot | None:
        """Return the photo of a kind; None where there is none."""
        return next((shot for shot in self.shots if shot.kind == kind), None)

    def gains_db(self, *, known: bool = False) -> dict[str, float]:
        """Return the simulated gain of the restored photo of each kind over the open shutter, dB.

        Parameters
        ----------
        known : bool
            Restored along the true motion; empty where that is not known.
        """
        figures = {shot.kind: shot.known_psnr_db if known else shot.psnr_db for shot in self.shots}
        opened = figures["open"]
        return {
            kind: psnr - opened
            for kind, psnr in figures.items()
            if psnr is not None and opened is not None
        }


def run_chain(
    scene: Scene,
    camera: Camera,
    *,
    exposure_s: float = EXPOSURE_S,
    device: DeviceProfile | None = None,
    chips: int | None = None,
    seed: int = 0,
    found: FoundMotion | None = None,
    levels: Sequence[float] = LEVELS,
    tell: Callable[[float, str], None] = lambda _fraction, _what: None,
) -> Chain:
    """Run the chain.

    Parameters
    ----------
    scene : Scene
    camera : Camera
    exposure_s : float
        Length of the exposure.
    device : DeviceProfile, optional
        Shutter that must be able to play the code; any other limit there is not.
    chips : int, optional
        When omitted one for each px of the path, at most 64; with a device as many as pay.
    seed : int
    found : FoundMotion, optional
        By :func:`find_motion` when omitted.
    levels : sequence of float
        Photo-electrons at full scale at which the ways to expose are compared, besides the
        camera's own.
    tell : callable
        Called with the fraction done and what is being done.

    Raises
    ------
    ValueError
        If the photo shows nothing to estimate a motion from, or the exposure cannot be divided so
        on the device.
    """
    clock = _Clock(tell)
    clock.begin(0.0, "estimating the motion")
    if found is None:
        found = find_motion(
            scene,
            camera,
            exposure_s=exposure_s,
            device=device,
            seed=seed,
            tell=lambda share, what: tell(_FOUND * share, what),
        )
    estimate = found.estimate

    def problem_along(one: MotionEstimate, count: int | None) -> SearchProblem:
        return _problem(one, camera, exposure_s=exposure_s, device=device, chips=count, seed=seed)

    clock.begin(_FOUND, "comparing exposures")
    problem = problem_along(estimate, chips)
    error_px = estimate.path_error_px or 0.0
    advice = advise(
        problem,
        levels=levels,
        path_error_px=error_px,
        seed=seed,
        progress=lambda share, what: tell(_FOUND + 0.8 * (_ADVISED - _FOUND) * share, what),
    )
    contrast = None
    if advice.choice in ("strobe", "code"):
        other = replace(problem, camera=Camera.load(CONTRAST))
        contrast = advise(other, levels=LIGHT_LEVELS, path_error_px=error_px, seed=seed)
    certificates = tuple(
        (kind, certify(way.code, estimate.best))
        for kind, way in _ways(advice).items()
        if kind != "coded" or contrast
    )

    clock.begin(_ADVISED, "exposing")
    sharp, truth = _sharp_scene(scene, estimate)
    frame = truth.frame_size() | 1
    rng = np.random.default_rng([seed, 3])

    def photographed(ways: dict[str, Way]) -> dict[str, FloatArray]:
        taken = {
            kind: capture(
                sharp,
                coded_psf(truth, way.code, frame),
                camera=_with_dark_noise(camera, way),
                rng=rng,
            )
            for kind, way in ways.items()
        }
        return taken if scene.sharp is None else {**taken, "open": scene.photo}

    clock.begin(_RESTORED, "restoring")
    reference = visible(sharp, frame)
    known = None if scene.motion is None else replace(scene.motion, direction="known")
    ways = _ways(advice)
    shots = _shots(ways, photographed(ways), estimate.best, known, camera, reference)
    alone = None
    if found.alone is not None:
        here = advise(problem_along(found.alone, problem.chips), levels=(), seed=seed).here
        kind = "coded" if here.choice in ("strobe", "code") else here.choice
        ways = {"open": here.ways[0], kind: here.advised}
        taken = _shots(ways, photographed(ways), found.alone.best, None, camera, reference)
        alone = next(shot for shot in taken if shot.kind == kind)
    clock.begin(1.0, "done")
    return Chain(
        scene,
        camera,
        exposure_s,
        device,
        seed,
        found,
        problem,
        advice,
        contrast,
        alone,
        certificates,
        reference,
        shots,
        clock.laps,
    )


def _problem(
    estimate: MotionEstimate,
    camera: Camera,
    *,
    exposure_s: float,
    device: DeviceProfile | None,
    chips: int | None,
    seed: int,
) -> SearchProblem:
    def of(count: int) -> SearchProblem:
        # a clock that most controllers can play; a device has its own
        chip_us = round(1e6 * exposure_s / count)
        length = (
            {"exposure_s": exposure_s}
            if device is not None or chip_us == 0
            else {"chip_ns": 1000 * chip_us}
        )
        return SearchProblem.along(
            estimate, chips=count, objective="mse", camera=camera, device=device, **length
        )

    if chips is None:
        if device is None:
            chips = int(np.clip(round(estimate.best.length_px), 8, _MOST_CHIPS))
        else:
            chips, _ = suited_chips(of, seed=seed)
    check_resolved(estimate.best, chips)
    return of(chips)


def _ways(advice: Advice) -> dict[str, Way]:
    """Ways to expose that are photographed: the open shutter, the best single exposure, the best
    code.
    """
    here = advice.here
    coded = here.advised if advice.choice in ("strobe", "code") else here.best("code")
    ways = {"open": here.ways[0], "snapshot": here.best("snapshot"), "coded": coded}
    return {kind: way for kind, way in ways.items() if way is not None}


def _sharp_scene(scene: Scene, estimate: MotionEstimate) -> tuple[FloatArray, Trajectory]:
    """Return the scene that the simulated photos show and the motion they see.

    Of one's own photo neither is known: its restoration and the estimate stand in for them.
    """
    if scene.sharp is not None and scene.motion is not None:
        return scene.sharp, scene.motion
    height, width = (min(side, _LARGEST_SCENE_PX) for side in scene.photo.shape[:2])
    top = (scene.photo.shape[0] - height) // 2
    left = (scene.photo.shape[1] - width) // 2
    part = scene.photo[top : top + height, left : left + width]
    restored = restore(part, estimate.psf, method="tv").image
    return np.clip(restored, 0, 1), estimate.best


def _shots(
    ways: dict[str, Way],
    photos: dict[str, FloatArray],
    motion: Trajectory,
    known: Trajectory | None,
    camera: Camera,
    reference: FloatArray,
) -> tuple[Shot, ...]:
    """Restore every photo in the same way, and judge all of them on the same part of the
    picture.
    """

    def restored(kind: str, path: Trajectory) -> Restoration:
        code = None if kind == "open" else ways[kind].code
        return restore(
            photos[kind],
            trajectory=path,
            code=code,
            method=_RESTORATION,
            camera=_with_dark_noise(camera, ways[kind]),
        )

    found = {"open": restored("open", motion)}
    for kind in list(ways)[1:]:
        if kind == "snapshot" and motion.direction == "unknown":
            # either direction restores it as well, but one of them shifted: the other photo shows
            # which
            turned = [replace(path, direction="known") for path in (motion, motion.reversed())]
            both = [restored(kind, path) for path in turned]
            found[kind] = min(
                both, key=lambda one: float(np.mean((one.image - found["open"].image) ** 2))
            )
        else:
            found[kind] = restored(kind, motion)
    ideal = {} if known is None else {kind: restored(kind, known) for kind in ways}
    reach = max(one.unreliable_px for one in (*found.values(), *ideal.values())) + 2
    crop = min(reach, min(reference.shape[:2]) // 4)
    scene = _grey(reference)

    def psnr_db(one: Restoration) -> float:
        return psnr_up_to_shift(_grey(one.image), scene, max_shift_px=3.0, crop_px=crop)

    return tuple(
        Shot(
            kind,
            way,
            photos[kind],
            found[kind].image,
            psnr_db(found[kind]),
            psnr_db(ideal[kind]) if kind in ideal else None,
        )
        for kind, way in ways.items()
    )


def _with_dark_noise(camera: Camera, way: Way) -> Camera:
    return camera.with_dark_noise(way.code.integration_ns * 1e-9)


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
