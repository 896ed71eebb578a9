"""The report in a headless Chromium: nothing asked of the network, no error, a slider that moves,
no wide page."""

import numpy as np
import pytest

from cep.files.images import encode_image
from cep.report.result_page import Picture, Report, Section, Table, write_report

PHONE = 380
DESK = 1200


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """Address of a report with everything in it that may be wide."""
    shades = (np.full((300, 400), shade) for shade in (0.1, 0.5, 0.9))
    gallery = tuple(
        Picture(encode_image(shade, ".png"), "A photo.", name, title=name)
        for shade, name in zip(shades, ("Blurred", "Restored", "At rest"), strict=True)
    )
    table = Table(tuple(f"a long heading, number {i}" for i in range(9)), (("row", *range(8)),))
    wide = Picture(encode_image(np.ones((100, 2000)), ".png"), "A figure.", "a wide figure")
    line = (
        "cep advise --trajectory motion/trajectory.json --chips 26 --exposure 33332us --camera"
        " video-8bit " + "1" * 90
    )
    section = Section(
        "Photos",
        ("1" * 200,),
        (table,),
        (wide,),
        gallery=gallery,
        compared=(0, 1),
        commands=(line,),
    )
    report = Report(
        "Title",
        "Summary",
        (("length", "12 px"),) * 4,
        (section,) * 3,
        "seed 1",
        "Setting",
        ("Remark",),
    )
    path = tmp_path_factory.mktemp("page") / "report.html"
    write_report(path, report)
    return path.as_uri()


@pytest.fixture
def opened(browser, address):
    """Open the page in a window so wide; at the end check that it asked for nothing and raised no
    error."""
    asked = []
    errors = []
    pages = []

    def open_page(width, **options):
        page = browser.new_page(viewport={"width": width, "height": 800}, **options)
        page.on("request", lambda request: asked.append(request.url))
        page.on("console", lambda message: errors.append(message.text))
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(address)
        pages.append(page)
        return page

    yield open_page
    for page in pages:
        page.close()
    assert errors == []
    assert [url for url in asked if not url.startswith("data:")] == [address] * len(pages)


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [PHONE, DESK])
def test_nothing_scrolls_sideways(opened, width, scheme):
    page = opened(width, color_scheme=scheme)
    assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_the_slider_moves_by_key_and_by_pointer(opened):
    page = opened(DESK)
    box = page.locator(".compare").first
    boundary = box.locator(".stage").evaluate_handle("stage => stage")

    def share():
        return float(
            boundary.evaluate("stage => stage.style.getPropertyValue('--at')").rstrip("%")
        )

    box.locator("input").focus()
    begun = share()
    page.keyboard.press("ArrowRight")
    assert share() > begun
    page.keyboard.press("Home")
    assert share() == 0
    box.locator(".stage").click(position={"x": 100, "y": 50})
    assert 0 < share() < 50


def test_any_two_pictures_can_be_compared(opened):
    page = opened(DESK)
    box = page.locator(".compare").first
    alts = "stage => [...stage.querySelectorAll('img')].map(one => one.alt)"
    assert box.locator(".stage").evaluate(alts) == ["Blurred", "Restored"]
    box.locator("select").nth(1).select_option(label="At rest")
    assert box.locator(".stage").evaluate(alts) == ["Blurred", "At rest"]


def test_without_scripts_the_pictures_show(opened):
    page = opened(PHONE, java_script_enabled=False)
    assert page.locator(".gallery img").first.is_visible()
    assert not page.locator(".compare").first.is_visible()
