"""The code search against the best codes known, on straight and curved motion; side by side, in
one run.

    python -m lab.studies.search [--only frontier|jeon|exact|speed|direction|long] [--seconds 60]
    [--seed 0]

- frontier: 52 chips, 26 open; smallest |P| and noise of deconvolution (DC-normalised), and one
  code with both.
- jeon: each length and light of Jeon's table; one code that is better on both figures.
- exact: proven optima, and the codes counted per second.
- speed: moves per second and core of the annealer on one curved path, against plain numpy.
- direction: curved motion of unknown direction; noise gain of the worse direction, for no code,
  one-way and robust codes.
- long: 128 to 1024 chips, and 52 chips under the limits of a device.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from cep.codes.published import PUBLISHED
from cep.optics.code import ShutterCode
from cep.proofs.certify.minimum import min_chip
from cep.proofs.measure import measure
from cep.search.annealing.anneal import anneal
from cep.search.cost import CodeCost
from cep.search.exhaustive.exact import codes_to_count, exact
from cep.search.limits import RunLimits
from cep.search.problem import SearchProblem
from lab.bench.published_codes import chip_noise_db, code_rows
from lab.studies.inputs import study_parser
from motdiff.motions import boracchi_foi

SHAKES = 8


def figures(code: ShutterCode) -> tuple[float, float]:
    """Smallest |P| in chips, and noise in dB, DC-normalised."""
    return min_chip(code), chip_noise_db(code) + 20 * np.log10(code.open_chips)


def search(problem: SearchProblem, seconds: float, seed: int) -> tuple[ShutterCode, float]:
    started = time.perf_counter()
    result = anneal(problem, rng=np.random.default_rng(seed), steps=None, time_s=seconds)
    return result.code, time.perf_counter() - started


def frontier(seconds: float, seed: int) -> None:
    print("| 52 chips, 26 open | min P | noise, dB | s |\n|---|---|---|---|")
    lowest, noise = figures(PUBLISHED["raskar-52"])
    print(f"| raskar-52 (2006) | {lowest:.4f} | {noise:.2f} | - |")
    circle = SearchProblem.along(chips=52, open_range=(26, 26))
    for objective in ("min-mtf", "noise", (("min-mtf", 0.15), ("noise", 1.0))):
        code, took = search(replace(circle, objective=objective), seconds, seed)
        lowest, noise = figures(code)
        print(
            f"| {objective}: {code.bits} | {lowest:.4f} | {noise:.2f} | {took:.0f} |", flush=True
        )


def jeon(seconds: float, seed: int) -> None:
    print("| code | open | its min P | its noise, dB | our min P | our noise, dB | better | s |")
    print("|---|---|---|---|---|---|---|---|")
    names = sorted(
        (name for name in PUBLISHED if name.startswith("jeon")),
        key=lambda name: PUBLISHED[name].chips,
    )
    rows = code_rows([(name, PUBLISHED[name]) for name in names], time_s=seconds / 4, seed=seed)
    for row in rows:
        (a, c), (b, d) = row.minima, row.noise_db
        print(
            f"| {row.name} | {row.published.open_chips} | {a:.4f} | {b:.2f} | {c:.4f} | {d:.2f} "
            f"| {'yes' if row.better else 'no'} | {row.seconds:.0f} |"
        )
    print(f"\nbetter on both: {sum(row.better for row in rows)} of {len(rows)}")


def proven(seconds: float, seed: int) -> None:
    del seconds, seed
    print("| chips | min P, proven | open | codes | s | G codes/s |\n|---|---|---|---|---|---|")
    exact(SearchProblem.along(chips=21))  # compiling
    for chips in (20, 24, 28, 32, 36, 39):
        problem = SearchProblem.along(chips=chips)
        result = exact(problem)
        count = codes_to_count(problem)
        rate = count / result.seconds / 1e9
        print(
            f"| {chips} | {result.minimum.lower:.6f} | {result.code.open_chips} | {count:.3g} |"
            f" {result.seconds:.2f} | {rate:.3g} |",
            flush=True,
        )
    print("first code with min P > 2:")
    first = SearchProblem.along(chips=39, open_range=(19, 19))
    code, took = search(first, 15.0, 0)
    print(f"annealing, 39 chips, 19 open: {min_chip(code):.6f} in {took:.0f} s, {code.bits}")


def speed(seconds: float, seed: int) -> None:
    del seconds
    from cep.search.annealing.cooling import anneal_chain
    from cep.search.annealing.terms import lay_out

    path = boracchi_foi(np.random.default_rng(seed))
    problem = SearchProblem.along(path, chips=52, objective="noise", direction="forward")
    coarse = CodeCost(problem, oversampling=8)
    tables = lay_out(coarse)
    code = problem.random_codes(1, rng=np.random.default_rng(seed))[0].astype(np.int8)
    columns = coarse.rows.shape[-1]
    print(f"| {columns} frequencies, one core | moves/s |\n|---|---|")
    for moves in (10_000, 1_000_000):
        started = time.thread_time()
        steps = 0
        best = code
        for count, codes in anneal_chain(
            problem, tables, code, temperatures_db=(0.3, 0.1), moves=moves, seed=1
        ):
            steps = steps + count
            best = codes[0]
    print(f"| annealing | {steps / (time.thread_time() - started):.3g} |")
    started = time.thread_time()
    steps = 0
    for count, _ in anneal_chain(
        problem, tables, best, temperatures_db=(0.05, 0.04), moves=1_000_000, seed=1
    ):
        steps += count
    print(f"| annealing, cold, at a good code | {steps / (time.thread_time() - started):.3g} |")
    started = time.thread_time()
    flips = np.repeat(best[None], 52, axis=0) ^ np.eye(52, dtype=np.int8)
    for _ in range(20):
        coarse.cost_of(flips)
    print(f"| numpy, 52 flips at a time | {20 * 52 / (time.thread_time() - started):.3g} |")


def direction(seconds: float, seed: int) -> None:
    del seed
    search_s = min(seconds, 10.0)
    rows = []
    for shake in range(SHAKES):
        path = boracchi_foi(np.random.default_rng(shake))
        problem = SearchProblem.along(
            path, chips=52, open_range=(1, 52), objective="noise", direction="unknown"
        )
        one_way = replace(problem, direction="forward")
        forward, _ = search(one_way, search_s, shake)
        robust, _ = search(problem, search_s, shake)
        gains = [
            [measure(ordered, code, budget=0) for ordered in (path, path.reversed())]
            for code in (ShutterCode("1" * 52), forward, robust)
        ]
        line = [gains[0][0].noise_gain_db, gains[1][0].noise_gain_db, gains[1][1].noise_gain_db]
        line.append(max(gain.noise_gain_db for gain in gains[2]))
        line += [gains[1][0].dnf_db, max(gain.dnf_db for gain in gains[2])]
        rows.append(line)
        print(f"shake {shake}: " + "  ".join(f"{value:.2f}" for value in line), flush=True)
    names = (
        "no code",
        "one-way",
        "one-way, reversed",
        "robust, worse way",
        "one-way, DNF",
        "robust, DNF",
    )
    print("| " + " | ".join(names) + " |\n|" + "---|" * len(names))
    print("| " + " | ".join(f"{value:.2f}" for value in np.mean(rows, axis=0)) + " |")


def long_codes(seconds: float, seed: int) -> None:
    print("| chips | open | min P | noise, dB | s |\n|---|---|---|---|---|")
    for chips in (128, 256, 512, 1024):
        problem = SearchProblem.along(
            chips=chips, open_range=(chips // 2, chips // 2), objective="noise"
        )
        code, took = search(problem, seconds, seed)
        lowest, noise = figures(code)
        print(
            f"| {chips} | {code.open_chips} | {lowest:.4f} | {noise:.2f} | {took:.0f} |",
            flush=True,
        )
    problem = SearchProblem.along(
        chips=52, open_range=(20, 30), objective="noise", runs=RunLimits(min_open=2, min_closed=2)
    )
    code, took = search(problem, seconds / 2, seed)
    lowest, noise = figures(code)
    print(
        f"| 52, runs of 2 at least | {code.open_chips} | {lowest:.4f} | {noise:.2f} | {took:.0f} |"
    )


SECTIONS = {
    "frontier": frontier,
    "jeon": jeon,
    "exact": proven,
    "speed": speed,
    "direction": direction,
    "long": long_codes,
}


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--only", choices=SECTIONS)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    for name, section in SECTIONS.items():
        if options.only in (None, name):
            print(f"\n## {name}\n")
            section(options.seconds, options.seed)


if __name__ == "__main__":
    main()
