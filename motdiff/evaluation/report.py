"""Report files of an evaluation: text, CSV and JSON tables, and pictures."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from motdiff.evaluation.pictures import contact_sheet, reliability_plot
from motdiff.evaluation.run import Outcome
from motdiff.evaluation.tables import calibration, calibration_text, summaries_csv, summary_text, summed_up
from motdiff.io.outputs import new_files, write_bytes

__all__ = ["report_document", "report_text", "write_report"]


def report_text(outcome: Outcome) -> str:
    """Tables as text."""
    if not outcome.rows:
        return "nothing was measured"
    text = summary_text(summed_up(outcome.rows))
    bins = calibration(outcome.rows)
    return f"{text}\n\n{calibration_text(bins)}" if bins else text


def report_document(outcome: Outcome, options: Mapping[str, object]) -> dict[str, object]:
    """Tables ready for JSON; missing figures are None, paths are text.

    Parameters
    ----------
    outcome : Outcome
    options : mapping, options of the command
    """
    document = {
        "options": dict(options),
        "stopped": outcome.stopped,
        "tables": [asdict(summary) for summary in summed_up(outcome.rows)],
        "calibration": [asdict(b) for b in calibration(outcome.rows)],
        "failures": [
            {"set": r.set, "case": r.case, "method": r.method, "failure": r.failure} for r in outcome.rows if r.failure
        ],
    }
    return {name: _plain(part) for name, part in document.items()}


def write_report(outcome: Outcome, document: Mapping[str, object], out: Path) -> None:
    """Write tables.csv, tables.json, reliability.png and sheet_SET.png beside rows.csv.

    Parameters
    ----------
    outcome : Outcome
    document : mapping, of :func:`report_document`
    out : folder
    """
    if not outcome.rows:
        return
    contents = {
        "tables.csv": summaries_csv(summed_up(outcome.rows)).encode(),
        "tables.json": (json.dumps(document, indent=1) + "\n").encode(),
    }
    if bins := calibration(outcome.rows):
        contents["reliability.png"] = reliability_plot(bins)
    for name, kernels in outcome.kernels.items():
        contents[f"sheet_{name}.png"] = contact_sheet(outcome.shown[name], kernels)
    with new_files(out / name for name in contents) as made:
        for name, content in contents.items():
            write_bytes(made[out / name], content)


def _plain(value: object) -> object:
    if isinstance(value, dict):
        return {name: _plain(part) for name, part in value.items()}
    if isinstance(value, list):
        return [_plain(part) for part in value]
    if isinstance(value, float) and math.isnan(value):
        return None
    return str(value) if isinstance(value, Path) else value
