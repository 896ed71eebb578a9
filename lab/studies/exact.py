"""Proven optima on the unit circle, as the tables of docs/optima.md, and the speed of the scan.

    python -m lab.studies.exact [--most 36] [--most-by-open 20] [--threads 1]

Minima are proven to a millionth. "Codes" are all that a proof accounts for, up to a shift in time;
the scan takes up mirror images once. Seconds are of the processor, all threads together, with
compiling done before.
"""

from __future__ import annotations

import time

from cep.search.exhaustive.exact import ExactResult, ProofLog, exact
from cep.search.problem import SearchProblem
from lab.block_proofs.blocks import judge_block, plan_blocks
from lab.studies.inputs import study_parser


def timed(problem: SearchProblem, threads: int) -> tuple[ExactResult, float]:
    started = time.process_time()
    result = exact(problem, threads=threads)
    return result, time.process_time() - started


def scan_log(result: ExactResult) -> ProofLog:
    """Log of a scan; a proof that comes with the package has none."""
    assert isinstance(result.proof, ProofLog)
    return result.proof


def free(longest: int, threads: int) -> None:
    print(
        "| n | largest min &#124;P&#124; | k | length | code | codes | cpu s"
        " |\n|--:|--:|--:|--:|:--|--:|--:|"
    )
    for chips in range(8, longest + 1):
        result, seconds = timed(SearchProblem.along(chips=chips), threads)
        core = result.code.bits.strip("0")
        codes = sum(entry.codes for entry in scan_log(result).lengths)
        row = (
            chips,
            f"{result.proof.upper:.6f}",
            result.code.open_chips,
            len(core),
            f"`{core}`",
            f"{codes:.3g}",
            f"{seconds:.2f}",
        )
        print("| " + " | ".join(str(cell) for cell in row) + " |", flush=True)


def by_open(longest: int, threads: int) -> None:
    print(
        "\n| n | " + " | ".join(f"k={open_chips}" for open_chips in range(3, longest + 1)) + " |"
    )
    print("|--:|" + "--:|" * (longest - 2))
    codes: dict[int, str] = {}
    for chips in range(8, longest + 1):
        cells = [""] * (longest - 2)
        for open_chips in range(3, chips + 1):
            result, _ = timed(
                SearchProblem.along(chips=chips, open_range=(open_chips, open_chips)), threads
            )
            cells[open_chips - 3] = f"{result.proof.upper:.4f}"
            codes[open_chips] = result.code.bits.strip("0")
        print(f"| {chips} | " + " | ".join(cells) + " |", flush=True)
    print(f"\n| k | best code of at most {longest} chips |\n|--:|:--|")
    for open_chips, bits in sorted(codes.items()):
        print(f"| {open_chips} | `{bits}` |")


def speed(threads: int) -> None:
    for chips in (28, 32, 36):
        result, seconds = timed(SearchProblem.along(chips=chips), threads)
        judged_codes = sum(entry.judged for entry in scan_log(result).lengths)
        print(
            f"n = {chips}: {result.seconds:.2f} s, {seconds:.2f} cpu s with {threads} thread(s), "
            f"{judged_codes / seconds / 1e9:.2f} G codes a cpu second (each mirror pair counted"
            " once)"
        )


def compare(chips: int) -> None:
    """Print processor seconds of the scan with bit tables and of the folded one, both with the
    optimum as bound.
    """
    problem = SearchProblem.along(chips=chips)
    result, seconds = timed(problem, 1)
    plan = plan_blocks(chips, 1, chips)
    records = [
        judge_block(
            plan.chips, plan.fewest, plan.most, block.first, block.until, result.proof.lower
        )
        for block in plan.blocks
    ]
    assert sum(int(record["codes"]) for record in records) == plan.codes
    assert result.code.bits.strip("0") in " ".join(str(record["survivors"]) for record in records)
    folded = sum(float(record["seconds"]) for record in records)
    print(f"n = {chips}: bit tables {seconds:.2f} cpu s, folds {folded:.2f} cpu s", flush=True)


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument(
        "--most", type=int, default=36, help="chips of the last row, free open count"
    )
    parser.add_argument(
        "--most-by-open",
        type=int,
        default=20,
        help="chips of the last row, per open count; 0 for none",
    )
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument(
        "--compare", type=int, nargs="+", default=(), help="chips: only compare the two scans"
    )
    args = parser.parse_args()
    exact(SearchProblem.along(chips=20), threads=1)
    if args.compare:
        judge_block(12, 1, 12, 0, 25, 1.0)
        for chips in args.compare:
            compare(chips)
        return
    speed(args.threads)
    free(args.most, args.threads)
    if args.most_by_open:
        by_open(args.most_by_open, args.threads)


if __name__ == "__main__":
    main()
