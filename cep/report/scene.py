"""Scene of the demo, its photos, and the motion estimated from them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import cep
from cep.calibration.order_codes import gray_planes
from hw.program import Program
from motdiff.crops import centre_crop, pick_crops
from motdiff.estimators.base import MotionEstimate
from motdiff.motions import quadratic
from motdiff.photo_values import to_linear
from motdiff.types import FloatArray

# a hand accelerates over a short exposure: a bent path that is slower at one end
_LENGTH_PX = (24.0, 28.0)
_BEND = 1.5
# crop that the photos of a set are searched on: larger ones take longer and are little better
_SET_PX = 192
_PLANES = 3  # photos of a set through a Gray code, beside the one with an open shutter


@dataclass(frozen=True)
class Scene:
    """Scene of the demo.

    Attributes
    ----------
    name : str
        What the photo shows, and where it comes from.
    photo : (H, W) or (H, W, 3) float
        The blurred calibration photo, linear light 0..1.
    sharp : float ndarray, optional
        The scene without blur, wider than the photo; unknown for a user's photo.
    motion : Trajectory, optional
        The motion that blurred it; unknown for a user's photo.
    """

    name: str
    photo: FloatArray
    sharp: FloatArray | None = None
    motion: cep.Trajectory | None = None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class SceneMotion:
    """The motion of a scene, and the photos that it was estimated from.

    Attributes
    ----------
    codes : tuple of ShutterCode
        Of the photos, the open shutter first; empty where there is that photo only.
    photos : tuple of float ndarrays, linear light
        One for each code.
    """

    estimate: MotionEstimate
    codes: tuple[cep.ShutterCode, ...] = ()
    photos: tuple[FloatArray, ...] = ()


def bundled_picture() -> FloatArray:
    """Return the public-domain picture of scikit-image, (512, 512, 3) linear light 0..1."""
    from skimage import data

    return to_linear(data.astronaut() / 255)


def bundled_scene(
    camera: cep.Camera, *, rng: np.random.Generator, side_px: int | None = None
) -> Scene:
    """Take a photo of the bundled picture, or of its middle ``side_px``, with a shaking hand."""
    sharp = bundled_picture()
    if side_px is not None:
        sharp = centre_crop(sharp, side_px, side_px)
    shortest_px, longest_px = _LENGTH_PX
    motion = quadratic(rng, min_length_px=shortest_px, max_length_px=longest_px, max_bend=_BEND)
    photo = cep.capture(sharp, motion.psf(motion.frame_size() | 1), camera=camera, rng=rng)
    name = (
        "Astronaut Eileen Collins (NASA, public domain; skimage.data.astronaut), blurred by a"
        " simulated hand shake"
    )
    return Scene(name, photo, sharp, motion)


def find_motion(
    scene: Scene,
    camera: cep.Camera,
    *,
    exposure_s: float,
    device: cep.DeviceProfile | None = None,
    seed: int = 0,
    progress: Callable[[float, str], None] = lambda _share, _note: None,
) -> SceneMotion:
    """Estimate a scene's motion, from photos through known codes where they can be simulated.

    A user's photo has no others, and neither has a device that cannot play the codes.
    """
    codes = _calibration_codes(exposure_s, device)
    if scene.sharp is None or scene.motion is None or not codes:
        try:
            return SceneMotion(cep.estimate_motion(scene.photo, progress=progress))
        except ValueError as error:
            raise ValueError(f"{scene.name}: {error}") from None
    frame = scene.motion.frame_size() | 1
    rng = np.random.default_rng([seed, 4])  # not the draws of the chain's photos, from 3
    photos = [scene.photo]
    for code in codes[1:]:
        psf = cep.coded_psf(scene.motion, code, frame)
        photos.append(cep.capture(scene.sharp, psf, camera=camera, rng=rng))
    row, column = pick_crops(scene.photo, size=_SET_PX, count=1)[0]
    estimate = cep.estimate_motion(
        # the same crop of each: a set is of one scene
        [photo[row : row + _SET_PX, column : column + _SET_PX] for photo in photos],
        codes=codes,
        seed=seed,
        progress=progress,
    )
    return SceneMotion(estimate, codes, tuple(photos))


def _calibration_codes(
    exposure_s: float, device: cep.DeviceProfile | None
) -> tuple[cep.ShutterCode, ...]:
    """Open shutter and bit planes of a Gray code; none where the device cannot play them."""
    bins = 2**_PLANES
    chip_ns = max(1, round(exposure_s / bins * 1e9))
    planes = [cep.ShutterCode(plane, chip_ns) for plane in gray_planes(_PLANES, bins)]
    if device is not None:
        programs = [Program(plane.bits, chip_ns=chip_ns) for plane in planes]
        if any(device.check(program) for program in programs):
            return ()
    return (cep.ShutterCode(np.ones(bins), chip_ns), *planes)
