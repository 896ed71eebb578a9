"""When coding pays: the map over light and read noise, and expected gains beside simulated ones.

    python -m lab.studies.verdict map [--walks 5] [--workers 2] [--image FILE]
    python -m lab.studies.verdict check [--captures 1000] [--workers 2]

`map`: gain of the best code over the best single exposure, dB, 40 chips, direction known, along a
straight motion of 40 px and along random walks of 60 px (the median of so many), known exactly or
to 0.25 px. `check`: fifteen cases of motion, camera and light; the best snapshot and the best code
are photographed so often, each time of another scene of the reference spectrum, and restored by a
Wiener filter: the gain so measured beside the expected one.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from cep.optics.band import BandSamples
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_otf
from cep.optics.scene import PHOTO, inverse_scene, noise_variance
from cep.search.advise import advise
from cep.search.problem import SearchProblem
from motdiff.motions import boracchi_foi, quadratic
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

LIGHT = (300.0, 1_000.0, 3_000.0, 10_000.0, 30_000.0, 100_000.0)
READ_NOISE = (2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0)
CHIPS = 40
STRAIGHT_PX = 40.0
WALK_PX = 60.0
ERROR_PX = 0.25  # of a path calibrated through codes
SIDE = 191  # px of a scene, odd: no frequency is its own mirror


def gains_over_light(case: tuple[str, int, float, float]) -> list[float]:
    """Gain, dB, of the best code over the best single exposure at each level of LIGHT."""
    kind, seed, read_noise, error_px = case
    path = Trajectory.straight(STRAIGHT_PX) if kind == "straight" else walk(seed)
    camera = Camera(photons_full_scale=LIGHT[0], read_noise_e=read_noise, bits=16)
    advice = advise(
        SearchProblem.along(path, chips=CHIPS, camera=camera),
        levels=LIGHT,
        path_error_px=error_px,
        threads=1,
    )
    return [level.code_gain_db or 0.0 for level in advice.levels]


def walk(seed: int) -> Trajectory:
    return boracchi_foi(np.random.default_rng([seed, 20]), max_length_px=WALK_PX)


def make_map(walks: int, image: Path, run: Callable[..., Iterable[list[float]]]) -> None:
    from cep.plots.canvas import new_figure, save

    columns = [
        ("straight", range(1), 0.0),
        ("walk", range(walks), 0.0),
        ("walk", range(walks), ERROR_PX),
    ]
    cases = [
        (kind, seed, e, error)
        for kind, seeds, error in columns
        for e in READ_NOISE
        for seed in seeds
    ]
    gains_by_case = iter(run(gains_over_light, cases))
    tables = {
        name: np.array(
            [np.median([next(gains_by_case) for _ in seeds], axis=0) for _ in READ_NOISE]
        )
        for name, (_, seeds, _) in zip(
            (
                f"straight motion of {STRAIGHT_PX:g} px",
                f"walks of {WALK_PX:g} px, known exactly",
                f"walks of {WALK_PX:g} px, known to {ERROR_PX:g} px",
            ),
            columns,
            strict=True,
        )
    }
    for name, gains in tables.items():
        print(f"\n{name}: gain of the best code over the best single exposure, dB")
        print("| read noise, e- | " + " | ".join(f"{level:,.0f}" for level in LIGHT) + " |")
        print("|---|" + "---:|" * len(LIGHT))
        for read_noise, row in zip(READ_NOISE, gains, strict=True):
            print(
                f"| {read_noise:g} | "
                + " | ".join(f"{max(value, 0.0):.1f}" for value in row)
                + " |"
            )
    figure = new_figure(11.5, 3.9)
    panels = figure.subplots(1, len(tables), sharey=True)
    for axes, (name, gains) in zip(panels, tables.items(), strict=True):
        mesh = axes.imshow(
            np.maximum(gains, 0), cmap="Greens", vmin=0, vmax=5, origin="lower", aspect="auto"
        )
        for (i, j), gain in np.ndenumerate(gains):
            text = f"+{gain:.1f}" if gain >= 0.1 else "\u2013"
            axes.text(
                j,
                i,
                text,
                ha="center",
                va="center",
                fontsize=8,
                color="white" if gain > 3 else "black",
            )
        axes.set_xticks(range(len(LIGHT)), [f"{level:,.0f}" for level in LIGHT], fontsize=7)
        axes.set_yticks(
            range(len(READ_NOISE)), [f"{read_noise:g}" for read_noise in READ_NOISE], fontsize=8
        )
        axes.set_title(name, fontsize=10)
        axes.set_xlabel("photo-electrons at full scale", fontsize=9)
    panels[0].set_ylabel("read noise, electrons", fontsize=9)
    figure.colorbar(mesh, ax=panels, label="gain of a code, dB (\u2013: expose for less)")
    save(figure, image)
    print(f"\n{image}")


# -- simulated captures ---------------------------------------------------------------------------


def check_cases() -> list[tuple[str, Trajectory, Camera]]:
    rng = np.random.default_rng(12)
    paths = {
        "straight, 20 px": Trajectory.straight(20.0),
        "arc": quadratic(rng, min_length_px=24, max_length_px=30, max_bend=1.5),
        "walk of 40 px": boracchi_foi(rng, max_length_px=40.0),
    }
    light = (
        (10_000.0, 2.0, 0.0),
        (10_000.0, 50.0, 0.0),
        (100_000.0, 200.0, 0.0),
        (1_000.0, 10.0, 0.0),
        (10_000.0, 2.0, 100_000.0),
    )
    return [
        (
            name,
            path,
            Camera(
                photons_full_scale=photons, read_noise_e=read_noise, dark_current_e_s=dark, bits=16
            ),
        )
        for name, path in paths.items()
        for photons, read_noise, dark in light
    ]


def checked(case: tuple[int, int]) -> tuple[float, float, float]:
    """Return the gain of the best code over the best snapshot, expected and simulated with its
    standard error, dB.
    """
    index, captures = case
    _, path, camera = check_cases()[index]
    known_path = replace(path, direction="known")
    advice = advise(
        SearchProblem.along(known_path, chips=24, camera=camera),
        levels=[],
        photographs=(),
        threads=1,
    )
    snapshot = advice.here.best("snapshot")
    code = advice.here.best("code")
    assert snapshot is not None
    assert code is not None
    errors = [
        squared_errors(known_path, design.code, camera, captures, seed=index)
        for design in (snapshot, code)
    ]
    gain = 10 * np.log10(errors[0].mean() / errors[1].mean())
    spread = np.std(errors[0] / errors[0].mean() - errors[1] / errors[1].mean()) / np.sqrt(
        captures
    )
    return code.psnr_db - snapshot.psnr_db, float(gain), float(10 / np.log(10) * spread)


def squared_errors(
    path: Trajectory, code: ShutterCode, camera: Camera, captures: int, *, seed: int
) -> FloatArray:
    """Mean square error of each restored capture; the scenes are the same for every code."""
    frequency = np.fft.fftfreq(SIDE)
    fx, fy = (grid.ravel() for grid in np.meshgrid(frequency, frequency))
    samples = BandSamples(
        fx, fy, np.full(fx.size, 1 / fx.size), (fx**2 + fy**2)[:, None], np.ones((fx.size, 1))
    )
    inverse = inverse_scene(samples)[:, 0].reshape(SIDE, SIDE)
    otf = coded_otf(path, code, fx, fy).reshape(SIDE, SIDE)
    noise = noise_variance(camera, code.duty, integration_s=code.integration_ns * 1e-9)
    wiener = np.conj(otf) / (np.abs(otf) ** 2 + noise * inverse)
    photons = camera.photons_full_scale
    read_sigma = camera.noise["read_sigma"]
    dark_e = float(camera.dark_e(code.integration_ns * 1e-9))
    scenes = np.random.default_rng([seed, 1])
    capture = np.random.default_rng([seed, 2, code.open_chips])
    draw = scenes_of(inverse)
    errors = []
    for _ in range(captures):
        spectrum = np.fft.fft2(draw(scenes) - PHOTO.mean)
        blurred = np.maximum(np.fft.ifft2(spectrum * otf).real + PHOTO.mean * code.duty, 0)
        photo = capture.poisson(
            photons * blurred
        ) / photons + read_sigma * capture.standard_normal(blurred.shape)
        photo += (capture.poisson(dark_e, blurred.shape) - dark_e) / photons
        restored = np.fft.fft2(photo - PHOTO.mean * code.duty) * wiener
        errors.append((np.abs(restored - spectrum) ** 2).mean() / SIDE**2)
    return np.array(errors)


def scenes_of(inverse: FloatArray) -> Callable[[np.random.Generator], FloatArray]:
    """Make a drawing of log-normal scenes: none is darker than black, and their spectrum is the
    reference scene's.
    """
    covariance = np.fft.ifft2(1 / inverse).real
    log_spectrum = np.maximum(np.fft.fft2(np.log1p(covariance / PHOTO.mean**2)).real, 0)
    variance = log_spectrum.mean()

    def draw(rng: np.random.Generator) -> FloatArray:
        normal = np.fft.ifft2(
            np.fft.fft2(rng.standard_normal(inverse.shape)) * np.sqrt(log_spectrum)
        ).real
        return PHOTO.mean * np.exp(normal - variance / 2)

    return draw


def check(captures: int, run: Callable[..., Iterable[tuple[float, float, float]]]) -> None:
    cases = check_cases()
    print("gain of the best code over the best single exposure, dB, 24 chips")
    print(
        "| motion | photo-electrons | read noise, e- | dark current, e-/s | expected | simulated |"
        " difference |"
    )
    print("|---|---:|---:|---:|---:|---:|---:|")
    worst = 0.0
    for (name, _, camera), result in zip(
        cases, run(checked, [(i, captures) for i in range(len(cases))]), strict=True
    ):
        expected, gain, spread = result
        worst = max(worst, abs(gain - expected))
        print(
            f"| {name} | {camera.photons_full_scale:,.0f} | {camera.read_noise_e:g} | "
            f"{camera.dark_current_e_s:,.0f} | {expected:.2f} | "
            f"{gain:.2f} ± {spread:.2f} | {gain - expected:+.2f} |",
            flush=True,
        )
    print(f"largest difference: {worst:.2f} dB")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("map", "check"))
    parser.add_argument("--walks", type=int, default=5, help="random walks of the map")
    parser.add_argument("--captures", type=int, default=1_000, help="of each way and case")
    parser.add_argument("--image", type=Path, default=Path("docs/images/verdict-map.png"))
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        if options.what == "map":
            make_map(options.walks, options.image, pool.map)
        else:
            check(options.captures, pool.map)


if __name__ == "__main__":
    main()
