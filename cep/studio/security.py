"""Gate in front of the studio: who may ask, from where and how much, and what a browser may do with the answer."""

from __future__ import annotations

import hmac
import secrets
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

__all__ = ["MOST_JSON_BYTES", "MOST_UPLOAD_BYTES", "Gate", "Keys", "TooLargeError"]

MOST_JSON_BYTES = 256 * 1024
MOST_UPLOAD_BYTES = 256 * 1024 * 1024
_UPLOADS = ("/api/upload/",)
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
_NO_KEY = "open the address that cep studio printed: it has the key to this page"


def _secret() -> str:
    return secrets.token_urlsafe(32)


@dataclass(frozen=True)
class Keys:
    """Secrets of one run, and the address that it is bound to.

    Attributes
    ----------
    port : int
    token : str
        In the address that is printed; it is exchanged for the cookie.
    session : str
        Value of the cookie.
    """

    port: int
    token: str = field(default_factory=_secret)
    session: str = field(default_factory=_secret)

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
        """What the Host header may say; any other name, and it was a foreign page that led here."""
        return f"127.0.0.1:{self.port}", f"localhost:{self.port}"


class Gate:
    """ASGI middleware: lets a request in only with the right host, origin, cookie and size.

    A foreign page can make a browser send requests here, and by DNS rebinding even under a name of its own. Its
    requests have another Host or Origin and no cookie, as the cookie is ``SameSite=Strict``.

    Parameters
    ----------
    app : ASGI application
    keys : Keys
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
        """Return the answer to a request that is not let in, and to the one that brings the token; None else."""
        headers, keys = Headers(scope=scope), self._keys
        if headers.get("host", "") not in keys.hosts:
            return PlainTextResponse("403: this address is not the studio's", 403)
        origin = headers.get("origin")
        writes = scope["method"] not in ("GET", "HEAD")
        if (writes or origin is not None) and origin not in {f"http://{host}" for host in keys.hosts}:
            return PlainTextResponse("403: requests come from the studio's own page alone", 403)
        if headers.get("sec-fetch-site", "none") not in ("none", "same-origin"):
            return PlainTextResponse("403: requests come from the studio's own page alone", 403)
        if scope["path"] == "/" and not writes:
            given = parse_qs(scope["query_string"].decode("latin-1")).get("token", [])
            if given:
                if len(given) == 1 and hmac.compare_digest(given[0].encode(), keys.token.encode()):
                    return self._with_cookie()
                return PlainTextResponse(f"403: the key is wrong; {_NO_KEY}", 403)
        if not self._knows(headers):
            return PlainTextResponse(f"403: {_NO_KEY}", 403)
        length = headers.get("content-length")
        if length is not None and (not length.isdigit() or int(length) > self._most(scope)):
            return _too_large(self._most(scope))
        return None

    def _with_cookie(self) -> Response:
        answer = RedirectResponse("/", 303)
        answer.set_cookie(self._keys.cookie, self._keys.session, httponly=True, samesite="strict", path="/")
        return answer

    def _knows(self, headers: Headers) -> bool:
        found: SimpleCookie = SimpleCookie()
        try:
            found.load(headers.get("cookie", ""))
        except CookieError:
            return False
        given = found.get(self._keys.cookie)
        return given is not None and hmac.compare_digest(given.value.encode(), self._keys.session.encode())

    @staticmethod
    def _most(scope: Scope) -> int:
        return MOST_UPLOAD_BYTES if scope["path"].startswith(_UPLOADS) else MOST_JSON_BYTES


class TooLargeError(Exception):
    """The body of a request is larger than is read."""


def _too_large(most: int) -> Response:
    message = f"at most {most // 1024} KB are read"
    if most >= 1024 * 1024:
        message = f"at most {most // 1024 // 1024} MB are read"
    return JSONResponse({"error": {"field": "page", "message": message}}, 413)


def _limited(receive: Receive, most: int) -> Receive:
    """Count the bytes of a body as they come: a length may be missing or a lie."""
    seen = 0

    async def counted() -> Message:
        nonlocal seen
        message = await receive()
        if message["type"] == "http.request":
            seen += len(message.get("body", b""))
            if seen > most:
                raise TooLargeError(most)
        return message

    return counted
