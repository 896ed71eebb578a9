"""Errors of commands: one line that names options as typed, and the exit code."""

from __future__ import annotations

import os
import re
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cep.commands.console import BAD_INPUT, FAILURE, announce

# options and arguments that set a parameter of another name: of those given, the first is meant
_SET_BY = {
    "bits": ("bits", "code", "codes"),
    "black_dn": ("black",),
    "chip": ("chip_ns",),
    "chip_ns": ("chip_ns", "exposure"),
    "chips": ("chips", "code", "codes"),
    "duty": ("open",),
    "exposure_s": ("exposure",),
    "length_px": ("linear",),
    "method": ("method", "methods"),
    "name": ("names",),
    "open_range": ("open",),
    "path_error_px": ("path_error",),
    "photons_full_scale": ("photons",),
    "read_noise_e": ("read_noise",),
    "response": ("device",),
    "scenarios": ("speed", "trajectory", "linear"),
    "trajectory": ("trajectory", "linear"),
}

# an error begins with the parameters that are wrong: "open_range, min_open and device: conflict"
_NAMED = re.compile(r"(?:^|(?<=, )|(?<= and )|(?<= or ))\w+(?=[ ,]|$)")
_FILE = re.compile(r"/|\.\w+$")  # or with a file, whose fields are not options
# behind the colon only what cannot be an English word: method='pmp', and names with underscores
_WITHIN = re.compile(
    r"""(?<![\w.'"/-])(?=[a-z0-9]*[_=])[a-z]\w*(?:=(?:'[^']*'|[^\s,]\S*)|(?![\w.'"/=-]))"""
)


def explain(error: BaseException) -> int:
    """Print one line for ``error`` and return the exit code: 2 for bad input, 1 for a failure.

    ``CEP_DEBUG=1`` in the environment prints the traceback too.
    """
    if os.environ.get("CEP_DEBUG") == "1":
        traceback.print_exception(error)
    # what must be known besides: a shutter that may be open, a code that was found
    notes = "".join(f"; {note}" for note in getattr(error, "__notes__", ()))
    code = FAILURE
    if hasattr(error, "format_message"):  # a usage error of click, which typer bundles
        path = getattr(getattr(error, "ctx", None), "command_path", "cep")
        line = f"{error.format_message()} (see {path} --help)"
        notes = ""
        code = BAD_INPUT
    elif isinstance(error, OSError):
        import errno

        # no fault of the command line
        full_disk = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
        reason = error.strerror or str(error) or type(error).__name__
        line = ": ".join(str(text) for text in (error.filename, reason) if text)
        if error.errno not in full_disk:
            code = BAD_INPUT
    elif isinstance(error, ValueError):
        line = str(error) or "wrong input"
        code = BAD_INPUT
    elif isinstance(error, MemoryError):
        line = f"not enough memory ({error}): use a smaller photo or crop it"
    elif isinstance(error, RuntimeError):
        line = str(error)
    else:  # a fault of the program: its kind helps whoever reports it
        line = f"{type(error).__name__}: {error}"
    announce(line + notes)
    return code


def with_photo_file(error: str, images: Sequence[Path]) -> str:
    """Name the file of ``photo 2`` in an error of several photos; others stay as they are."""
    prefix = re.match(r"photo(?: (\d+))?: ", error)
    if prefix is None:
        return error
    return f"{images[int(prefix[1] or 1) - 1]}: {error[prefix.end() :]}"


def in_options(message: str, context: Any) -> str:
    """Translate the Python parameters that an error names into the command's options.

    The library has no knowledge of the command line, so its errors name its own parameters.

    Parameters
    ----------
    message : str
        As the library has it: "name: what is wrong", or "name value and other value conflict:
        why". Behind the colon ``other=value`` and names with an underscore are translated too.
        Names that no option sets stay as they are, and so do the fields of a file, which stand
        behind its name.
    context : click context
        Of the command: with its parameters, and whether each was given.

    Returns
    -------
    str
        As "--chips: what is wrong with --method exact".
    """

    def spelt(match: re.Match[str]) -> str:
        name, _, value = match[0].partition("=")
        if (option := _spelling(name, context)) is None:
            return match[0]
        return " ".join(filter(None, (option, value.strip("'"))))

    names, colon, fault = message.partition(": ")
    options = names if _FILE.search(names) else _NAMED.sub(spelt, names)
    if not colon or options == names:
        return message
    return f"{options}: {_WITHIN.sub(spelt, fault)}"


def _spelling(name: str, context: Any) -> str | None:
    """Spell the option or argument that sets a parameter; None where none does."""
    params: dict[str, Any] = {}
    for param in context.command.params:
        longest = max(param.opts, key=len)
        # a field may have another name than its option: open_chips is --open
        params |= {param.name: param, longest.lstrip("-").replace("-", "_"): param}

    def is_default(param: Any) -> bool:
        source = context.get_parameter_source(param.name)
        return source is None or source.name != "COMMANDLINE"

    setters = [params[key] for key in _SET_BY.get(name, (name,)) if key in params]
    if not setters:
        return None
    setter = min(setters, key=is_default)  # the first of those given
    if setter.param_type_name == "argument":
        return str(setter.metavar or setter.name.upper()).strip("[].")
    return str(max(setter.opts, key=len))
