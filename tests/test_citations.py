"""Citations: every name that commands use is known, every work is behind a name or a page."""

import re

import pytest
from citations import SOFTWARE, citable, cite, software
from works import works

from cep.codes.published import names as code_names
from cep.restoration.registry import METHODS as RESTORATIONS
from cep.search.problem import OBJECTIVES
from lab.bench.coded.designs import DESIGNS
from lab.evaluation.methods import METHODS as MEASURED
from motdiff.estimators.registry import METHODS as ESTIMATORS

ENTRY = re.compile(r"^@\w+\{([\w-]+),", re.MULTILINE)


def test_every_name_of_a_command_can_be_cited():
    asked = (*ESTIMATORS, *MEASURED, *RESTORATIONS, *DESIGNS, *OBJECTIVES, *code_names())
    for name in asked:
        found = cite([name])
        assert (SOFTWARE in found.works) == (name in found.unpublished), name
        assert found.works, name
    assert cite(
        [f"{next(iter(ESTIMATORS))}@weights.safetensors", "selfdeblur:20"]
    ).works.keys() >= {"ren2020"}


def test_no_name_has_a_work_that_is_not_in_the_file():
    for kind, named in citable().items():
        for name, keys in named.items():
            assert set(keys) <= works().keys(), (kind, name)
            assert len(set(keys)) == len(keys), (kind, name)


def test_all_works_are_printed_once_without_a_name():
    entries = ENTRY.findall(cite().bibtex)
    assert sorted(entries) == sorted([*works(), SOFTWARE])
    assert software().bibtex in cite().bibtex


def test_works_come_in_the_order_of_the_names_and_only_once():
    assert list(cite(["tv", "pmp", "tv"]).works)[:2] == ["wang2008", "krishnan2009"]
    text = cite(["tv", "pmp", "strobe"]).bibtex
    assert ENTRY.findall(text).count("wen2021pmp") == 1
    assert "% tv, pmp\n@article{wen2021pmp," in text
    assert f"% strobe\n@misc{{{SOFTWARE}," in text


def test_a_key_is_a_name():
    assert list(cite(["raskar2006"]).works) == ["raskar2006"]
    assert list(cite([SOFTWARE]).works) == [SOFTWARE]


@pytest.mark.parametrize(
    ("name", "near"), [("raskar52", "raskar-52"), ("PMP", "pmp"), ("Raskar2006", "raskar2006")]
)
def test_an_unknown_name_has_suggestions(name, near):
    with pytest.raises(
        ValueError, match=rf"^methods: no method.* is called '{name}'; did you mean .*\b{near}\b"
    ):
        cite([name])
