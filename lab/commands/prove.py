"""``python -m lab prove``: the largest minimum of |P|, proven in blocks; and the proof's check."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from cep.commands.code_options import OpenChips, open_range
from cep.commands.console import INTERRUPTED, Page, finish, progress
from cep.commands.options import CommonOptions, command, option, output_option
from lab.commands.tables import Dask

if TYPE_CHECKING:
    from lab.block_proofs.check import ProofVerdict
    from lab.block_proofs.prove import BlockProof


@dataclass(frozen=True, kw_only=True)
class ProveOptions(CommonOptions):
    """Options of ``python -m lab prove``."""

    chips: int | None = option("--chips", "N", "Most chips of the codes.", min=1, max=60)
    open_chips: OpenChips = None
    workers: int | None = option(
        "--workers", "N", "Threads that judge blocks; as many as cores when omitted.", min=1
    )
    dask: Dask = None
    output: Path | None = output_option(
        "Folder of the proof, proof.jsonl; one that is there is continued. With --check a JSON"
        " file of the verdict.",
        metavar="PATH",
    )
    check: Path | None = option("--check", "FILE", "Check this proof.jsonl instead.")
    blocks: int | None = option(
        "--blocks",
        "N",
        "With --check: blocks to judge again, drawn by --seed; 4 when omitted.",
        min=1,
    )


@command(ProveOptions)
def prove(options: ProveOptions) -> None:
    """Prove the largest minimum of |P| over all codes, in blocks that are kept as they finish.

    The codes are those of at most so many chips, at any place of the exposure. Ctrl-C keeps the
    finished blocks; the same command goes on from them.

    --check counts a proof's blocks, judges every survivor, and judges folds of a few blocks again,
    by code that shares nothing with the search. A proof that does not hold is refused with the
    reason.

    Example: python -m lab prove --chips 44 --workers 2 -o proof44

    Example: python -m lab prove --check proof44/proof.jsonl --blocks 8
    """
    if options.check is not None:
        _check(options, options.check)
        return
    if options.blocks is not None:
        raise ValueError("--blocks: needs --check FILE")
    if options.chips is None or options.output is None:
        raise ValueError("--chips N and -o FOLDER: both are needed, or --check FILE")
    from os import cpu_count

    from lab.block_proofs.prove import prove as find

    chips_open = open_range(options.open_chips, options.chips)
    with progress("judging blocks") as tick:
        proof = find(
            options.chips,
            chips_open,
            folder=options.output,
            workers=options.workers or cpu_count() or 1,
            dask=options.dask,
            progress=lambda share, best: tick(share, f"{best.open_chips} open"),
        )
    is_whole = proof.finished == len(proof.plan.blocks)
    warnings = []
    if not is_whole:
        warnings.append(
            f"{proof.finished} of {len(proof.plan.blocks)} blocks are kept in {proof.file}: the"
            " same command goes on from there"
        )
    finish(
        {**proof.to_dict(), "seed": options.seed, "warnings": warnings},
        _page_proof(proof),
        as_json=options.as_json,
    )
    if not is_whole:
        raise typer.Exit(INTERRUPTED)


def _check(options: ProveOptions, file: Path) -> None:
    """Check a proof; refuse one that does not hold."""
    from dataclasses import asdict

    import numpy as np

    from lab.block_proofs.check import verify_proof
    from motdiff.files.json_files import json_text
    from motdiff.files.outputs import claim, write_text

    refused = {
        "--chips": options.chips,
        "--open": options.open_chips,
        "--workers": options.workers,
        "--dask": options.dask,
    }
    for name, reason in refused.items():
        if reason is not None:
            raise ValueError(f"{name}: not valid with --check, the file says it")
    output = options.output
    outputs = claim([] if output is None else [output], force=options.force, inputs=[file])
    with progress("checking") as tick:
        verdict = verify_proof(
            file,
            blocks=options.blocks or 4,
            rng=np.random.default_rng(options.seed),
            progress=tick,
        )
    if not verdict:
        raise ValueError(f"{file}: the proof does not hold: {verdict.reasons[-1]}")
    result = {"proof": file, **asdict(verdict), "seed": options.seed, "warnings": []}

    def save(temporary: Mapping[Path, Path]) -> None:
        if output is not None:
            write_text(temporary[output], json_text(result))

    finish(result, _page_verdict(verdict), as_json=options.as_json, outputs=outputs, save=save)


def _page_proof(proof: BlockProof) -> Page:
    plan = proof.plan
    yield (
        f"{proof.file}: {proof.finished} of {len(plan.blocks)} blocks,"
        f" {proof.judged:.3g} of {plan.codes:.3g} codes; {proof.seconds:.1f} s"
    )
    yield f"{proof.code.bits}: min |P| {proof.minimum.lower:.6f}"
    if proof.proven:
        yield (
            f"proven: no code of at most {plan.chips} chips with"
            f" {_open_range(plan.fewest, plan.most)} open is better"
        )


def _page_verdict(verdict: ProofVerdict) -> Page:
    yield (
        f"holds: no code of at most {verdict.chips} chips with"
        f" {_open_range(verdict.fewest_open, verdict.most_open)} open has a larger"
        f" minimum of |P| than {verdict.minimum:.6f}, of {verdict.bits}"
    )
    for reason in verdict.reasons:
        yield f"  {reason}"


def _open_range(fewest: int, largest: int) -> str:
    return str(largest) if fewest == largest else f"{fewest} to {largest}"
