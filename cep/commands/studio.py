"""``cep studio``: codes dragged, searched and compared on a page of this computer."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from cep.commands.console import finish
from cep.commands.options import Force, Json, argument, command, flag, option


@dataclass(frozen=True, kw_only=True)
class StudioOptions:
    """Options of ``cep studio``."""

    file: Path | None = argument(
        "FILE", "A studio.json that the page saved, to begin with.", default=None
    )
    port: int = option(
        "--port", "N", "Port on 127.0.0.1; a free one when omitted.", 0, min=0, max=65535
    )
    no_browser: bool = flag("--no-browser", "Print the address, and leave the browser alone.")
    extract: Path | None = option(
        "--extract",
        "FOLDER",
        "Instead of the page: write the trajectory.json, code.json and commands.sh of"
        " FILE's state.",
    )
    force: Force = False
    as_json: Json = False


@command(StudioOptions)
def studio(options: StudioOptions) -> None:
    """Open the studio: a page on this computer where a code is dragged and everything follows.

    Drop a blurred photo or choose a motion, give camera and light, and see the verdict, MTF,
    certified minimum, noise and the simulated photo follow every chip. Search, compare, export,
    play on a controller. The page is served on 127.0.0.1 alone, to the browser that opens the
    printed address first: its key works once. Ctrl-C ends it.

    Example: cep studio

    Example: cep studio studio.json --extract design
    """
    if options.extract is not None:
        if options.file is None:
            raise ValueError("--extract: needs the studio.json to take apart")
        from cep.studio.documents import extract as take_apart

        written = take_apart(options.file, options.extract, force=options.force)
        finish({"files": written}, map(str, written), as_json=options.as_json)
        return
    try:
        import starlette  # noqa: F401 - only whether it is there
        import uvicorn  # noqa: F401
    except ImportError:
        raise ValueError(
            "the studio needs two more packages: pip install 'coded-exposure[studio]'"
        ) from None
    from cep.studio.serving import serve

    state = None
    if options.file is not None:
        from cep.studio.documents import stored_state

        state = stored_state(options.file)

    def ready(address: str) -> None:
        if options.as_json:
            finish({"address": address}, as_json=True)
            sys.stdout.flush()  # a pipe's reader waits for it, and the server goes on
        else:
            print(  # noqa: T201
                f"The studio is at {address}\nThis address opens it once, in one browser. Ctrl-C"
                " ends it.",
                file=sys.stderr,
                flush=True,
            )

    def browse(page: str) -> None:
        import webbrowser

        webbrowser.open(page)

    serve(
        port=options.port,
        first_state=state,
        on_ready=ready,
        browse=None if options.no_browser else browse,
    )
