"""What the demo starts from: a scene in motion, its photos, and what they tell of the motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cep.calibration.calibrate import estimate_motion
from cep.calibration.order_codes import gray_planes
from cep.optics.camera import Camera
from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from hw.device import DeviceProfile
from hw.program import Program
from motdiff.crops import pick_crops
from motdiff.estimators.base import MotionEstimate
from motdiff.motions import quadratic
from motdiff.simulate import to_linear
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

_LENGTH_PX = (24.0, 28.0)
_BEND = 1.5
# crop that the photos of a set are searched on: larger ones take longer and are little better
_SET_PX = 192
_PLANES = 3  # photos of a set through a Gray code, beside the one with an open shutter
_SET_SHARE = 0.65  # of the time: the open photo alone takes the rest


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


@dataclass(frozen=True)
class FoundMotion:
    """What photos tell of a scene's motion.

    Attributes
    ----------
    estimate : MotionEstimate
        From all photos.
    codes : tuple of ShutterCode
        Through which they were taken, the open shutter first; empty where there is that photo
        only.
    photos : tuple of float ndarrays, linear light
        One for each code.
    alone : MotionEstimate or None
        From the photo with the open shutter alone, where there are others.
    """

    estimate: MotionEstimate
    codes: tuple[ShutterCode, ...] = ()
    photos: tuple[FloatArray, ...] = ()
    alone: MotionEstimate | None = None


def bundled_picture() -> FloatArray:
    """Return the public-domain picture that scikit-image carries, (512, 512, 3) linear light
    0..1.
    """
    from skimage import data

    return to_linear(data.astronaut() / 255)


def bundled_scene(
    camera: Camera, *, rng: np.random.Generator, side_px: int | None = None
) -> Scene:
    """Take a photo of a public-domain picture that scikit-image carries, with a shaking hand.

    Parameters
    ----------
    camera : Camera
    rng : numpy Generator
    side_px : int, optional
        Side of the part around the middle of the picture; all of it when omitted.
    """
    sharp = bundled_picture()
    if side_px is not None:
        corner = (len(sharp) - side_px) // 2
        sharp = sharp[corner : corner + side_px, corner : corner + side_px]
    # a hand accelerates over a short exposure: a bent path that is slower at one end
    motion = quadratic(
        rng, min_length_px=_LENGTH_PX[0], max_length_px=_LENGTH_PX[1], max_bend=_BEND
    )
    photo = capture(sharp, motion.psf(motion.frame_size() | 1), camera=camera, rng=rng)
    name = (
        "Astronaut Eileen Collins (NASA, public domain; skimage.data.astronaut), blurred by a"
        " simulated hand shake"
    )
    return Scene(name, photo, sharp, motion)


def own_photo(name: str, photo: FloatArray, *, warnings: tuple[str, ...] = ()) -> Scene:
    """Start from a blurred photo (H, W) or (H, W, 3), linear light 0..1, whose motion nobody
    knows.
    """
    return Scene(name, photo, warnings=warnings)


def find_motion(
    scene: Scene,
    camera: Camera,
    *,
    exposure_s: float,
    device: DeviceProfile | None = None,
    seed: int = 0,
    tell: Callable[[float, str], None] = lambda _fraction, _what: None,
) -> FoundMotion:
    """Find a scene's motion: by a set of photos through known codes where it can be photographed
    again.

    Of one's own photo there are no others, and neither are there through a device that cannot play
    the codes.

    Parameters
    ----------
    scene : Scene
    camera : Camera
    exposure_s : float
        Length of the exposure.
    device : DeviceProfile, optional
        Shutter that must be able to play the codes.
    seed : int
    tell : callable
        Called with the fraction done and what is being done.

    Raises
    ------
    ValueError
        If the photo shows nothing to estimate a motion from.
    """

    def blind(begin: float) -> MotionEstimate:
        try:
            return estimate_motion(
                scene.photo, progress=lambda share, what: tell(begin + (1 - begin) * share, what)
            )
        except ValueError as error:
            raise ValueError(f"{scene.name}: {error}") from None

    codes = _set_of_codes(exposure_s, device)
    if scene.sharp is None or scene.motion is None or not codes:
        return FoundMotion(blind(0.0))
    frame = scene.motion.frame_size() | 1
    rng = np.random.default_rng([seed, 4])
    coded = [
        capture(scene.sharp, coded_psf(scene.motion, one, frame), camera=camera, rng=rng)
        for one in codes[1:]
    ]
    photos = (scene.photo, *coded)
    row, column = pick_crops(scene.photo, size=_SET_PX, count=1)[0]
    parts = [photo[row : row + _SET_PX, column : column + _SET_PX] for photo in photos]
    found = estimate_motion(
        parts, codes=codes, seed=seed, progress=lambda share, what: tell(_SET_SHARE * share, what)
    )
    return FoundMotion(found, codes, photos, alone=blind(_SET_SHARE))


def _set_of_codes(exposure_s: float, device: DeviceProfile | None) -> tuple[ShutterCode, ...]:
    """Open shutter and bit planes of a Gray code; none where the device cannot play them."""
    bins = 2**_PLANES
    chip_ns = max(1, round(exposure_s / bins * 1e9))
    planes = [ShutterCode(plane, chip_ns) for plane in gray_planes(_PLANES, bins)]
    if device is not None and any(
        device.check(Program.from_bits(one.bits, chip_ns=chip_ns)) for one in planes
    ):
        return ()
    return (ShutterCode(np.ones(bins), chip_ns), *planes)
