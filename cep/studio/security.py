"""Gate in front of the studio: who may ask, from where and how much, and what a browser may do."""

from __future__ import annotations

import asyncio
import hmac
import html
import os
import secrets
from dataclasses import dataclass, field
from pathlib import Path

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import HTTPConnection
from starlette.responses import (
    HTMLResponse,
    JSONResponse,
    PlainTextResponse,
    RedirectResponse,
    Response,
)
from starlette.types import ASGIApp, Message, Receive, Scope, Send

_MOST_BYTES = 256 * 1024  # of a request: the longest path and all pins take less than 64 KB
_MOST_UPLOADED = {
    "/api/upload/photo": 256 * 1024**2,  # a TIFF of 40 megapixels with 16 bits
    "/api/upload/gyro": 32 * 1024**2,  # as motdiff.files.inputs reads
    "/api/upload/document": 4 * 1024**2,  # parsed, JSON takes up to 30 times as much memory
}
_MOST_BODY_S = 60.0  # a body that stalls would keep its connection for good
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:;"
        " connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",  # for browsers that lack frame-ancestors
    "Referrer-Policy": "no-referrer",  # the address may hold the token
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
_NO_KEY = "open the address that cep studio printed: it has the key to this page"
_SPENT = (
    "the key has been used, and works once: go on in the browser that used it, or start cep studio"
    " again"
)
_LEADING = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="referrer" content="no-referrer">
<meta http-equiv="refresh" content="0; url={address}">
<title>Coded exposure studio</title>
</head>
<body><p><a href="{address}">Open the studio</a></p></body>
</html>
"""


def _secret() -> str:
    return secrets.token_urlsafe(32)  # 256 bits: not to be guessed


@dataclass
class Keys:
    """Secrets of one run, and the address that it is bound to.

    Attributes
    ----------
    port : int
    token : str
        In the address that is printed; it is exchanged for the cookie, once.
    session : str
        Value of the cookie.
    is_used : bool
        Whether the token has been exchanged.
    """

    port: int
    token: str = field(default_factory=_secret)
    session: str = field(default_factory=_secret)
    is_used: bool = field(default=False, init=False)
    _page: Path | None = field(default=None, init=False)

    def spend(self, token: str) -> bool:
        """Return whether this is the token, for the first time."""
        # compare_digest takes as long for each wrong token: its time gives nothing away
        if self.is_used or not hmac.compare_digest(token.encode(), self.token.encode()):
            return False
        self.is_used = True
        if self._page is not None:
            self._page.unlink(missing_ok=True)
        return True

    def page_in(self, folder: Path) -> Path:
        """Write a page that leads this user alone to the studio; it goes with the token's use."""
        self._page = folder / "open.html"
        # the mode at once, as chmod afterwards leaves a moment; O_EXCL follows no prepared link
        descriptor = os.open(self._page, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with open(descriptor, "w", encoding="utf-8") as file:
            file.write(_leading(self.address))
        return self._page

    @property
    def address(self) -> str:
        """Address to open."""
        return f"http://127.0.0.1:{self.port}/?token={self.token}"

    @property
    def cookie(self) -> str:
        """Name of the cookie: browsers keep those of all ports of a host together."""
        return f"cep_studio_{self.port}"

    @property
    def hosts(self) -> tuple[str, str]:
        """What the Host header may say: under any other name a foreign page has led here."""
        return f"127.0.0.1:{self.port}", f"localhost:{self.port}"


class Gate:
    """ASGI middleware: lets a request in only with the right host, origin, cookie and size.

    A foreign page can make a browser send requests here, and by DNS rebinding even under a name of
    its own. Its requests have another Host or Origin and no cookie, as the cookie is
    ``SameSite=Strict``.
    """

    def __init__(self, app: ASGIApp, keys: Keys) -> None:
        self._app = app
        self._keys = keys

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request, or pass it on."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":
            return  # no web sockets here

        async def guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    headers[name] = value
            await send(message)

        answer = self._refusal(scope)
        if answer is not None:
            await answer(scope, receive, guarded)
            return
        await self._app(scope, _limited(receive, self._most(scope)), guarded)

    def _refusal(self, scope: Scope) -> Response | None:
        """Return the answer to a request that is not let in, or brings the token; else None."""
        connection = HTTPConnection(scope)
        headers = connection.headers
        keys = self._keys
        if headers.get("host", "") not in keys.hosts:
            return PlainTextResponse("403: this address is not the studio's", 403)
        # browsers send it with each POST: a form on a foreign page gives itself away
        origin = headers.get("origin")
        writes = scope["method"] not in ("GET", "HEAD")
        if (writes or origin is not None) and origin not in {
            f"http://{host}" for host in keys.hosts
        }:
            return PlainTextResponse("403: requests come from the studio's own page alone", 403)
        foreign = headers.get("sec-fetch-site", "none") not in ("none", "same-origin")
        tokens: list[str] = []
        if scope["path"] == "/":
            tokens = connection.query_params.getlist("token")
        if (
            len(tokens) == 1
            and scope["method"] == "GET"
            and not _is_prefetch(headers)
            and keys.spend(tokens[0])
        ):
            return self._with_cookie(linked=foreign)
        if foreign:
            return PlainTextResponse("403: requests come from the studio's own page alone", 403)
        cookie = connection.cookies.get(keys.cookie, "")
        if not hmac.compare_digest(cookie.encode(), keys.session.encode()):
            return PlainTextResponse(f"403: {_SPENT if tokens and keys.is_used else _NO_KEY}", 403)
        if not writes and (
            "transfer-encoding" in headers or headers.get("content-length", "0") != "0"
        ):
            return PlainTextResponse("400: this address takes no body", 400)
        if tokens:  # the printed address, followed again in the browser that has the cookie
            return RedirectResponse("/", 303)
        length = headers.get("content-length")
        if length is not None and (
            not length.isdecimal() or len(length) > 15 or int(length) > self._most(scope)
        ):
            return refusal(TooLargeError(self._most(scope)), 413)
        return None

    def _with_cookie(self, *, linked: bool) -> Response:
        """Lead on to the page, and give the browser its cookie."""
        answer: Response = RedirectResponse("/", 303)  # takes the token out of the address bar
        if linked:  # redirected from another page's link, a browser would hold the cookie back
            answer = HTMLResponse(_leading("/"))
        # no script can read it, and no request from another site carries it
        answer.set_cookie(
            self._keys.cookie, self._keys.session, httponly=True, samesite="strict", path="/"
        )
        return answer

    @staticmethod
    def _most(scope: Scope) -> int:
        return _MOST_UPLOADED.get(scope["path"], _MOST_BYTES)


class TooLargeError(Exception):
    """The body of a request is larger than is read."""

    def __init__(self, limit: int) -> None:
        size = f"{limit // 1024} KB"
        if limit >= 1024 * 1024:
            size = f"{limit // 1024 // 1024} MB"
        super().__init__(f"at most {size} are read")


class LateError(Exception):
    """The body of a request did not come in time."""


def refusal(error: Exception, status: int) -> Response:
    """Return the answer that shows an error beside its field of the page."""
    field = getattr(error, "field", "page")
    return JSONResponse({"error": {"field": field, "message": str(error)}}, status)


def _limited(receive: Receive, limit: int) -> Receive:
    """Count the bytes of a body as they come, and the time: its stated length may be a lie."""
    received = 0
    is_complete = False
    deadline_s = asyncio.get_running_loop().time() + _MOST_BODY_S

    async def counted() -> Message:
        nonlocal received, is_complete
        if is_complete:  # what comes after the body is that the client has gone
            return await receive()
        try:
            async with asyncio.timeout_at(deadline_s):
                message = await receive()
        except TimeoutError:
            raise LateError(f"the request did not come within {_MOST_BODY_S:g} s") from None
        if message["type"] == "http.request":
            received += len(message.get("body", b""))
            is_complete = not message.get("more_body", False)
            if received > limit:
                raise TooLargeError(limit)
        return message

    return counted


def _is_prefetch(headers: Headers) -> bool:
    """Whether a browser asks ahead of its user, who may never follow."""
    return any("prefetch" in headers.get(name, "") for name in ("sec-purpose", "purpose", "x-moz"))


def _leading(address: str) -> str:
    return _LEADING.format(address=html.escape(address))
