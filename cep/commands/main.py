"""The ``cep`` command itself: its table of commands, and one line instead of a traceback."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Annotated, Any

import typer

from cep.commands import (
    advise,
    audit,
    calibrate,
    calibration_set,
    camera,
    controller,
    deblur,
    demo,
    export,
    mtf,
    optimize,
    shoot,
    simulate,
    studio,
    upload,
)
from cep.commands.console import BAD_INPUT, FAILURE, INTERRUPTED, announce, warn
from cep.commands.errors import explain
from cep.commands.help_pages import Command, Group

# commands of earlier versions that are not part of the product
_MOVED = {
    "bench": "moved to the laboratory, in the repository: python -m lab bench",
    "pareto": "moved to the laboratory, in the repository: python -m lab pareto",
    "refine": "is now an option: cep calibrate PHOTO... --code CODE --trajectory FILE",
    "hw list": "is now: cep hw info, without --port",
    "hw load": "is now: cep upload",
    "hw arm": "is now: cep upload --arm",
    "hw monitor": "is now: cep hw info --watch SECONDS",
    "camera show": "is now: cep camera list NAME",
    "cite": "is now the page Works of the documentation; the file: cep/files/works.bib",
}

_PYTHON = "is for Python: cep.SearchProblem.along and cep.optimize"
_PROVE = "proofs in blocks moved to the laboratory, in the repository: python -m lab prove"
_CLASS = "moved to the laboratory, in the repository: python -m lab design-class"
_DEVICE = "is a figure of the shutter: --device FILE.toml"
_DIRECTION = "is a field of the motion: direction, known or unknown, in trajectory.json"
# options of earlier versions, by command
_MOVED_OPTIONS = {
    "advise": {"--direction": _DIRECTION},
    "optimize": {
        "--all": _CLASS,
        "--alternatives": _PYTHON,
        "--bound": _PYTHON,
        "--cache": _PROVE,
        "--chip-ns": "is --exposure, of all chips together",
        "--class": _CLASS,
        "--dask": _PROVE,
        "--direction": _DIRECTION,
        "--duty": "is a share of the open chips: --open 40%:60%",
        "--each": "is a loop: for each file one cep optimize --trajectory FILE -o CODE",
        "--figure": "is for cep audit and cep mtf, which measure the code",
        "--max-open": _DEVICE,
        "--min-period": _DEVICE,
        "--rule": _PYTHON,
        "--table": "is for cep audit CODE, which prints the figures of the code",
        "--workers": _PROVE,
    },
}


class _Commands(Group):
    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as error:
            for note in getattr(error, "__notes__", ()):  # typer drops them
                warn(note)
            raise


app = typer.Typer(
    name="cep",
    cls=_Commands,
    help=(
        "Coded exposure: from one blurred photo to the shutter code for its motion, and back to a"
        " sharp photo."
    ),
    epilog="Begin with: cep demo -o demo",
    pretty_exceptions_enable=False,  # an error is one line, by explain()
    rich_markup_mode="rich",
)


def _print_version(is_asked: bool) -> None:
    if is_asked:
        from cep import __version__

        typer.echo(__version__)
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option(
            "--version", help="Print the version and exit.", is_eager=True, callback=_print_version
        ),
    ] = False,
) -> None:
    pass  # the option's callback acts, before a missing command is complained about


app.command("calibrate")(calibrate.calibrate)
app.command("calibration-set")(calibration_set.calibration_set)
app.command("advise")(advise.advise)
app.command("optimize")(optimize.optimize)
app.command("audit")(audit.audit)
app.command("mtf")(mtf.mtf)
app.command("simulate")(simulate.simulate)
app.command("deblur")(deblur.deblur)
app.command("export")(export.export)
app.command("upload")(upload.upload)
app.command("shoot")(shoot.shoot)
app.add_typer(camera.camera, name="camera", cls=Group)
app.add_typer(controller.hw, name="hw", cls=Group)
app.command("studio")(studio.studio)
app.command("demo")(demo.demo)
# typer makes plain commands; these show examples and name options in their errors
for _group in (app, camera.camera, controller.hw):
    for _command in _group.registered_commands:
        _command.cls = Command


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0 done, 1 failed, 2 bad input, 130 interrupted.

    Parameters
    ----------
    arguments : sequence of str, optional
        The command line without the program's name; that of this process when omitted.
    """
    if arguments is None:
        arguments = sys.argv[1:]
    words = list(arguments) or ["--help"]
    for name in (words[0], " ".join(words[:2])):
        if name in _MOVED:
            announce(f"{name} {_MOVED[name]}")
            return BAD_INPUT
    for option in (word.partition("=")[0] for word in words[1:]):
        if successor := _MOVED_OPTIONS.get(words[0], {}).get(option):
            announce(f"{option} {successor}")
            return BAD_INPUT
    return run_app(app, words, name="cep")


def run_app(app: typer.Typer, arguments: Sequence[str], *, name: str) -> int:
    """Run one command of an app and return its exit code, with one line instead of a traceback.

    Parameters
    ----------
    app : typer.Typer
    arguments : sequence of str
        The command line without the program's name.
    name : str
        Of the program, for its help pages.
    """
    try:
        # in standalone mode click would print errors in its own way, and exit
        outcome = app(args=list(arguments), prog_name=name, standalone_mode=False)
    except (KeyboardInterrupt, typer.Abort):
        announce("interrupted")
        return INTERRUPTED
    except BrokenPipeError:
        # the reader has gone (as in cep ... | head): nothing to say, and nobody to say it to;
        # Python would complain when it flushes stdout at its end, so that goes nowhere
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILURE
    except Exception as error:
        return explain(error)
    if outcome == INTERRUPTED:
        announce("interrupted")  # typer has turned Ctrl-C into this exit code
    return outcome if isinstance(outcome, int) else 0  # what a command returns is not its code


def _show_warning(message: Warning | str, *_location: object, **_options: object) -> None:
    """Print a warning of a library as every other, one line without the place in the sources."""
    warn(str(message))


def run() -> None:
    """Console entry point; being ended from outside closes a shutter as Ctrl-C does."""
    import signal
    import warnings
    from io import TextIOWrapper

    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # signs that its encoding lacks
    warnings.showwarning = _show_warning
    for name in ("SIGTERM", "SIGHUP"):  # Windows has no SIGHUP; nohup ignores it, which stays
        if hasattr(signal, name) and signal.getsignal(getattr(signal, name)) is signal.SIG_DFL:
            signal.signal(getattr(signal, name), signal.default_int_handler)
    sys.exit(main())
