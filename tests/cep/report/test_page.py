"""The page of the demo is one file: everything inside, nothing fetched, every text escaped."""

import base64
import hashlib
import re
import shlex
from dataclasses import replace
from html.parser import HTMLParser

import pytest
import typer
from hostile_names import HOSTILE

from cep.commands.main import app
from cep.report.page import html

PICTURES = (
    "advice",
    "blurred",
    "code_strip",
    "mtf",
    "path",
    "photos",
    "psfs",
    "restored_coded",
    "restored_snapshot",
    "scene_at_rest",
)


class Page(HTMLParser):
    """Visible text, commands and images of a page."""

    def __init__(self, page):
        super().__init__()
        self.text = ""
        self.commands = ""
        self.images = []
        self.inside = []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        if tag == "img":
            self.images.append(dict(attrs))
        if tag in ("code", "script", "style"):
            self.inside.append(tag)

    def handle_endtag(self, tag):
        if self.inside and self.inside[-1] == tag:
            self.inside.pop()

    def handle_data(self, data):
        if "code" in self.inside:
            self.commands += data
        if not {"script", "style"} & set(self.inside):
            self.text += data


def test_the_page_recommends_no_code_where_none_is_advised(plain, page_of):
    page = Page(page_of(plain))
    assert plain.advice.here.sentence.startswith("Coding does not pay here")
    assert plain.advice.here.sentence in page.text
    assert plain.shot("coded").exposure.code.bits not in page.text
    assert not re.search(
        r"cep (optimize|upload|export)|refined\.json|Code this exposure|Pulse the shutter",
        page.text,
    )
    assert "best code (not advised)" in page.text
    assert page.text.count("(not advised)") == 1


def test_the_page_leads_with_the_verdict(coded, page_of):
    page = Page(page_of(coded))
    assert coded.code.bits in page.text
    assert "(not advised)" not in page.text
    assert page.text.index("For ") < page.text.index(coded.advice.here.sentence)
    assert page.text.index(coded.advice.here.sentence) < page.text.index("Gain over the light")


def test_figures_on_the_page_are_those_of_the_files(either, demo_of, page_of):
    _, figures = demo_of(either)
    text = Page(page_of(either)).text.replace("−", "-")
    assert figures["verdict"] in text
    for psnr_db in figures["psnr_db"].values():
        assert psnr_db is None or f"{psnr_db:.2f}" in text
    for gain_db in figures["simulated_gains_db"].values():
        assert f"{gain_db:+.2f}" in text
    for kind, gain in figures["gains_db"].items():
        if kind != "code" or gain != figures["gains_db"].get("strobe"):
            assert f"{gain:+.2f}" in text
    assert not re.search(r"\bnan\b|\binf\b", text)


def test_the_page_is_one_file_and_described(either):
    page = html(either)
    images = Page(page).images
    assert len(images) >= 7
    assert all(
        image["alt"] and image["src"].startswith("data:image/png;base64,") for image in images
    )
    assert not re.search(
        r"""(?:src|href|srcset|action)="(?!data:image/png;|\#)|url\(|@import|https?:""", page
    )


def test_the_commands_on_the_page_take_their_options(either):
    commands = typer.main.get_command(app).commands
    page = html(either, dict.fromkeys(PICTURES, b""), options="--camera video-8bit --photons 100")
    lines = Page(page).commands.strip().splitlines()
    assert len(lines) >= 3
    for line in lines:
        program, name, *arguments = shlex.split(line)
        assert program == "cep"
        known = {option for parameter in commands[name].params for option in parameter.opts}
        assert {part for part in arguments if part.startswith("-")} <= known


def test_the_only_script_is_the_one_that_the_policy_names(coded, page_of):
    page = page_of(coded)
    (script,) = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in page
    assert "default-src 'none'" in page
    assert not re.search(r"fetch|XMLHttpRequest|innerHTML|eval|https?:", script)


@pytest.mark.parametrize("name", [*HOSTILE, "a & b < c", "\x1b[2J\u202egnp", "'\""], ids=ascii)
def test_texts_are_escaped(coded, name):
    chain = replace(coded, scene=replace(coded.scene, name=name, warnings=(name,)))
    png = dict.fromkeys(PICTURES, b"")
    page = html(chain, png)
    assert page.count("<script") == 1
    assert not {"\x1b", "\u202e"} & set(page)
    if name.isprintable():
        assert Page(page).text.count(name) == 2
