import asyncio
import base64
import io
import json
import queue
import socket
import threading
import zipfile
from urllib.parse import urlsplit

import numpy as np
import pytest
import uvicorn
from full_disk import full_disk
from hostile_requests import hostile
from starlette.requests import ClientDisconnect

import cep
from cep.files.images import encode_image, read_image
from cep.files.raw_files import RAW_SUFFIXES
from cep.search.measured import corrected, shifts_db
from cep.search.verdict import verdict, verdict_of
from cep.studio import serving
from cep.studio.jobs import BusyError
from cep.studio.serving import bound_socket
from cep.studio.state import read_setting
from cep.studio.uploads import Uploads
from cep.studio.views import Views
from hw.export import EXPORTERS

SHOT = {"camera": "twin:", "port": "emulated", "release": ""}


def posted(client, name, **asked):
    answer = client.post(f"/api/{name}", json=asked)
    assert answer.status_code == 200, answer.text
    return answer.json()


def test_the_page_and_its_files_are_served(client):
    page = client.get("/")
    assert page.headers["content-type"].startswith("text/html")
    assert "http://" not in page.text
    assert "https://" not in page.text
    assert (
        f'accept="image/png,image/jpeg,image/tiff,image/webp,{",".join(RAW_SUFFIXES)}"'
        in page.text
    )
    for name, kind in (("studio.js", "text/javascript"), ("studio.css", "text/css")):
        assert client.get(f"/static/{name}").headers["content-type"].startswith(kind)


def test_small_packets_of_an_answer_are_not_held_back():
    async def accepted():
        kept = asyncio.get_running_loop().create_future()
        with bound_socket(0) as bound:
            async with await asyncio.start_server(
                lambda _, writer: kept.set_result(writer), sock=bound
            ):
                _, client = await asyncio.open_connection(*bound.getsockname())
                writer = await kept
                found = writer.get_extra_info("socket").getsockopt(
                    socket.IPPROTO_TCP, socket.TCP_NODELAY
                )
                for one in (client, writer):
                    one.close()
        return found

    assert asyncio.run(accepted()) != 0


def test_figures_are_those_of_the_library(client, setting):
    found = posted(client, "picture", setting=setting)
    path = cep.Trajectory.straight(20.0)
    code = cep.ShutterCode(setting["bits"])
    camera = cep.Camera.load("video-8bit")
    audit = cep.audit(code, path, camera=camera.at(2000), flips=0)
    assert audit.no_inverse
    assert found["figures"]["noise_gain_db"] is None
    without = {**setting, "bits": setting["bits"][:-1] + "1"}
    other = cep.audit(cep.ShutterCode(without["bits"]), path, camera=camera.at(2000), flips=0)
    assert not other.no_inverse
    assert posted(client, "picture", setting=without)["figures"]["noise_gain_db"] == pytest.approx(
        other.metrics.noise_gain_db
    )
    assert found["figures"]["mse_db"] == pytest.approx(audit.metrics.mse_db)
    proven = cep.certify(code, path)
    assert 0.999 * proven.lower <= found["figures"]["min_mtf_lower"] <= proven.upper
    frequencies = np.linspace(0, 0.5, 241)
    assert found["curve"] == pytest.approx(cep.mtf(path, code, frequencies, 0.0), abs=2e-5)
    db = np.frombuffer(base64.b64decode(found["map"]["db"]), np.uint8).reshape(49, 97)
    assert db[0, 48] == round(
        255 * (1 + 20 * np.log10(code.duty) / 50)
    )  # the light, at zero frequency
    assert found["code"]["chip_ns"] == 1_250_000


def shifted_verdict(read):
    """The verdict of the library's model, shifted by what photographs show."""
    code, error_px = read.code(), read.path_error_px
    modelled = verdict(read.problem(), code, path_error_px=error_px, photographs=())
    shifts = shifts_db(read.trajectory, read.sensor)
    ways = tuple(corrected(way, shifts, 1.0) for way in modelled.exposures)
    return verdict_of(read.problem(), ways, [code], path_error_px=error_px)


@pytest.mark.parametrize("path_error", [None, 0.4])
def test_the_verdict_is_that_of_the_library(client, setting, path_error):
    setting = {
        **setting,
        "path_error": path_error,
        "bits": "11010001",  # with an error each single exposure is judged along many paths
        "motion": {**setting["motion"], "length": 8},
    }
    found = posted(client, "verdict", setting=setting)
    read = read_setting(setting)
    expected = shifted_verdict(read)
    assert found["sentence"] == expected.sentence
    assert ("a path known to 0.4 px" in found["sentence"]) == (path_error is not None)
    assert found["gains_db"] == pytest.approx(
        expected.gains_db, abs=1e-4
    )  # sums of BLAS in another order
    turned = {
        **setting,
        "bits": setting["bits"][1:] + "1",
    }  # the ways without a code are kept from the first one
    other = read_setting(turned)
    again = shifted_verdict(other)
    assert posted(client, "verdict", setting=turned)["sentence"] == again.sentence
    assert [way["name"] for way in found["ways"]][:2] == ["open shutter", "best single exposure"]


def test_photos_are_pictures_in_colour_that_differ(client, setting, tmp_path):
    codes = {"code": setting["bits"], "open": "1" * 16, "snapshot": "0" * 6 + "1111" + "0" * 6}
    taken, restored = (
        posted(client, "photos", setting=setting, codes=codes, restored=restored)
        for restored in (False, True)
    )
    assert set(taken) == set(restored) == set(codes)
    assert len({*taken.values(), *restored.values()}) == 6
    for photo in (*taken.values(), *restored.values()):
        head, _, content = photo.partition(",")
        assert head == "data:image/jpeg;base64"
        (tmp_path / "photo.jpg").write_bytes(base64.b64decode(content))
        pixels = read_image(tmp_path / "photo.jpg")
        assert pixels.shape == (256, 256, 3)
        assert (
            np.ptp(pixels, axis=2).max() > 0.2
        )  # the bundled scene has colours, and so have its photos


def test_a_scene_that_is_written_again_is_read_again(setting, tmp_path):
    scene = tmp_path / "scene.npy"
    codes = {"code": setting["bits"]}
    views = Views()
    taken = []
    for level in (0.2, 0.8, 0.2):
        np.save(scene, np.full((300, 300), level, np.float32))
        taken.append(views.photos(read_setting(setting), scene, codes, restored=False)["code"])
    assert taken[0] == taken[2] != taken[1]


@pytest.mark.parametrize(
    "codes",
    [None, {}, {"code": "101"}, {"code": "0" * 16}, {"code": 3}, dict.fromkeys("abcd", "1" * 16)],
)
def test_photos_of_wrong_codes_are_refused_in_one_line(client, setting, codes):
    answer = client.post("/api/photos", json={"setting": setting, "codes": codes})
    assert answer.status_code == 422
    assert answer.json()["error"]["field"] == "scene"


def test_a_code_that_breaks_a_limit_is_measured_and_named(client, setting):
    found = posted(client, "picture", setting={**setting, "open": [2, 4]})
    assert found["code"]["broken"] == ["9 chips are open; the limit is 2 to 4"]
    assert found["error"] is None


def test_limits_that_no_code_keeps_are_told_beside_their_field(client, setting):
    found = posted(client, "picture", setting={**setting, "device": "mechanical"})
    assert found["error"]["field"] == "device"
    assert found["figures"]["psnr_db"] > 0
    refused = client.post("/api/verdict", json={"setting": {**setting, "device": "mechanical"}})
    assert refused.status_code == 422
    assert refused.json()["error"]["field"] == "device"


def test_pins_are_compared_at_equal_length(client, setting):
    pins = {"mirror": setting["bits"][::-1], "short": "101"}
    found = posted(client, "compare", setting=setting, pins=pins)["pins"]
    assert set(found) == {"mirror"}
    assert found["mirror"]["mse_db"] == pytest.approx(
        posted(client, "picture", setting=setting)["figures"]["mse_db"]
    )


@pytest.mark.parametrize("file_format", sorted(EXPORTERS))
def test_every_format_is_exported(client, setting, file_format):
    answer = client.post("/api/export", json={"setting": setting, "format": file_format})
    if answer.status_code == 422:  # what a format cannot hold is one sentence beside it
        assert answer.json()["error"]["field"] == "format"
    else:
        assert answer.json()["text"]


def test_a_sketch_of_chips_between_two_ticks_is_downloaded_with_a_warning(client, setting):
    document = {"setting": {**setting, "exposure": "20001us"}, "format": "arduino"}
    answer = client.post("/api/export", json=document).json()
    assert "#define TICKS 2500u" in answer["text"]
    assert answer["warnings"] == [
        "its chips last 1250000 ns instead of 1250062 ns: whole ticks of 500 ns"
    ]
    assert client.post("/api/export", json={**document, "format": "csv"}).json()["warnings"] == []


def test_a_document_is_opened_by_what_it_is(client, setting):
    saved = posted(client, "save", setting=setting, state={"bits": setting["bits"]})
    assert (
        client.post(
            "/api/upload/document",
            content=json.dumps(
                {**saved["trajectory"], "source": {"path_uncertainty_px": 0.25}}
            ).encode(),
        ).json()["path_error"]
        == 0.25
    )
    for part, key in (("trajectory", "paths"), ("code", "bits")):
        found = client.post("/api/upload/document", content=json.dumps(saved[part]).encode())
        assert key in found.json(), found.text
    assert (
        client.post("/api/upload/document", content=json.dumps(saved).encode()).json()["state"]
        == saved["state"]
    )
    wrong = client.post("/api/upload/document", content=b'{"schema": "cep.code/1", "bits": "2"}')
    assert wrong.status_code == 422
    assert "/tmp" not in wrong.text  # no path of the server is disclosed
    assert "cep-studio" not in wrong.text


def test_a_code_is_opened_with_the_shutter_it_was_searched_for(client, setting):
    saved = posted(client, "save", setting={**setting, "device": "led-strobe"}, state={})["code"]
    assert saved["problem"]["device"]["name"] == "led-strobe"
    found = client.post("/api/upload/document", content=json.dumps(saved).encode()).json()
    assert (found["device"], "warning" in found) == ("led-strobe", False)
    saved["problem"]["device"]["max_on_ns"] = 2_000_000  # one's own, which the page cannot name
    found = client.post("/api/upload/document", content=json.dumps(saved).encode()).json()
    assert found["device"] == ""
    assert "led-strobe" in found["warning"]
    del saved["problem"]["device"]["name"]
    wrong = client.post("/api/upload/document", content=json.dumps(saved).encode())
    assert (wrong.status_code, wrong.json()["error"]["field"]) == (422, "open_file")


def test_a_gyroscope_gives_a_motion_of_known_direction(client):
    rows = "\n".join(f"{i * 1e-3:.4f},0,{0.2:.3f},0" for i in range(101))
    found = client.post(
        "/api/upload/gyro?focal=1000&start=0.01&exposure=0.05",
        content=f"t_s,wx,wy,wz\n{rows}\n".encode(),
    )
    (path,) = found.json()["paths"]
    assert path["length_px"] == pytest.approx(1000 * 0.2 * 0.05, rel=0.01)
    assert path["direction"] == "known"
    assert (
        path["x"][-1] < path["x"][0]
    )  # about the camera's axis that points down: the image runs left
    assert (
        found.json()["warnings"][0]
        == "time: t_s, in s; rates: wx, wy, wz, in rad/s; axes: right,down,forward"
    )
    log = f"t_s,wx,wy,wz\n{rows}\n".encode()
    upright = client.post(
        "/api/upload/gyro?focal=1000&start=0.01&exposure=1/20&axes=right,up,back", content=log
    )
    (other,) = upright.json()["paths"]
    np.testing.assert_allclose(other["x"], np.negative(path["x"]), atol=1e-9)
    for wrong, field in (
        ("exposure=0.05&axes=x", "gyro_axes"),
        ("exposure=soon", "gyro_exposure"),
    ):
        refused = client.post(
            f"/api/upload/gyro?focal=1000&start=0.01&{wrong}", content=log
        ).json()["error"]
        assert refused["field"] == field
    late = client.post(
        "/api/upload/gyro?focal=1000&start=9&exposure=0.05",
        content=f"t_s,wx,wy,wz\n{rows}\n".encode(),
    )
    assert late.json()["error"]["field"] == "gyro"


def files_of(client):
    return sorted(path.name for path in studio_of(client).uploads.folder.iterdir())


def studio_of(client):
    return client.app.state.studio


def test_only_photos_are_kept_and_the_oldest_go(client):
    refused = client.post("/api/upload/photo", content=b"GIF89a" + bytes(100))
    assert refused.json()["error"]["field"] == "photo"
    assert files_of(client) == []
    photo = encode_image(np.random.default_rng(0).random((32, 32)), ".png")
    keys = [client.post("/api/upload/photo", content=photo).json()["photo"] for _ in range(10)]
    assert files_of(client) == sorted(f"{key}.png" for key in keys[-8:])
    assert client.get(f"/api/photo/{keys[-1]}").status_code == 404  # no preview yet
    assert client.get(f"/api/photo/{keys[0]}").status_code == 422


@pytest.mark.parametrize("suffix", RAW_SUFFIXES)
def test_a_raw_file_is_kept_under_its_suffix_and_not_read_as_a_tiff(client, suffix):
    begins_as_tiff = b"II*\0" + bytes(60)
    key = client.post(f"/api/upload/photo?suffix={suffix.upper()}", content=begins_as_tiff).json()[
        "photo"
    ]
    assert f"{key}{suffix}" in files_of(client)
    other = client.post("/api/upload/photo?suffix=/../x.nef", content=begins_as_tiff).json()[
        "photo"
    ]
    assert f"{other}.tif" in files_of(client)


def test_hostile_requests_are_refused_and_leave_nothing(client, keys):
    rng = np.random.default_rng(0)
    before = files_of(client)
    for _ in range(60):
        method, path, changed, chunks = hostile(rng)
        request = client.build_request(
            method, path, content=iter(chunks) if len(chunks) > 1 else b"".join(chunks)
        )
        request.headers["cookie"] = f"{keys.cookie}={keys.session}"
        for name, value in changed.items():
            if value is None:
                request.headers.pop(name, None)
            else:
                request.headers[name] = value
        answer = client.send(request)
        assert 400 <= answer.status_code < 500, (
            method,
            path,
            changed,
            chunks[:1],
            answer.status_code,
            answer.text,
        )
        assert "Traceback" not in answer.text
    assert files_of(client) == before
    assert client.get("/").status_code == 200


@pytest.mark.parametrize("length", [7, 8, 64, 65])
def test_a_page_has_a_name_of_8_to_64_letters_and_digits(client, length):
    answer = client.post("/api/stop", json={"page": "a" * length})
    if 8 <= length <= 64:
        assert answer.status_code < 300
    else:
        assert answer.status_code == 422
        assert "8 to 64 letters and digits" in answer.text


HUGE = json.loads("[" + "9" * 400 + ', 1e999, NaN, "\\ud800", [[]], {"a": {}}, true]')


@pytest.mark.parametrize("value", HUGE, ids=lambda value: str(type(value).__name__))
def test_no_value_anywhere_in_a_request_is_an_error_of_the_server(client, setting, value):
    page = "a" * 16
    codes = {"code": setting["bits"]}
    asked = {
        "picture": [{"setting": setting, name: value} for name in ("steps", "seed")],
        "photos": [
            {"setting": setting, "codes": codes, "scene": value},
            {"setting": setting, "codes": {"c": value}},
        ],
        "compare": [{"setting": setting, "pins": value}],
        "export": [{"setting": setting, "format": value}],
        "save": [
            {"setting": setting, "state": [value]},
            {"setting": setting, "state": {"search": value}},
        ],
        "job": [
            {"page": value, "kind": "search", "setting": setting},
            {"page": page, "kind": value, "setting": setting},
            {"page": page, "kind": "search", "setting": setting, "steps": value},
            {"page": page, "kind": "search", "setting": setting, "seed": value},
            {"page": page, "kind": "play", "setting": setting, "port": value},
            {"page": page, "kind": "calibrate", "photo": value},
            *(
                {"page": page, "kind": "shoot", "setting": setting, **SHOT, name: value}
                for name in ("camera", "port", "release")
                if value or name != "release"  # which may be left to the camera
            ),
        ],
        "stop": [{"page": value}],
        "verdict": [{"setting": {**setting, name: value}} for name in setting],
    }
    for name, documents in asked.items():
        for document in documents:
            answer = client.post(f"/api/{name}", content=json.dumps(document).encode())
            assert answer.status_code == 422, (name, document, answer.text)
            assert answer.json()["error"]["message"].isprintable()


@pytest.mark.parametrize("name", ["\ud800", "two\nlines", "x" * 200])
def test_a_code_of_an_unprintable_name_is_refused(client, setting, name):
    for address, field in (("compare", "pins"), ("photos", "codes")):
        body = json.dumps({"setting": setting, field: {name: setting["bits"]}}).encode()
        assert client.post(f"/api/{address}", content=body).status_code == 422


@pytest.mark.parametrize(
    ("state", "named"),
    [
        ({"bits": 5}, "state.bits"),
        ({"motion": None}, "state.motion"),
        ({"pins": 3}, "state.pins"),
        ([], "state"),
        ({"open": 10**400}, "state.open"),
        ({"photons": "many"}, "state.photons"),
        ({"search": "5:0"}, "state.search"),
        ({"min_open": {"a": [[[]]]}}, "state.min_open"),
        ({"exposure": ["1/30"]}, "state.exposure"),
    ],
)
def test_a_studio_file_of_wrong_types_is_one_line_that_names_the_field(client, state, named):
    answer = client.post(
        "/api/upload/document",
        content=json.dumps({"schema": "cep.studio/1", "state": state}).encode(),
    )
    assert answer.status_code == 422
    assert answer.json()["error"]["field"] == "open_file"
    assert answer.json()["error"]["message"].startswith(f"{named}:")


def test_a_connection_that_asks_nothing_is_closed(monkeypatch):
    monkeypatch.setattr(serving, "_MOST_SILENT_S", 0.2)
    ready = queue.Queue()
    servers = []
    run = uvicorn.Server.run
    monkeypatch.setattr(
        uvicorn.Server, "run", lambda self, sockets: [servers.append(self), run(self, sockets)]
    )
    thread = threading.Thread(target=lambda: serving.serve(on_ready=ready.put))
    thread.start()
    try:
        home = urlsplit(ready.get(timeout=60))
        with socket.create_connection((home.hostname, home.port), timeout=60) as silent:
            silent.sendall(b"GET / HTTP/1.1\r\nhost: ")
            assert silent.recv(100) == b""
    finally:
        servers[0].should_exit = True
        thread.join(60)
    assert not thread.is_alive()


def test_a_stream_too_many_is_refused(client, monkeypatch):
    def refuse(_page):
        raise BusyError("too many pages listen")

    monkeypatch.setattr(studio_of(client).jobs, "listen", refuse)
    answer = client.get("/api/events?page=aaaaaaaa")
    assert answer.status_code == 409
    assert "too many pages listen" in answer.text


@pytest.mark.parametrize("kind", ["photo", "text"])
def test_half_an_upload_leaves_nothing(kind):
    async def half():
        yield b"\x89PNG\r\n\x1a\n" + bytes(100)
        raise ClientDisconnect

    uploads = Uploads()
    try:
        with pytest.raises(ClientDisconnect):
            asyncio.run(
                uploads.photo(half())
                if kind == "photo"
                else uploads.text(half(), ".json", field="open_file")
            )
        assert list(uploads.folder.iterdir()) == []
    finally:
        uploads.close()
    assert not uploads.folder.exists()


@pytest.mark.parametrize(
    ("address", "field"),
    [
        ("upload/photo", "photo"),
        ("upload/document", "open_file"),
        ("upload/gyro", "gyro"),
        ("example-photo", "photo"),
    ],
)
def test_a_full_disk_is_told_beside_the_field_and_leaves_nothing(
    client, monkeypatch, address, field
):
    folder = client.app.state.studio.uploads.folder
    before = set(folder.iterdir())
    with full_disk(monkeypatch, writes=0):
        answer = client.post(
            f"/api/{address}", content=encode_image(np.full((20, 20), 0.5), ".png")
        )
    assert answer.status_code == 422
    error = answer.json()["error"]
    assert error["field"] == field
    assert error["message"].startswith(
        "the studio's folder cannot be written (no space left on device); free space"
    )
    assert set(folder.iterdir()) == before


def test_a_shot_that_is_not_taken_yet_is_not_there(client):
    key, path = studio_of(client).uploads.reserve(".tif")
    assert client.get(f"/api/photo/{key}/shot.zip").status_code == 422
    path.write_bytes(b"II*\0")
    path.with_name(f"{key}_sharp.png").write_bytes(b"png")
    packed = client.get(f"/api/photo/{key}/shot.zip")
    assert packed.headers["content-type"] == "application/zip"
    with zipfile.ZipFile(io.BytesIO(packed.content)) as archive:
        assert archive.namelist() == ["photo.tif", "restored.png"]
