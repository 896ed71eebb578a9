"""``cep cite``: BibTeX on stdout or in a file, and one line for a name that is not known."""

import tomllib
from pathlib import Path

from cep.files.works import works

ROOT = Path(__file__).resolve().parents[3]


def test_bibtex_is_printed_as_it_stands(cep):
    out = cep("cite", "pmp", "raskar-52").out
    assert works()["wen2021pmp"].bibtex in out
    assert works()["raskar2006"].bibtex in out
    assert "strobe" not in out


def test_json_has_the_fields_as_text(cep):
    found = cep.succeeds("cite", "tendero2013", "random")
    assert found["unpublished"] == ["random"]
    entry, software = found["works"]
    assert software["behind"] == ["random"]
    assert entry["author"].endswith("Rougé, Bernard")
    assert entry["bibtex"] == works()["tendero2013"].bibtex


def test_a_file_is_written_whole_and_not_replaced(cep, tmp_path):
    target = tmp_path / "works.bib"
    assert "entries" in cep("cite", "-o", target).out
    assert target.read_text(encoding="utf-8").count("@") == len(works()) + 1
    assert "use --force" in cep.refuses("cite", "pmp", "-o", target)
    assert cep("cite", "wiener", "-o", target, "--force").code == 0


def test_an_unknown_name_is_one_line(cep, tmp_path):
    line = cep.refuses("cite", "pmp", "raskar-25", "-o", tmp_path / "works.bib")
    assert line.startswith(
        "cep: METHOD: no method, code, figure or work is called 'raskar-25'; did you mean"
        " raskar-52"
    )
    assert not (tmp_path / "works.bib").exists()


def test_the_citation_of_the_software_states_the_version_and_licence():
    yaml = (ROOT / "CITATION.cff").read_text(encoding="utf-8").splitlines()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert f"version: {project['version']}" in yaml
    assert f"license: {project['license']}" in yaml
    assert "cff-version: 1.2.0" in yaml
