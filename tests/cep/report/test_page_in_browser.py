"""The report in a headless Chromium: nothing asked of the network, no error, a slider that moves,
no wide page."""

import pytest

PHONE = 380
DESK = 1200


@pytest.fixture(scope="module")
def address(coded, demo_of):
    return (demo_of(coded)[0] / "report.html").as_uri()


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
    assert box.locator(".stage").evaluate(alts) == ["Blurred", "Coded, restored"]
    box.locator("select").nth(1).select_option(label="Scene at rest")
    assert box.locator(".stage").evaluate(alts) == ["Blurred", "Scene at rest"]


def test_without_scripts_the_pictures_show(opened):
    page = opened(PHONE, java_script_enabled=False)
    assert page.locator(".gallery img").first.is_visible()
    assert not page.locator(".compare").first.is_visible()
