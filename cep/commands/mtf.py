"""``cep mtf``: MTFs of codes along a motion, drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cep.commands.console import Table, finish, progress
from cep.commands.options import FigureOptions, command, option, output_option

if TYPE_CHECKING:
    from cep.optics.code import ShutterCode
    from cep.proofs.mtf_curves import MtfRow


@dataclass(frozen=True, kw_only=True)
class MtfOptions(FigureOptions):
    """Options of ``cep mtf``."""

    codes: list[str] | None = option(
        "--code", "CODE", "Code to draw: bits, code.json or a name; may be repeated."
    )
    output: Path = output_option("Figure to write: .png, .pdf or .svg.", Path("mtf.png"))


@command(MtfOptions)
def mtf(options: MtfOptions) -> None:
    """Draw the MTFs of codes along a motion, in one and two dimensions, beside the open shutter's.

    Example: cep mtf --trajectory trajectory.json --code code.json --code raskar-52 -o mtf.png
    """
    from cep.codes.sources import code_label, load_code
    from cep.plots.canvas import check_figure_name, save
    from cep.plots.codes import mtf_figure
    from cep.proofs.mtf_curves import OPEN, compare_mtfs

    check_figure_name(options.output)
    motion = options.load_motion().trajectory
    figures = options.find_figures()
    codes: dict[str, ShutterCode] = {}
    for source in options.codes or []:
        label = code_label(source)
        while label in (OPEN, *codes):  # files in two folders may have one name
            label += "'"
        codes[label] = load_code(source)
    outputs = options.outputs(options.output)
    with progress("drawing"):
        curves = compare_mtfs(motion, codes, figures=figures, on_checked=outputs.check)
    finish(
        {
            "image": options.output,
            "curves": {name: row.to_dict() for name, row in curves.items()},
            "seed": options.seed,
        },
        [_table(curves, options.output)],
        as_json=options.as_json,
        outputs=outputs,
        save=lambda temporary: save(
            mtf_figure(motion, {name: row.code for name, row in curves.items()}),
            temporary[options.output],
        ),
        tables=options.tables,
    )


def _table(curves: Mapping[str, MtfRow], output: Path) -> Table:
    from cep.proofs.measure import figure_head, figure_in_words
    from cep.proofs.mtf_curves import OPEN

    heads = (figure_head(*item) for item in curves[OPEN].figures.items())
    rows = [
        (
            name,
            *(row.metrics.in_words(figure) for figure in ("min_mtf", "noise_gain_db", "mse_db")),
            *map(figure_in_words, row.figures.values()),
        )
        for name, row in curves.items()
    ]
    columns = ("code", "min MTF", "noise gain, dB", "MSE, dB", *heads)
    return Table(str(output), columns, rows)
