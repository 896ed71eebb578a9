"""A restoration of the registry is in every list that the product and the laboratory have."""

import inspect
import re
import subprocess
import sys

import pytest
from works import works

from cep.restoration.registry import METHODS, find_method, registered_method
from cep.restoration.restore import restore

DUMMY = """
import sys
sys.path.insert(0, "docs/_extensions")
from cep.restoration import registry
registry.METHODS["dummy"] = registry.Method(
    "dummy", "as if sharp", "skimage.restoration:unsupervised_wiener", ("field1987",), True
)
import numpy as np
from citations import cite
from cep.commands.main import main
from lab.bench.coded.protocol import coded_protocol
main(["deblur", "--help"])
main(["deblur", "photo.png", "--method", "x"])
main(["deblur", "photo.png", "--method", "tv", "--photons", "9"])
print(list(cite(["dummy"]).works), coded_protocol("ours", ["restoration=dummy"]).restoration)
"""


def test_a_new_method_is_in_every_list():
    run = subprocess.run(
        [sys.executable, "-c", DUMMY], capture_output=True, text=True, check=True, encoding="utf-8"
    )
    words = " ".join(run.stdout.replace("│", " ").split())
    for method in METHODS.values():
        assert f"{method.name} ({method.about}), " in words
    assert "dummy (as if sharp), or module:name" in words
    assert f"one of {', '.join(METHODS)}, dummy, or module:name" in run.stderr
    with_camera = ", ".join(name for name, method in METHODS.items() if method.uses_camera)
    assert f"--photons: not valid with --method tv; {with_camera} and dummy use" in run.stderr
    assert "['field1987'] dummy" in run.stdout


def test_the_front_door_names_them_all():
    for name in METHODS:
        assert f'"{name}"' in restore.__doc__, f"{name}: the docstring lacks it"


@pytest.mark.parametrize("page", ["docs/theory/restoration.md", "docs/glossary.md"])
def test_the_pages_name_them_all(pytestconfig, page):
    text = (pytestconfig.rootpath / page).read_text(encoding="utf-8").lower()
    assert {name for name in METHODS if not re.search(rf"\b{name}\b", text)} == set()


@pytest.mark.parametrize("name", METHODS)
def test_what_a_method_says_of_itself_holds(name):
    method = METHODS[name]
    assert find_method(name) == (name, method.function)
    assert registered_method(method.function) is method
    assert set(method.cites) <= works().keys()
    options = inspect.signature(method.function).parameters
    assert method.uses_camera == ("camera" in options)
    assert method.reports_progress == ("progress" in options)


@pytest.mark.parametrize("name", ["l0", "tv-ring", "inverse"])
def test_a_method_that_is_gone_is_refused_with_those_there_are(name):
    with pytest.raises(
        ValueError, match=rf"^method: must be one of {', '.join(METHODS)}"
    ) as error:
        find_method(name)
    successor = str(error.value).rpartition("repository: ")[2]
    assert (name == "inverse") == (successor in str(error.value).split())
    if name == "inverse":
        assert callable(find_method(successor)[1])


def test_a_function_of_your_own_is_not_registered():
    name, function = find_method("skimage.restoration:richardson_lucy")
    assert name == "skimage.restoration:richardson_lucy"
    assert registered_method(function) is None
