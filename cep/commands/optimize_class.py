"""``cep optimize --all`` and ``--class``: one code for a class of motions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cep.commands.console import table
from cep.commands.options import MOTION
from cep.search.search_options import ending, openings

if TYPE_CHECKING:
    from rich.console import Console

    from cep.commands.search_run import SearchRun
    from cep.optics.code import ShutterCode
    from cep.search.optimize_class import ClassOptimum, ClassTask
    from cep.search.recipe import Found


All = Annotated[
    Path | None,
    typer.Option(
        "--all",
        metavar="FOLDER",
        rich_help_panel=MOTION,
        help=(
            "One code for all motions of a folder, FOLDER/*/trajectory.json, best in their mean"
            " decibels."
        ),
    ),
]
ClassName = Annotated[
    str | None,
    typer.Option(
        "--class",
        metavar="walks|FILE",
        rich_help_panel=MOTION,
        help=(
            "One code for a class of motions, without calibration: walks (simulated hand shakes),"
            " or shakes cut from a gyro recording (its z axis along the line of sight), each as"
            " long as the exposure."
        ),
    ),
]
PathLength = Annotated[
    float | None,
    typer.Option(
        "--length",
        metavar="PX",
        rich_help_panel=MOTION,
        help="With --class: length of each walk, or larger side of each shake; 60 when omitted.",
    ),
]
ClassSize = Annotated[
    int | None,
    typer.Option(
        "--motions",
        metavar="N",
        min=2,
        max=256,
        rich_help_panel=MOTION,
        help=(
            "With --class: motions to draw for the search; 100 when omitted. It is judged on 300"
            " others."
        ),
    ),
]


def refuse_with_class(option: str, given: Mapping[str, bool]) -> None:
    """Refuse options that a class of motions takes no notice of.

    Parameters
    ----------
    option : str
        "--all" or "--class".
    given : mapping from an option to whether it was given

    Raises
    ------
    ValueError
        If one was.
    """
    for name, there in given.items():
        if there:
            raise ValueError(
                f"{name}: not valid with {option}, which searches one code for many motions"
            )


def optimize_class(task: ClassTask, run: SearchRun) -> Callable[[], None]:
    """Search and write one code for many motions.

    Parameters
    ----------
    task : ClassTask
    run : SearchRun

    Returns
    -------
    function that prints what was found

    Raises
    ------
    ValueError
        If the output is in the way, or the device cannot play the code.
    """
    from functools import partial

    from cep.files.files import StoredCode, write_code
    from cep.search.optimize import stored_search
    from cep.search.optimize_class import optimize_class as find

    outputs = run.outputs()
    outputs.check()

    def alone(code: ShutterCode, found: Found, made: Mapping[Path, Path]) -> None:
        """Write the code without what it is worth."""
        write_code(
            made[run.output], StoredCode(code, problem=stored_search(task.described, found))
        )

    with run.keeping() as keep:
        best = find(
            task.motions,
            task.problem,
            run.how,
            others=task.others,
            progress=run.tick,
            on_found=lambda code, found: keep([code], partial(alone, code, found)),
        )
    result = {"file": run.output, **best.to_dict(), "warnings": [*task.warnings, *best.warnings]}
    return run.shown(
        result,
        partial(_show, best=best, file=run.output),
        outputs=outputs,
        codes=[best.code],
        save=lambda made: best.save(made[run.output], described=task.described),
    )


def _show(console: Console, *, best: ClassOptimum, file: Path) -> None:
    """Print a class code for people."""
    code = best.code
    found = best.found
    console.print(best.verdict)
    console.print(f"{file}: {code.bits}")
    light = f"{code.open_chips} of {code.chips} chips open, {openings(code)}"
    console.print(f"{light}; {found.seconds:.1f} s, {ending(found.stopped, found.steps)}")
    unseen = best.others > 0
    rows = [
        (
            row.label,
            row.code.open_chips,
            row.mean_db,
            *([row.others_db] if unseen else []),
            row.behind_db,
            row.behind_error_db,
        )
        for row in best.rows
    ]
    where = [f"on the {best.motions} searched", *([f"on {best.others} others"] if unseen else [])]
    objective = best.problem.objective if isinstance(best.problem.objective, str) else "mix"
    console.print(
        table(
            f"mean {objective} over the motions, dB, lower is better",
            ("code", "open", *where, "behind this code", "standard error"),
            rows,
        )
    )
