"""Every search problem is made by SearchProblem.along, and none forgets the camera's limits."""

import ast
import itertools
import json
from pathlib import Path

import pytest

from cep.files.code_files import read_code
from cep.optics.code import ShutterCode

ROOT = Path(__file__).parents[1]
BUILDER = ROOT / "cep/search/problem.py"
CAMERA = ("--camera", "microbolometer")
LEAST = 12  # chips of 1 ms: this camera exposes for 12 ms at least


def sources():
    for folder in ("cep", "lab", "hw", "motdiff", "notebooks"):
        yield from (ROOT / folder).rglob("*.py")


def test_no_other_module_constructs_a_problem():
    places = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path in sources()
        if path != BUILDER
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call)
        and getattr(node.func, "id", getattr(node.func, "attr", "")) == "SearchProblem"
    ]
    assert places == []


def shortest_opening(bits):
    return min(length for opened, length in ShutterCode(bits).runs if opened)


@pytest.mark.parametrize(
    ("program", "command"),
    [
        ("cep", ("optimize", "--linear", "40", "--steps", "300")),
        ("lab", ("frames", "--linear", "40", "--steps", "300")),
        pytest.param(
            "lab",
            ("design-class", "walks", "--motions", "2", "--steps", "300"),
            marks=pytest.mark.slow(reason="walks are judged on photographs"),
        ),
        ("lab", ("pareto", "--linear", "40", "--steps", "300")),
    ],
)
def test_searched_codes_open_as_long_as_the_camera_exposes(request, workplace, program, command):
    run = request.getfixturevalue(program)
    found = run.succeeds(*command, "--chips", "40", *CAMERA, "-o", "new.json")
    if command[0] == "pareto":
        codes = [point["bits"] for point in found["points"]]
        stored = json.loads(Path("new.json").read_text())["problem"]["min_open"]
    else:
        files = found.get("files", [found.get("file")])
        codes = [read_code(file).code.bits for file in files]
        stored = read_code(files[0]).problem["min_open"]
    assert stored == LEAST
    assert min(map(shortest_opening, codes)) >= LEAST


@pytest.mark.parametrize(
    ("program", "command"),
    [
        ("cep", ("optimize", "--linear", "12", "--exposure", "8ms", "--chips", "8")),
        ("cep", ("advise", "--linear", "12", "--exposure", "8ms", "--chips", "8")),
        ("lab", ("frames", "--linear", "12", "--exposure", "8ms", "--chips", "8")),
        ("lab", ("design-class", "walks", "--exposure", "8ms", "--chips", "8")),
        ("lab", ("pareto", "--linear", "12", "--exposure", "8ms", "--chips", "8")),
    ],
)
def test_an_exposure_below_the_camera_s_is_refused(request, workplace, program, command):
    run = request.getfixturevalue(program)
    line = run.refuses(*command, *CAMERA, "-o", "new.json" if command[0] != "advise" else "a.png")
    assert "the camera exposes for at least 12 ms, a code of 8 chips lasts 8 ms" in line


def test_ways_to_expose_are_as_long_as_the_camera_exposes(cep, workplace):
    found = cep.succeeds(
        "advise", "--linear", "40", "--chips", "40", "--exposure", "40ms", *CAMERA, "-o", "a.png"
    )
    levels = (level["ways"].values() for level in found["levels"])
    ways = itertools.chain(found["ways"].values(), *levels)
    assert min(shortest_opening(way["bits"]) for way in ways) >= LEAST
