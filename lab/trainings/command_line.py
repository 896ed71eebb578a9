"""Command lines of the trainings: how a command ends."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from motdiff.files.inputs import printable


def run_command(parser: argparse.ArgumentParser, arguments: Sequence[str] | None) -> int:
    """Parse the arguments and call the chosen command, which is the default ``command`` of its
    parser.

    Returns
    -------
    int
        Exit code: 0 done, 2 for bad input, 1 for a failure, 130 after Ctrl-C. All but 0 print one
        line to stderr.
    """
    options = parser.parse_args(arguments)
    try:
        options.command(options)
    except (ValueError, FileNotFoundError, NotADirectoryError) as error:
        return _failed(error, 2)
    except (OSError, FloatingPointError) as error:
        return _failed(error, 1)
    except KeyboardInterrupt:
        return _failed("stopped", 130)
    return 0


def _failed(error: object, code: int) -> int:
    line = (str(error) or type(error).__name__).splitlines()[0]
    print(f"error: {printable(line)}", file=sys.stderr)
    return code
