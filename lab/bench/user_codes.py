"""User-defined codes that a table compares too: ``NAME=SOURCE``, read and spelled again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cep.codes.sources import code_file, load_code
from cep.optics.code import ShutterCode
from lab.bench.coded.run import check_names


def load_user_codes(options: Sequence[str]) -> dict[str, ShutterCode]:
    """Read codes by their names.

    Parameters
    ----------
    options : sequence of str
        Each ``NAME=SOURCE``, the source as of :func:`cep.codes.sources.find_code`.

    Raises
    ------
    ValueError
        If a text has no name, a name comes twice or cannot be a row of a table, or a source is no
        code.
    """
    codes: dict[str, ShutterCode] = {}
    for text in options:
        name, equals, source = text.partition("=")
        if not equals:
            raise ValueError(f"code: must be NAME=SOURCE, as my=1011, got {text[:40]!r}")
        check_names([name])
        if name in codes:
            raise ValueError(f"code: every name must come once, {name} comes twice")
        try:
            codes[name] = load_code(source)
        except ValueError as error:
            raise ValueError(f"code: {name}: {error}") from None
    return codes


def user_code_options(options: Sequence[str], codes: Mapping[str, ShutterCode]) -> str:
    """Spell the options ``--code`` of :func:`load_user_codes` without anybody's folders."""
    sources = [text.partition("=")[2] for text in options]
    names = [file.name if (file := code_file(source)) else source for source in sources]
    return " ".join(f"--code {name}={source}" for name, source in zip(codes, names, strict=True))
