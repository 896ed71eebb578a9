"""What a blind or speed table leaves behind: tables for people and programs, every cell, and a figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cep.bench.blind.picture import blind_figure, shown
from cep.bench.blind.run import Plan
from cep.bench.blind.tables import cells_csv
from cep.bench.engine import Outcome
from cep.bench.figures import FIGURE_SUFFIXES, write_figure
from cep.bench.layout import means_in_words, tables_csv, tables_json, tables_markdown
from cep.bench.tables import Table
from cep.outputs import new_folder
from motdiff.evaluation.measure import RESTORATION

__all__ = ["outputs", "write_report"]

_RESTORED = (f"PSNR and SSIM are those of the photo's luminance restored, up to shift, by {RESTORATION}.",)


def outputs(name: str) -> tuple[str, ...]:
    """Files of the table ``name``."""
    figures = (f"{name}{suffix}" for suffix in FIGURE_SUFFIXES)
    return (f"{name}.md", f"{name}.csv", f"{name}.json", f"{name}-cells.csv", *figures)


def write_report(
    folder: Path,
    name: str,
    tables: Sequence[Table],
    *,
    plan: Plan,
    outcome: Outcome,
    command: str,
    warnings: Sequence[str],
    pictured: Sequence[str] = (),
    unmeasured: Mapping[str, str] | None = None,
    force: bool = False,
) -> dict[str, Path]:
    """Write NAME.md, .csv, .json and NAME-cells.csv, and NAME.png and .pdf where methods are pictured; all or nothing.

    Parameters
    ----------
    folder : Path, made where it is missing
    name : str
    tables : sequence of Table
    plan : Plan
    outcome : Outcome
    command : str
        What makes them again.
    warnings : sequence of str
        All of them, the plan's too.
    pictured : sequence of methods
    unmeasured : mapping from method to reason
        Told of, with those of which every cell failed.
    force : bool
        Whether existing files may be replaced.

    Returns
    -------
    dict from a file's name to its path

    Raises
    ------
    ValueError
        If a file exists and ``force`` is not given.
    OSError
        If one cannot be written.
    """
    lines = shown(outcome.results, methods=pictured) if pictured else []
    with new_folder(folder, outputs(name), force=force) as made:
        text = _introduction(name, plan, outcome, tables, command, warnings) + tables_markdown(tables)
        absent = {**(unmeasured or {}), **_failed(outcome)}
        text += "".join(f"\n{method} is not measured: {reason}.\n" for method, reason in absent.items())
        if lines:
            write_figure(blind_figure(lines, pictured), made, name)
            text += f"\n![photos, kernels and what each method restores]({name}.png)\n"
        machines = outcome.machines
        texts = {
            ".md": text,
            ".csv": tables_csv(tables),
            ".json": tables_json(
                tables, command=command, seed=plan.protocol.seed, machines=machines, warnings=warnings
            ),
            "-cells.csv": cells_csv(outcome.figures, outcome.failures),
        }
        for ending, content in texts.items():
            (made / f"{name}{ending}").write_text(content, encoding="utf-8", newline="")
        names = sorted(item.name for item in made.iterdir())
    return {item: folder / item for item in names}


def _introduction(
    name: str, plan: Plan, outcome: Outcome, tables: Sequence[Table], command: str, warnings: Sequence[str]
) -> str:
    machines = "; ".join(_in_words(machine) for machine in outcome.machines)
    restored = any(column.figure == "psnr_db" for table in tables for column in table.columns)
    head = [
        f"# The {name} table",
        "",
        f"Made by `{command}`, protocol `{plan.protocol.name}`, seed {plan.protocol.seed}, on",
        f"{machines or 'no machine'}.",
        f"{_counts(plan)}.",
        means_in_words(tables),
        *(_RESTORED if restored else ()),
        *(f"\n- {warning}" for warning in warnings),
        "",
        "",
    ]
    return "\n".join(head)


def _counts(plan: Plan) -> str:
    """Count what is photographed; a folder may hold less than the protocol asks for."""
    photos, motions, taken = (len({cell.name[place] for cell in plan.cells}) for place in (1, 2, slice(1, 3)))
    if not any("motion" in cell.arguments for cell in plan.cells):
        return f"{_number(taken, 'photo')} with real blur, of {_number(photos, 'scene')}"
    if taken == photos * motions:
        return f"{_number(photos, 'photo')}, each with {_number(motions, 'motion')}"
    return f"{_number(photos, 'photo')}, {_number(motions, 'motion')}, {taken} pairs of them"


def _number(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def _failed(outcome: Outcome) -> dict[str, str]:
    """Return a reason for each method without a single figure."""
    measured = {name[0] for name, own in outcome.figures.items() if own}
    return {name[0]: reason for name, reason in outcome.failures.items() if name[0] not in measured}


def _in_words(machine: Mapping[str, Any]) -> str:
    versions = machine["versions"]
    packages = ", ".join(f"{package} {versions[package]}" for package in ("numpy", "torch") if versions.get(package))
    return f"{machine['processor']}, {machine['cores']} cores, Python {machine['python']}, {packages}"
