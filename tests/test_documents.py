"""Documents hold together: links and anchors lead somewhere, and indexes list all of their
records."""

import os
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
LEFT_OUT = {"node_modules", "build", "dist", "demo", "out"}
CODE = (".py", ".toml", ".c", ".h", ".mjs")
GENERATED = {ROOT / "docs" / name for name in ("command-line.md", "overview.md", "works.md")}
"""Pages that the build of the site writes; test_site follows their links."""


def files(*suffixes):
    found = []
    for folder, inside, names in os.walk(ROOT):
        inside[:] = [name for name in inside if not name.startswith(".") and name not in LEFT_OUT]
        found += [Path(folder, name) for name in names if name.endswith(suffixes)]
    return sorted(found)


def without_code(text):
    return re.sub(r"^```.*?^```$|`[^`\n]*`", "", text, flags=re.DOTALL | re.MULTILINE)


def anchors(path):
    """Anchors of a document's headings, as GitHub makes them."""
    text = re.sub(
        r"^```.*?^```$", "", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE
    )
    seen: dict[str, int] = {}
    for heading in re.findall(r"^#+ +(.*?)\s*$", text, re.MULTILINE):
        shown = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading)
        slug = re.sub(r"[^\w\- ]", "", shown.lower()).replace(" ", "-")
        seen[slug] = seen.get(slug, -1) + 1
        yield slug if seen[slug] == 0 else f"{slug}-{seen[slug]}"


def problem(path, anchor):
    if path in GENERATED:
        return None
    if not path.exists():
        return f"{path.relative_to(ROOT)} does not exist"
    if anchor and anchor not in set(anchors(path)):
        return f"{path.relative_to(ROOT)} has no heading #{anchor}"
    return None


DOCUMENTS = [path for path in files(".md") if path not in GENERATED]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_somewhere(document):
    links = re.findall(r"\]\(([^)\s]+)\)", without_code(document.read_text(encoding="utf-8")))
    problems = []
    for link in links:
        if re.match(r"[a-z]+:", link):
            continue  # another site
        target, _, anchor = link.partition("#")
        problems.append(
            problem((document.parent / target).resolve() if target else document, anchor)
        )
    assert not list(filter(None, problems))


def test_source_names_documents_that_exist():
    named = [
        (path, name.partition("#"))
        for path in files(*CODE)
        for name in re.findall(r"\bdocs/[\w/-]+\.md(?:#[\w-]+)?", path.read_text(encoding="utf-8"))
    ]
    assert named
    problems = {
        f"{path.relative_to(ROOT)}: {problem(ROOT / name, anchor)}"
        for path, (name, _, anchor) in named
        if problem(ROOT / name, anchor)
    }
    assert not problems


def test_the_index_of_decisions_lists_each_record_once():
    folder = ROOT / "docs" / "decisions"
    records = []
    for path in set(folder.glob("*.md")) - {folder / "README.md"}:
        titles = re.findall(r"^#+ +(.*?)\s*$", path.read_text(encoding="utf-8"), re.MULTILINE)
        records += [
            (title, f"{path.name}#{anchor}")
            for title, anchor in zip(titles, anchors(path), strict=True)
        ][1:]
    index = (folder / "README.md").read_text(encoding="utf-8")
    listed = re.findall(r"^- \[(.*)\]\(([\w-]+\.md#[\w-]+)\)$", index, re.MULTILINE)
    assert len(records) > 20
    assert sorted(listed) == sorted(records)


def test_the_list_of_studies_is_whole():
    folder = ROOT / "lab" / "studies"
    studies = {file.stem for file in folder.glob("*.py")} - {"__init__", "inputs", "motions"}
    text = (folder / "README.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE)) == studies


def test_the_list_of_the_laboratory_s_rooms_is_whole():
    lab = ROOT / "lab"
    text = (lab / "README.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`.*?/`) \|", text, re.MULTILINE)
    rooms = {file.parent.name for file in lab.glob("*/__init__.py")}
    assert {room for row in rows for room in re.findall(r"`(\w+)/`", row)} == rooms
