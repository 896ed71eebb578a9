import asyncio

import pytest
from starlette.testclient import TestClient

from cep.studio import security
from cep.studio.security import Gate, Keys, LateError
from cep.studio.server import make_app

GOOD = "http://127.0.0.1:8765"


def test_the_token_is_exchanged_for_a_strict_cookie(bare, keys):
    bare.cookies.clear()
    answer = bare.get(f"/?token={keys.token}", follow_redirects=False)
    assert (answer.status_code, answer.headers["location"]) == (303, "/")
    cookie = answer.headers["set-cookie"].lower()
    assert "samesite=strict" in cookie
    assert "httponly" in cookie
    assert keys.token not in answer.headers["set-cookie"]
    assert bare.get("/").status_code == 200  # the client kept it


@pytest.mark.parametrize(
    "path",
    [
        "/",
        "/?token=wrong",
        "/?token=",
        "/static/studio.js",
        "/api/start",
        "/api/events?page=aaaaaaaa",
    ],
)
def test_without_the_key_nothing_is_told(bare, path):
    bare.cookies.clear()
    answer = bare.get(path)
    assert answer.status_code == 403
    assert "script" not in answer.text


@pytest.fixture
def fresh():
    """Keys that no test has used, and a client without one."""
    keys = Keys(8765)
    with TestClient(make_app(keys), base_url=GOOD, follow_redirects=False) as client:
        yield keys, client


def test_the_key_works_once(fresh):
    keys, client = fresh
    assert client.get(f"/?token={keys.token}").status_code == 303
    client.cookies.clear()
    answer = client.get(f"/?token={keys.token}")
    assert answer.status_code == 403
    assert "works once" in answer.text
    assert "set-cookie" not in answer.headers


def test_the_printed_address_leads_on_in_the_browser_that_has_the_cookie(fresh):
    keys, client = fresh
    for _ in range(2):
        answer = client.get(f"/?token={keys.token}")
        assert (answer.status_code, answer.headers["location"]) == (303, "/")
    assert "set-cookie" not in answer.headers
    assert client.get("/").status_code == 200


@pytest.mark.parametrize(
    "ahead",
    [
        {"sec-purpose": "prefetch"},
        {"sec-purpose": "prefetch;prerender"},
        {"purpose": "prefetch"},
        "HEAD",
    ],
)
def test_a_browser_that_looks_ahead_does_not_use_the_key_up(fresh, ahead):
    keys, client = fresh
    method, headers = ("HEAD", {}) if ahead == "HEAD" else ("GET", ahead)
    early = client.request(method, f"/?token={keys.token}", headers=headers)
    assert early.status_code == 403
    assert "set-cookie" not in early.headers
    assert client.get(f"/?token={keys.token}").status_code == 303


def test_a_visit_from_a_file_is_led_on_by_a_page_of_the_studio(fresh):
    keys, client = fresh
    answer = client.get(f"/?token={keys.token}", headers={"sec-fetch-site": "cross-site"})
    assert answer.status_code == 200
    assert "set-cookie" in answer.headers
    assert 'http-equiv="refresh" content="0; url=/"' in answer.text
    assert keys.token not in answer.text


def test_two_tokens_are_none(bare, keys):
    bare.cookies.clear()
    assert bare.get(f"/?token={keys.token}&token=x").status_code == 403


@pytest.mark.parametrize(
    "host", ["evil.example:8765", "127.0.0.1", "127.0.0.1:80", "localhost.evil.example:8765", ""]
)
def test_another_host_is_refused_even_with_the_key(client, host):
    assert client.get("/", headers={"host": host}).status_code == 403


@pytest.mark.parametrize(
    "origin",
    ["http://evil.example", "null", "http://127.0.0.1:1", "https://127.0.0.1:8765", "", None],
)
def test_another_origin_is_refused_even_with_the_key(client, origin, setting):
    headers = dict(client.headers)
    headers.pop("origin")
    request = client.build_request("POST", "/api/picture", json={"setting": setting})
    if origin is None:
        del request.headers["origin"]
    else:
        request.headers["origin"] = origin
    assert client.send(request).status_code == 403


def test_a_request_that_the_browser_calls_foreign_is_refused(client):
    assert client.get("/", headers={"sec-fetch-site": "cross-site"}).status_code == 403
    assert client.get("/", headers={"sec-fetch-site": "same-origin"}).status_code == 200


def test_refusals_too_carry_the_policy(client):
    for answer in (
        client.get("/"),
        client.get("/", headers={"host": "evil.example"}),
        client.get("/nothing"),
    ):
        policy = answer.headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert "http" not in policy  # nothing from elsewhere
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["cache-control"] == "no-store"


def test_a_body_is_counted_whatever_its_length_says(client):
    told = client.post("/api/picture", content=b" " * 300_000)
    untold = client.post("/api/picture", content=(b" " * 65_536 for _ in range(8)))
    for answer in (told, untold):
        assert answer.status_code == 413
        assert "256 KB" in answer.text or "262,144 bytes" in answer.text


@pytest.mark.parametrize(("address", "most"), [("document", 4), ("gyro", 32), ("photo", 256)])
def test_an_upload_of_too_many_bytes_is_refused_before_it_is_read(client, address, most):
    length = most * 1024**2 + 1
    answer = client.post(
        f"/api/upload/{address}", content=iter(()), headers={"content-length": str(length)}
    )
    assert answer.status_code == 413
    assert f"at most {most} MB" in answer.text


def test_a_document_of_many_megabytes_is_refused_while_it_comes(client, monkeypatch):
    def parsed(*_):
        pytest.fail("was parsed")

    monkeypatch.setattr("cep.studio.server.opened_document", parsed)
    answer = client.post("/api/upload/document", content=(b"[" * 2**20 for _ in range(6)))
    assert answer.status_code == 413
    assert "at most 4 MB" in answer.text


@pytest.mark.parametrize("length", ["9" * 5000, "1" * 20, "\u00b2", "-1", "x"])
def test_a_length_that_is_no_number_is_refused(client, length, setting):
    headers = {"content-length": length.encode("latin-1")}
    answer = client.post("/api/picture", content=b"{}", headers=headers)
    assert answer.status_code == 413


def test_a_get_with_a_body_is_refused(client):
    assert client.request("GET", "/api/events?page=aaaaaaaa", content=b"x").status_code == 400


def test_a_body_that_does_not_come_is_not_waited_for_without_an_end(keys, monkeypatch):
    monkeypatch.setattr(security, "_MOST_BODY_S", 0.05)

    async def reads(_scope, receive, _send):
        while (await receive())["more_body"]:
            pass

    async def never():
        await asyncio.sleep(60)

    headers = {
        "host": f"127.0.0.1:{keys.port}",
        "origin": GOOD,
        "cookie": f"{keys.cookie}={keys.session}",
    }
    scope = {
        "type": "http",
        "method": "POST",
        "path": "/api/picture",
        "query_string": b"",
        "headers": [(name.encode(), value.encode()) for name, value in headers.items()],
    }
    with pytest.raises(LateError, match=r"within 0\.05 s"):
        asyncio.run(asyncio.wait_for(Gate(reads, keys)(scope, never, never), 30))
