"""``cep cite``: BibTeX of the works behind methods, codes, restorations and figures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cep.commands.console import finish
from cep.commands.options import Force, Json, output_option

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rich.console import Console


def cite(
    methods: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="METHOD",
            help=(
                "Names as commands use them: estimators, published codes, ways to choose a code,"
                " objectives, "
                "restorations, figures; or keys of entries. All works when omitted."
            ),
        ),
    ] = None,
    output: Annotated[Path | None, output_option("File to write instead, as works.bib.")] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Print the BibTeX of the works behind methods, published codes, restorations and figures.

    Each entry stands below the names that it is behind. What is of this software has the
    software's own entry.

    Example: cep cite pmp dce raskar2006

    Example: cep cite -o works.bib
    """
    from cep.commands.citations import SOFTWARE, software
    from cep.commands.citations import cite as find
    from cep.files.outputs import claim
    from cep.files.works import works
    from motdiff.files.outputs import write_text

    outputs = claim([] if output is None else [output], force=force)
    found = find(methods or ())
    entries = {key: software() if key == SOFTWARE else works()[key] for key in found.works}
    result = {
        "works": [
            {
                "key": key,
                "type": one.kind,
                **{name: one.text(name) for name in one.fields},
                "behind": found.works[key],
                "bibtex": one.bibtex,
            }
            for key, one in entries.items()
        ],
        "unpublished": found.unpublished,
        "file": output,
    }

    def page(console: Console) -> None:
        if output is None:
            typer.echo(found.bibtex, nl=False)
        else:
            console.print(f"{output}: {len(found.works)} entries")

    def save(made: Mapping[Path, Path]) -> None:
        if output is not None:
            write_text(made[output], found.bibtex)

    finish(result, as_json=as_json, show=page, outputs=outputs, save=save)
