"""Codes searched along a path that is off, used along the true one.

    python -m lab.studies.off_path [--walks 16] [--errors 0 0.1 0.25 0.5 1] [--steps 150000]

Walks of 60 px, 52 chips, 26 open, direction known; smooth errors of the path. Rows: the objective
alone, ``xN`` the mean over N paths with other errors of that size. Columns, mean over the walks:
noise gain and ``mse`` along the true path, then the error of a Wiener filter that has the path
that is off, at 10,000 photo-electrons, with the filter's noise as the camera's and at its best;
less the same objective alone, 95 % interval.
"""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from cep.optics.band import band_samples
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_otf
from cep.optics.scene import inverse_scene, noise_variance
from cep.search.annealing.anneal import anneal
from cep.search.cost import CodeCost
from cep.search.problem import SearchProblem
from lab.class_code.motions import draw_motions
from lab.studies.inputs import study_parser
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

ROWS = ("noise", "noise x8", "mse", "mse x8")
_KNOTS = 201
_ALIKE = 0.1
_CHIPS = 52
_OPEN = 26


def off(
    path: Trajectory, error_px: float, rng: np.random.Generator, *, exactly: bool
) -> Trajectory:
    """Displace a path by a smooth error, correlated over a tenth of the exposure."""
    t = np.linspace(0, 1, _KNOTS)
    alike = np.exp(-0.5 * ((t[:, None] - t) / _ALIKE) ** 2)
    error = np.linalg.cholesky(alike + 1e-8 * np.eye(_KNOTS)) @ rng.standard_normal((_KNOTS, 2))
    error -= error.mean(axis=0)
    error *= error_px / (np.sqrt((error**2).sum(axis=1).mean()) if exactly else np.sqrt(2))
    times = np.union1d(path.t, t)
    xy = [
        np.interp(times, path.t, path.xy[:, i]) + np.interp(times, t, error[:, i]) for i in (0, 1)
    ]
    return Trajectory.from_samples(np.stack(xy, axis=1), t=times, direction="known")


def restored_db(true: Trajectory, assumed: Trajectory, code: ShutterCode) -> tuple[float, float]:
    """Error of a Wiener filter with a path that is off: with the camera's noise, and with what
    noise suits it best.
    """
    samples = band_samples(true)
    passed, assumed_otf = (
        coded_otf(path, code, samples.fx, samples.fy) for path in (true, assumed)
    )
    inverse = inverse_scene(samples)[:, 0]
    noise = noise_variance(Camera(), code.duty)

    def error_db(stated_db: FloatArray) -> float:
        gain = np.conj(assumed_otf) / (np.abs(assumed_otf) ** 2 + stated_db * inverse)
        lost = np.abs(1 - gain * passed) ** 2 / inverse + np.abs(gain) ** 2 * noise
        return float(10 * np.log10(samples.weight @ lost))

    return error_db(noise), min(error_db(noise * 10**step) for step in np.arange(-0.5, 3.1, 0.25))


def figures(
    path: Trajectory, assumed: Trajectory, row: str, error_px: float, seed: int, steps: int
) -> list[float]:
    name, _, samples_text = row.partition(" x")
    rng = np.random.default_rng([seed, 9])
    paths = (
        [off(assumed, error_px, rng, exactly=False) for _ in range(int(samples_text))]
        if samples_text
        else [assumed]
    )
    problem = SearchProblem.along(
        *paths,
        chips=_CHIPS,
        open_range=(_OPEN, _OPEN),
        objective=name,
        direction="forward",
        rule="mean",
    )
    started = time.process_time()
    code = anneal(problem, rng=np.random.default_rng(1), steps=steps, time_s=600, threads=1).code
    seconds = time.process_time() - started
    judge = CodeCost(
        SearchProblem.along(path, chips=_CHIPS, objective="noise", direction="forward"),
        oversampling=16,
        dtype=np.float64,
    )
    bits = code.array[None].astype(np.int8)
    along = [float(objective.cost_of(bits)[0]) for objective in (judge, judge.instead("mse"))]
    return [*along, *restored_db(path, assumed, code), seconds]


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--walks", type=int, default=16)
    parser.add_argument(
        "--errors", type=float, nargs="+", default=[0.0, 0.1, 0.25, 0.5, 1.0], metavar="PX"
    )
    parser.add_argument("--steps", type=int, default=150_000)
    options = parser.parse_args()
    walks = draw_motions(options.walks, length_px=60.0, rng=np.random.default_rng(8))
    for error_px in options.errors:
        results: dict[str, NDArray[np.float64]] = {}
        for row in ROWS if error_px else ("noise", "mse"):
            runs = []
            for index, path in enumerate(walks):
                rng = np.random.default_rng([index, round(1000 * error_px)])
                wrong = off(path, error_px, rng, exactly=True) if error_px else path
                runs.append(figures(path, wrong, row, error_px, index, options.steps))
            results[row] = np.array(runs)
            means = "  ".join(f"{value:7.2f}" for value in results[row].mean(axis=0)[:4])
            less = results[row] - results[row.split(" ")[0]]
            spread = 1.96 * less.std(axis=0, ddof=1) / np.sqrt(len(less))
            compared = "  ".join(
                f"{m:+.2f} +- {s:.2f}" for m, s in zip(less.mean(axis=0)[:4], spread, strict=False)
            )
            print(
                f"{error_px:5.2f} px  {row:9} {means}   {compared}  "
                f" {results[row][:, 4].mean():.1f} s",
                flush=True,
            )


if __name__ == "__main__":
    main()
