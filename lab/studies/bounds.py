"""Bounds: what no code can exceed, by which argument, how long it takes, and how far the best code
found stays below.

    python -m lab.studies.bounds [--seconds 5] [--skip-curve-noise]

min |P| in chips on the unit circle; min |H| times n along a motion, so that both count open chips;
noise in dB, 10 log10 mean 1/|H|^2, light-true. "found" anneals for each objective for so many
seconds, one core.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from cep.search.annealing.anneal import anneal
from cep.search.bounds import bound
from cep.search.cost import CodeCost
from cep.search.problem import SearchProblem
from lab.relaxed_bounds.dual_proofs import relaxed_bound
from lab.studies.inputs import study_parser
from motdiff.motions import boracchi_foi
from motdiff.trajectory import Trajectory

CHIPS = 52
OPEN = (26, 26)


def problems() -> dict[str, SearchProblem]:
    curve = boracchi_foi(np.random.default_rng(0), max_length_px=60.0)
    ramp = Trajectory.from_samples(
        np.stack([60 * np.linspace(0, 1, 50) ** 2, np.zeros(50)], axis=1)
    )
    along = SearchProblem.along
    return {
        "circle n=52 k=26": SearchProblem.along(chips=CHIPS, open_range=OPEN),
        "circle n=32": SearchProblem.along(chips=32),
        "circle n=12 k=6": SearchProblem.along(chips=12, open_range=(6, 6)),
        "straight 60 px": along(Trajectory.straight(60.0), chips=CHIPS, open_range=OPEN),
        "straight 30 px": along(Trajectory.straight(30.0), chips=CHIPS, open_range=OPEN),
        "accelerated 60 px": along(ramp, chips=CHIPS, open_range=OPEN, direction="forward"),
        "curve, one way": along(curve, chips=CHIPS, open_range=OPEN, direction="forward"),
        "curve, both ways": along(curve, chips=CHIPS, open_range=OPEN, direction="unknown"),
    }


def row(name: str, problem: SearchProblem, seconds: float, *, noise: bool) -> None:
    for goal in ("min-mtf", "noise") if noise else ("min-mtf",):
        goal_problem = replace(problem, objective=goal)
        cells = []
        started = time.perf_counter()
        result = bound(goal_problem)
        took = time.perf_counter() - started
        quick = result.noise if goal == "noise" else result.min_mtf * problem.chips
        winner = result.method["noise" if goal == "noise" else "min_mtf"]
        cells.append(f"{quick:8.4f} {winner:17s}{took:6.2f} s")
        started = time.perf_counter()
        relaxed, proofs = relaxed_bound(goal_problem)
        took = time.perf_counter() - started
        tight = relaxed if goal == "noise" else relaxed * problem.chips
        checked = all(proof.check() for proof in proofs)
        cells.append(f"{tight:8.4f}{took:6.2f} s{'' if checked else ' PROOF FAILS'}")
        code = anneal(goal_problem, rng=np.random.default_rng(0), steps=None, time_s=seconds).code
        metrics = problem.measure(code, budget=0)
        if not problem.scenarios:
            reached = CodeCost.fine(goal_problem).exact_cost(code)
            reached = reached if goal == "noise" else 10 ** (-reached / 20) * problem.chips
        else:
            reached = metrics.noise_gain_db if goal == "noise" else metrics.min_mtf * problem.chips
        print(f"{name:18s} {goal:8s} {cells[0]}  {cells[1]}  found {reached:8.4f}", flush=True)


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument(
        "--skip-curve-noise",
        action="store_true",
        help="the longest relaxations, up to a minute each",
    )
    chosen = parser.parse_args()
    for name, problem in problems().items():
        row(
            name,
            problem,
            chosen.seconds,
            noise=not (chosen.skip_curve_noise and name.startswith("curve")),
        )


if __name__ == "__main__":
    main()
