"""The registry of estimators: one that is added stands in every list."""

import json
import re
import subprocess
import sys
from dataclasses import fields

import pytest

from cep.calibration.calibrate import estimate_motion
from motdiff.estimators.method import is_needed
from motdiff.estimators.registry import METHODS, blind_methods, make_method

DUMMY = '''
"""Straight motion of a stated length."""
from dataclasses import dataclass
from motdiff.estimators.method import Method, option
from motdiff.estimators.registry import METHODS

@dataclass(frozen=True, kw_only=True)
class Straight(Method):
    name = "straight"
    about = "of a stated length"
    cites = ("raskar2006",)
    is_blind = True
    length_px: float = option("number", "Length of it.", flag="--length", metavar="PX", default=7)

    def make(self, *, seed=0, progress=None):
        from motdiff.trajectory import Trajectory

        class Estimator:
            def estimate(_, photo):
                return Trajectory.straight(self.length_px)

        return Estimator()

METHODS["straight"] = Straight  # the one line
'''

LISTS = """
import contextlib, io, json, os, sys, tempfile
from pathlib import Path
import straight
import numpy as np
from citations import citable
from starlette.testclient import TestClient
import cep
from cep.commands.main import main
from cep.files.images import write_image
from cep.studio.fields import FieldError
from cep.studio.server import _Studio
from lab.evaluation.methods import METHODS as MEASURED, named_estimators

def ran(*arguments):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(list(arguments))
    return code, out.getvalue(), err.getvalue()

photo = np.random.default_rng(0).random((70, 80))
write_image("photo.png", photo)
code, out, _ = ran("calibrate", "photo.png", "--method", "straight", "--length", "9", "--json")
import asyncio
def studio():
    try:
        asyncio.run(_Studio().job({"page": "page123456", "kind": "calibrate", "method": "x"}))
    except FieldError as error:
        return str(error)
print(json.dumps({
    "help": ran("calibrate", "--help")[1],
    "error": ran("calibrate", "photo.png", "--method", "x")[2],
    "calibrated_px": json.loads(out)["length_px"],
    "estimated_px": cep.estimate_motion(photo, method="straight", length_px=11).best.length_px,
    "citations": citable()["estimators of motion"]["straight"],
    "studio": studio(),
    "lab": "straight" in MEASURED and "straight" in named_estimators(["straight"]),
}))
"""


@pytest.mark.parametrize("name", METHODS)
def test_what_is_declared_is_what_the_estimator_has(name):
    values = {"sharp": [[0.0, 1.0]] * 2, "codes": ("1011",)}
    needed = [declared.name for declared in fields(METHODS[name]) if is_needed(declared)]
    if not values.keys() >= set(needed):
        pytest.skip("its values are those of a recording")
    method = make_method(name, {option: values[option] for option in needed})
    estimator = method.make()
    assert getattr(estimator, "smallest_px", method.smallest_px) == method.smallest_px
    assert hasattr(estimator, "estimate_from") >= method.is_blind
    assert getattr(estimator, "method", name) == name


def test_the_front_door_names_them_all():
    for name in METHODS:
        assert f'"{name}"' in estimate_motion.__doc__, f"{name}: the docstring lacks it"


def test_the_tour_names_them_all(pytestconfig):
    text = (pytestconfig.rootpath / "docs" / "tour.md").read_text(encoding="utf-8")
    assert {name for name in METHODS if not re.search(rf"\b{name}\b", text)} == set()


def test_one_that_is_added_stands_in_every_list(tmp_path, pytestconfig):
    (tmp_path / "straight.py").write_text(DUMMY)
    root = pytestconfig.rootpath
    paths = [str(tmp_path), str(root), str(root / "docs/_extensions")]
    script = f"import sys; sys.path[:0] = {paths!r}\n{LISTS}"
    ran = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, cwd=tmp_path, check=False
    )
    assert ran.returncode == 0, ran.stderr
    lists = json.loads(ran.stdout)
    assert "straight (of a stated length)" in " ".join(lists["help"].replace("│", " ").split())
    assert "With --method straight" in lists["help"]
    assert "--length" in lists["help"]
    assert f"{', '.join(METHODS)}, straight, or module:name" in lists["error"]
    assert lists["calibrated_px"] == pytest.approx(9)
    assert lists["estimated_px"] == pytest.approx(11)
    assert lists["citations"] == ["raskar2006"]
    assert lists["studio"] == f"the methods are {' and '.join([*blind_methods(), 'straight'])}"
    assert lists["lab"]
