import pytest

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
    "path", ["/", "/?token=wrong", "/?token=", "/static/studio.js", "/api/start", "/api/events?page=aaaaaaaa"]
)
def test_without_the_key_nothing_is_told(bare, path):
    bare.cookies.clear()
    answer = bare.get(path)
    assert answer.status_code == 403
    assert "script" not in answer.text


def test_two_tokens_are_none(bare, keys):
    bare.cookies.clear()
    assert bare.get(f"/?token={keys.token}&token=x").status_code == 403


@pytest.mark.parametrize("host", ["evil.example:8765", "127.0.0.1", "127.0.0.1:80", "localhost.evil.example:8765", ""])
def test_another_host_is_refused_even_with_the_key(client, host):
    assert client.get("/", headers={"host": host}).status_code == 403


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1:1", "https://127.0.0.1:8765", "", None]
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
    for answer in (client.get("/"), client.get("/", headers={"host": "evil.example"}), client.get("/nothing")):
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
