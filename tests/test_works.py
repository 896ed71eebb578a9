"""Published works: one file that is BibTeX, and the documents that cite from it."""

import re
from pathlib import Path

import pytest
from works import work, works

ROOT = Path(__file__).resolve().parents[1]
SOURCE = (ROOT / "cep" / "files" / "works.bib").read_text(encoding="utf-8")
REQUIRED = {
    "article": {"author", "title", "journal", "year"},
    "inproceedings": {"author", "title", "booktitle", "year"},
    "incollection": {"author", "title", "booktitle", "publisher", "year"},
    "book": {"author", "title", "publisher", "year"},
    "techreport": {"author", "title", "note"},
    "misc": {"author", "title", "year"},
}


def test_every_entry_is_read_once_with_all_its_fields():
    assert len(works()) == len(re.findall(r"^@", SOURCE, re.MULTILINE)) > 60
    assert sum(len(entry.fields) for entry in works().values()) == len(
        re.findall(r"^  \w+ = ", SOURCE, re.MULTILINE)
    )


@pytest.mark.parametrize("entry", works().values(), ids=lambda entry: entry.key)
def test_an_entry_has_the_fields_of_its_type_as_latex(entry):
    assert REQUIRED[entry.kind] <= entry.fields.keys()
    assert entry.bibtex.isascii()
    for field, value in entry.fields.items():
        assert value.count("{") == value.count("}"), field
        assert not re.search(r"(?<!\\)[&%#_$]", value) or field == "doi", field
        assert "\\" not in entry.text(field), field
    if "year" in entry.fields:
        assert re.fullmatch(r"(19|20)\d\d", entry.fields["year"])
    if "pages" in entry.fields:
        first, _, last = entry.fields["pages"].partition("--")
        assert int(first) <= int(last or first)
    if "doi" in entry.fields:
        assert entry.fields["doi"].startswith("10.")


def test_a_citation_has_authors_title_and_venue():
    assert (
        work("tendero2013").line
        == "Tendero, Morel, Rougé: *The flutter shutter paradox.* SIAM Journal on Imaging Sciences"
        " 6, 2013."
    )
    assert work("koehler2012").authors == ("Köhler", "Hirsch", "Mohler", "Schölkopf", "Harmeling")
    assert work("emva1288").authors == ("European Machine Vision Association",)


def test_the_theory_cites_these_works():
    cited = 0
    lines = {entry.line for entry in works().values()}
    for page in (ROOT / "docs" / "theory").glob("*.md"):
        _, _, sources = page.read_text(encoding="utf-8").partition("## Sources\n")
        for item in re.findall(r"^- (.*)$", sources, re.MULTILINE):
            assert any(item.startswith(line) for line in lines), f"{page.name}: {item}"
            cited += 1
    assert cited > 15
