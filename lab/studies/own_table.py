"""Codes of the search that lose to a row of their own comparison.

    python -m lab.studies.own_table [--problems 14] [--steps 20000] [--seed 0]

Random problems: walks, arcs and straight lines of 20 to 60 px, 16 to 64 chips, each objective,
cameras of little and much read noise. ``lost`` is by how many dB the best row that keeps the
problem's limits beats the returned code, by the problem's own objective; "free" counts rows
outside the limits as well, such as a snapshot with fewer open chips.
"""

from __future__ import annotations

import numpy as np

from cep.optics.camera import Camera
from cep.search.code_search import SearchOptions, search_code
from cep.search.cost import CodeCost
from cep.search.objectives import OBJECTIVES
from cep.search.problem import SearchProblem, open_range_of_duty
from lab.studies.inputs import study_parser
from lab.studies.motions import circular_arc
from motdiff.motions import boracchi_foi
from motdiff.trajectory import Trajectory


def random_problem(rng: np.random.Generator) -> SearchProblem:
    kind = rng.choice(["walk", "arc", "straight"])
    length = float(rng.uniform(20, 60))
    if kind == "walk":
        path = boracchi_foi(rng, max_length_px=length)
    elif kind == "arc":
        path = circular_arc(rng.uniform(0.5, 3.0), length_px=length, samples=40)
    else:
        path = Trajectory.straight(length)
    chips = int(rng.integers(16, 65))
    low = float(rng.uniform(0.1, 0.5))
    return SearchProblem.along(
        path,
        chips=chips,
        objective=str(rng.choice(list(OBJECTIVES))),
        open_range=open_range_of_duty(chips, low, min(1.0, low + 0.4)),
        camera=Camera(
            photons_full_scale=float(10 ** rng.uniform(3, 5)),
            read_noise_e=float(10 ** rng.uniform(0.3, 2)),
        ),
    )


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--problems", type=int, default=14)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    print(
        "chips  objective   code, dB   lost, dB  to                               lost free,"
        " dB  to"
    )
    losses = []
    for index in range(options.problems):
        problem = random_problem(rng)
        result = search_code(problem, SearchOptions(steps=options.steps, seed=index), threads=1)
        fine = CodeCost.fine(problem)
        path_cost = fine.exact_cost(result.code)
        costs = {row.name: fine.exact_cost(row.code) for row in result.baselines}
        within = {row.name for row in result.baselines if problem.allows(row.code)}
        best = min(within, key=costs.__getitem__)
        free = min(costs, key=costs.__getitem__)
        losses.append((path_cost - costs[best], path_cost - costs[free]))
        print(
            f"{problem.chips:5d}  {problem.objective!s:10s} {path_cost:9.3f} "
            f" {losses[-1][0]:9.3f} "
            f" {best:31s}  {losses[-1][1]:13.3f}  {free}",
            flush=True,
        )
    table = np.array(losses)
    lost = (table > 1e-6).sum(axis=0)
    worst = table.max(axis=0)
    print(f"lost within the limits: {lost[0]} of {len(table)}, up to {worst[0]:.3f} dB")
    print(f"lost to any row: {lost[1]} of {len(table)}, up to {worst[1]:.3f} dB")


if __name__ == "__main__":
    main()
