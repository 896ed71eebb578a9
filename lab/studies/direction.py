"""How often the two-direction test is right, on simulated coded photos.

    python -m lab.studies.direction [--photos 60] [--jitter 0] [--seed 0]

Boracchi-Foi, accelerated and straight motions, 300 x 300 px scenes, Raskar's 52-chip code and
random half-open codes; Gauss noise of 0.2 to 2 % of full scale (the coded photo has half the
light); the tested path is off by `--jitter`.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from skimage import data

from cep.codes.published import published
from cep.optics.camera import Camera
from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.restoration.direction import compare_psfs
from lab.studies.inputs import study_parser
from motdiff.motions import boracchi_foi, quadratic, random_straight
from motdiff.photo_values import to_linear
from motdiff.psf_frame import PSF_PX
from motdiff.trajectory import Trajectory

RASKAR_52 = published("raskar-52").code
SCENES = (
    "camera",
    "astronaut",
    "coffee",
    "chelsea",
    "rocket",
    "moon",
    "brick",
    "grass",
    "coins",
    "page",
)
MOTIONS: dict[str, Callable[[np.random.Generator], Trajectory]] = {
    "Boracchi-Foi": boracchi_foi,
    "accelerated": quadratic,
    "straight": lambda rng: random_straight(rng, min_length_px=10),
}
NOISE = ((0.002, 0.005), (0.005, 0.01), (0.01, 0.02))


def scene(name: str) -> np.ndarray:
    image = np.asarray(getattr(data, name)(), dtype=float) / 255
    grey = image if image.ndim == 2 else image[..., :3] @ np.array([0.2126, 0.7152, 0.0722])
    return to_linear(grey, gamma=2.2)[:363, :363]


def random_code(rng: np.random.Generator) -> ShutterCode:
    chips = int(rng.choice([26, 40, 52]))
    inner = rng.permutation([1] * (chips // 2 - 2) + [0] * (chips - chips // 2))
    return ShutterCode("1" + "".join(str(bit) for bit in inner) + "1")


def jittered(path: Trajectory, amount_px: float, rng: np.random.Generator) -> Trajectory:
    knots = rng.normal(scale=max(amount_px, 1e-12), size=(6, 2))
    t = np.linspace(0, 1, 200)
    wobble = np.stack(
        [np.interp(t, np.linspace(0, 1, 6), knots[:, axis]) for axis in (0, 1)], axis=1
    )
    return Trajectory.from_samples(path.at(t) + wobble, t=t)


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--photos", type=int, default=60)
    parser.add_argument("--jitter", type=float, default=0.0)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    scenes = [scene(name) for name in SCENES]
    rows: list[tuple[str, int, bool, float]] = []
    started = time.process_time()
    while len(rows) < options.photos:
        motion = str(rng.choice(list(MOTIONS)))
        band = int(rng.integers(len(NOISE)))
        sigma = float(np.exp(rng.uniform(*np.log(NOISE[band]))))
        code = RASKAR_52 if len(rows) % 2 else random_code(rng)
        path = MOTIONS[motion](rng)
        guess = jittered(path, options.jitter, rng) if options.jitter else path
        if max(p.frame_size() for p in (path, guess, guess.reversed())) > PSF_PX:
            continue
        camera = Camera(photons_full_scale=1e6, read_noise_e=sigma * 1e6)
        photo = capture(
            scenes[int(rng.integers(len(scenes)))], coded_psf(path, code), camera=camera, rng=rng
        )
        result = compare_psfs(photo, coded_psf(guess, code), coded_psf(guess.reversed(), code))
        rows.append((motion, band, result.direction == "forward", result.confidence))
    seconds = (time.process_time() - started) / len(rows)

    def line(label: str, chosen: list[tuple[str, int, bool, float]]) -> None:
        if chosen:
            right = np.mean([r[2] for r in chosen])
            confident = [r[2] for r in chosen if r[3] > 0.9]
            tail = f"{100 * np.mean(confident):5.1f} % of {len(confident)}" if confident else "-"
            print(f"{label:<22}{len(chosen):>7}{100 * right:>9.1f} %   {tail}")

    print(f"{'':<22}{'photos':>7}{'right':>11}   right when confidence > 0.9")
    for motion in MOTIONS:
        line(motion, [r for r in rows if r[0] == motion])
    for index, (low, high) in enumerate(NOISE):
        line(f"sigma {100 * low:g}..{100 * high:g} %", [r for r in rows if r[1] == index])
    line("all", rows)
    print(f"{seconds:.2f} CPU-s a photo")


if __name__ == "__main__":
    main()
