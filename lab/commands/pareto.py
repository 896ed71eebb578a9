"""``python -m lab pareto``: what minimum, noise and light codes can have together."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cep.commands.code_options import SEARCH, CodeOptions, chips_option, ending, in_bits
from cep.commands.console import Page, Table, finish, progress
from cep.commands.options import (
    CommonOptions,
    MotionOptions,
    PlotFile,
    TableFile,
    command,
    option,
    output_option,
    table_files,
)

if TYPE_CHECKING:
    from lab.fronts.comparison import FrontComparison


_FIGURES = (".png", ".pdf", ".svg")


@dataclass(frozen=True, kw_only=True)
class ParetoOptions(CommonOptions, CodeOptions, MotionOptions):
    """Options of ``python -m lab pareto``."""

    chips: int | None = chips_option("Number of chips; 52 when omitted.", fewest=2)
    time_s: float | None = option(
        "--time",
        "S",
        "Search for so many seconds, 60 when --steps is omitted too: the front depends on"
        " the machine.",
        panel=SEARCH,
    )
    steps: int | None = option(
        "--steps",
        "N",
        "Make so many moves, however long it takes: the same seed and moves give the same"
        " front. With --time whichever ends first.",
        panel=SEARCH,
        min=0,
    )
    output: Path = output_option("File to write.", Path("front.json"))
    plot: PlotFile = None
    tables: TableFile = None


@command(ParetoOptions)
def pareto(options: ParetoOptions) -> None:
    """Search the codes that no other beats in minimum, noise and light together; Ctrl-C keeps what
    is found so far.

    A code is beaten when another is at least as good in all three and better in one: its smallest
    |H|, larger is better; its noise gain, 10 log10 mean 1/|H|^2, smaller is better; its open
    chips, more is better. Codes with a zero are left out. Both figures are light-true: a darker
    code pays for its lost light.

    Without a motion the front is for straight motion at any speed: the minimum is that of |P| over
    the whole unit circle, in chips, and the noise that of P alone, without the blur within a chip.
    Along a straight motion the minimum is over the band's continuum, and both include that blur.
    Along a curved path nearly every code has true zeros at single frequencies: the front is then
    over noise and light alone, noise and minimum are those over the samples, and the minimum,
    which proves nothing, is shown for comparison.

    Along a motion it is said first whether to code at all: verdict, choice and gains_db of --json,
    as of cep optimize, are null without a motion. single is the best single exposure, measured as
    the front is.

    Example: python -m lab pareto --chips 52 --open 22:40 --time 60 -o front.json --plot front.png
    """
    with progress("searching") as tick:
        from lab.fronts.comparison import pareto as find_front
        from motdiff.files.outputs import Outputs
        from motdiff.files.trajectories import stated_uncertainty_px

        output = options.output
        picture = options.plot or output.with_suffix(".png")
        if picture.suffix.lower() not in _FIGURES:
            raise ValueError(
                f"--plot: must end in {', '.join(_FIGURES[:-1])} or {_FIGURES[-1]}, got {picture}"
            )
        if picture == output:
            raise ValueError(f"--plot: must be another file than the output, got {picture}")
        file = options.trajectory
        error_px = None
        motions = []
        if file is not None or options.linear is not None:
            stored = options.load_motion()
            motions = [stored.trajectory]
            error_px = None if file is None else stated_uncertainty_px(stored, file)
        problem = options.problem(*motions)
        outputs = Outputs(
            (output, picture, *table_files(options.tables)),
            options.force,
            () if file is None else (file,),
        )
        front = find_front(
            problem,
            steps=options.steps,
            time_s=options.time_s,
            seed=options.seed,
            path_error_px=error_px or 0.0,
            progress=tick,
            on_checked=outputs.check,
        )
    result = {
        "file": output,
        "plot": picture,
        **front.to_dict(),
        "seed": options.seed,
        "warnings": front.warnings,
    }
    source = {"trajectory": file, "linear_px": options.linear}
    finish(
        result,
        _page(front, output, picture),
        as_json=options.as_json,
        outputs=outputs,
        save=lambda staged: front.save(staged[output], staged[picture], source=source),
        tables=options.tables,
        summary=in_bits(point.code for point in front.front.points),
    )


def _page(comparison: FrontComparison, output: Path, picture: Path) -> Page:
    from cep.proofs.measure import HOPELESS_DB

    front = comparison.front
    knees = comparison.knees
    if comparison.verdict is None:
        yield (
            "Whether to code at all depends on the motion and the camera: cep advise --linear PX"
            " says it."
        )
    else:
        yield comparison.verdict.sentence
    ending_text = f"{front.seconds:.1f} s, {ending(front.stopped, front.steps)}"
    yield f"{output}, {picture}: {len(front.points)} codes that none found beats; {ending_text}"
    minimum_name = {"chips": "min |P|, chips", "light-true": "min MTF"}.get(
        front.unit, "min MTF, sampled"
    )
    references = {f"published: {name}": point for name, point in comparison.published.items()}
    if comparison.single is not None:
        references = {"best single exposure": comparison.single, **references}
    rows = [
        (
            name,
            point.open_chips,
            point.minimum,
            point.noise_db if point.noise_db <= HOPELESS_DB else f"> {HOPELESS_DB:.0f}",
            point.mse_db,
        )
        for name, point in (*knees.items(), *references.items())
    ]
    columns = ("code", "open", minimum_name, "noise gain, dB", "MSE, dB")
    yield Table(f"{front.problem.chips} chips", columns, rows)
    for name, point in knees.items():
        yield f"{name}: {point.code.bits}"
