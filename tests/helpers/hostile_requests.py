"""Requests that a hostile page, a broken client or a bored neighbour might send, drawn at
random."""

import json

GOOD = {
    "motion": {"kind": "straight", "length": 20, "angle": 0},
    "bits": "1101000111010110",
    "exposure": "20ms",
    "camera": "video-8bit",
    "photons": 2000,
    "read_noise": 5,
    "device": "",
    "open": None,
}
ANSWERS = ("picture", "photos", "verdict", "compare", "export", "save", "job", "stop")
ODD = (
    None,
    True,
    -1,
    0,
    1e999,
    float("nan"),
    10**400,
    "",
    "../../etc/passwd",
    "/etc/passwd",
    "\0",
    "1" * 100_000,
    [],
    [[]],
    {},
    {"kind": "path"},
    "module:name",
    "os:system",
    "code.json",
    "☃",
    "\ud800",
    "'; drop table",
)
PATHS = (
    "/../../etc/passwd",
    "/static/../server.py",
    "/static/%2e%2e/server.py",
    "/static/..%2f..%2fpyproject.toml",
    "/static/",
    "/static//etc/passwd",
    "/api/photo/../../../etc/passwd",
    "/api/photo/%2e%2e%2f%2e%2e",
    "/api/photo/00",
    "/api/nothing",
    "/static/studio.js%00.png",
    "/api/events",
    "/api/events?page=..",
    "/api/events?page=" + "a" * 3000,
)


def hostile(rng):
    """Draw a request that must be refused: method, path, what to change of the right headers, body
    in chunks."""
    kind = rng.integers(9)
    answer = f"/api/{ANSWERS[rng.integers(len(ANSWERS))]}"
    odd = ODD[rng.integers(len(ODD))]
    if kind == 0:  # no JSON
        junk = [
            b"",
            b"{",
            b"[]",
            b"null",
            b"\xff\xfe",
            b'{"setting":',
            b"[" * 5000,
            bytes(rng.integers(0, 256, 200)),
        ]
        return "POST", answer, {}, [junk[rng.integers(len(junk))]]
    if kind == 1:  # a wrong field
        name = sorted(set(GOOD) - {"open"})[rng.integers(len(GOOD) - 1)]
        broken = {**GOOD, name: odd if odd not in (None, "") else "../x"}
        if name == "motion" or rng.random() < 0.3:
            broken["motion"] = {"kind": "path", "t": odd, "x": [odd], "y": odd}
        name = "picture" if rng.random() < 0.5 else "verdict"
        return (
            "POST",
            f"/api/{name}",
            {},
            [json.dumps({"setting": broken, "page": odd, "state": odd}).encode()],
        )
    if kind == 2:  # a body that is too large, its length told or not
        return "POST", answer, {}, [b" " * 65536] * 8
    if kind == 3:
        return "GET", PATHS[rng.integers(len(PATHS))], {}, []
    good = [json.dumps({"setting": GOOD}).encode()]
    if kind == 4:  # without the key, or with a wrong one
        cookies = [
            "",
            "cep_studio_8765=wrong",
            "cep_studio_8765=",
            "a=b; cep_studio_8765=" + "x" * 2000,
            "\x7f;=,;",
        ]
        return "POST", answer, {"cookie": cookies[rng.integers(len(cookies))]}, good
    if kind == 5:  # from another page
        origins = [
            "http://evil.example",
            "null",
            "http://127.0.0.1:1",
            "https://127.0.0.1:8765",
            "http://localhost",
            None,
        ]
        return "POST", answer, {"origin": origins[rng.integers(len(origins))]}, good
    if kind == 6:  # under another name: DNS rebinding
        hosts = [
            "evil.example:8765",
            "127.0.0.1",
            "127.0.0.1:80",
            "localhost.evil.example:8765",
            "",
            "[::1]:8765",
        ]
        return (
            "GET" if rng.random() < 0.5 else "POST",
            answer,
            {"host": hosts[rng.integers(len(hosts))]},
            good,
        )
    if kind == 7:  # uploads of no photo, no document
        where = ["photo", "document", "gyro?focal=1&start=0&exposure=1", "gyro?focal=x"][
            rng.integers(4)
        ]
        junk = [
            b"",
            b"GIF89a" + bytes(99),
            b"#!/bin/sh\nrm -rf /",
            b"<svg onload=alert(1)>",
            b'{"schema": "cep.code/1"}',
            bytes(5000),
        ]
        return "POST", f"/api/upload/{where}", {}, [junk[rng.integers(len(junk))]]
    method = ["PUT", "DELETE", "PATCH", "OPTIONS", "TRACE"][rng.integers(5)]
    return method, answer, {}, []
