"""The chain of `cep demo`: motion, verdict, exposures, restorations and, where it pays, a code."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

import cep
from cep.optics.path_limits import check_resolved
from cep.proofs.certify.certificate import Certificate
from cep.report.scene import Scene, SceneMotion, find_motion
from cep.restoration.result import Restoration
from cep.restoration.sharpen import LEAST_CONFIDENCE, sharpen
from cep.search.advise import LEVELS, Advice
from cep.search.chip_count import problem_of_standard_chips
from cep.search.exposures import CODED, Choice, Exposure
from motdiff.crops import centre_crop
from motdiff.estimators.base import MotionEstimate
from motdiff.metrics import psnr_up_to_shift
from motdiff.photo_values import luminance
from motdiff.simulate import visible
from motdiff.types import FloatArray

# of the bundled case: its fixed noise is large enough for a code to be the best exposure
STANDARD_CAMERA = "video-8bit"
EXPOSURE_S = 1 / 30  # where none is given
_LARGEST_SCENE_PX = 768  # of a user's photo: TV takes a minute on more
_RESTORATION = "pnp"  # the one that the gains are those of
# shares of the time when each is done
_MOTION_SHARE = 0.6
_ADVICE_SHARE = 0.76
_PHOTOS_SHARE = 0.95


@dataclass(frozen=True)
class Shot:
    """A simulated photo and its restoration.

    Attributes
    ----------
    kind : {"open", "snapshot", "coded"}
    exposure : Exposure
        How it was exposed.
    photo, restored : float ndarrays, linear light
        The restoration is at the brightness of the open exposure.
    psnr_db : float
        Of the restoration, grey, linear light, up to shift.
    """

    kind: str
    exposure: Exposure
    photo: FloatArray
    restored: FloatArray
    psnr_db: float


@dataclass(frozen=True)
class Chain:
    """Results of the demo, for its files and its page.

    Attributes
    ----------
    problem : SearchProblem
        Along the estimated motion; its camera takes the simulated photos.
    advice : Advice
        Over the light.
    reference : float ndarray
        The scene at rest, as large as the photos.
    shots : tuple of Shot
        Open shutter first, then the best single exposure and the best code, where the limits leave
        them.
    certificate : Certificate
        Smallest MTF of the exposure advised, along the motion as estimated.
    sharpened : Restoration or None
        A user's own photo, restored from itself or kept; None of the bundled one.
    """

    scene: Scene
    seed: int
    motion: SceneMotion
    problem: cep.SearchProblem
    device: cep.DeviceProfile | None
    advice: Advice
    reference: FloatArray
    shots: tuple[Shot, ...]
    certificate: Certificate
    sharpened: Restoration | None = None

    @property
    def verdict(self) -> str:
        """What to do; of a user's photo how far its motion and its own scene bear that out."""
        sentences = [self.advice.here.sentence]
        if self.scene.sharp is None:
            gain_db = self.gains_db()[_kind(self.choice)]
            if self.choice != "open":
                sentences.append(
                    f"On the scene assumed from this photo the simulation shows {gain_db:+.1f} dB"
                    " over the open shutter."
                )
            if self.estimate.confidence < LEAST_CONFIDENCE:
                sentences.insert(
                    0,
                    "The motion of this photo was probably not found (confidence"
                    f" {self.estimate.confidence:.2f}), so take this as an example at most.",
                )
        return " ".join(sentences)

    @property
    def estimate(self) -> MotionEstimate:
        """The motion that the exposure is chosen for and the photos are restored along."""
        return self.motion.estimate

    @property
    def choice(self) -> Choice:
        """Kind of exposure that is advised."""
        return self.advice.choice

    @property
    def coded(self) -> bool:
        """Whether the shutter is to open more than once."""
        return self.choice in CODED

    @property
    def code(self) -> cep.ShutterCode | None:
        """The code, where one is advised."""
        return self.advised_shot.exposure.code if self.coded else None

    @property
    def advised_shot(self) -> Shot:
        """The photo taken as advised."""
        return self.shot(_kind(self.choice))

    def shot(self, kind: str) -> Shot:
        """Return the photo of a kind that there is."""
        return next(shot for shot in self.shots if shot.kind == kind)

    def gains_db(self) -> dict[str, float]:
        """Return the simulated gain of each restored photo over that of the open shutter, dB."""
        return {shot.kind: shot.psnr_db - self.shots[0].psnr_db for shot in self.shots}


def run_chain(
    scene: Scene,
    camera: cep.Camera,
    *,
    exposure_s: float = EXPOSURE_S,
    device: cep.DeviceProfile | None = None,
    chips: int | None = None,
    seed: int = 0,
    motion: SceneMotion | None = None,
    levels: Sequence[float] = LEVELS,
    progress: Callable[[float, str], None] = lambda _share, _note: None,
) -> Chain:
    """Run the chain.

    ValueError if the photo shows no motion, or the exposure cannot be divided so on the device.

    Parameters
    ----------
    device : DeviceProfile, optional
        Shutter that must be able to play the code; without it any code can be played.
    chips : int, optional
        When omitted as of :func:`cep.search.chip_count.problem_of_standard_chips`.
    motion : SceneMotion, optional
        By :func:`find_motion` when omitted.
    levels : sequence of float
        Photo-electrons at full scale at which the ways to expose are compared, besides the
        camera's.
    progress : callable, optional
        Called with the finished share, 0..1, and the current step.
    """
    progress(0.0, "estimating the motion")
    if motion is None:
        motion = find_motion(
            scene,
            camera,
            exposure_s=exposure_s,
            device=device,
            seed=seed,
            progress=lambda share, note: progress(_MOTION_SHARE * share, note),
        )
    estimate = motion.estimate
    progress(_MOTION_SHARE, "comparing exposures")
    problem = _problem(estimate, camera, exposure_s, device, chips)
    advice = cep.advise(
        problem,
        levels=levels,
        path_error_px=estimate.path_error_px or 0.0,
        seed=seed,
        progress=lambda share, note: progress(
            _MOTION_SHARE + (_ADVICE_SHARE - _MOTION_SHARE) * share, note
        ),
    )
    progress(_ADVICE_SHARE, "exposing and restoring")
    reference, shots = _shots(scene, estimate, camera, _exposures(advice), seed)
    sharpened = None
    if scene.sharp is None:
        progress(_PHOTOS_SHARE, "sharpening the photo")
        sharpened = sharpen(scene.photo, estimate)
    progress(1.0, "done")
    certificate = cep.certify(advice.here.advised.code, estimate.best)
    return Chain(
        scene, seed, motion, problem, device, advice, reference, shots, certificate, sharpened
    )


def _problem(
    estimate: MotionEstimate,
    camera: cep.Camera,
    exposure_s: float,
    device: cep.DeviceProfile | None,
    chips: int | None,
) -> cep.SearchProblem:
    """Make the problem along a motion, of the standard number of chips where that is open."""

    def problem_of(count: int) -> cep.SearchProblem:
        length_s = exposure_s
        chip_us = round(1e6 * exposure_s / count)
        if device is None and chip_us > 0:  # a clock of whole us, which most controllers can play
            length_s = 1e-6 * chip_us * count
        return cep.SearchProblem.along(
            estimate,
            chips=count,
            objective="mse",
            camera=camera,
            device=device,
            exposure_s=length_s,
        )

    if chips is None:
        return problem_of_standard_chips(problem_of)
    check_resolved(estimate.best, chips)
    return problem_of(chips)


def _exposures(advice: Advice) -> dict[str, Exposure]:
    """Return the open shutter, then the best single exposure and code that the limits leave."""
    candidates = {
        "open": advice.here.open_shutter,
        "snapshot": advice.here.best("snapshot"),
        "coded": advice.here.best("code"),
    }
    if advice.choice in CODED:  # even pulses, where no code is better
        candidates["coded"] = advice.here.advised
    return {kind: exposure for kind, exposure in candidates.items() if exposure is not None}


def _shots(
    scene: Scene,
    estimate: MotionEstimate,
    camera: cep.Camera,
    exposures: Mapping[str, Exposure],
    seed: int,
) -> tuple[FloatArray, tuple[Shot, ...]]:
    """Return the scene at rest, and a photo taken each way, all restored in the same way."""
    path = estimate.best
    sharp = scene.sharp
    motion = scene.motion
    if sharp is None or motion is None:
        # of a user's photo neither is known: its restoration and the estimate stand in
        crop = centre_crop(scene.photo, _LARGEST_SCENE_PX, _LARGEST_SCENE_PX)
        sharp = np.clip(cep.restore(crop, estimate.psf, method="tv").image, 0, 1)
        motion = path
    frame = motion.frame_size() | 1  # odd: its middle pixel is no displacement
    reference = visible(sharp, frame)
    rng = np.random.default_rng([seed, 3])  # the motion's photos draw from 4
    cameras = {
        kind: camera.with_dark_noise(exposure.code.integration_ns * 1e-9)
        for kind, exposure in exposures.items()
    }
    photos = {
        kind: cep.capture(
            sharp, cep.coded_psf(motion, exposure.code, frame), camera=cameras[kind], rng=rng
        )
        for kind, exposure in exposures.items()
    }
    if scene.sharp is not None:
        photos["open"] = scene.photo

    def restore(kind: str, along: cep.Trajectory) -> Restoration:
        return cep.restore(
            photos[kind],
            trajectory=along,
            code=None if kind == "open" else exposures[kind].code,
            method=_RESTORATION,
            camera=cameras[kind],
        )

    restorations = {kind: restore(kind, path) for kind in exposures if kind != "snapshot"}
    if "snapshot" in exposures:
        # either direction restores it as well, but one of them shifted: the open photo shows which
        paths = [path]
        if path.direction == "unknown":
            paths = [replace(along, direction="known") for along in (path, path.reversed())]
        restorations["snapshot"] = min(
            (restore("snapshot", along) for along in paths),
            key=lambda image: float(np.mean((image.image - restorations["open"].image) ** 2)),
        )
    # all are compared where the least reliable of them is good, but on half the picture
    border = max(restoration.unreliable_px for restoration in restorations.values()) + 2
    border = min(border, min(reference.shape[:2]) // 4)
    # compared up to a shift: where a path lies is a convention, no error of the picture
    grey = _grey(reference)
    return reference, tuple(
        Shot(
            kind,
            exposure,
            photos[kind],
            restorations[kind].image,
            psnr_up_to_shift(
                _grey(restorations[kind].image), grey, max_shift_px=3.0, crop_px=border
            ),
        )
        for kind, exposure in exposures.items()
    )


def _kind(choice: Choice) -> str:
    """Kind of the shot that is taken by such a choice."""
    return "coded" if choice in CODED else choice


def _grey(image: FloatArray) -> FloatArray:
    return np.clip(luminance(image), 0, 1)
