"""Codes that were found are not lost while a command still compares them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cep.files.code_files import StoredCode
    from cep.optics.code import ShutterCode
    from motdiff.files.outputs import Outputs


@contextmanager
def saved_on_interrupt(outputs: Outputs) -> Iterator[Callable[[Mapping[Path, StoredCode]], None]]:
    """Write codes on Ctrl-C that are found but not yet compared; another error names them.

    What it yields is called with each file's code as soon as they are known.
    """
    from dataclasses import replace

    from cep.files.code_files import write_code

    codes: dict[Path, StoredCode] = {}
    try:
        yield codes.update
    except KeyboardInterrupt:
        if codes:
            summary = in_bits(stored.code for stored in codes.values())
            # the code alone: the rest is not made yet
            with replace(outputs, paths=tuple(codes)).written(summary=summary) as staged:
                for path, stored in codes.items():
                    write_code(staged[path], stored)
        raise
    except Exception as error:
        if codes:
            error.add_note(f"found: {in_bits(stored.code for stored in codes.values())}")
        raise


def in_bits(codes: Iterable[ShutterCode]) -> str:
    """Write codes for an error line."""
    return ", ".join(code.bits for code in codes)
