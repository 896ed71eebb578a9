"""When coding pays: the map over light and read noise, as photographs show it.

    python -m lab.studies.verdict [--walks 3] [--workers 2] [--image FILE]

Gain of the best code over the best single exposure, dB, as ``cep advise`` measures it on the
twelve bundled photographs; in brackets the gains of the single photographs, without the least and
the greatest. 40 chips, direction known, along a straight motion of 40 px and along random walks of
60 px (the median of so many), known exactly or to 0.25 px.
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from cep.optics.camera import Camera
from cep.search.advise import advise
from cep.search.exposures import gain_range_db
from cep.search.problem import SearchProblem
from lab.studies.inputs import study_parser
from motdiff.motions import boracchi_foi
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

LIGHT = (1_000.0, 3_000.0, 10_000.0, 30_000.0, 100_000.0)
READ_NOISE = (2.0, 10.0, 50.0, 200.0)
CHIPS = 40
STRAIGHT_PX = 40.0
WALK_PX = 60.0
ERROR_PX = 0.25  # of a path calibrated through codes
WORTH_DB = 0.1

Case = tuple[int | None, float, float, float]


def measured_gain(case: Case) -> tuple[float, float, float]:
    """Return gain, least and greatest, dB, of the best code over the best single exposure.

    Parameters
    ----------
    case : (seed of the walk or None, error of the path in px, read noise in e-, photo-electrons)
    """
    seed, error_px, read_noise_e, photons = case
    path = Trajectory.straight(STRAIGHT_PX)
    if seed is not None:
        path = boracchi_foi(np.random.default_rng([seed, 20]), max_length_px=WALK_PX)
    camera = Camera(photons_full_scale=photons, read_noise_e=read_noise_e, bits=16)
    problem = SearchProblem.along(path, chips=CHIPS, camera=camera)
    verdict = advise(problem, levels=(), path_error_px=error_px, threads=1).here
    code = verdict.best("code")
    snapshot = verdict.best("snapshot")
    assert code is not None
    assert snapshot is not None
    limits_db = gain_range_db(code, snapshot)
    assert limits_db is not None
    return code.psnr_db - snapshot.psnr_db, *limits_db


def columns(walks: int) -> dict[str, tuple[list[int | None], float]]:
    """Return walks' seeds (None: a straight motion) and path's error, px, of each panel."""
    seeds: list[int | None] = list(range(walks))
    return {
        f"straight motion of {STRAIGHT_PX:g} px": ([None], 0.0),
        f"walks of {WALK_PX:g} px, known exactly": (seeds, 0.0),
        f"walks of {WALK_PX:g} px, known to {ERROR_PX:g} px": (seeds, ERROR_PX),
    }


def print_table(name: str, gains_db: FloatArray) -> None:
    print(f"\n{name}: gain of the best code over the best single exposure, dB\n")
    print("| read noise, e- | " + " | ".join(f"{photons:,.0f}" for photons in LIGHT) + " |")
    print("|---:|" + "---:|" * len(LIGHT))
    for read_noise_e, row in zip(READ_NOISE, gains_db, strict=True):
        cells = [f"{mean:+.1f} ({low:+.1f} to {high:+.1f})" for mean, low, high in row]
        print(f"| {read_noise_e:g} | {' | '.join(cells)} |", flush=True)


def draw(tables: dict[str, FloatArray], image: Path) -> None:
    from cep.plots.canvas import new_figure, save

    figure = new_figure(11.5, 3.6)
    panels = figure.subplots(1, len(tables), sharey=True)
    for axes, (name, gains_db) in zip(panels, tables.items(), strict=True):
        mesh = axes.imshow(
            np.maximum(gains_db[..., 0], 0),
            cmap="Greens",
            vmin=0,
            vmax=3,
            origin="lower",
            aspect="auto",
        )
        for i, j in np.ndindex(gains_db.shape[:2]):
            mean_db, low_db, high_db = np.round(gains_db[i, j], 1) + 0.0  # no -0.0
            style = {"ha": "center", "color": "white" if mean_db > 1.8 else "black"}
            text = f"+{mean_db:.1f}" if mean_db >= WORTH_DB else "\u2013"
            axes.text(j, i, text, va="bottom", fontsize=9, **style)
            text = f"{low_db:.1f} to {high_db:.1f}".replace("-", "\u2212")
            axes.text(j, i - 0.08, text, va="top", fontsize=6, **style)
        axes.set_xticks(range(len(LIGHT)), [f"{photons:,.0f}" for photons in LIGHT], fontsize=7)
        axes.set_yticks(range(len(READ_NOISE)), [f"{e:g}" for e in READ_NOISE], fontsize=8)
        axes.set_title(name, fontsize=10)
        axes.set_xlabel("photo-electrons at full scale", fontsize=9)
    panels[0].set_ylabel("read noise, electrons", fontsize=9)
    figure.colorbar(mesh, ax=panels, label="gain of a code, dB (\u2013: expose for less)")
    save(figure, image)


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--walks", type=int, default=3, help="random walks")
    parser.add_argument("--image", type=Path, default=Path("docs/images/verdict-map.png"))
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    tables = {}
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        for name, (seeds, error_px) in columns(options.walks).items():
            cases = [
                (seed, error_px, read_noise_e, photons)
                for read_noise_e in READ_NOISE
                for photons in LIGHT
                for seed in seeds
            ]
            gains_db = np.reshape(
                list(pool.map(measured_gain, cases)),
                (len(READ_NOISE), len(LIGHT), len(seeds), 3),
            )
            tables[name] = np.median(gains_db, axis=2)
            print_table(name, tables[name])
    draw(tables, options.image)
    print(f"\n{options.image}")


if __name__ == "__main__":
    main()
