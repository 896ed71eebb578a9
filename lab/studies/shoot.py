"""Shots of ``cep shoot`` on the twin, end to end over the controller's protocol.

    python -m lab.studies.shoot [SHOTS]

Prints: frames that are the twin's own bits, computed anew from the pins; lost, doubled and
unnoticed frames; PSNR of restored photos against those of ``cep simulate``; the time beside the
exposure; and how many triggers of a belt are obeyed; and a photo summed from a slow-motion video.
"""

from __future__ import annotations

import tempfile
import threading
import time
from pathlib import Path

import cv2
import numpy as np
from skimage import data

from cep.codes.sources import load_code
from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.restoration.restore import restore
from cep.shutter.exposure_plan import Release, ShotSettings
from cep.shutter.play import play_on_triggers
from cep.shutter.rig import Rig, Shot
from cep.shutter.shoot import open_rig, shoot
from cep.shutter.twin import TwinCamera, code_values, openings_s
from hw.emulation.uno import EmulatedUno
from lab.studies.inputs import study_parser
from motdiff.crops import centre_crop
from motdiff.metrics import psnr
from motdiff.photo_values import to_display, to_linear
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory

CODE = ShutterCode(load_code("raskar-52").bits, 200_000)
PATH = Trajectory.straight(52.0, direction="known")
RESTORED = 10
_BORDER_PX = 40


def own_values(camera: TwinCamera, shot: Shot, light: np.ndarray) -> np.ndarray:
    """Compute a frame's code values anew: the noise is that of its number."""
    rng = np.random.default_rng([camera.options.seed, shot.frame.frame_id - 1])
    rng.standard_normal()
    noise = camera.noise.with_dark_noise(shot.frame.exposure_s or 0.0)
    return code_values(noise, noise.expose(light, rng=rng))


def judged(rig: Rig, shot: Shot, rng: np.random.Generator) -> tuple[float, float]:
    """PSNR, dB, of the shot restored, and of a simulated photo of the same scene."""
    camera = rig.camera
    assert isinstance(camera, TwinCamera)
    scene = camera.scene.light
    photos = (
        shot.record.light(shot.frame.values),
        capture(scene, PATH, CODE, shot.record.noise, rng=rng),
    )
    psnrs = []
    for photo in photos:
        sharp = restore(photo, code=CODE, trajectory=PATH, camera=shot.record.noise).image
        middle = [side - 2 * _BORDER_PX for side in sharp.shape[:2]]
        compared = centre_crop(np.clip(sharp, 0, 1), *middle)
        psnrs.append(psnr(compared, centre_crop(scene, *middle)))
    return psnrs[0], psnrs[1]


def run(release: Release, shots: int) -> None:
    """Take shots and print a row of the table."""
    beside_s = []
    equal = count = 0
    pairs = []
    rng = np.random.default_rng(1)
    with open_rig("twin:") as rig:
        camera = rig.camera
        assert isinstance(camera, TwinCamera)
        rig.prepare(CODE, ShotSettings(release=release, motion=PATH))
        for number in range(shots):
            start_s = time.monotonic()
            shot = rig.shoot()
            beside_s.append(time.monotonic() - start_s - (shot.frame.exposure_s or 0.0))
            count += shot.counts
            # the pins once more, without what the camera had asked them
            pin = "trigger" if release is Release.CAMERA else "busy"
            rises = [cycle for cycle, level in camera.uno.edges(pin) if level]
            trigger_s = rises[-1] / 16e6
            begun_s = (shot.frame.timestamp_ns or 0) * 1e-9 - trigger_s
            light = camera.scene.collected(
                openings_s(camera.uno.edges(), trigger_s),
                start_s=begun_s,
                end_s=begun_s + (shot.frame.exposure_s or 0.0),
            )
            equal += bool((own_values(camera, shot, light) == shot.frame.values).all())
            if number % max(1, shots // RESTORED) == 0:
                pairs.append(judged(rig, shot, rng))
        plays = len([level for _cycle, level in camera.uno.edges("busy") if level])
    gains = np.array(pairs)
    worst_ms, median_ms = 1e3 * max(beside_s), 1e3 * float(np.median(beside_s))
    print(
        f"| {release} | {count} of {shots} | {plays} | {equal} | {gains[:, 0].mean():.2f} |"
        f" {gains[:, 1].mean():.2f} | {median_ms:.0f} | {worst_ms:.0f} |",
        flush=True,
    )


def belt(hertz: float, triggers: int = 100) -> None:
    """Print how many triggers a code of 6.4 ms is played on, without a camera."""
    code = ShutterCode("1011001110100110", 400_000)
    with EmulatedUno() as uno:
        start = threading.Timer(0.5, uno.trigger, kwargs={"pulses": triggers, "hertz": hertz})
        start.start()
        result = play_on_triggers(uno.port, code, plays=triggers, wait_s=1.0)
    print(f"| {hertz:g} triggers a second | {result.plays} of {triggers} played |", flush=True)


def burst(fps: float = 240.0) -> None:
    """Print the PSNR of a photo summed from a video of 8 bits, and of the direct simulation."""
    slices = PATH.slice_psfs(np.linspace(0, 1, CODE.chips + 1), PATH.frame_size() | 1)
    scene = to_linear(data.camera() / 255)
    frames = [blur_valid(scene, CODE.chips * psf) for psf in slices]
    noise = np.random.default_rng(0).normal(0, 0.002, frames[0].shape)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "slow.mkv"
        video = cv2.VideoWriter(
            str(file), cv2.VideoWriter.fourcc(*"FFV1"), fps, frames[0].shape[::-1]
        )
        for frame in frames:
            codes = np.rint(255 * to_display(np.clip(frame, 0, 1))).astype(np.uint8)
            video.write(np.dstack([codes] * 3))
        video.release()
        (shot,) = shoot(f"burst:{file}", CODE, settings=ShotSettings(motion=PATH))
    photos = (
        shot.record.light(shot.frame.values),
        blur_valid(scene, coded_psf(PATH, CODE, size=PATH.frame_size() | 1)),
    )
    middle = [side - 2 * _BORDER_PX for side in noise.shape]
    psnrs = [
        psnr(
            centre_crop(
                np.clip(restore(photo + noise, code=CODE, trajectory=PATH).image, 0, 1), *middle
            ),
            centre_crop(scene, *middle),
        )
        for photo in photos
    ]
    print(f"| burst | {psnrs[0]:.2f} dB, direct simulation {psnrs[1]:.2f} dB |", flush=True)


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("shots", type=int, nargs="?", default=200)
    options = parser.parse_args()
    print(
        "| triggered by | count | plays | own bits | PSNR, dB | simulated, dB |"
        " ms beside the exposure, median | worst |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for who in (Release.SHUTTER, Release.CAMERA):
        run(who, options.shots)
    for frequency_hz in (10, 30, 60, 80):
        belt(frequency_hz)
    burst()


if __name__ == "__main__":
    main()
