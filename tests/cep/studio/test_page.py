"""The studio in a headless Chromium: what a hand, a keyboard and a reload do, and nothing asked of
anybody else."""

import http.client
import json
import os
import re
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
from emulators.tools import require_simavr

from cep.files.images import encode_image, read_image
from cep.studio.state import saved_setting
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory

PHONE = 380
DESK = 1280
pytestmark = pytest.mark.slow  # a server of its own, and a browser


def started(*arguments, **streams):
    """Start a studio in a process of its own, as the command does: the process, and the address
    that it told."""
    command = [
        sys.executable,
        "-c",
        "from cep.commands.main import run; run()",
        "studio",
        "--json",
        *arguments,
    ]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, **streams)
    told = ""
    while not told.rstrip().endswith("}"):
        told += server.stdout.readline()
    return server, json.loads(told)["address"]


@pytest.fixture(scope="module")
def server_address():
    """Address of a studio without its key, and the cookie for which the key was exchanged."""
    server, told = started("--no-browser")
    home = urlsplit(told)
    client = http.client.HTTPConnection(home.netloc, timeout=60)
    client.request("GET", f"/?{home.query}")
    cookie = client.getresponse().getheader("set-cookie").split(";")[0].partition("=")
    client.close()
    address = f"http://{home.netloc}/"
    yield (
        address,
        {
            "name": cookie[0],
            "value": cookie[2],
            "url": address,
            "httpOnly": True,
            "sameSite": "Strict",
        },
    )
    server.send_signal(signal.SIGINT)
    assert server.wait(15) == 0
    server.stdout.close()


@pytest.fixture
def studio(browser, server_address):
    """Open the studio in a window of a given width; at the end check for requests to other hosts
    and errors."""
    contexts = []
    asked = []
    errors = []
    home, cookie = server_address

    def open_page(width=DESK, state="", **options):
        context = browser.new_context(viewport={"width": width, "height": 900}, **options)
        contexts.append(context)
        context.add_cookies([cookie])
        page = context.new_page()
        page.on("request", lambda request: asked.append(request.url))
        page.on(
            "console",
            lambda message: errors.append(message.text) if "422" not in message.text else None,
        )
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(home)
        if state:
            page.evaluate("state => { location.hash = state; }", state)
        shown(page)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert errors == []
    hosts = {urlsplit(url).netloc for url in asked if not url.startswith(("data:", "blob:"))}
    assert hosts == {urlsplit(home).netloc}


def until(page, expression, seconds=60):
    """Wait for an expression; the page's policy forbids Playwright's own way, which evaluates text
    in the page."""
    ends = time.monotonic() + seconds
    while not page.evaluate(expression):
        assert time.monotonic() < ends, expression
        time.sleep(0.02)


def shown(page):
    """Wait until everything shows the latest state."""
    until(
        page,
        "['picture', 'photo', 'verdict'].every((one) => document.body.dataset[one] ==="
        " document.body.dataset.asked)",
    )


def address(page):
    """State in the address, which follows the page a little later."""
    until(page, "!('address' in document.body.dataset)")
    return urlsplit(page.url).fragment


def bits(page):
    return dict(part.split("=", 1) for part in address(page).split("&"))["code"]


def chip(page, number):
    return page.locator("#strip button").nth(number - 1)


def test_ctrl_c_ends_it_without_a_word_while_a_page_listens():
    server, told = started("--no-browser", stderr=subprocess.PIPE)
    home = urlsplit(told)
    first = http.client.HTTPConnection(home.netloc, timeout=60)
    first.request("GET", f"/?{home.query}")
    cookie = first.getresponse().getheader("set-cookie").split(";")[0]
    stream = http.client.HTTPConnection(home.netloc, timeout=60)
    stream.request("GET", "/api/events?page=0123456789", headers={"cookie": cookie})
    news = stream.getresponse()
    assert news.readline() == b"data: null\n"
    server.send_signal(signal.SIGINT)
    assert server.wait(60) == 0
    assert news.read().strip() == b""  # it was ended, not broken off
    assert server.stderr.read() == ""
    for one in (first, stream, server.stdout, server.stderr):
        one.close()


def test_the_browser_that_is_led_by_the_file_has_the_page_and_nobody_else(browser, tmp_path):
    opener = tmp_path / "opener"
    asked = tmp_path / "asked"
    opener.write_text(
        f"#!/bin/sh\nprintf '%s\\n' \"$@\" > {asked}.part && mv {asked}.part {asked}\n"
    )
    opener.chmod(
        0o755
    )  # the browser of the command: every user of the computer can read what it is called with
    server, told = started(env={**os.environ, "BROWSER": f"{opener} %s"})
    contexts = [browser.new_context() for _ in range(2)]
    try:
        ends = time.monotonic() + 60
        while not asked.exists():
            assert time.monotonic() < ends
            time.sleep(0.02)
        (file,) = asked.read_text().splitlines()
        assert file.startswith("file:///")
        assert urlsplit(told).query.partition("=")[2] not in file
        first, stranger = (context.new_page() for context in contexts)
        first.goto(file)
        first.wait_for_url(f"http://{urlsplit(told).netloc}/#*")
        until(first, "document.body.dataset.asked !== undefined")
        shown(first)
        assert not Path(file.removeprefix("file://")).exists()
        first.reload()
        shown(first)
        again = contexts[0].new_page()
        again.goto(told)  # the printed address, in the browser that has the page
        until(again, "document.body.dataset.asked !== undefined")
        assert "token" not in again.url
        stranger.goto(told)
        assert "the key has been used, and works once" in stranger.content()
    finally:
        for context in contexts:
            context.close()
        server.send_signal(signal.SIGINT)
        assert server.wait(60) == 0
        server.stdout.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [PHONE, DESK, 3840])
def test_nothing_scrolls_sideways(studio, width, scheme):
    page = studio(width, color_scheme=scheme)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.locator("#sentence").inner_text().endswith((".", "…"))
    assert page.locator("#f-psnr").inner_text().endswith("dB")


def sentence(page):
    return page.locator("#sentence").inner_text()


def decided(page):
    """Wait for the verdict over the light."""
    until(page, "!document.getElementById('sentence').classList.contains('stale')", 240)


def test_a_short_motion_has_fewer_chips_and_a_longer_one_has_them_again(studio):
    page = studio()
    before = bits(page)
    page.locator("#length").fill("7")
    shown(page)
    assert 2 <= len(bits(page)) <= 28  # a quarter of a pixel each
    assert page.locator("#chips").input_value() == str(len(bits(page)))
    assert page.locator(".error[data-for~=bits]").inner_text() == ""
    page.locator("#length").fill("40")
    shown(page)
    assert bits(page) == before


def test_nothing_is_said_to_do_before_the_best_code_was_searched(studio):
    page = studio(state="code=1101000111010110&motion=straight:16:0&camera=video-8bit&photons=500")
    seen = {sentence(page)}
    while page.evaluate("document.getElementById('sentence').classList.contains('stale')"):
        seen.add(sentence(page))
    decided(page)
    verdicts = {text for text in seen if not text.startswith(("Searching", "Starting"))}
    assert verdicts <= {sentence(page)}


def test_figures_of_another_motion_do_not_stay(studio):
    page = studio(state="code=1101000111010110&motion=straight:16:0")
    assert page.locator("#f-psnr").is_visible()
    page.locator("#bits").evaluate("box => { box.closest('details').open = true; }")
    page.locator("#bits").fill("10" * 60)  # more chips than the motion tells apart
    until(page, "document.body.hasAttribute('data-blank')")
    for place in ("#f-psnr", "#curve", "#compare"):
        assert not page.locator(place).is_visible()
    until(page, "document.getElementById('sentence').textContent.startsWith('No verdict')")
    page.locator("#bits").fill("1101000111010110")
    until(page, "!document.body.hasAttribute('data-blank')")
    shown(page)
    assert page.locator("#f-psnr").is_visible()


def test_no_column_of_the_table_is_cut_off_on_a_phone(studio):
    page = studio(PHONE, state="code=1101000111010110&motion=straight:16:0")
    edges = page.locator("#pins :is(th, td)").evaluate_all(
        "cells => cells.map((cell) => cell.getBoundingClientRect().right)"
    )
    assert max(edges) <= PHONE
    assert page.locator("#pins").evaluate("table => table.scrollWidth <= table.clientWidth")
    assert chip(page, 1).bounding_box()["width"] >= 20


def test_a_click_a_drag_and_keys_change_the_code_and_the_address(studio):
    page = studio(state="code=1000000000000001&motion=straight:16:0")
    before = page.locator("#f-psnr").inner_text()
    chip(page, 3).click()
    shown(page)
    assert bits(page) == "1010000000000001"
    assert page.locator("#f-psnr").inner_text() != before
    begin, end = (chip(page, number).bounding_box() for number in (5, 8))
    page.mouse.move(begin["x"] + 3, begin["y"] + 20)
    page.mouse.down()
    page.mouse.move(end["x"] + 3, end["y"] + 20, steps=2)
    page.mouse.up()
    assert bits(page) == "1010111100000001"
    chip(page, 1).focus()
    for key in ("ArrowRight", "Space", "End", "Space", "Shift+ArrowLeft"):
        page.keyboard.press(key)
    assert bits(page) == "1110111100000000"
    assert chip(page, 2).get_attribute("aria-checked") == "true"
    assert chip(page, 2).get_attribute("aria-label") == "chip 2 of 16, open"
    page.locator("#undo").click()
    page.locator("#undo").click()
    assert bits(page) == "1110111100000001"
    shown(page)


def test_what_was_played_is_shown_until_the_code_changes(studio):
    page = studio(state="code=1101000111010110&motion=straight:16:0")
    page.locator("#play").click()
    until(page, "!document.getElementById('played').hidden")
    assert page.locator("#played svg").get_attribute("aria-label").startswith("10 edges")
    assert page.locator("#strip").evaluate("strip => strip.getBoundingClientRect().top >= 0")
    chip(page, 3).click()
    assert page.locator("#played").is_hidden()
    shown(page)


def test_both_ends_of_a_wrong_range_are_marked_and_a_code_is_pinned_once(studio):
    page = studio(state="code=1101000111010110&motion=straight:16:0")
    page.locator("#pin").click()
    page.locator("#pin").click()
    assert address(page).count("pin=") == 1
    page.locator("#open-low").fill("60")
    until(page, "document.querySelector('.error[data-for=open]').textContent !== ''")
    assert [
        page.locator(f"#open-{end}").get_attribute("aria-invalid") for end in ("low", "high")
    ] == ["true", "true"]
    page.locator("#open-low").fill("6")
    until(page, "document.querySelector('.error[data-for=open]').textContent === ''")
    assert page.locator("#open-low").get_attribute("aria-invalid") is None
    shown(page)


def test_the_last_open_chip_stays(studio):
    page = studio(state="code=0100&motion=straight:16:0")
    chip(page, 2).click()
    assert bits(page) == "0100"


def test_the_address_is_the_state(studio):
    page = studio()
    page.locator("#length").fill("23.5")
    page.locator("#camera").select_option("sony-imx250")
    page.locator("#photons").fill("900")
    page.locator("#open-low").fill("10")
    page.locator("#pin").click()
    page.locator("input[value=restored]").check(force=True)
    shown(page)
    other = studio(state=address(page))
    for field, value in (
        ("length", "23.5"),
        ("camera", "sony-imx250"),
        ("photons", "900"),
        ("open-low", "10"),
    ):
        assert other.locator(f"#{field}").input_value() == value
    assert other.locator("input[value=restored]").is_checked()
    assert other.locator("#pins").get_by_text("raskar-52").count() == 1
    for figure in ("#f-psnr", "#f-min", "#f-noise"):
        assert other.locator(figure).inner_text() == page.locator(figure).inner_text()


def test_the_divider_compares_two_photos(studio):
    page = studio(
        state="code=1101000111010110&motion=straight:16:0&camera=video-8bit&photons=2000"
    )
    tags = [page.locator(f"#tag-{side}").inner_text() for side in ("left", "right")]
    assert tags == ["open shutter", "this code"]
    width = page.locator("#compare").bounding_box()["width"]
    page.locator("#divider").focus()
    page.keyboard.press("ArrowRight")
    assert page.locator("#divider").get_attribute("aria-valuetext") == "51 percent from the left"
    clipped = page.evaluate("getComputedStyle(document.getElementById('compare'), '::after').left")
    assert float(clipped.removesuffix("px")) == pytest.approx(0.51 * width - 1, abs=1)
    before = page.locator("#photo-left").get_attribute("src")
    page.locator("#side-left").select_option("snapshot")
    shown(page)
    until(page, "document.getElementById('tag-left').textContent === 'best single exposure'")
    assert page.locator("#photo-left").get_attribute("src") != before
    assert "left=snapshot" in address(page)
    assert (
        page.locator("#photo-left").get_attribute("alt")
        == "Simulated photo, best single exposure, as taken"
    )


@pytest.mark.slow  # fifty paths
def test_the_error_of_the_path_counts_in_the_verdict(studio):
    page = studio(
        state="code=1101000111010110&motion=straight:16:0&camera=video-8bit&photons=2000"
    )
    known = page.locator("#f-psnr").inner_text()
    page.locator("#path_error").fill("0.5")
    page.locator("#path_error").press("Tab")
    until(
        page,
        "document.getElementById('f-psnr').textContent.endsWith('dB') &&"
        " location.hash.includes('path_error=0.5')",
    )
    shown(page)
    assert float(page.locator("#f-psnr").inner_text().split()[0]) < float(known.split()[0])
    assert (
        "--trajectory trajectory.json" in page.locator("#commands").inner_text()
    )  # the file states the error
    page.locator("#path_error").fill("99")
    page.locator("#path_error").press("Tab")
    until(page, "document.querySelector('.error[data-for=path_error]').textContent !== ''")
    assert (
        page.locator(".error[data-for=path_error]").inner_text()
        == "Must be a number within 0 to 20 px."
    )


def test_wrong_input_is_told_beside_its_field_and_survives_a_reload(studio):
    page = studio()
    page.locator("#exposure").fill("soon")
    until(page, "document.querySelector('.error[data-for=exposure]').textContent !== ''")
    assert (
        page.locator(".error[data-for=exposure]").inner_text()
        == "Must be a time above 0 as 1/30, 0.02, 20ms or 500us, got 'soon'."
    )
    page.reload()
    until(page, "document.querySelector('.error[data-for=exposure]').textContent !== ''")
    assert page.locator("#exposure").input_value() == "soon"
    page.locator("#exposure").fill("20ms")
    until(page, "document.querySelector('.error[data-for=exposure]').textContent === ''")
    shown(page)


def test_many_quick_changes_keep_the_address_and_an_early_reload_loses_nothing(studio):
    """Browsers refuse more than 200 new addresses in 10 s, and an error would end the test."""
    page = studio(state="code=" + "10" * 20 + "&motion=straight:30:0")
    page.evaluate("""async () => {
          const range = document.getElementById("length-range");
          for (let i = 0; i < 220; i++) {
            range.value = 20 + (i % 40);
            range.dispatchEvent(new Event("input"));
            await new Promise((done) => setTimeout(done, 4));
          }
          document.querySelector("#strip button").click();
        }""")
    page.reload()
    until(page, "document.body.dataset.asked !== undefined")
    shown(page)
    assert "motion=straight:39:0" in address(page)
    assert bits(page) == "00" + "10" * 19


def test_a_search_shows_its_best_survives_a_reload_and_can_be_stopped(studio):
    page = studio(state="code=" + "10" * 30 + "&motion=straight:30:0")
    before = bits(page)
    page.locator("#effort").select_option("2000000")
    page.locator("#search").click()
    until(page, f"!location.hash.includes('code={before}')", 90)
    page.reload()
    until(
        page, "!document.getElementById('stop').hidden", 30
    )  # it is still running, and this page's
    page.locator("#stop").click()
    until(page, "!document.getElementById('search').hidden", 90)
    found = bits(page)
    assert len(found) == len(before)
    page.reload()
    shown(page)
    assert bits(page) == found  # a job that is over is not taken over again


def test_two_pages_keep_to_themselves(studio):
    one = studio(state="code=11010001&motion=straight:8:0")
    two = studio(state="code=1011&motion=straight:4:0")
    chip(one, 3).click()
    chip(two, 2).click()
    shown(one)
    shown(two)
    assert (bits(one), bits(two)) == ("11110001", "1111")


@pytest.mark.slow  # a photo is searched
def test_a_photo_gives_a_path_with_its_confidence(studio, tmp_path):
    rng = np.random.default_rng(0)
    scene = 0.1 + 0.8 * np.kron(rng.random((28, 32)), np.ones((7, 7)))
    path = Trajectory.from_samples([[0, 0], [6, 1], [9, 5], [10, 11]])
    photo = tmp_path / "../blurred.png"
    photo.write_bytes(encode_image(blur_valid(scene, path.psf(25)), ".png"))
    page = studio()
    page.locator("#photo-file").set_input_files(photo)
    until(page, "document.getElementById('drop-share').value > 0", 60)
    assert page.locator("#drop-job").is_visible()  # where the photo is
    assert page.locator("#job").is_hidden()
    assert sentence(page).startswith("The verdict follows")
    until(page, "location.hash.includes('motion=path:')", 120)
    shown(page)
    assert re.fullmatch(r"\d+ %", page.locator("#confidence-text").inner_text())
    assert page.locator("#alternatives button").count() >= 1
    assert page.locator("#photo-path path").count() == 2
    with page.expect_download(timeout=120_000) as saving:
        page.locator("#sharpen").click()
    saved = tmp_path / "sharpened.png"
    saving.value.save_as(saved)
    sharpened = read_image(saved)
    assert sharpened.shape == read_image(photo).shape
    until(page, "document.getElementById('photo-image').src.endsWith('/sharpened')")
    page.locator("#sharpened-view").click()
    page.reload()
    shown(page)
    assert page.locator("#alternatives button").count() >= 1
    until(page, "document.getElementById('photo-image').naturalWidth > 0")
    assert page.locator("#photo-image").is_visible()


@pytest.mark.slow(reason="a photo on an emulated board, restored")
def test_a_photo_is_taken_by_keys_alone_and_saved(studio, tmp_path):
    require_simavr()
    page = studio(PHONE, "code=1101000111010110&motion=straight:16:0")
    page.locator("#to-shot").press("Enter")
    assert page.evaluate("document.activeElement.id") == "shoot"
    page.keyboard.press("Shift+Tab")  # back to the camera, past two choices and a word
    page.locator("#shot_camera").fill("twin:photons=500")
    page.keyboard.press("Enter")
    until(page, "!document.getElementById('shot-stop').hidden")
    until(page, "document.getElementById('shot-restored').naturalWidth > 0", 120)
    assert "of white" in page.locator("#shot-sentence").inner_text()
    assert "played once" in page.locator("#shot-verdict").inner_text()
    assert page.locator("#shot-histogram rect").count() == 64
    assert page.locator("#shot-photo").evaluate("image => image.naturalWidth") > 100
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE
    with page.expect_download() as saving:
        page.locator("#shot-save").press("Enter")
    saved = tmp_path / saving.value.suggested_filename
    saving.value.save_as(saved)
    with zipfile.ZipFile(saved) as archive:
        assert archive.namelist() == ["photo.tif", "photo.json", "restored.png"]
        assert json.loads(archive.read("photo.json"))["code"]["bits"] == "1101000111010110"
    page.reload()
    shown(page)
    until(page, "document.getElementById('shot-photo').naturalWidth > 0")
    page.locator("#shot_camera").fill("twin:speed=1")
    page.locator("#shoot").click()
    until(page, "document.querySelector('[data-for~=shot_camera]').textContent !== ''")
    assert "has no 'speed=1'" in page.locator("[data-for~=shot_camera]").inner_text()
    assert page.locator("#shot_camera").get_attribute("aria-invalid") == "true"


def test_the_link_to_the_code_keeps_the_state(studio):
    page = studio(state="code=1101000111010110&motion=straight:16:0")
    page.locator(".skip").press("Enter")
    assert page.evaluate("document.activeElement.closest('#strip') !== null")
    shown(page)
    assert bits(page) == "1101000111010110"


def test_what_is_saved_opens_again(studio, tmp_path):
    page = studio(state="code=1101000111010110&motion=example:walk&camera=video-8bit&photons=2000")
    with page.expect_download() as saving:
        page.locator("#save").click()
    saved = tmp_path / "studio.json"
    saving.value.save_as(saved)
    other = studio(state="code=11&motion=straight:9:0")
    other.locator("#open_file").set_input_files(saved)
    until(other, "location.hash.includes('code=1101000111010110')")
    shown(other)
    assert address(other) == address(page)
    with page.expect_download() as exporting:
        page.locator("#format").select_option("csv")
        page.locator("#export").click()
    assert exporting.value.suggested_filename == "code.csv"


WRONG_STATES = [
    ({"bits": 5}, "State.bits: a code is a row of 1 (open) and 0 (closed), as 11010001."),
    (
        {"motion": {"kind": "path", "t": None, "x": 1, "y": []}},
        "State.motion: a path has 2 to 512 samples",
    ),
    ({"pins": [{"name": 3}]}, "State.pins: must be a list of codes"),
    ({"photons": "<b>many</b>"}, "State.photons: must be a number within 1 to"),
]


def test_a_studio_file_of_wrong_types_is_one_line_on_the_page(studio, tmp_path):
    page = studio(state="motion=straight:16:0&code=1101000111010110")
    before = address(page)
    error = page.locator(".error[data-for~=open_file]")
    for number, (state, said) in enumerate(WRONG_STATES):
        file = tmp_path / f"studio_{number}.json"
        file.write_text(json.dumps({"schema": "cep.studio/1", "state": state}))
        page.locator("#open_file").set_input_files(file)
        start = json.dumps(said)
        until(
            page,
            "document.querySelector('.error[data-for~=open_file]').textContent"
            f".startsWith({start})",
        )
        assert "\n" not in error.inner_text()
        chip(page, 1).click()  # the page goes on from where it was
        chip(page, 1).click()
        shown(page)
        assert address(page) == before


HASHES = [
    ("photons=1e400", "photons"),
    ("photons=NaN", "photons"),
    ("photons=x", "photons"),
    ("read_noise=-1", "read_noise"),
    ("motion=straight:x:0", "length"),
    ("motion=straight", "length"),
    ("motion=loop:1", "motion"),
    ("motion=path:known:1:AAAA", "motion"),
    ("motion=path:known:x:" + "A" * 40, "motion"),
    ("motion=path:a", "motion"),
    ("motion=path:known:1:" + "A" * 40_000, "motion"),
    ("motion=path:known:1:!", "motion"),
    ("open=a:b", "open"),
    ("open=1:2:3", "open"),
    ("min_open=1e999", "min_open"),
    ("code=" + "10" * 400, "bits"),
    ("code=x", "bits"),
]


def test_a_malformed_address_is_told_beside_its_field(studio):
    page = studio(state="code=1101000111010110&motion=straight:16:0")
    for text, field in HASHES:
        page.evaluate("hash => { location.hash = hash; }", text)
        until(page, f"document.querySelector('.error[data-for~={field}]').textContent !== ''")
        if text.startswith("code"):
            continue  # is not sent
        states = page.evaluate(
            """async (hash) => {
              const { fromAddress, toAddress } = await import("/static/state.js"), state = fromAddress(hash);
              return [state, fromAddress(toAddress(state))];
            }""",
            text,
        )
        assert states[0] == states[1]  # what was typed stays there to be mended


def test_names_of_the_language_are_no_trap_for_names_of_codes(studio):
    names = "&".join(
        f"pin={name}=10{bit}"
        for name, bit in (("__proto__", 0), ("constructor", 1), ("toString", 1))
    )
    page = studio(
        state=(
            f"code=1101000111010110&motion=straight:16:0&left=constructor&right=__proto__&{names}"
        )
    )
    assert page.locator("#pins").get_by_text("__proto__").count() == 1
    assert [page.locator(f"#side-{side}").input_value() for side in ("left", "right")] == [
        "open",
        "code",
    ]


def test_a_page_begins_with_what_the_reader_of_files_takes_for_granted(studio):
    page = studio()
    first = page.evaluate(
        "async () => { const m = await import('/static/state.js'); return"
        " m.settingOf(m.DEFAULTS); }"
    )
    setting = saved_setting({})
    for name in ("bits", "exposure", "camera", "device", "photons", "read_noise", "path_error"):
        assert getattr(setting, name) == first[name]
    assert setting.motion == first["motion"]
