"""Paths that the network draws, followed as they are drawn or traced anew from the kernels that
they become.

    python -m lab.studies.drawn_path [--photos FOLDER] [--count 16] [--seed 0]

For simulated photos with real borders and 1 % noise: the network's one-step map and dwell, told of
the quick classical searches. "kernel": the drawn PSF is traced. "map": the map is traced and given
the drawn PSF's dwell. "refined kernel" and "refined map": the same with the PSF refined on the
photo, which is what ``cep calibrate`` does with the kernel. Figures: MNC of the trajectory's PSF;
the path's distance from the true one in order, px, the better way round; and how much worse a code
of 32 chips searched along the trajectory is than one searched along the true one, both for either
direction, dB of the expected error along the true one.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from cep.optics.code import ShutterCode
from cep.search.code_search import SearchOptions, search_code
from cep.search.problem import SearchProblem
from lab.bench.blind.protocol import synthetic_trace
from lab.evaluation.map_tracing import trace_map
from lab.evaluation.metrics import ordered_distance_px
from lab.studies.inputs import large_scenes, photos, refusals, study_parser
from motdiff.blind_search.coarse_to_fine import refined
from motdiff.estimators.kernel_score import Judge
from motdiff.estimators.motdiff.drawing import quick_search
from motdiff.metrics import mnc_subpixel
from motdiff.motions import boracchi_foi, random_gyro_motion
from motdiff.network.denoiser import MotDiffNetwork
from motdiff.network.diffusion import cosine_schedule
from motdiff.network.physics_maps import physics_maps
from motdiff.network.sampling import sample_paths
from motdiff.psf_frame import ODD_PX, PSF_PX, in_frame, without_faint_light, without_faint_parts
from motdiff.simulate import photograph
from motdiff.tracing.dwell import fit_dwell
from motdiff.tracing.quadratic import simplest_trajectory
from motdiff.trajectory import Trajectory
from motdiff.weights import load_network

SIDE_PX = 256 + PSF_PX - 1
WAYS = ("kernel", "map", "refined kernel", "refined map")


def motions(rng: np.random.Generator) -> dict[str, Trajectory]:
    trace = synthetic_trace(rng, duration_s=30.0, rate_hz=200.0)
    return {
        "walk of 60 px": boracchi_foi(rng),
        "walk of 20 px": boracchi_foi(rng, max_length_px=20.0),
        "shake": random_gyro_motion(
            trace, rng, exposure_s=float(rng.uniform(0.05, 0.3)), extent_px=20.0
        ),
    }


def trajectories(network: MotDiffNetwork, photo: np.ndarray, seed: int) -> dict[str, Trajectory]:
    crops = photo[None]
    sigma = Judge(crops).sigma
    light = torch.from_numpy(crops.astype(np.float32))[None]
    searched = quick_search(crops, sigma=sigma)
    with torch.no_grad():
        maps = physics_maps(light, torch.from_numpy(searched.astype(np.float32))[None])
        samples = sample_paths(
            network,
            network.condition(None, maps),
            count=1,
            schedule=cosine_schedule(),
            steps=1,
            generator=torch.Generator().manual_seed(seed),
        )
    psf = samples.psfs()[0, 0].double().numpy()
    odd = without_faint_light(in_frame(psf[None], ODD_PX), below=0.02)[0]
    sharpened = refined(crops, odd / odd.sum(), sigma)
    chances = samples.path[0, 0].numpy()
    # a lost guess is sure of no pixel
    path = trace_map(chances > min(0.5, 0.5 * float(chances.max())))
    return {
        "kernel": simplest_trajectory(without_faint_parts(psf)),
        "map": fit_dwell(path, psf),
        "refined kernel": simplest_trajectory(without_faint_parts(sharpened)),
        "refined map": fit_dwell(path, sharpened),
    }


def searched(path: Trajectory, seed: int) -> ShutterCode:
    problem = SearchProblem.along(
        path, chips=32, open_range=(10, 22), objective="mse", direction="unknown"
    )
    return search_code(problem, SearchOptions(steps=20_000, seed=seed)).code


def error_db(path: Trajectory, code: ShutterCode) -> float:
    problem = SearchProblem.along(path, chips=32, objective="mse", direction="unknown")
    return problem.measure(code, budget=0).mse_db


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--photos", type=Path)
    parser.add_argument("--count", type=int, default=16)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    with refusals(parser):
        scenes = [light for _, light in large_scenes(photos(options.photos), least_px=SIDE_PX)]
    network = load_network()
    scores: dict[str, dict[str, list[tuple[float, float, float]]]] = {}
    for number in range(options.count):
        rng = np.random.default_rng([options.seed, number])
        scene = scenes[number % len(scenes)]
        scene = scene.mean(axis=2) if scene.ndim == 3 else scene
        top, column = (int(rng.integers(side - SIDE_PX + 1)) for side in scene.shape)
        scene = scene[top : top + SIDE_PX, column : column + SIDE_PX]
        for kind, truth in motions(rng).items():
            photo = photograph(scene, truth.psf(), rng=rng)
            least_db = error_db(truth, searched(truth, number))
            for variant, path in trajectories(network, photo, number).items():
                psf = in_frame(path.psf(max(PSF_PX, path.frame_size())), PSF_PX)
                figures = (
                    mnc_subpixel(psf, truth.psf()),
                    ordered_distance_px(path.xy, truth.xy),
                    error_db(truth, searched(path, number)) - least_db,
                )
                scores.setdefault(kind, {}).setdefault(variant, []).append(figures)
    print("| motions | way | photos | MNC | in order, px | code worse by, dB |")
    print("|---|---|---|---|---|---|")
    for kind, by_way in scores.items():
        for variant in WAYS:
            table = np.array(by_way[variant])
            error = table.std(axis=0) / len(table) ** 0.5
            cells = " | ".join(
                f"{m:.3f} ({e:.3f})" for m, e in zip(table.mean(axis=0), error, strict=True)
            )
            print(f"| {kind} | {variant} | {len(table)} | {cells} |")


if __name__ == "__main__":
    main()
