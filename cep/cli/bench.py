"""``cep bench``: comparisons with what others published, run again here; ``codes`` is here, the others beside."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cep.cli import bench_blind, bench_cep
from cep.cli.console import finish, progress, table
from cep.cli.options import Force, Json, Seed

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["bench"]

bench = typer.Typer(help="Compare with what others published.", no_args_is_help=True)
_FAMILY = "jeon"


bench.command("blind")(bench_blind.blind)
bench.command("cep")(bench_cep.cep)
bench.command("speed")(bench_blind.speed)


@bench.command("codes")
def codes(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME]...", help="Published codes; Jeon's table when none is named.")
    ] = None,
    time_s: Annotated[float, typer.Option("--time", help="Time of each search, s.")] = 30.0,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="File for the table, Markdown.")] = None,
    force: Force = False,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Search against published codes, each at its own number of chips and open chips; one code for both figures.

    Example: cep bench codes raskar-52 jeon-100 --time 60 -o codes.md
    """
    from cep.baselines import published as registry
    from cep.bench.codes import code_rows
    from cep.outputs import claim, write_text

    if not 0 < time_s < 1e6:
        raise ValueError(f"--time: must be above 0 seconds, got {time_s:g}")
    chosen = names or [name for name in registry.names() if name.startswith(_FAMILY)]
    known = [(name, registry.published(name).code) for name in chosen]
    if output is not None:
        claim([output], force=force)
    with progress("searching") as tick:
        rows = code_rows(known, time_s=time_s, seed=seed, progress=tick)
    head = ("code", "open", "its min |P|", "its noise, dB", "our min |P|", "our noise, dB", "better on both")
    lines = [
        (
            row.name,
            row.published.open_chips,
            f"{row.minima[0]:.4f}",
            f"{row.noise_db[0]:.2f}",
            f"{row.minima[1]:.4f}",
            f"{row.noise_db[1]:.2f}",
            "yes" if row.better else "no",
        )
        for row in rows
    ]
    if output is not None:
        text = [head, ("---",) * len(head), *lines]
        write_text(output, "".join("| " + " | ".join(map(_escaped, line)) + " |\n" for line in text))
    unfinished = len(known) - len(rows)
    result = {
        "file": output,
        "tables": {
            "codes": [
                {
                    "name": row.name,
                    "chips": row.published.chips,
                    "open": row.published.open_chips,
                    "bits": row.ours.bits,
                    "min_chip": {"published": row.minima[0], "ours": row.minima[1]},
                    "noise_db": {"published": row.noise_db[0], "ours": row.noise_db[1]},
                    "better": row.better,
                    "seconds": row.seconds,
                }
                for row in rows
            ]
        },
        "seed": seed,
        "warnings": [f"stopped early: {unfinished} codes are left out"] if unfinished else [],
    }

    def show(console: Console) -> None:
        console.print(table(f"smallest |P|, and noise relative to DC; {time_s:g} s each", head, lines))
        console.print(f"better on both: {sum(row.better for row in rows)} of {len(rows)}")

    finish(result, as_json=as_json, show=show)


def _escaped(value: object) -> str:
    return str(value).replace("|", "\\|")
