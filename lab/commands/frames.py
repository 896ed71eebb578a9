"""``python -m lab frames``: codes of several exposures of one motion, restored together."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cep.commands.code_options import (
    CodeOptions,
    SearchRunOptions,
    ending,
    in_bits,
    objective_mix,
    saved_on_interrupt,
)
from cep.commands.console import Page, Table, finish, progress
from cep.commands.options import (
    CommonOptions,
    MotionOptions,
    TableFile,
    command,
    option,
    output_option,
    table_files,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lab.frames.optimum import FramesOptimum


@dataclass(frozen=True, kw_only=True)
class FramesOptions(CommonOptions, SearchRunOptions, CodeOptions, MotionOptions):
    """Options of ``python -m lab frames``."""

    frames: int = option("--frames", "N", "Exposures, each with its code.", 2, min=2)
    output: Path = output_option(
        "Files to write: code.json becomes code_1.json, code_2.json, ...", Path("code.json")
    )
    tables: TableFile = None


@command(FramesOptions)
def frames(options: FramesOptions) -> None:
    """Search the codes of exposures that complement each other and are restored together.

    One fills the frequencies that another loses. They are compared with the best single code,
    played in every exposure.

    Example: python -m lab frames --linear 52 --frames 2 --open 26 -o pair.json
    """
    with progress("searching") as tick:
        from cep.optics.path_limits import check_frame, check_resolved
        from cep.search.code_search import SearchOptions
        from lab.frames.optimum import optimize_frames
        from motdiff.files.outputs import claim

        motion = options.load_motion().trajectory
        problem = options.problem(motion, objective=objective_mix(options.objective or "mse"))
        check_frame(motion)
        check_resolved(motion, problem.chips)
        stem = options.output.stem
        files = [
            options.output.with_name(f"{stem}_{number}{options.output.suffix}")
            for number in range(1, options.frames + 1)
        ]
        outputs = claim(
            [*files, *table_files(options.tables)],
            force=options.force,
            inputs=[] if options.trajectory is None else [options.trajectory],
        )
        with saved_on_interrupt(outputs) as keep:
            best = optimize_frames(
                problem,
                SearchOptions(steps=options.steps, time_s=options.time_s, seed=options.seed),
                options.frames,
                progress=tick,
                on_found=lambda stored: keep(dict(zip(files, stored, strict=True))),
            )
    source = {"trajectory": options.trajectory, "linear_px": options.linear}
    finish(
        {
            "files": files,
            **best.to_dict(),
            "warnings": list(best.warnings),
            "seed": options.seed,
        },
        _page(best, files),
        as_json=options.as_json,
        outputs=outputs,
        save=lambda staged: best.save([staged[file] for file in files], source=source),
        tables=options.tables,
        summary=in_bits(best.search.codes),
    )


def _page(best: FramesOptimum, files: Sequence[Path]) -> Page:
    """Print the codes and what they are worth together for people."""
    codes = best.search.codes
    straight = best.problem.on_circle
    yield best.verdict.sentence
    for file, code in zip(files, codes, strict=True):
        yield f"{file}: {code.bits}"
    lowest = "min_chip" if straight else "min_mtf"
    columns = ("frames", "open", "min |P|, chips" if straight else "min MTF", "noise gain, dB")
    rows: list[tuple[object, ...]] = [
        (file.stem, code.open_chips, metrics.in_words(lowest), metrics.in_words("noise_gain_db"))
        for file, code, metrics in zip(files, codes, best.metrics, strict=True)
    ]
    for name, light, figures in (
        ("together", sum(code.open_chips for code in codes), best.joint),
        (
            f"best single code, {len(codes)} times",
            len(codes) * best.single.open_chips,
            best.repeated,
        ),
    ):
        noise_db = figures.noise_gain_db
        rows.append(
            (
                name,
                light,
                figures.min_chip if straight else figures.min_mtf,
                "> 100" if noise_db is None else noise_db,
            )
        )
    yield Table("on this motion (worse direction where unknown)", columns, rows)
    yield "together: root of the sum of |H|^2, its minimum as sampled"
    yield f"{best.search.seconds:.1f} s, {ending(best.search.stopped, best.search.steps)}"
