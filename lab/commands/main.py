"""The commands of ``python -m lab``: comparisons with published work, Pareto fronts."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import typer

from cep.commands.console import lines_of
from cep.commands.help_pages import Command, Group
from cep.commands.main import run_app
from lab.commands import bench, design_class, frames, pareto, prove

app = typer.Typer(
    name="lab",
    cls=Group,
    help=(
        "The laboratory of coded-exposure: comparisons with what others published, and fronts of"
        " codes. Trainings are python -m lab.trainings.NAME, studies python -m lab.studies.NAME."
    ),
    epilog=(
        "All tables, small: python -m lab bench --quick -o bench\n\n"
        "A method of yours: python -m lab bench blind --methods pmp,mymodule:MyEstimator\n\n"
        "A code of yours: python -m lab bench cep --quick --code my=101100111000\n\n"
        "A front of codes: python -m lab pareto --chips 52 --open 20:32 -o front.json"
    ),
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    add_completion=False,
)


@app.callback()
def _root() -> None:
    pass  # a group without work of its own


app.add_typer(bench.bench, name="bench", cls=Group)
app.command("pareto")(pareto.pareto)
app.command("prove")(prove.prove)
app.command("design-class")(design_class.design_class)
app.command("frames")(frames.frames)
for _group in (app, bench.bench):
    for _command in _group.registered_commands:
        _command.cls = Command


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command of the laboratory and return its exit code.

    Parameters
    ----------
    arguments : sequence of str, optional
        The command line without the program's name; that of this process when omitted.
    """
    if arguments is None:
        arguments = sys.argv[1:]
    with lines_of("lab"):
        return run_app(app, list(arguments) or ["--help"], name="python -m lab")
