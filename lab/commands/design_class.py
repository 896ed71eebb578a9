"""``python -m lab design-class``: one code for a class of motions."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cep.commands.code_options import (
    CodeOptions,
    SearchRunOptions,
    ending,
    exposure_seconds,
    objective_mix,
    openings,
    saved_on_interrupt,
)
from cep.commands.console import Page, Table, finish, progress
from cep.commands.options import (
    MOTION,
    CommonOptions,
    TableFile,
    argument,
    command,
    option,
    table_files,
)
from cep.search.chip_count import STANDARD_CHIPS

if TYPE_CHECKING:
    from lab.class_code.optimum import ClassOptimum

_CHIP_S = 1e-3  # where no exposure is given


@dataclass(frozen=True, kw_only=True)
class DesignClassOptions(CommonOptions, SearchRunOptions, CodeOptions):
    """Options of ``python -m lab design-class``."""

    motion_class: str = argument(
        "CLASS",
        "walks (simulated hand shakes); a gyro recording, its z axis along the line of"
        " sight, cut into shakes as long as the exposure; or a folder with motions,"
        " FOLDER/*/trajectory.json.",
    )
    length: float | None = option(
        "--length",
        "PX",
        "Length of each walk, or larger side of each shake; 60 when omitted.",
        panel=MOTION,
    )
    motions: int | None = option(
        "--motions",
        "N",
        "Motions to draw for the search; 100 when omitted. The code is judged on 300 others.",
        panel=MOTION,
        min=2,
        max=256,
    )
    tables: TableFile = None


@command(DesignClassOptions)
def design_class(options: DesignClassOptions) -> None:
    """Search the code that is best for a class of motions, in their mean decibels.

    Where a single motion's order in time cannot be had, a code for its class takes its place.

    Fields of --json that need a word:

    - motions, mean_db, other_motions, others_db: the mean of the objective's decibels over the
      motions of the search, and over motions drawn anew, null for a folder.
    - behind_db and behind_error_db, of each of baselines: how much worse it is there, and the
      standard error.

    Example: python -m lab design-class walks --length 60 --chips 32 --open 16

    Example: python -m lab design-class shots_motion --chips 40 --open 40%:60%
    """
    with progress("searching") as tick:
        from cep.search.code_search import SearchOptions
        from lab.class_code.motions import class_scenarios, motion_class
        from lab.class_code.search import optimize_class
        from motdiff.files.outputs import claim

        stated_s = exposure_seconds(options.exposure)
        exposure_s = (options.chips or STANDARD_CHIPS) * _CHIP_S if stated_s is None else stated_s
        motions = motion_class(
            options.motion_class,
            length_px=options.length,
            count=options.motions,
            exposure_s=exposure_s,
            seed=options.seed,
        )
        problem = options.problem(
            *class_scenarios(motions.searched),
            objective=objective_mix(options.objective or "mse"),
            rule="mean",
        )
        outputs = claim([options.output, *table_files(options.tables)], force=options.force)
        with saved_on_interrupt(outputs) as keep:
            best = optimize_class(
                motions.searched,
                problem,
                SearchOptions(steps=options.steps, time_s=options.time_s, seed=options.seed),
                held_out=motions.held_out,
                progress=tick,
                on_found=lambda stored: keep({options.output: stored}),
            )
    finish(
        {
            "file": options.output,
            **best.to_dict(),
            "warnings": [*motions.warnings, *best.warnings],
            "seed": options.seed,
        },
        _page(best, options.output),
        as_json=options.as_json,
        outputs=outputs,
        save=lambda staged: best.save(staged[options.output], source=motions.source),
        tables=options.tables,
        summary=best.code.bits,
    )


def _page(best: ClassOptimum, file: Path) -> Page:
    """Print a class code for people."""
    code = best.code
    result = best.outcome
    yield best.verdict
    yield f"{file}: {code.bits}"
    light = f"{code.open_chips} of {code.chips} chips open, {openings(code)}"
    yield f"{light}; {result.seconds:.1f} s, {ending(result.stopped, result.steps)}"
    unseen = best.held_out > 0
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
    where = [
        f"on the {best.motions} searched",
        *([f"on {best.held_out} others"] if unseen else []),
    ]
    objective = best.problem.objective if isinstance(best.problem.objective, str) else "mix"
    yield Table(
        f"mean {objective} over the motions, dB, lower is better",
        ("code", "open", *where, "behind this code", "standard error"),
        rows,
    )
