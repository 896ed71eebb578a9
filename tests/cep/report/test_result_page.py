"""The report is one file: everything inside, nothing fetched, every text escaped."""

import base64
import hashlib
import re
from html.parser import HTMLParser

import pytest

from cep.report.result_page import Picture, Report, Section, Table, html, write_report

PNG = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
)


class Reader(HTMLParser):
    """Collects tags, attributes and text, and checks that tags are closed in order."""

    VOID = frozenset({"meta", "img", "br", "link"})

    def __init__(self):
        super().__init__()
        self.open = []
        self.attributes = []
        self.tags = []
        self.text = ""

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, name, value) for name, value in attrs]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


@pytest.fixture
def report():
    table = Table(
        ("code", "min MTF", "gain, dB"),
        (("ours", 0.123456, -1.5), ("open", None, float("nan")), ("snapshot", 1.2e-16, -0.0)),
        highlight=0,
    )
    sections = (
        Section(
            "Motion",
            ("It moved.",),
            (table,),
            (Picture(PNG, "A path", "a line"),),
            ("Direction unknown.",),
        ),
        Section("Code", commands=("cep advise --linear 9", "cep code < a > b")),
        Section("<script>alert(1)</script>", ("a & b < c",)),
    )
    return Report("Title", "Summary", (("length", "12 px"),), sections, "seed 1")


def read(page):
    reader = Reader()
    reader.feed(page)
    assert reader.open == []
    return reader


def test_nothing_is_fetched_and_nothing_runs(report):
    page = html(report)
    reader = read(page)
    assert not {"script", "link", "iframe", "object"} & set(reader.tags)
    addresses = [
        value
        for _, name, value in reader.attributes
        if name in ("src", "href", "srcset", "action")
    ]
    assert addresses
    assert all(value.startswith(("data:image/png;base64,", "#")) for value in addresses)
    assert not re.search(r"url\(|@import|https?:", page)
    assert not any(name.startswith("on") for _, name, _ in reader.attributes)


def gallery():
    titles = ("Blurred", "Restored", "At rest")
    pictures = tuple(Picture(PNG, "A photo", f"photo {title}", title=title) for title in titles)
    return Report(
        "Title", "Summary", sections=(Section("Photos", gallery=pictures, compared=(0, 1)),)
    )


def test_the_only_script_is_the_one_that_the_policy_names():
    page = html(gallery())
    reader = read(page)
    assert reader.tags.count("script") == 1
    script = re.search(r"<script>(.*?)</script>", page, re.DOTALL)[1]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in page
    assert "default-src 'none'" in page
    assert not re.search(r"fetch|XMLHttpRequest|innerHTML|eval|https?:", script)


def test_without_a_script_the_gallery_still_shows_every_picture():
    page = html(gallery())
    images = [value for tag, name, value in read(page).attributes if (tag, name) == ("img", "alt")]
    assert images == ["photo Blurred", "photo Restored", "photo At rest"]
    assert re.search(r'<div class="compare"[^>]* hidden>', page)


def test_commands_are_text(report):
    assert "cep code < a > b" in read(html(report)).text


def test_texts_are_escaped(report):
    reader = read(html(report))
    assert "<script>alert(1)</script>" in reader.text
    assert "a & b < c" in reader.text


def test_pictures_are_inside_and_described(report):
    reader = read(html(report))
    images = {name: value for tag, name, value in reader.attributes if tag == "img"}
    assert base64.b64decode(images["src"].split(",", 1)[1]) == PNG
    assert images["alt"] == "a line"


def test_numbers_warnings_and_links(report):
    reader = read(html(report))
    for text in ("0.1235", "−1.5", "–", "Direction unknown.", "12 px", "seed 1"):
        assert text in reader.text
    assert "nan" not in reader.text
    assert "1.2e" not in reader.text  # 0 but for rounding
    targets = {value for _, name, value in reader.attributes if name == "id"}
    links = {value.removeprefix("#") for _, name, value in reader.attributes if name == "href"}
    assert links == targets


def test_light_dark_and_paper_are_thought_of(report):
    page = html(report)
    assert "prefers-color-scheme: dark" in page
    assert "@media print" in page


def test_same_report_same_bytes(report, tmp_path):
    write_report(tmp_path / "a.html", report)
    assert (tmp_path / "a.html").read_text(encoding="utf-8") == html(report)
    assert [item.name for item in tmp_path.iterdir()] == ["a.html"]


def test_ragged_tables_are_refused():
    with pytest.raises(ValueError, match="need 2 cells"):
        Table(("a", "b"), (("only one",),))


def test_numbers_stand_right_and_text_stands_left():
    rows = (
        ("ours", 0.5, "+1.20", "can be played", None),
        ("open", None, "33.3 ms", "2 openings are too many", 3),
    )
    table = Table(("code", "MTF", "gain", "device", "count"), rows)
    assert table.numeric == (False, True, True, False, True)


def test_links_are_followed_only_when_clicked():
    page = html(
        Report(
            "Title",
            "Summary",
            sections=(Section("Wiring", links=(("a & b", "../docs/a%20b.md"),)),),
        )
    )
    assert ("a", "href", "../docs/a%20b.md") in read(page).attributes
    assert ">a &amp; b</a>" in page
