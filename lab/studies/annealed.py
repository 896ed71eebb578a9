"""The annealing against the proven optima of docs/optima.md, which it is not given: smallest |P|
and its share.

    python -m lab.studies.annealed [--chips 40 44 48 52] [--seeds 0 1] [--seconds 60]

Seconds are of the processor, on one thread, with compiling done before. 52 chips have 26 open,
others any number.
"""

from __future__ import annotations

import time

import numpy as np

from cep.optics.code import ShutterCode
from cep.proofs.certify.minimum import min_chip
from cep.search.annealing.anneal import anneal
from cep.search.optima import proven_optimum
from cep.search.problem import SearchProblem
from cep.search.search_result import SearchResult
from lab.studies.inputs import study_parser

CHIPS = (40, 41, 42, 43, 44, 45, 46, 47, 48, 52)


def annealed(problem: SearchProblem, seconds: float, seed: int) -> SearchResult:
    """Anneal for ``seconds`` of the processor: the wall clock counts what other processes do."""
    started = time.process_time()

    def stop_at_the_end(_share: float, _code: ShutterCode) -> None:
        if time.process_time() - started > seconds:
            raise KeyboardInterrupt

    rng = np.random.default_rng(seed)
    return anneal(
        problem, rng=rng, steps=None, time_s=100 * seconds, threads=1, progress=stop_at_the_end
    )


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--chips", type=int, nargs="+", default=CHIPS)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--seconds", type=float, default=60.0)
    options = parser.parse_args()
    annealed(SearchProblem.along(chips=40), 0.1, 0)  # compiling
    print("| chips | open | proven | annealed | share, % | million moves | cpu s | seed |")
    print("|--:|--:|--:|--:|--:|--:|--:|--:|")
    for seed in options.seeds:
        for chips in options.chips:
            problem = SearchProblem.along(
                chips=chips, open_range=(26, 26) if chips == 52 else None
            )
            proven = proven_optimum(problem)
            if proven is None:
                raise SystemExit(f"--chips: no proof for {chips} chips, see docs/optima.md")
            started = time.process_time()
            result = annealed(problem, options.seconds, seed)
            seconds = time.process_time() - started
            lowest = min_chip(result.code)
            share = 100 * lowest / proven.minimum.upper
            print(
                f"| {chips} | {result.code.open_chips} | {proven.minimum.upper:.4f} | {lowest:.4f}"
                f" | {share:.1f} | {result.steps / 1e6:,.0f} | {seconds:.1f} | {seed} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
