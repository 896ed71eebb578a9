"""``cep optimize --frames``: codes of several exposures of one motion, restored together."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from cep.commands.console import table
from cep.search.search_options import Task, ending

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from cep.commands.search_run import SearchRun
    from cep.search.annealing.frames import FramesResult
    from cep.search.frames import FramesOptimum


def optimize_frames(task: Task, frames: int, run: SearchRun) -> Callable[[], None]:
    """Search and write the codes of several frames, beside the best single code played in every
    frame.

    Parameters
    ----------
    task : Task
    frames : int
        As of :func:`cep.search.frames.optimize_frames`.
    run : SearchRun

    Returns
    -------
    function that prints what was found

    Raises
    ------
    ValueError
        If the method is not to anneal, an output is in the way, or the device cannot play a code.
    """
    from functools import partial

    from cep.search.frames import optimize_frames as find_frames
    from cep.search.frames import write_frames

    stem = run.output.stem
    suffix = run.output.suffix
    files = [run.output.with_name(f"{stem}_{number}{suffix}") for number in range(1, frames + 1)]

    outputs = run.outputs(*files)

    def alone(found: FramesResult, made: Mapping[Path, Path]) -> None:
        """Write the codes without what they are worth."""
        write_frames([made[file] for file in files], found, described=task.described)

    with run.keeping(*files) as keep:
        best = find_frames(
            task.problem,
            run.how,
            frames,
            progress=run.tick,
            on_checked=outputs.check,
            on_found=lambda found: keep(found.codes, partial(alone, found)),
        )
    result = {"files": files, **best.to_dict(), "warnings": list(best.warnings)}
    return run.shown(
        result,
        partial(_show, best=best, files=files),
        outputs=outputs,
        codes=best.found.codes,
        save=lambda made: best.save([made[file] for file in files], described=task.described),
    )


def _show(console: Console, *, best: FramesOptimum, files: Sequence[Path]) -> None:
    """Print the codes and what they are worth together for people."""
    codes = best.found.codes
    straight = best.problem.on_circle
    console.print(best.verdict.sentence)
    for file, code in zip(files, codes, strict=True):
        console.print(f"{file}: {code.bits}")
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
        noise = figures.noise_gain_db
        rows.append(
            (
                name,
                light,
                figures.min_chip if straight else figures.min_mtf,
                "> 100" if noise is None else noise,
            )
        )
    console.print(table("on this motion (worse direction where unknown)", columns, rows))
    console.print("together: root of the sum of |H|^2, its minimum as sampled")
    console.print(f"{best.found.seconds:.1f} s, {ending(best.found.stopped, best.found.steps)}")
