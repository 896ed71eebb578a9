"""docs/audit.html in a headless Chromium against the library: zeros, proven minimum, noise gain,
grids."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from cep.codes.published import CLAIMS, names, published
from cep.optics.code import ShutterCode
from cep.proofs.audit import grid_claims
from cep.proofs.certify.minimum import chip_minimum
from cep.proofs.certify.zeros import zeros_of_code
from cep.proofs.measure import measure
from motdiff.trajectory import Trajectory

PAGE = Path(__file__).resolve().parents[3] / "docs" / "audit.html"


@pytest.fixture(scope="module")
def page(browser):
    """The page; at the end check that it asked for nothing and raised no error."""
    asked = []
    errors = []
    opened = browser.new_page(viewport={"width": 1200, "height": 800})
    opened.on("request", lambda request: asked.append(request.url))
    opened.on("pageerror", lambda error: errors.append(str(error)))
    opened.goto(PAGE.as_uri())
    yield opened
    opened.close()
    assert errors == []
    assert [url for url in asked if not url.startswith("data:")] == [PAGE.as_uri()]


def random_codes():
    """Codes of 1 to 60 chips, every third with a factor on the circle: a sum of shifted copies, or
    a palindrome."""
    rng = np.random.default_rng(22)
    codes = []
    while len(codes) < 200:
        chips = rng.integers(0, 2, rng.integers(1, 61))
        if len(codes) % 6 == 0:  # copies at a distance: P times (1 + z^d), zeros of order 2d
            chips = np.concatenate([chips, chips])
        if len(codes) % 6 == 3:  # a palindrome: zeros at angles that are no root of unity
            chips = np.concatenate([chips, chips[::-1][1:]])
        if chips.any():
            codes.append("".join(map(str, chips)))
    return codes


@pytest.mark.slow(reason="200 codes are certified twice")
def test_the_page_agrees_with_the_library_on_200_codes(page):
    codes = random_codes()
    found = page.evaluate(
        "codes => codes.map(bits => { const found = audit(bits); delete found.curve;"
        " if (found.noise_gain_db === Infinity) found.noise_gain_db = 1e9; return found; })",
        codes,
    )
    rooted = irrational = without = 0
    for bits, shown in zip(codes, found, strict=True):
        code = ShutterCode(bits)
        zeros = zeros_of_code(bits)
        ours = [(zero.at[0], zero.order) for zero in zeros.found]
        theirs = [(zero["at"], zero["order"]) for zero in shown["zeros"]["found"]]
        assert zeros.complete, bits
        assert shown["zeros"]["complete"], bits
        assert [order for _, order in ours] == [order for _, order in theirs], bits
        for (at, _), zero in zip(ours, shown["zeros"]["found"], strict=True):
            assert abs(at - zero["at"]) <= zero["radius"] + 1e-13, bits
            assert zero["radius"] < 1e-7
        rooted += any(order for _, order in ours)
        irrational += any(order == 0 for _, order in ours)
        without += not ours
        true = chip_minimum(code)
        lower = shown["minimum"]["lower"]
        upper = shown["minimum"]["upper"]
        assert lower <= true.upper, bits
        assert true.lower <= upper, bits
        assert upper - lower <= 2e-6 * upper, bits
        gain = measure(Trajectory.straight(float(code.chips)), code, budget=0).noise_gain_db
        hopeless = gain > 60 and shown["noise_gain_db"] > 60  # samples beside a zero: rounding
        assert hopeless or shown["noise_gain_db"] == pytest.approx(gain, abs=1e-6), bits
        claims = grid_claims(code, None, true.upper)
        assert [(claim.points, claim.verdict) for claim in claims] == [
            (claim["points"], claim["verdict"]) for claim in shown["grids"]
        ], bits
        np.testing.assert_allclose(
            [claim["minimum"] for claim in shown["grids"]],
            [claim.minimum for claim in claims],
            atol=1e-9,
        )
        assert shown["sentence"].startswith("Do not use this code") == shown["null"]
    assert min(rooted, irrational, without) >= 15


def test_the_published_codes_are_those_of_the_registry():
    listed = json.loads(
        re.search(r'id="published">(.*?)</script>', PAGE.read_text(encoding="utf-8"), re.DOTALL)[1]
    )
    assert [(one["name"], one["bits"], one["source"]) for one in listed] == [
        (name, published(name).code.bits, published(name).source) for name in names()
    ]
    assert {one["name"]: tuple(one["claim"]) for one in listed if "claim" in one} == dict(CLAIMS)


@pytest.mark.parametrize(
    ("text", "bits"),
    [
        (" 1011\n0_1, 1", "1011011"),
        ("3, 2, 1", "111001"),
        ("0xA1", "10100001"),
        ("0x02952CB8A2301F/50", published("jeon-50").code.bits),
        ('{"bits": "1101", "chip_ns": 5}', "1101"),
    ],
)
def test_codes_are_read_from_every_notation(page, text, bits):
    assert page.evaluate("text => parse(text)", text) == bits


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "Paste a code"),
        ("000", "No chip is open"),
        ("1" * 257, "At most 256 chips"),
        ("12", "hex with 0x"),
        ("3, 0, 1", "1 or more"),
        ("1e9, 1", "no code"),
        ("9999999999, 1", "At most 256"),
        ("0xF1/4", "open chip lies before"),
        ("0xF/9", "1 to 4"),
        ("{}", '"bits"'),
        ("{", "not valid JSON"),
        ("<b>", "no code"),
    ],
)
def test_bad_input_is_one_line_beside_the_field(page, text, says):
    page.fill("#code", text)
    page.wait_for_function(
        "says => document.querySelector('#error').textContent.includes(says)", arg=says
    )
    assert page.get_attribute("#code", "aria-invalid") == "true"
    page.fill("#code", "1101")
    page.wait_for_function("document.querySelector('#error').textContent === ''")


def test_the_address_is_the_state(page):
    page.select_option("#published-codes", "merl-31-t62")
    assert "proven zero at 1/6" in page.text_content("#sentence")
    assert page.url.endswith("#" + published("merl-31-t62").code.bits)
    page.evaluate("location.hash = '1101'")
    page.wait_for_function(
        "document.querySelector('#sentence').textContent.includes('3 of 4 chips')"
    )
    assert page.input_value("#code") == "1101"
    page.evaluate("location.hash = 'merl-31-t62'")
    page.wait_for_function(
        "document.querySelector('#sentence').textContent.includes('proven zero at 1/6')"
    )


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [380, 1200])
def test_nothing_scrolls_sideways(browser, scheme, width):
    opened = browser.new_page(viewport={"width": width, "height": 800}, color_scheme=scheme)
    opened.goto(PAGE.as_uri() + "#" + published("jeon-200").code.bits)
    assert opened.locator("#plot svg").is_visible()
    assert opened.evaluate("document.documentElement.scrollWidth") <= width
    opened.close()
