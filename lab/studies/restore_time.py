"""Time of the default restoration, of coded photos along a known motion.

    python -m lab.studies.restore_time [MEGAPIXELS ...]

Prints seconds for grey and colour; 1 and 12 megapixels when none are given. On an idle machine.
"""

from __future__ import annotations

import time

import numpy as np
from skimage import data

from cep.codes.sources import load_code
from cep.optics.camera import Camera
from cep.optics.capture import capture
from cep.restoration.restore import restore
from lab.studies.inputs import study_parser
from motdiff.photo_values import to_linear
from motdiff.trajectory import Trajectory

PATH = Trajectory.straight(30.0, angle_rad=0.5, direction="known")
CAMERA = Camera(photons_full_scale=10_000, read_noise_e=2)


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("megapixels", type=float, nargs="*", default=[1.0, 12.0])
    options = parser.parse_args()
    code = load_code("raskar-52")
    tile = to_linear(data.astronaut() / 255)
    for megapixels in options.megapixels:
        side = round(np.sqrt(megapixels * 1e6)) + PATH.frame_size() - 1
        repeats = -(-side // len(tile))
        scene = np.tile(tile, (repeats, repeats, 1))[:side, :side]
        rng = np.random.default_rng(0)
        photo = np.stack(
            [
                capture(channel, PATH, code, CAMERA, rng=rng)
                for channel in np.moveaxis(scene, 2, 0)
            ],
            axis=2,
        )
        for name, light in (("grey", photo[..., 1]), ("colour", photo)):
            start_s = time.perf_counter()
            restored = restore(light, trajectory=PATH, code=code, camera=CAMERA)
            print(
                f"{light.shape[1]} x {light.shape[0]} px, {name}:"
                f" {time.perf_counter() - start_s:.1f} s by {restored.method}",
                flush=True,
            )


if __name__ == "__main__":
    main()
