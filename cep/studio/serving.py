"""Process of the studio's server: bound to 127.0.0.1, run by uvicorn until Ctrl-C."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Mapping
from contextlib import suppress
from types import FrameType
from typing import Any

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from cep.studio.jobs import Jobs
from cep.studio.security import Keys
from cep.studio.server import make_app

_MOST_SILENT_S = 10.0  # of a connection that has asked nothing yet


class _Impatient(H11Protocol):
    """Closes connections that ask nothing: each takes one of the server's open files."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self.loop.call_later(_MOST_SILENT_S, self._close_unused)

    def _close_unused(self) -> None:
        if self.cycle is None:
            self.transport.close()


class _Server(uvicorn.Server):
    """Ends the streams of news when it is asked to stop: it would wait for them."""

    def __init__(self, config: uvicorn.Config, jobs: Jobs) -> None:
        super().__init__(config)
        self._jobs = jobs

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        self._jobs.dismiss()
        super().handle_exit(sig, frame)


def serve(
    *,
    port: int = 0,
    first_state: Mapping[str, Any] | None = None,
    on_ready: Callable[[str], None] = lambda _address: None,
    browse: Callable[[str], object] | None = None,
) -> None:
    """Serve the studio on 127.0.0.1 until Ctrl-C.

    Parameters
    ----------
    port : int
        0 takes a free one.
    first_state : mapping, optional
        As of :func:`cep.studio.server.make_app`.
    on_ready : callable
        Called with the address to open, key included, when it is bound.
    browse : callable, optional
        Called then with the address of a file that leads a browser to the page: a browser's
        command line can be read by everybody on the computer, and the file by this user alone. The
        first visit of the page removes it.

    Raises
    ------
    ValueError
        If the port cannot be used.
    OSError
        If the file cannot be written.
    """
    bound = bound_socket(port)
    keys = Keys(bound.getsockname()[1])
    app = make_app(keys, first_state=first_state)
    config = uvicorn.Config(
        app,
        log_level="error",
        access_log=False,
        server_header=False,
        date_header=False,
        timeout_graceful_shutdown=1,
        http=_Impatient,
        h11_max_incomplete_event_size=64 * 1024,
        ws="none",
    )
    server = _Server(config, app.state.studio.jobs)
    bound.listen(64)
    on_ready(keys.address)
    if browse is not None:
        browse(keys.page_in(app.state.studio.uploads.folder).as_uri())
    with bound, suppress(KeyboardInterrupt):
        server.run(sockets=[bound])


def bound_socket(port: int) -> socket.socket:
    """Bind the port on 127.0.0.1, 0 for a free one.

    The protocol is named because asyncio turns the delay of small packets off for sockets of TCP
    alone; with it, an answer of two packets takes 40 ms more.
    """
    bound = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        # a port can be had again at once after the server before
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind(("127.0.0.1", port))
    except (OSError, OverflowError) as error:
        bound.close()
        reason = getattr(error, "strerror", None) or str(error)
        raise ValueError(
            f"port: {port} cannot be used ({reason}); leave it out for a free one"
        ) from None
    return bound
