"""A studio in the process of the test, and a client with its key."""

import pytest
from starlette.testclient import TestClient

from cep.studio.security import Keys
from cep.studio.server import make_app

PORT = 8765


@pytest.fixture(scope="module")
def keys():
    return Keys(PORT)


@pytest.fixture(scope="module")
def bare(keys):
    """A client that has no key yet."""
    app = make_app(keys)
    with TestClient(
        app, base_url=f"http://127.0.0.1:{PORT}", raise_server_exceptions=False
    ) as client:
        client.headers["origin"] = f"http://127.0.0.1:{PORT}"
        yield client


@pytest.fixture
def client(bare, keys):
    """A client with the key, as the studio's own page has it."""
    bare.cookies.clear()
    bare.cookies.set(keys.cookie, keys.session, domain="127.0.0.1", path="/")
    return bare


@pytest.fixture
def setting():
    return {
        "motion": {"kind": "straight", "length": 20, "angle": 0},
        "bits": "1101000111010110",
        "exposure": "20ms",
        "camera": "video-8bit",
        "photons": 2000,
        "read_noise": None,
        "device": "",
        "open": None,
    }
