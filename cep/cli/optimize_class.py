"""``cep optimize --all`` and ``--class``: one code for a class of motions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cep.cli.console import finish, table
from cep.cli.options import MOTION
from cep.workflows.search_options import SearchOptions, ending, problem_of

if TYPE_CHECKING:
    from rich.console import Console

    from cep.cli.console import Tick
    from cep.optics.camera import Camera
    from cep.optics.code import ShutterCode
    from cep.search.recipe import Found
    from cep.workflows.optimize import Search
    from cep.workflows.optimize_class import ClassOptimum
    from hw.device import DeviceProfile
    from motdiff.trajectory import Trajectory

__all__ = ["All", "ClassName", "ClassSize", "PathLength", "optimize_class", "refuse_with_class"]


All = Annotated[
    Path | None,
    typer.Option(
        "--all", metavar="FOLDER", rich_help_panel=MOTION,
        help="One code for all motions of a folder, FOLDER/*/trajectory.json, best in their mean decibels.",
    ),
]  # fmt: skip
ClassName = Annotated[
    str | None,
    typer.Option(
        "--class", metavar="walks|FILE", rich_help_panel=MOTION,
        help="One code for a class of motions, without calibration: walks (simulated hand shakes), or shakes cut from "
        "a gyro recording, each as long as the exposure.",
    ),
]  # fmt: skip
PathLength = Annotated[
    float | None,
    typer.Option(
        "--length", metavar="PX", rich_help_panel=MOTION,
        help="With --class: length of each walk, or larger side of each shake; 60 when omitted.",
    ),
]  # fmt: skip
ClassSize = Annotated[
    int | None,
    typer.Option(
        "--motions", metavar="N", min=2, max=256, rich_help_panel=MOTION,
        help="With --class: motions to draw for the search; 100 when omitted. It is judged on 300 others.",
    ),
]  # fmt: skip
_LENGTH_PX, _WALKS = 60.0, "walks"
_NONE: tuple[Trajectory, ...] = ()


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
            raise ValueError(f"{name}: not valid with {option}, which searches one code for many motions")


def optimize_class(
    wish: SearchOptions,
    how: Search,
    tick: Tick,
    *,
    folder: Path | None,
    motion_class: str | None,
    length_px: float | None,
    count: int | None,
    camera: Camera,
    profile: DeviceProfile | None,
    device: str | None,
    output: Path,
    force: bool,
    as_json: bool,
) -> Callable[[], None]:
    """Search and write one code for the motions of a folder, or of a class.

    Parameters
    ----------
    wish, how, camera, profile
        The options; ``wish.rule`` is the mean in any case.
    tick : Tick
    folder : Path, optional
        As ``cep calibrate FOLDER`` writes it.
    motion_class : str, optional
        Instead: "walks" or a gyro recording.
    length_px, count
        Of the class.
    device, output, force, as_json
        As the command's options.

    Returns
    -------
    function that prints what was found

    Raises
    ------
    ValueError
        If there are no motions, one cannot be read, an output is in the way, or the options conflict.
    """
    from functools import partial

    import numpy as np

    from cep.io.files import StoredCode, write_code
    from cep.io.outputs import claim
    from cep.search.playable import unplayable
    from cep.search.scenarios import class_scenarios
    from cep.workflows.optimize import described_search, stored_search
    from cep.workflows.optimize_class import OTHERS, check_class
    from cep.workflows.optimize_class import optimize_class as find
    from motdiff.io.trajectories import StoredMotion

    if how.method != "anneal":
        raise ValueError("--method: a code for a class of motions needs anneal")
    if folder is not None:
        if length_px is not None or count is not None:
            raise ValueError(f"{'--motions' if length_px is None else '--length'}: needs --class")
        motions, others = _motions_of(folder, wish.direction), _NONE
    else:
        assert motion_class is not None
        exposure_s = wish.chips * wish.chip_ns * 1e-9
        length_px = _LENGTH_PX if length_px is None else length_px
        motions, others = _drawn(motion_class, length_px, exposure_s, count, OTHERS, how.seed)
    wish = replace(wish, objective=wish.objective or "mse", rule="mean", direction="forward")
    rng = np.random.default_rng([how.seed, 2])
    problem = problem_of(wish, StoredMotion(motions[0]), camera=camera, profile=profile, rng=rng)
    problem = replace(problem, scenarios=class_scenarios(motions))
    check_class(problem)
    claim([output], force=force)
    drawn = None if motion_class is None else {"kind": motion_class, "length_px": length_px}
    described: dict[str, Any] = {
        "folder": None if folder is None else str(folder), "class": drawn, "device": device,
        **described_search(problem, how),
    }  # fmt: skip

    def keep(code: ShutterCode, found: Found) -> None:
        """Write the code before it is judged: Ctrl-C from here on must not lose it."""
        if reason := unplayable(code.bits, profile, wish.chip_ns):
            raise ValueError(reason)
        write_code(output, StoredCode(code, problem=stored_search(described, found)))

    best = find(motions, problem, how, others=others, progress=tick, on_found=keep)
    best.save(output, described=described)
    result = {"file": output, **best.to_dict(), "seed": how.seed, "warnings": list(best.warnings)}
    return partial(finish, result, as_json=as_json, show=partial(_show, best=best, file=output))


def _motions_of(folder: Path, direction: str) -> tuple[Trajectory, ...]:
    from cep.workflows.compare import as_designed
    from cep.workflows.optimize_folder import motions_in
    from motdiff.io.trajectories import read_motion

    return tuple(as_designed(read_motion(path).trajectory, direction) for path in motions_in(folder).values())


def _drawn(
    kind: str, length_px: float, exposure_s: float, count: int | None, others: int, seed: int
) -> tuple[tuple[Trajectory, ...], tuple[Trajectory, ...]]:
    import numpy as np

    from cep.workflows.optimize_class import DRAWN, draw_motions
    from motdiff.io.gyro_tables import read_gyro

    if not 1 <= length_px <= 1000:
        raise ValueError(f"--length: must lie within 1..1000 px, got {length_px:g}")
    if kind != _WALKS and not Path(kind).exists():
        raise ValueError(f"--class: must be walks or a gyro recording, and there is no file {kind}")
    gyro = None if kind == _WALKS else read_gyro(kind)
    made = []
    for part, number in enumerate((count or DRAWN, others)):
        rng = np.random.default_rng([seed, 4, part])
        try:
            made.append(draw_motions(number, length_px=length_px, rng=rng, gyro=gyro, exposure_s=exposure_s))
        except ValueError as error:  # only a recording's
            raise ValueError(
                f"{kind}: {str(error).partition(': ')[2]}; the exposure is --chips times --chip-ns"
            ) from None
    return made[0], made[1]


def _show(console: Console, *, best: ClassOptimum, file: Path) -> None:
    """Print a class code for people."""
    code, found = best.code, best.found
    console.print(f"{file}: {code.bits}")
    light = f"{code.open_chips} of {code.chips} chips open, {code.pulses} openings"
    console.print(f"{light}; {found.seconds:.1f} s, {ending(found.stopped, found.steps)}")
    unseen = best.others > 0
    rows = [
        (
            row.name if row.within_limits else f"{row.name} (outside the limits)",
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
