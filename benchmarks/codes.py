"""Shutter codes, measured: the published ones, the annealer's, and what an unknown direction costs on curved paths.

    python benchmarks/codes.py [--seconds 40] [--curved-seconds 10] [--motions 8] [--only league|straight|curved]

Noise gains are 10 log10 mean 1/|H|^2. On straight motion H is the code's polynomial in chips over the unit circle; on
curved paths it is light-true over the band [-0.5, 0.5]^2, and "DC" adds 20 log10 duty.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from cep.baselines.published import for_chips, names, published
from cep.code import ShutterCode
from cep.minimum import chip_minimum, min_chip
from cep.mtf import chip_noise_db, measure
from cep.search.anneal import anneal
from cep.search.bounds import bound
from cep.search.problem import SearchProblem
from motdiff.motions import boracchi_foi


def chip_row(name: str, code: ShutterCode, seconds: float | None = None) -> None:
    minimum, lower, noise = min_chip(code), chip_minimum(code).lower, chip_noise_db(code)
    # a grid near a true zero gives a finite figure that means nothing
    shown = (
        f"{noise:8.2f} {noise + 20 * np.log10(code.open_chips):8.2f}" if minimum > 1e-9 else f"{'inf':>8} {'inf':>8}"
    )
    took = "" if seconds is None else f"  {seconds:.1f} s"
    print(
        f"{name:22s} {code.chips:4d} {code.open_chips:4d} {minimum:8.4f} {lower:8.4f} {minimum / code.open_chips:7.4f} "
        f"{shown}{took}"
    )


def league() -> None:
    print("Published codes on the unit circle")
    print(f"{'code':22s} {'n':>4} {'k':>4} {'min |P|':>8} {'lower':>8} {'/k':>7} {'noise dB':>8} {'DC dB':>8}")
    for name in names():
        chip_row(name, published(name).code)


def straight(seconds: float) -> None:
    print(f"\nAnnealing at n = 52, k = 26 on the unit circle, {seconds:g} s each, one core")
    for objective in ("min-mtf", "noise"):
        problem = SearchProblem(chips=52, open_range=(26, 26), objective=objective)
        start = [entry.code for entry in for_chips(52)]
        found = anneal(problem, rng=np.random.default_rng(0), steps=None, time_s=seconds, start=start)
        chip_row(f"anneal {objective}", found.code, found.seconds)
        print(
            f"  {found.code.bits}  {found.steps / found.seconds:,.0f} moves/s; no code of 26 ones exceeds "
            f"min |P| {bound(problem).min_chip:.2f}"
        )


def curved(seconds: float, motions: int) -> None:
    print(f"\nCurved paths (Boracchi-Foi, 60 px), 52 chips, {seconds:g} s a search; noise gain dB, light-true (DC)")
    print(
        f"{'path':>6} {'no code':>15} {'one-way, along':>15} {'one-way, back':>15} {'both ways':>15} {'true min':>10}"
    )
    table = []
    for seed in range(motions):
        path = boracchi_foi(np.random.default_rng(seed), max_length_px=60.0)
        gains, lowest = [measure(path, ShutterCode("1" * 52), budget=0)], []
        for direction in ("forward", "unknown"):
            problem = SearchProblem.along(path, chips=52, open_range=(26, 26), objective="noise", direction=direction)
            code = anneal(problem, rng=np.random.default_rng(seed), steps=None, time_s=seconds).code
            ways = [measure(way, code, budget=0) for way in (path, path.reversed())]
            lowest.append(max(way.min_mtf for way in ways))
            gains += ways if direction == "forward" else [max(ways, key=lambda way: way.noise_gain_db)]
        row = [(gain.noise_gain_db, gain.dnf_db) for gain in gains]
        table.append(row)
        print(f"{seed:6d}", *(f"{gain:7.1f} ({dc:5.1f})" for gain, dc in row), f"{max(lowest):9.1e}")
    print(f"{'mean':>6}", *(f"{gain:7.1f} ({dc:5.1f})" for gain, dc in np.mean(table, axis=0)))
    print(f"{'std':>6}", *(f"{gain:7.1f} ({dc:5.1f})" for gain, dc in np.std(table, axis=0)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=40.0)
    parser.add_argument("--curved-seconds", type=float, default=10.0)
    parser.add_argument("--motions", type=int, default=8)
    parser.add_argument("--only", choices=["league", "straight", "curved"])
    chosen = parser.parse_args()
    began = time.monotonic()
    if chosen.only in (None, "league"):
        league()
    if chosen.only in (None, "straight"):
        straight(chosen.seconds)
    if chosen.only in (None, "curved"):
        curved(chosen.curved_seconds, chosen.motions)
    print(f"\n{time.monotonic() - began:.0f} s")


if __name__ == "__main__":
    main()
