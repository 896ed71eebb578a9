"""Which restoration is the default: pnp, TV, the Wiener filter, and the one that the photo's own
evidence chooses, where the path is known so well.

    python -m lab.studies.default_method PHOTOS [--count 6]

PHOTOS is a folder of sharp photographs. Each is photographed along a straight motion of 25 px and
a walk of 40 px, with the shutter open and through a code, at three levels of noise, and restored
along the true path and along one that is wrong by 0.3 and by 1 px rms. Prints the mean PSNR, dB,
up to shift, in linear light, away from the borders.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from cep.optics.camera import Camera
from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.restoration.choice import choose_method, restore_with_estimate
from cep.restoration.plug_and_play import pnp
from cep.restoration.tv import tv
from cep.restoration.wiener import wiener
from lab.photo_gains.photographs import load_scenes
from lab.studies.inputs import refusals, study_parser
from motdiff.metrics import psnr_up_to_shift
from motdiff.motions import boracchi_foi, with_smooth_error
from motdiff.threads import side_by_side
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

SIDE_PX = 250
CODE = ShutterCode("1110000111000000000110110110011001110011")
SHUTTERS = {"open": ShutterCode("1" * CODE.chips), "coded": CODE}
NOISE = ((2.0, 100_000.0), (2.0, 10_000.0), (20.0, 10_000.0))  # e-, photo-electrons
ERRORS_PX = (0.0, 0.3, 1.0)
METHODS: dict[str, Callable[[FloatArray, FloatArray], FloatArray]] = {
    "pnp": pnp,
    "tv": tv,
    "wiener": wiener,
    "by evidence": lambda photo, psf: restore_with_estimate(
        photo, psf, choose_method(photo, psf).method
    ),
}


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("photos", type=Path)
    parser.add_argument("--count", type=int, default=6)
    arguments = parser.parse_args()
    with refusals(parser):
        scenes = load_scenes(arguments.photos, side_px=SIDE_PX, count=arguments.count)
    paths = {
        "straight 25 px": Trajectory.straight(25.0),
        "walk 40 px": boracchi_foi(np.random.default_rng(3), max_length_px=40.0),
    }
    print("| motion | shutter | e- / photo-electrons | error, px | " + " | ".join(METHODS) + " |")
    print("|---|---|---|---:|" + "---:|" * len(METHODS))
    for name, path in paths.items():
        for shutter, code in SHUTTERS.items():
            for read_noise_e, photons in NOISE:
                camera = Camera(photons_full_scale=photons, read_noise_e=read_noise_e)
                for error_px in ERRORS_PX:
                    jobs = [
                        partial(restored_psnr_db, scene, path, code, camera, error_px, seed=i)
                        for i, scene in enumerate(scenes)
                    ]
                    means = np.mean(side_by_side(jobs), axis=0)
                    row = " | ".join(f"{mean:.2f}" for mean in means)
                    light = f"{read_noise_e:g} / {photons:,.0f}"
                    print(f"| {name} | {shutter} | {light} | {error_px:g} | {row} |", flush=True)


def restored_psnr_db(
    scene: FloatArray,
    path: Trajectory,
    code: ShutterCode,
    camera: Camera,
    error_px: float,
    *,
    seed: int,
) -> list[float]:
    """PSNR of each method of :data:`METHODS`."""
    true_path = path
    if error_px > 0:
        true_path = with_smooth_error(path, error_px, rng=np.random.default_rng([seed, 5]))
    size = max(path.frame_size(), true_path.frame_size()) | 1
    reach = size // 2
    true_psf = coded_psf(true_path, code, size)
    photo = capture(scene, true_psf, None, camera, rng=np.random.default_rng(seed))
    inner = (slice(2 * reach, -2 * reach),) * 2
    middle = (slice(reach, -reach),) * 2
    psf = coded_psf(path, code, size)
    return [
        psnr_up_to_shift(np.clip(method(photo, psf), 0, 1)[middle], scene[inner])
        for method in METHODS.values()
    ]


if __name__ == "__main__":
    main()
