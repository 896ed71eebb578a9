"""The site of the documentation: built without a warning, links that lead somewhere, no outside
request."""

import importlib.util
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
import typer
from emulators.tools import give_up

from cep import __all__ as front_door
from cep.commands.main import app

ROOT = Path(__file__).resolve().parent.parent
LOADED = {
    "link": "href",
    "script": "src",
    "img": "src",
    "source": "src",
    "iframe": "src",
    "video": "src",
    "object": "data",
}


class Page(HTMLParser):
    """Links, what a browser would load, and the places that links can lead to."""

    def __init__(self, path):
        super().__init__()
        self.links = []
        self.loaded = []
        self.places = set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.places |= {found[key] for key in ("id", "name") if found.get(key)}
        if tag == "a" and found.get("href"):
            self.links.append(found["href"])
        if found.get(LOADED.get(tag, "")):
            self.loaded.append(found[LOADED[tag]])


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    if any(importlib.util.find_spec(name) is None for name in ("sphinx", "furo", "myst_parser")):
        give_up("sphinx, furo and myst-parser not installed: make docs")
    folder = tmp_path_factory.mktemp("site")
    build = [
        sys.executable,
        "-m",
        "sphinx",
        "-q",
        "-W",
        "--keep-going",
        "-b",
        "html",
        "docs",
        str(folder),
    ]
    done = subprocess.run(build, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.slow(reason="Sphinx reads every document and every docstring of the front door")
def test_the_site(site):
    pages = {path: Page(path) for path in site.rglob("*.html")}
    assert len(pages) > 25
    wrong = []
    for path, page in pages.items():
        for link in [*page.links, *page.loaded]:
            parts = urlsplit(link)
            if parts.scheme == "data":
                continue
            if parts.scheme or parts.netloc:
                wrong += [f"{path.name} loads {link}"] if link in page.loaded else []
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.exists():
                wrong.append(f"{path.name}: {link} does not exist")
            elif (
                parts.fragment
                and target in pages
                and unquote(parts.fragment) not in pages[target].places
            ):
                wrong.append(f"{path.name}: {link} has no such place")
    styles = [
        path
        for path in site.rglob("*.css")
        if re.search(r"@import|url\(\s*['\"]?(https?:)?//", path.read_text())
    ]
    assert not wrong
    assert not styles
    text = (site / "command-line.html").read_text(encoding="utf-8")
    for option in {
        name
        for command in commands()
        for one in command.params
        for name in one.opts
        if name[0] == "-"
    }:
        assert option in text
    python = (site / "python.html").read_text(encoding="utf-8")
    assert all(f"cep.{name}" in python for name in front_door if name != "__version__")


def commands():
    waiting = [typer.main.get_command(app)]
    while waiting:
        command = waiting.pop()
        waiting += getattr(command, "commands", {}).values()
        yield command
