"""Goldens: run every command with small fixed inputs, and compare what checkouts print and write.

A refactoring that should change nothing is held against a record of the checkout before it::

    python -m lab.studies.goldens record --root BEFORE -o before
    python -m lab.studies.goldens record --root AFTER -o after --inputs before/inputs
    python -m lab.studies.goldens compare before after

Each case runs in a fresh folder with copies of the inputs. ``DIR/NAME`` then holds ``stdout``,
``stderr``, ``exit``, ``files.json`` (the files written, with their SHA-256) and in ``files``
copies of the small ones. What differs from run to run, as paths, times and rates, is replaced by
placeholders first: see ``RULES`` and ``COSTS``. The inputs are drawn here and by the commands of
``PREPARATION``; with ``--inputs`` those of an earlier record are taken instead, so that a
difference in one of these commands does not show in all other cases.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from lab.studies.goldens.comparison import compare
from lab.studies.goldens.recording import PreparationError, record
from lab.studies.inputs import study_parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Returns
    -------
    int
        Exit code: 0 done and nothing differs, 1 something differs, 2 bad input.
    """
    parser = study_parser(__doc__)
    verbs = parser.add_subparsers(required=True, dest="verb")
    recording = verbs.add_parser("record", help="run all cases of a checkout")
    recording.add_argument("--root", type=Path, required=True, help="the checkout, with its .venv")
    recording.add_argument(
        "-o", "--out", type=Path, required=True, help="folder of the record, a new one"
    )
    recording.add_argument("--inputs", type=Path, help="inputs of an earlier record, DIR/inputs")
    recording.add_argument(
        "--only", default="", metavar="PATTERN", help="only cases whose name matches"
    )
    comparing = verbs.add_parser("compare", help="compare two records")
    comparing.add_argument("before", type=Path)
    comparing.add_argument("after", type=Path)
    comparing.add_argument("--lines", type=int, default=40, help="lines to print of a case")
    options = parser.parse_args(arguments)
    if options.verb == "record":
        if options.out.exists():
            parser.error(f"{options.out}: exists")
        if not (options.root / ".venv" / "bin" / "cep").exists():
            parser.error(f"--root: {options.root} is no checkout with a .venv/bin/cep")
        if options.inputs is not None and not options.inputs.is_dir():
            parser.error(f"--inputs: there is no folder {options.inputs}")
        try:
            record(options.root, options.out, inputs=options.inputs, only=options.only)
        except PreparationError as error:
            parser.error(str(error))
        return 0
    for folder in (options.before, options.after):
        if not (folder / "seconds.json").is_file():  # written last
            parser.error(f"{folder}: is no record that came to its end: it has no seconds.json")
    return 0 if compare(options.before, options.after, most_lines=options.lines) else 1


if __name__ == "__main__":
    raise SystemExit(main())
