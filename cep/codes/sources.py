"""Codes by their bits, file, published name, or as a user-defined object."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from cep.codes.published import published
from cep.files.code_files import StoredCode, read_code
from cep.optics.code import ShutterCode
from motdiff.files.plugins import is_reference, load_object

COMPLEMENT = "complement:"
"""Before a code: the one that is open where that is closed, for a second shutter."""

_SHARED = ("device", "camera", "scene")


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
    codes = {source: load_code(source) for source in sources if source != "open"}
    # photos of one motion last equally long: the open shutter has the chips of the others
    chips = next((code.chips for code in codes.values()), 1)
    chip_times = [stated_chip_ns(source, code) for source, code in codes.items()]
    chip_ns = next(
        (time_ns for time_ns in chip_times if time_ns is not None), ShutterCode("1").chip_ns
    )
    codes["open"] = ShutterCode("1" * chips, chip_ns)
    for source, time_ns in zip(codes, chip_times, strict=False):
        if time_ns is None:
            codes[source] = ShutterCode(codes[source].bits, chip_ns)
    return tuple(codes[source] for source in sources)


def stated_chip_ns(source: str, code: ShutterCode) -> int | None:
    """Return the chip time, ns, that comes with a code; None for bits and published names."""
    if code_file(source) is not None or is_reference(source.removeprefix(COMPLEMENT)):
        return code.chip_ns
    return None


def find_code(source: str, *, chip_ns: int | None = None) -> StoredCode:
    """Return the code that a text stands for, with what its file says of it.

    ValueError if it is none of these; the line says so. OSError if the file cannot be read.

    Parameters
    ----------
    source : str
        Bits as ``1011``; a ``code.json``; the name of a published code as ``raskar-52``; or
        ``module:name``, a :class:`ShutterCode`, bits, or a function without arguments that returns
        either. ``complement:`` before any of them is open where that code is closed.
    chip_ns : int, optional
        Chip time, ns, instead of the code's own.
    """
    if source.startswith(COMPLEMENT):
        stored = find_code(source.removeprefix(COMPLEMENT), chip_ns=chip_ns)
        # its shutter, camera and scene are those of the first
        about = {name: stored.problem[name] for name in _SHARED if name in stored.problem}
        return StoredCode(stored.code.complement(), problem=about)
    file = code_file(source)
    # in this order: a file may be named as a code is, and bits are never looked up as a name
    if file is not None:
        stored = read_code(file)
    elif source.startswith(("0", "1")) or not source:
        stored = StoredCode(ShutterCode(source))
    elif is_reference(source):
        stored = StoredCode(_load_own(source))
    else:
        try:
            stored = StoredCode(published(source).code)
        except ValueError:  # its list of names says nothing of files and bits
            raise ValueError(
                f"{source[:40]!r} is no code: give bits as 1011, a code.json file, a published"
                " code's name as raskar-52, or module:name"
            ) from None
    if chip_ns is None:
        return stored
    return replace(stored, code=ShutterCode(stored.code.bits, chip_ns))


def code_file(source: str) -> Path | None:
    """Return the file that a code is read from; None where its bits or a name are given.

    Bits are bits however many there are: a file name ends at some 255 characters, and asking for a
    longer one fails.
    """
    source = source.removeprefix(COMPLEMENT)
    if not set(source) - set("01"):
        return None
    if source.endswith(".json") or os.path.isfile(source):
        return Path(source)
    return None


def code_label(source: str) -> str:
    """Name a code for tables and legends: a file by its stem, long bits by their head."""
    if source.startswith(COMPLEMENT):
        return COMPLEMENT + code_label(source.removeprefix(COMPLEMENT))
    if (file := code_file(source)) is not None:
        return file.stem
    if len(source) <= 16:
        return source
    return f"{source[:12]}... ({len(source)})"


def _load_own(reference: str) -> ShutterCode:
    target = load_object(reference)
    try:
        code = target() if callable(target) else target
        if not isinstance(code, ShutterCode):
            code = ShutterCode(code)
        return code
    except (TypeError, ValueError) as error:
        raise ValueError(f"{reference}: is no code ({error})") from None
