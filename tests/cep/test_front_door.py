"""``import cep``: its names, how they are loaded, and objects of the user's own."""

import ast
import inspect
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cep as package
from motdiff.files.plugins import load_object
from motdiff.files.trajectories import read_motion
from motdiff.simulate import blur_valid

NAMES = sorted(set(package.__all__) - {"__version__"})
PLUGIN = """
import numpy as np
from cep import ShutterCode, Trajectory

code = ShutterCode("110100", 20_000)
bits = "1011"
number = 7

def make():
    return [1, 0, 1, 1]

def late(trajectory, code):  # forward and backward differ
    return code.array @ range(code.chips) + trajectory.xy[0, 0]

def light(trajectory, code):
    return np.float32(code.duty)

def broken(trajectory, code):
    raise RuntimeError("out\\nof order")

def wordy(trajectory, code):
    return "much"

def undefined(trajectory, code):
    return float("nan")

def as_it_is(photo, psf):
    return photo / psf.sum()

def cut(photo, psf):
    return photo[:-1]

class Straight:
    def estimate(self, photo):
        from motdiff.estimators.base import MotionEstimate
        motion = Trajectory.straight(7.0)
        return MotionEstimate("straight", (motion,), (1.0,), motion.psf(), 0.5)
"""


@pytest.fixture
def plugin(tmp_path, monkeypatch, request):
    """A module of the user's own in the current folder, of a name that no other test uses."""
    name = "own_" + "".join(letter for letter in request.node.name if letter.isalnum())
    monkeypatch.chdir(tmp_path)
    Path(f"{name}.py").write_text(PLUGIN)
    yield name
    sys.modules.pop(name, None)


def test_names_modules_and_typed_imports_agree():
    tree = ast.parse(Path(package.__file__).read_text())
    typed = {
        alias.name: node.module
        for block in tree.body
        if isinstance(block, ast.If)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert typed == package._MODULES
    assert sorted(typed) == NAMES
    assert set(NAMES) <= set(dir(package))


@pytest.mark.parametrize("name", NAMES)
def test_a_name_is_the_object_of_its_module_and_shows_an_example(name):
    found = getattr(package, name)
    assert found.__module__ == package._MODULES[name]
    text = inspect.getdoc(found)
    assert "Examples\n--------" in text, name


def test_nothing_else_is_there():
    with pytest.raises(AttributeError, match="no_such_name"):
        package.no_such_name  # noqa: B018


def test_import_loads_nothing_but_the_standard_library():
    program = (
        "import sys, cep; print([name for name in ('numpy', 'torch', 'hw', 'motdiff', 'typer') if"
        " name in sys.modules])"
    )
    told = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert told.stdout.strip() == "[]"


# -- objects of the user's own --------------------------------------------------------------------


def test_a_code_of_ones_own(plugin):
    assert package.load_code(f"{plugin}:code").chip_ns == 20_000
    assert (
        package.load_code(f"{plugin}:bits").bits
        == package.load_code(f"{plugin}:make").bits
        == "1011"
    )
    for name in ("number", "missing"):
        with pytest.raises(ValueError, match=f"^{plugin}:{name}: "):
            package.load_code(f"{plugin}:{name}")


def test_a_restoration_of_ones_own(plugin):
    scene = np.kron(np.random.default_rng(0).random((6, 6)), np.ones((8, 8)))
    path = package.Trajectory.straight(6.0)
    photo = np.clip(blur_valid(scene, path.psf(9)), 0, 1)
    by_name = package.restore(photo, trajectory=path, method=f"{plugin}:as_it_is")
    by_object = package.restore(photo, trajectory=path, method=load_object(f"{plugin}:as_it_is"))
    np.testing.assert_allclose(by_name.image, photo)
    np.testing.assert_array_equal(by_name.image, by_object.image)
    assert by_object.method == "as_it_is"
    with pytest.raises(ValueError, match=r"method: .*cut returned an image of shape"):
        package.restore(photo, trajectory=path, method=f"{plugin}:cut")
    ours = package.restore(
        photo, trajectory=path, method=lambda photo, psf: package.restore(photo, psf, method="tv")
    )
    of_the_product = package.restore(photo, trajectory=path, method="tv")
    np.testing.assert_array_equal(ours.image, of_the_product.image)
    with pytest.raises(ValueError, match=r"method: .* returned a dict, wanted the restored photo"):
        package.restore(photo, trajectory=path, method=lambda _photo, _psf: {})
    with pytest.raises(ValueError, match="is no function"):
        package.restore(photo, trajectory=path, method=f"{plugin}:number")


def test_a_figure_of_ones_own():
    path = package.Trajectory.from_samples([[0, 0], [9, 3], [14, 12]])
    code = package.ShutterCode("11100101")
    figures = {
        "start": lambda trajectory, _code: trajectory.xy[0, 0],
        "open": lambda _path, code: code.open_chips,
    }
    both = package.audit(code, path, flips=0, figures=figures).figures
    # no one number: nothing says which of the directions is the worse
    assert both == {"start": (path.xy[0, 0], path.xy[-1, 0]), "open": (5.0, 5.0)}
    known = replace(path, direction="known")
    assert package.audit(code, known, flips=0, figures=figures).figures == {
        "start": known.xy[0, 0],
        "open": 5.0,
    }


def test_a_figure_that_fails_is_named_before_the_work(monkeypatch):
    monkeypatch.setattr(
        "cep.proofs.audit.measure_worst", lambda *_args, **_options: pytest.fail("it was measured")
    )
    path = package.Trajectory.straight(9.0)
    for figure in (
        lambda _path, _code: 1 / 0,
        lambda _path, _code: None,
        lambda _path, _code: True,
    ):
        with pytest.raises(ValueError, match=r"^figure mine: "):
            package.audit(package.ShutterCode("11100101"), path, figures={"mine": figure})


def test_an_estimator_of_ones_own(plugin, tmp_path):
    photo = np.random.default_rng(0).random((40, 50))
    found = package.estimate_motion(photo, method=f"{plugin}:Straight")
    assert found.best.length_px == pytest.approx(7.0)
    again = package.estimate_motion(photo, method=load_object(f"{plugin}:Straight")())
    assert again.best.length_px == found.best.length_px
    assert "path of 7.0 px" in repr(found)
    assert found._repr_png_().startswith(b"\x89PNG")
    files = found.save(tmp_path / "motion")
    assert read_motion(files["trajectory.json"]).trajectory.length_px == pytest.approx(7.0)
    with pytest.raises(ValueError, match=r"^samples: not valid with an estimator"):
        package.estimate_motion(photo, method=load_object(f"{plugin}:Straight")(), samples=3)
    with pytest.raises(ValueError, match=r"^samples: not valid with method="):
        package.estimate_motion(photo, method=f"{plugin}:Straight", samples=3)
    with pytest.raises(ValueError, match="has no method estimate"):
        package.estimate_motion(photo, method=f"{plugin}:number")


@pytest.mark.slow  # eight commands
def test_commands_take_them(cep, workplace, plugin):
    Path(workplace / f"{plugin}.py").write_text(PLUGIN)
    sharp = cep.succeeds(
        "deblur",
        "blurred.png",
        "--trajectory",
        "trajectory.json",
        "--method",
        f"{plugin}:as_it_is",
    )
    assert sharp["method"] == f"{plugin}:as_it_is"
    assert cep.succeeds("audit", f"{plugin}:code")["bits"] == "110100"
    assert "no_such_module" in cep.refuses("audit", "no_such_module:code")
    line = cep.refuses(
        "deblur",
        "blurred.png",
        "--trajectory",
        "trajectory.json",
        "--method",
        f"{plugin}:nothing",
        "-o",
        "x.png",
    )
    assert f"{plugin} has no 'nothing'" in line
    assert sharp["direction"] == "unknown"
    own = ("--method", f"{plugin}:Straight")
    assert cep.succeeds("calibrate", "blurred.png", *own, "-o", "motion")[
        "length_px"
    ] == pytest.approx(7.0)
    Path("shots").mkdir()
    for name in ("a.png", "b.png"):
        shutil.copy("blurred.png", f"shots/{name}")
    folder = cep.succeeds("calibrate", "shots", *own, "-o", "motions", "--workers", "2")
    assert [one["length_px"] for one in folder["photos"].values()] == pytest.approx([7.0, 7.0])


def test_commands_take_figures(cep, workplace, plugin):
    Path(workplace / f"{plugin}.py").write_text(PLUGIN)
    late = f"{plugin}:late"
    light = f"{plugin}:light"
    own = ("--trajectory", "trajectory.json", "--figure", late, "--figure", light)
    audited = cep.succeeds("audit", "1101000101101111", *own)["figures"]
    assert set(audited) == {late, light}
    assert audited[light] == [10 / 16, 10 / 16]
    assert audited[late][0] != audited[late][1]
    curves = cep.succeeds("mtf", "--code", "1101000101101111", *own)["curves"]
    assert curves["open shutter"]["figures"][light] == [1.0, 1.0]
    assert curves["1101000101101111"]["figures"] == audited
    assert "forward / backward" in cep("audit", "1011", *own).out
    for name in ("broken", "wordy", "undefined", "number", "missing"):
        for command in (("audit", "1011"), ("mtf", "-o", "x.png")):
            line = cep.refuses(
                *command, "--trajectory", "trajectory.json", "--figure", f"{plugin}:{name}"
            )
            assert f"{plugin}:{name}" in line
    assert not list(Path().glob("x.*"))


def test_a_module_that_fails_is_named_in_one_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("own_broken.py").write_text("1 / 0\n")
    with pytest.raises(
        ValueError, match=r"^own_broken:x: importing own_broken failed .ZeroDivisionError"
    ) as caught:
        load_object("own_broken:x")
    assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match="must be module:name"):
        load_object("own broken")


def test_a_restoration_saves_itself(tmp_path):
    scene = np.kron(np.random.default_rng(0).random((6, 6)), np.ones((8, 8)))
    psf = package.Trajectory.straight(6.0).psf(9)
    found = package.restore(np.clip(blur_valid(scene, psf), 0, 1), psf)
    found.save(tmp_path / "sharp.png", bits=16)
    np.testing.assert_allclose(
        package.read_image(tmp_path / "sharp.png"), np.clip(found.image, 0, 1), atol=1e-4
    )
    assert found._repr_png_().startswith(b"\x89PNG")
    assert "48 x 48" not in repr(found)
    assert "40 x 40 px by tv" in repr(found)


def test_a_code_goes_with_a_trajectory_alone():
    photo = np.random.default_rng(0).random((32, 32))
    psf = np.full((3, 3), 1 / 9)
    path = package.Trajectory.straight(4.0)
    code = package.ShutterCode("1011")
    with pytest.raises(ValueError, match=r"^trajectory and psf: give one of them at most"):
        package.restore(photo, psf, trajectory=path)
    with pytest.raises(ValueError, match=r"^code: not valid with a PSF"):
        package.restore(photo, psf, code=code)
    with pytest.raises(ValueError, match=r"^code: goes with a trajectory"):
        package.capture(photo, psf, code, rng=np.random.default_rng(0))


def test_a_capture_along_a_path_is_the_one_through_its_psf():
    scene = np.random.default_rng(0).random((40, 40))
    path = package.Trajectory.from_samples([[0, 0], [4, 1], [6, 5]])
    code = package.ShutterCode("1011")
    psf = package.coded_psf(path, code, path.frame_size() | 1)
    along = package.capture(scene, path, code, rng=np.random.default_rng(3))
    through = package.capture(scene, psf, rng=np.random.default_rng(3))
    np.testing.assert_array_equal(along, through)
