"""``cep bench cep``: every way to choose a shutter code, side by side."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cep.cli.bench_options import (
    Cache,
    Dask,
    Data,
    Engine,
    Job,
    Quick,
    Workers,
    figures_of,
    run_job,
    show_tables,
    spelled,
)
from cep.cli.options import Force, Json, output_option

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.console import Console

    from cep.bench.coded.protocol import CodedProtocol
    from cep.bench.index import Part
    from cep.cli.console import Tick

__all__ = ["cep", "cep_job"]


def cep(
    data: Data = None,
    protocol: Annotated[
        str,
        typer.Option(
            "--protocol", metavar="NAME|FILE", help="paper, ours, or a .toml file like cep/bench/coded/ours.toml."
        ),
    ] = "paper",
    designs: Annotated[
        str,
        typer.Option(
            "--designs", metavar="NAME,...", help="Ways to choose the code, as open,dnf,both-ways; all when omitted."
        ),
    ] = "",
    quick: Quick = False,
    workers: Workers = None,
    dask: Dask = None,
    cache: Cache = None,
    output: Annotated[Path, output_option("Folder to write into.", metavar="FOLDER")] = Path("bench-cep"),
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Compare codes by the photos they give: the paper's table III, and ours with real borders, light and directions.

    Every row takes the same sharp photos along the same motions, and every search has the same budget. Finished cells
    are kept: stopped by Ctrl-C, the same command with --force goes on.

    Example: cep bench cep --quick --protocol ours -o coded
    """
    engine = Engine.of(output, cache=cache, workers=workers, dask=dask)
    job = cep_job(output, engine, data=data, protocol=protocol, designs=designs, quick=quick, force=force)
    run_job(job, as_json=as_json)


def cep_job(
    output: Path, engine: Engine, *, data: Path | None, protocol: str, designs: str, quick: bool, force: bool
) -> Job:
    """Plan the coded-exposure table; the parameters are the options of :func:`cep`."""
    from cep.bench.coded.designs import DESIGNS
    from cep.bench.coded.protocol import coded_protocol
    from cep.bench.coded.report import OUTPUTS, write_coded_report
    from cep.bench.coded.run import measure_coded
    from cep.bench.coded.tables import coded_tables
    from cep.bench.index import Part, first_table
    from cep.outputs import claim_folder

    claim_folder(output, OUTPUTS, force=force)
    chosen = coded_protocol(protocol)
    chosen = chosen.quick if quick else chosen
    names = [name.strip() for name in designs.split(",")] if designs else list(DESIGNS)
    photos, warnings = _photos(data, chosen)
    given = {"--data": data and data.resolve().name, "--protocol": Path(protocol).name, "--designs": designs}
    command = spelled("cep", given, quick=quick)

    def run(tick: Tick) -> tuple[Part, Callable[[Console], None]]:
        measured = measure_coded(
            chosen, photos, cache=engine.cache, designs=names, workers=engine.workers, dask=engine.dask, progress=tick
        )
        all_warnings = [*warnings, *measured.warnings]
        if measured.failures:
            name, reason = next(iter(measured.failures.items()))
            all_warnings.append(f"{len(measured.failures)} cells failed, the first: {name}: {reason}")
        if measured.missing:
            all_warnings.append("stopped early: cells are left out; the same command with --force goes on")
        tables = coded_tables(measured)
        files = write_coded_report(output, tables, measured, command=command, warnings=all_warnings, force=force)
        part = Part(
            f"Coded exposure, {chosen.name}", command, first_table(tables), figures_of(tables), files,
            measured.failures, measured.missing, all_warnings, measured.machines,
        )  # fmt: skip
        return part, lambda console: show_tables(console, tables)

    about = {"folder": output, "protocol": chosen.name, "designs": names}
    return Job(about, run)


def _photos(data: Path | None, protocol: CodedProtocol) -> tuple[dict[str, Path], list[str]]:
    """Pick the sharp photos, and say what keeps them from being what the protocol asks for."""
    from cep.bench.coded.run import scene_px
    from cep.bench.photos import BUNDLED_WARNING, bundled_photos, photo_folder, pick
    from cep.bench.scenes import labels_of

    paths = bundled_photos() if data is None else photo_folder(data)
    picked = pick(paths, protocol.photos, least_px=scene_px(protocol))
    warnings = []
    if data is None:
        warnings.append(BUNDLED_WARNING)
    if len(picked) < protocol.photos:
        warnings.append(f"{len(picked)} photos are large enough, the protocol asks for {protocol.photos}")
    return dict(zip(labels_of(picked), picked, strict=True)), warnings
