"""Shutter codes, measured: the published ones, the annealer's, and what an unknown direction costs
on curved paths.

    python -m lab.studies.codes [--seconds 40] [--curved-seconds 10] [--motions 8]
                               [--only league|certificates|straight|curved] [--table league.tex]

Noise gains are 10 log10 mean 1/|H|^2. On straight motion H is the code's polynomial in chips over
the unit circle; on curved paths it is light-true over the band [-0.5, 0.5]^2, and "DC" adds 20
log10 duty.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from cep.codes.published import CLAIMS, for_chips, names, published
from cep.files.tables import Sheet, check_table_name, markdown_table, write_sheets
from cep.optics.code import ShutterCode
from cep.proofs.certify.certificate import certify
from cep.proofs.certify.minimum import chip_minimum
from cep.proofs.measure import measure
from cep.proofs.verify import verify
from lab.bench.published_codes import chip_noise_db
from lab.studies.inputs import study_parser
from motdiff.motions import boracchi_foi
from motdiff.trajectory import Trajectory


def chip_row(name: str, code: ShutterCode, seconds: float) -> None:
    minimum = chip_minimum(code)
    noise = chip_noise_db(code)
    print(
        f"{name:22s} {code.chips:4d} {code.open_chips:4d} {minimum.upper:8.4f}"
        f" {minimum.lower:8.4f}"
        f" {minimum.upper / code.open_chips:7.4f} {noise:8.2f}"
        f" {noise + 20 * np.log10(code.open_chips):8.2f}  {seconds:.1f} s"
    )


def league(file: Path | None) -> None:
    """Print the tables of docs/league.md, and write them to a .tex, .csv or .md file where one is
    named.
    """
    measured = []
    claimed = []
    for name in names():
        code = published(name).code
        minimum = chip_minimum(code)
        noise = chip_noise_db(code)
        grid = np.abs(np.fft.fft(code.array)).min()
        noise_figures = "inf", "inf"
        if minimum.upper > 0:
            noise_figures = f"{noise:.2f}", f"{noise + 20 * np.log10(code.open_chips):.2f}"
        proven = f"{minimum.lower:.4f} .. {minimum.upper:.4f}"
        measured.append(
            (
                name,
                code.chips,
                code.open_chips,
                proven,
                f"{minimum.upper / code.open_chips:.4f}",
                f"{grid:.4f}",
                *noise_figures,
            )
        )
    for name, (points, claim) in CLAIMS.items():
        code = published(name).code
        minimum = chip_minimum(code)
        true = f"{minimum.upper / code.open_chips:.4f}"
        claimed.append(
            (name, points, f"{claim:.6f}", true, f"{minimum.at[0]:.6f}", minimum.method)
        )
    heads = (
        "code",
        "n",
        "k",
        "min |P|, proven",
        "/ DC",
        "n-point DFT says",
        "noise, dB",
        "noise / DC, dB",
    )
    opponents = (
        "code",
        "points of the grid",
        "claimed min / DC",
        "proven min / DC",
        "where, cycles per chip",
        "proof",
    )
    sheets = [
        Sheet("Published codes, measured again", heads, measured),
        Sheet("Minima that their authors claim", opponents, claimed),
    ]
    print(
        "\n".join(
            f"{markdown_table(sheet.columns, [list(map(str, row)) for row in sheet.rows])}\n"
            for sheet in sheets
        )
    )
    if file is not None:
        write_sheets(sheets, file)


def certificates() -> None:
    """Print how tight certificates are, what they cost, and what checking them costs."""
    print("\nCertificates: CPU seconds of the proof and of the second opinion, after compiling")
    print(
        f"{'code and motion':36s} {'lower':>12} {'upper':>12} {'width':>8} {'proof':>7}"
        f" {'check':>7}  method, verdict"
    )
    shakes = [boracchi_foi(np.random.default_rng(seed), max_length_px=60.0) for seed in range(3)]
    rng = np.random.default_rng(0)
    rows: list[tuple[str, ShutterCode, Trajectory | None]] = [
        (name, published(name).code, None) for name in ("raskar-52", "merl-31-t62", "jeon-200")
    ]
    rows.append(("random, 1024 chips", random_code(rng, 1024), None))
    rows += [
        (f"random, 52 chips, shake {shake}", random_code(rng, 52), path)
        for shake, path in enumerate(shakes)
        for _ in range(5)
    ]
    # a long shake gives nearly every code a zero; a short one, or a short opening, need not
    for shake, path in enumerate(shakes):
        rows.append((f"one chip of 52, shake {shake}", ShutterCode("1".center(52, "0")), path))
        rows += [
            (
                f"random, 52 chips, shake {shake} at 5 px",
                random_code(rng, 52),
                path.scaled(1 / 12),
            )
            for _ in range(2)
        ]
    certify(ShutterCode("1101"), shakes[0])
    for name, code, path in rows:
        started = time.process_time()
        certificate = certify(code, path)
        proven = time.process_time()
        verdict = verify(certificate.to_dict(), bits=code.bits)
        checked = time.process_time()
        print(
            f"{name:36s} {certificate.lower:12.8f} {certificate.upper:12.8f}"
            f" {certificate.relative_width:8.1e}"
            f" {proven - started:7.3f} {checked - proven:7.3f}  {certificate.method},"
            f" {'confirmed' if verdict.holds else verdict.reasons[-1]}"
        )


def random_code(rng: np.random.Generator, chips: int) -> ShutterCode:
    return ShutterCode("1" + "".join(rng.choice(["0", "1"], chips - 1)))


def straight(seconds: float) -> None:
    from cep.search.annealing.anneal import anneal
    from cep.search.bounds import bound
    from cep.search.problem import SearchProblem

    print(f"\nAnnealing at n = 52, k = 26 on the unit circle, {seconds:g} s each, one core")
    for objective in ("min-mtf", "noise"):
        problem = SearchProblem.along(chips=52, open_range=(26, 26), objective=objective)
        start = [entry.code for entry in for_chips(52)]
        result = anneal(
            problem, rng=np.random.default_rng(0), steps=None, time_s=seconds, start=start
        )
        chip_row(f"anneal {objective}", result.code, result.seconds)
        print(
            f"  {result.code.bits}  {result.steps / result.seconds:,.0f} moves/s; no code of 26"
            " ones"
            f" exceeds min |P| {bound(problem).min_chip:.2f}"
        )


def curved(seconds: float, motions: int) -> None:
    from cep.search.annealing.anneal import anneal
    from cep.search.problem import SearchProblem

    print(
        f"\nCurved paths (Boracchi-Foi, 60 px), 52 chips, {seconds:g} s a search; noise gain dB,"
        " light-true (DC)"
    )
    print(
        f"{'path':>6} {'no code':>15} {'one-way, along':>15} {'one-way, back':>15}"
        f" {'both ways':>15} {'true min':>10}"
    )
    table = []
    for seed in range(motions):
        path = boracchi_foi(np.random.default_rng(seed), max_length_px=60.0)
        gains = [measure(path, ShutterCode("1" * 52), budget=0)]
        lowest = []
        for direction in ("forward", "unknown"):
            problem = SearchProblem.along(
                path, chips=52, open_range=(26, 26), objective="noise", direction=direction
            )
            code = anneal(
                problem, rng=np.random.default_rng(seed), steps=None, time_s=seconds
            ).code
            metrics = [measure(ordered, code, budget=0) for ordered in (path, path.reversed())]
            lowest.append(max(ordered.min_mtf for ordered in metrics))
            gains += (
                metrics
                if direction == "forward"
                else [max(metrics, key=lambda ordered: ordered.noise_gain_db)]
            )
        row = [(gain.noise_gain_db, gain.dnf_db) for gain in gains]
        table.append(row)
        print(
            f"{seed:6d}", *(f"{gain:7.1f} ({dc:5.1f})" for gain, dc in row), f"{max(lowest):9.1e}"
        )
    print(f"{'mean':>6}", *(f"{gain:7.1f} ({dc:5.1f})" for gain, dc in np.mean(table, axis=0)))
    print(f"{'std':>6}", *(f"{gain:7.1f} ({dc:5.1f})" for gain, dc in np.std(table, axis=0)))


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--seconds", type=float, default=40.0)
    parser.add_argument("--curved-seconds", type=float, default=10.0)
    parser.add_argument("--motions", type=int, default=8)
    parser.add_argument("--only", choices=["league", "certificates", "straight", "curved"])
    parser.add_argument("--table", type=Path, help="also write the league: .tex, .csv or .md")
    chosen = parser.parse_args()
    if chosen.table is not None:
        check_table_name(chosen.table)
    started = time.monotonic()
    if chosen.only in (None, "league"):
        league(chosen.table)
    if chosen.only in (None, "certificates"):
        certificates()
    if chosen.only in (None, "straight"):
        straight(chosen.seconds)
    if chosen.only in (None, "curved"):
        curved(chosen.curved_seconds, chosen.motions)
    print(f"\n{time.monotonic() - started:.0f} s")


if __name__ == "__main__":
    main()
