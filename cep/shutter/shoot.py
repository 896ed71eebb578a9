"""Photos through codes, by a camera and a coded shutter that are opened for them; how alike photos
taken alike are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import numpy as np

from cep.optics.code import ShutterCode
from cep.shutter.cameras import CAMERAS
from cep.shutter.exposure_plan import ShotSettings
from cep.shutter.rig import Rig, Shot
from hw.cameras import open_camera
from hw.drivers.cxp import Controller
from motdiff.types import FloatArray


def shoot(
    camera: str,
    code: ShutterCode | Sequence[ShutterCode],
    *,
    port: str | None = None,
    count: int = 1,
    settings: ShotSettings | None = None,
    keep: Callable[[Shot], object] = lambda _shot: None,
) -> tuple[Shot, ...]:
    """Take photos through a code: upload, read back, arm, fire, read the frame, check.

    Parameters
    ----------
    camera : str
        As ``pylon:``, ``pylon:22845317`` or ``twin:scene=cat``: a kind of
        :data:`cep.shutter.cameras.CAMERAS`, and which.
    code : ShutterCode, or a sequence
        Of several each is loaded in turn, for ``count`` photos.
    port : str, optional
        Serial port of the controller, or ``auto``; a twin brings its own, a burst needs none.
    count : int
        Photos, one after the other; the first that does not count ends them.
    settings : ShotSettings, optional
        Who begins, the motion, the camera's file, its exposure and gain.
    keep : callable
        Called with each photo as soon as it is there.

    Raises
    ------
    ValueError
        If there is no such camera or controller, or they cannot play and hold the code; nothing
        was armed.
    CameraError, hw.errors.VerifyError, hw.port.LinkError, hw.errors.DeviceError
        If camera or controller fail. The shutter is closed, the camera released.

    Examples
    --------
    ::

        settings = cep.ShotSettings(motion=estimate.best)
        code = cep.load_code("code.json")
        (shot,) = cep.shoot("pylon:", code, port="/dev/ttyACM0", settings=settings)
        print(shot.counts, shot.frame.values.max())
    """
    if count < 1:
        raise ValueError(f"count: must be at least 1, got {count}")
    codes = [code] if isinstance(code, ShutterCode) else list(code)
    shots: list[Shot] = []
    with open_rig(camera, port) as rig:
        try:
            for played in codes:
                rig.prepare(played, settings)
                shots += rig.series(count, keep=keep)
                if not shots[-1].counts:
                    break
        except BaseException as error:  # Ctrl-C as well: the photos are there
            if len(codes) > 1:
                error.add_note(f"photos of {len(shots) // count} of {len(codes)} codes count")
            raise
    return tuple(shots)


@contextmanager
def open_rig(camera: str, port: str | None = None) -> Iterator[Rig]:
    """Open a camera and the controller of its shutter; parameters and errors are `shoot`'s."""
    with ExitStack() as stack:
        device = stack.enter_context(open_camera(camera, CAMERAS))
        port = device.controller_port(port)
        controller = None if port is None else stack.enter_context(Controller.open(port))
        yield Rig(device, controller)


@dataclass(frozen=True)
class Repeatability:
    """How alike photos of one scene and motion are.

    Attributes
    ----------
    brightness_spread : float
        Standard deviation of the photos' mean light, over its mean.
    shift_px : float
        Largest displacement of a photo from the first, px.
    noise : float
        Standard deviation of a pixel from photo to photo, rms over the pixels, of white.
    """

    brightness_spread: float
    shift_px: float
    noise: float

    def __str__(self) -> str:
        return (
            f"brightness repeats within {self.brightness_spread:.2%}, the image within"
            f" {self.shift_px:.2f} px, a pixel within {self.noise:.2%} of white"
        )


def repeatability(photos: Sequence[FloatArray]) -> Repeatability:
    """Compare (N >= 2) photos, (H, W) or (H, W, 3) in linear light."""
    import cv2

    stack = np.stack([np.atleast_3d(photo).mean(axis=2) for photo in photos])
    means = stack.mean(axis=(1, 2))
    # without a window the borders, which do not move, would decide
    window = cv2.createHanningWindow(stack.shape[:0:-1], cv2.CV_64F)
    shifts = [cv2.phaseCorrelate(stack[0], photo, window)[0] for photo in stack[1:]]
    return Repeatability(
        brightness_spread=float(means.std(ddof=1) / max(means.mean(), np.finfo(float).tiny)),
        shift_px=float(np.hypot(*np.array(shifts).T).max()),
        noise=float(np.sqrt(stack.var(axis=0, ddof=1).mean())),
    )
