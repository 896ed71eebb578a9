"""Server of the studio on 127.0.0.1: its addresses, each a few lines, behind the gate."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import Receive, Scope, Send
from threadpoolctl import threadpool_limits

from cep.files.raw_files import RAW_SUFFIXES
from cep.optics.camera import Camera
from cep.shutter.exposure_plan import Release
from cep.studio.documents import opened_document, opened_gyro
from cep.studio.fields import FieldError, is_text, read_choice
from cep.studio.jobs import BusyError, Job, Jobs
from cep.studio.photo_files import beside
from cep.studio.security import Gate, Keys, LateError, TooLargeError, refusal
from cep.studio.shots import shot_archive
from cep.studio.state import Setting, read_codes, read_search, read_setting
from cep.studio.uploads import Uploads
from cep.studio.views import Views, start_view
from cep.studio.work import KINDS
from hw.port import list_ports
from motdiff.estimators.registry import blind_methods

_STATIC = {file.name: file for file in (resources.files("cep.studio") / "static").iterdir()}
_TYPES = {"html": "text/html", "css": "text/css", "js": "text/javascript"}
# answers to errors, RFC 9110: unprocessable content, conflict, content too large, timeout
_STATUS = {FieldError: 422, BusyError: 409, TooLargeError: 413, LateError: 408}
_BEAT_S = 15.0  # a page that has gone is noticed when it is written to
_MOST_PHOTOS = 3  # of one request
_MOST_PAGE = 64  # characters of a page's name
_MOST_CAMERA = 300  # of a camera's, which may hold a path
Answer = Callable[[Mapping[str, Any]], Awaitable[Mapping[str, Any]]]
Endpoint = Callable[[Request], Awaitable[Response]]
T = TypeVar("T")


class _Studio:
    """What the addresses share."""

    def __init__(self) -> None:
        self.views = Views()
        self.uploads = Uploads()
        self.jobs = Jobs()
        # a verdict that takes a second must not hold up the pictures
        self._quick = ThreadPoolExecutor(2, thread_name_prefix="picture")
        self._slow = ThreadPoolExecutor(1, thread_name_prefix="verdict")

    async def quickly(self, do: Callable[..., T], *args: Any, **options: Any) -> T:
        return await asyncio.get_running_loop().run_in_executor(
            self._quick, lambda: do(*args, **options)
        )

    async def slowly(self, do: Callable[..., T], *args: Any) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._slow, lambda: do(*args))

    def close(self) -> None:
        self.jobs.close()
        for pool in (self._quick, self._slow):
            pool.shutdown(wait=False, cancel_futures=True)
        self.uploads.close()

    # -- answers to a document of the page --------------------------------------------------------

    async def picture(self, document: Mapping[str, Any]) -> Mapping[str, Any]:
        steps, seed = read_search(document)
        return await self.quickly(self.views.picture, _setting(document), steps=steps, seed=seed)

    async def photos(self, document: Mapping[str, Any]) -> Mapping[str, Any]:
        scene = self._scene(document.get("scene"))
        setting = _setting(document)
        codes = read_codes(document.get("codes"), "scene", limit=_MOST_PHOTOS)
        if any(len(bits) != setting.chips for bits in codes.values()):
            raise FieldError(
                "scene",
                f"the codes of the photos need {setting.chips} chips, as the page's code has",
            )
        restored = document.get("restored") is True
        return await self.quickly(self.views.photos, setting, scene, codes, restored=restored)

    async def verdict(self, document: Mapping[str, Any]) -> Mapping[str, Any]:
        return await self.slowly(self.views.verdict, _setting(document))

    async def compare(self, document: Mapping[str, Any]) -> Mapping[str, Any]:
        pins = read_codes(document.get("pins"), "pins")
        return await self.slowly(self.views.compared, _setting(document), pins)

    async def export(self, document: Mapping[str, Any]) -> Mapping[str, Any]:
        return await self.quickly(self.views.exported, _setting(document), document.get("format"))

    async def save(self, document: Mapping[str, Any]) -> Mapping[str, Any]:
        state = document.get("state")
        if not isinstance(state, dict):
            raise FieldError("page", "the state to save must be an object")
        return await self.slowly(self.views.saved, _setting(document), state)

    async def job(self, document: Mapping[str, Any]) -> Mapping[str, Any]:
        page = _page(document.get("page"))
        kind = document.get("kind")
        if not isinstance(kind, str) or kind not in KINDS:
            raise FieldError("job", f"the kinds of jobs are {', '.join(KINDS)}")
        if kind == "calibrate":
            method = document.get("method", "motdiff")
            if method not in blind_methods():
                raise FieldError("method", f"the methods are {' and '.join(blind_methods())}")
            photo = self.uploads.path(document.get("photo"))
            order: dict[str, Any] = {"path": str(photo), "method": method}
        elif kind == "sharpen":
            photo = self.uploads.path(document.get("photo"))
            order = {"path": str(photo), "anyway": document.get("anyway") is True}
        elif kind == "shoot":
            order = await self._shot(document)
        else:
            _setting(document).problem()
            steps, seed = read_search(document)
            order = {"setting": document["setting"], "steps": steps, "seed": seed}
        if kind == "play":
            port = await self._port(document.get("port"), "port")
            order |= {"port": port, "arm": document.get("arm") is True}
        return self.jobs.start(page, kind, order).to_dict()

    async def _shot(self, document: Mapping[str, Any]) -> dict[str, Any]:
        """Return the order of a photo by a camera."""
        _setting(document).code()
        camera = document.get("camera")
        if not is_text(camera, _MOST_CAMERA) or not camera:
            raise FieldError("shot_camera", "name a camera, as twin: or pylon:")
        port = await self._port(document.get("port"), "shot_port")
        release = read_choice(
            {"shot_release": document.get("release")}, "shot_release", [*Release], default=""
        )
        key, path = self.uploads.reserve(".tif")
        return {
            "setting": document["setting"],
            "camera": camera,
            "port": port,
            "release": release,
            "photo": key,
            "path": str(path),
        }

    async def _port(self, port: object, field: str) -> str:
        """Check the port of a controller: one of this computer's, or the emulated one."""
        ports = [info.port for info in await self.quickly(list_ports)]
        if not isinstance(port, str) or port not in ["emulated", *ports]:
            raise FieldError(field, "choose a port of the list")
        return port

    async def stop(self, document: Mapping[str, Any]) -> Mapping[str, Any]:
        self.jobs.stop(_page(document.get("page")))
        return {}

    def _scene(self, key: object) -> Path | None:
        """Return the file of the restored part of a photo, None for the bundled scene."""
        if key in (None, ""):
            return None
        scene = beside(self.uploads.path(key), "scene.npy")
        return scene if scene.is_file() else None

    # -- other requests ---------------------------------------------------------------------------

    async def start(self, _: Request) -> Response:
        return JSONResponse(await self.quickly(start_view))

    async def ports(self, _: Request) -> Response:
        ports = await self.quickly(list_ports)
        return JSONResponse(
            {"ports": [{"name": info.port, "about": info.description} for info in ports]}
        )

    async def events(self, request: Request) -> Response:
        return _News(self.jobs, _page(request.query_params.get("page")))

    async def example_photo(self, _: Request) -> Response:
        content = await self.quickly(_bundled_photo)
        return JSONResponse({"photo": self.uploads.add(content, ".png")})

    async def upload_photo(self, request: Request) -> Response:
        suffix = request.query_params.get("suffix", "")
        return JSONResponse({"photo": await self.uploads.photo(request.stream(), suffix=suffix)})

    async def shot(self, request: Request) -> Response:
        photo = self.uploads.path(request.path_params["key"])
        return Response(await self.quickly(shot_archive, photo), media_type="application/zip")

    def uploading(
        self, suffix: str, field: str, read: Callable[..., Mapping[str, Any]]
    ) -> Endpoint:
        """Return what answers with the content of a text that is sent."""

        async def endpoint(request: Request) -> Response:
            file = await self.uploads.text(request.stream(), suffix, field=field)
            try:
                return JSONResponse(await self.quickly(read, file, request.query_params))
            finally:
                file.unlink(missing_ok=True)

        return endpoint

    def made_of_photo(self, ending: str, media_type: str) -> Endpoint:
        """Return what answers with a file beside a photo's."""

        async def endpoint(request: Request) -> Response:
            file = beside(self.uploads.path(request.path_params["key"]), ending)
            if not file.is_file():
                raise HTTPException(404)
            return FileResponse(file, media_type=media_type)

        return endpoint


def make_app(keys: Keys, *, first_state: Mapping[str, Any] | None = None) -> Starlette:
    """Make the application, with the gate in front of it.

    Parameters
    ----------
    first_state : mapping, optional
        State that a page without one in its address begins with.
    """
    studio = _Studio()

    @asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        studio.jobs.warm()
        # small products: more threads only wait for each other
        with threadpool_limits(limits=1, user_api="blas"):
            yield
        studio.close()

    async def opened_state(_: Request) -> Response:
        return JSONResponse({} if first_state is None else {"state": first_state})

    async def static(request: Request) -> Response:
        return _static(request.path_params.get("name", "index.html"))

    def answering(answer: Answer) -> Endpoint:
        async def endpoint(request: Request) -> Response:
            return JSONResponse(await answer(await _document(request)))

        return endpoint

    reads: dict[str, Endpoint] = {
        "/": static,
        "/static/{name}": static,
        "/api/start": studio.start,
        "/api/opened": opened_state,
        "/api/ports": studio.ports,
        "/api/events": studio.events,
        "/api/photo/{key}": studio.made_of_photo("preview.jpg", "image/jpeg"),
        "/api/photo/{key}/sharpened": studio.made_of_photo("sharp_preview.jpg", "image/jpeg"),
        "/api/photo/{key}/sharpened.png": studio.made_of_photo("sharp.png", "image/png"),
        "/api/photo/{key}/shot.zip": studio.shot,
    }
    writes: dict[str, Endpoint] = {
        "/api/example-photo": studio.example_photo,
        "/api/upload/photo": studio.upload_photo,
        "/api/upload/document": studio.uploading(
            ".json", "open_file", lambda file, _: opened_document(file)
        ),
        "/api/upload/gyro": studio.uploading(".csv", "gyro", opened_gyro),
    }
    for name in ("picture", "photos", "verdict", "compare", "export", "save", "job", "stop"):
        writes[f"/api/{name}"] = answering(getattr(studio, name))
    handlers: dict[Any, Any] = dict.fromkeys((*_STATUS, ClientDisconnect), _refused)
    app = Starlette(
        routes=[
            *(Route(path, endpoint) for path, endpoint in reads.items()),
            *(Route(path, endpoint, methods=["POST"]) for path, endpoint in writes.items()),
        ],
        lifespan=lifespan,
        exception_handlers=handlers,
        middleware=[Middleware(Gate, keys=keys)],
    )
    app.state.studio = studio
    return app


async def _document(request: Request) -> Mapping[str, Any]:
    body = await request.body()
    try:
        document = json.loads(body)
    except (ValueError, RecursionError):  # the latter of JSON that nests too deep
        raise FieldError("page", "the request is not JSON") from None
    if not isinstance(document, dict):
        raise FieldError("page", "the request must be a JSON object")
    return document


def _setting(document: Mapping[str, Any]) -> Setting:
    return read_setting(document.get("setting"))


def _page(name: object) -> str:
    if not isinstance(name, str) or not 8 <= len(name) <= _MOST_PAGE or not name.isalnum():
        raise FieldError("page", "a page has a name of 8 to 64 letters and digits")
    return name


class _News(StreamingResponse):
    """What happens to a page's job, for as long as the page listens."""

    def __init__(self, jobs: Jobs, page: str) -> None:
        super().__init__((), 200, media_type="text/event-stream")
        self._jobs = jobs
        self._page = page

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        queue = self._jobs.listen(self._page)
        self.body_iterator = _events(self._jobs, queue)
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._jobs.leave(self._page, queue)


async def _events(jobs: Jobs, queue: asyncio.Queue[Job | None]) -> AsyncIterator[str]:
    """Tell of a job as it goes on; an idle line shows whether the page is still there."""
    while True:
        try:
            job: Job | None = await asyncio.wait_for(queue.get(), _BEAT_S)
        except TimeoutError:
            yield ": beat\n\n"
            continue
        if jobs.closing:
            return
        while not queue.empty():  # only the latest state counts
            job = queue.get_nowait()
        yield f"data: {json.dumps(job and job.to_dict())}\n\n"


def _static(name: str) -> Response:
    media_type = _TYPES.get(name.rpartition(".")[2])
    if name not in _STATIC or media_type is None:
        raise HTTPException(404)
    content = _STATIC[name].read_bytes()
    if name == "index.html":
        content = content.replace(b"{raw_suffixes}", ",".join(RAW_SUFFIXES).encode())
    return Response(content, media_type=media_type)


def _bundled_photo() -> bytes:
    """Blurred photo of the demo, as a PNG file."""
    from cep.files.images import encode_image
    from cep.report.chain import STANDARD_CAMERA
    from cep.report.scene import bundled_scene

    scene = bundled_scene(Camera.load(STANDARD_CAMERA), rng=np.random.default_rng(0))
    return encode_image(scene.photo, ".png")


def _refused(_: Request, error: Exception) -> Response:
    if isinstance(error, ClientDisconnect):
        return Response(status_code=400)  # the client has gone: it is not read
    return refusal(error, _STATUS[type(error)])
