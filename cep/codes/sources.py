"""A code by its bits, its file, its published name, or an object of the user's own."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from cep.codes.published import published
from cep.files.files import StoredCode, read_code
from cep.optics.code import ShutterCode
from motdiff.files.plugins import is_reference, load_object


def load_code(source: str, *, chip_ns: int | None = None) -> ShutterCode:
    """Return a code by its bits, file or name: :func:`find_code` without what the file says of it.

    Examples
    --------
    >>> load_code("bdinr-8", chip_ns=250_000)
    ShutterCode(bits='11100101', chip_ns=250000)
    """
    return find_code(source, chip_ns=chip_ns).code


def load_codes(sources: Sequence[str]) -> tuple[ShutterCode, ...]:
    """Return the codes of several photos of one motion; ``open`` has the chips of the others.

    Bits and published names say nothing of time: their chips last as long as those of the first
    code that does.

    Examples
    --------
    >>> [code.bits for code in load_codes(["open", "bdinr-8"])]
    ['11111111', '11100101']
    """
    known = [None if source == "open" else load_code(source) for source in sources]
    chips = next((code.chips for code in known if code is not None), 1)
    stated = [
        None if code is None else stated_chip_ns(source, code)
        for source, code in zip(sources, known, strict=True)
    ]
    chip_ns = next(
        (time_ns for time_ns in stated if time_ns is not None), ShutterCode("1").chip_ns
    )
    return tuple(
        (
            code
            if code is not None and time_ns is not None
            else ShutterCode(code.bits if code else "1" * chips, chip_ns)
        )
        for code, time_ns in zip(known, stated, strict=True)
    )


def stated_chip_ns(source: str, code: ShutterCode) -> int | None:
    """Return the chip time, ns, that comes with a code; None for bits and published names, which
    state none.
    """
    return code.chip_ns if code_file(source) is not None or is_reference(source) else None


def find_code(source: str, *, chip_ns: int | None = None) -> StoredCode:
    """Return the code that a text stands for, with what its file says of it.

    Parameters
    ----------
    source : str
        Bits as ``1011``; a ``code.json``; the name of a published code as ``raskar-52``; or
        ``module:name``, a :class:`ShutterCode`, bits, or a function without arguments that returns
        either.
    chip_ns : int, optional
        Chip time, ns, instead of the code's own.

    Raises
    ------
    ValueError
        If it is none of these; the line says so.
    OSError
        If the file cannot be read.
    """
    file = code_file(source)
    if file is not None:
        stored = read_code(file)
    elif source.startswith(("0", "1")) or not source:
        stored = StoredCode(ShutterCode(source))
    elif is_reference(source):
        stored = StoredCode(_own(source))
    else:
        try:
            stored = StoredCode(published(source).code)
        except ValueError:
            raise ValueError(
                f"{source[:40]!r} is no code: give bits as 1011, a code.json file, a published"
                " code's name as raskar-52, or module:name"
            ) from None
    return (
        stored if chip_ns is None else replace(stored, code=ShutterCode(stored.code.bits, chip_ns))
    )


def code_file(source: str) -> Path | None:
    """Return the file that a code is read from; None where its bits or a name are given.

    Bits are bits however many there are: a file name ends at some 255 characters, and asking for a
    longer one fails.
    """
    if not set(source) - set("01"):
        return None
    return Path(source) if source.endswith(".json") or os.path.isfile(source) else None


def code_label(source: str) -> str:
    """Name a code for tables and legends: a file by its stem, long bits by their head."""
    if (file := code_file(source)) is not None:
        return file.stem
    return source if len(source) <= 16 else f"{source[:12]}... ({len(source)})"


def _own(reference: str) -> ShutterCode:
    found = load_object(reference)
    try:
        made = found() if callable(found) else found
        return made if isinstance(made, ShutterCode) else ShutterCode(made)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{reference}: is no code ({error})") from None
