"""The published shutter codes, measured anew, and what certificates prove and cost.

    python -m lab.studies.codes [--only league|certificates] [--table league.tex]

Noise gains are 10 log10 mean 1/|P|^2 of the code's polynomial P, in chips, over the unit circle;
"/ DC" adds 20 log10 of the open chips.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from cep.codes.published import CLAIMS, names, published
from cep.files.tables import Sheet, check_table_name, markdown_table, write_sheets
from cep.optics.code import ShutterCode
from cep.proofs.certify.certificate import certify
from cep.proofs.certify.minimum import chip_minimum
from cep.proofs.verify import verify
from lab.bench.published_codes import chip_noise_db
from lab.studies.inputs import refusals, study_parser
from motdiff.motions import boracchi_foi
from motdiff.trajectory import Trajectory


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
    for name, code, motion in rows:
        started = time.process_time()
        certificate = certify(code, motion)
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


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--only", choices=["league", "certificates"])
    parser.add_argument("--table", type=Path, help="also write the league: .tex, .csv or .md")
    chosen = parser.parse_args()
    if chosen.table is not None:
        with refusals(parser):
            check_table_name(chosen.table)
    started = time.monotonic()
    if chosen.only in (None, "league"):
        league(chosen.table)
    if chosen.only in (None, "certificates"):
        certificates()
    print(f"\n{time.monotonic() - started:.0f} s")


if __name__ == "__main__":
    main()
