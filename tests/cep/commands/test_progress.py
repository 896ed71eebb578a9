"""What commands show while they work: something from the first second, and a share that only
grows, to the whole."""

import ast
import io
import json
import re
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import cep.commands
from cep.commands.console import progress
from cep.commands.main import main
from cep.files.images import read_photo, write_image
from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from motdiff.estimators.base import MotionEstimate
from motdiff.files.trajectories import read_motion
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory

BENT = Trajectory.from_samples([[0, 0], [6, 1], [9, 5]])

FIRST = """
import json, sys
from importlib.abc import MetaPathFinder

SLOW = {"numpy", "cv2", "scipy", "torch", "matplotlib", "numba", "skimage", "joblib"}
shown = {}

class Terminal:
    encoding, text = "utf-8", ""
    def isatty(self): return True
    def fileno(self): return 2
    def flush(self): pass
    def write(self, text): Terminal.text += text

class Finder(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name in SLOW and name not in shown:
            shown[name] = Terminal.text

sys.meta_path.insert(0, Finder())
sys.stderr = Terminal()
from cep.commands.main import main
code = main(sys.argv[1:])
print(json.dumps({"code": code, "shown": shown, "last": Terminal.text}))
"""


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("calibrate", "small.png"), "estimating the motion (motdiff)"),
        (("calibrate", "small"), "estimating the motion (motdiff)"),
        (
            ("deblur", "blurred.png", "--trajectory", "trajectory.json", "-o", "out.txt"),
            "restoring",
        ),
        (("deblur", "blurred.png", "--code", "1101", "-o", "out.txt"), "restoring"),
        (
            ("calibrate", "small.png", "--code", "1101", "--trajectory", "nowhere.json"),
            "refining the motion",
        ),
        (("demo", "--photo", "small.png"), "starting"),
        (("optimize", "--linear", "12", "--chips", "12", "--open", "13"), "searching"),
    ],
)
def test_something_is_shown_before_anything_slow_is_loaded(workplace, arguments, words):
    """On a terminal, in a fresh interpreter; each command fails soon, and what it showed is gone
    then."""
    write_image("small.png", np.random.default_rng(0).random((30, 30)))
    (workplace / "small").mkdir()
    ran = subprocess.run(
        [sys.executable, "-c", FIRST, *arguments], capture_output=True, text=True, check=True
    )
    found = json.loads(ran.stdout)
    assert found["code"] == 2
    assert found["shown"]
    for module, shown in found["shown"].items():
        assert words in shown, module
    assert "\ncep: " in found["last"].replace("\x1b[2K", "\n")


@pytest.mark.parametrize("columns", [64, 80, 100, 120, 200])
def test_the_time_left_is_whole_however_narrow_the_terminal_is(monkeypatch, columns):
    shown = io.StringIO()
    shown.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", shown)
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setenv("TERM", "xterm")
    with progress("estimating the motion (motdiff)") as tick:
        tick(0.5, "3 of 7 photos, about 1.6 min left")
    lines = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", shown.getvalue()).replace("\r", "\n").split("\n")
    halves = [line for line in lines if "50 %" in line]
    assert halves
    for line in halves:
        assert len(line) <= columns
        assert "estimating the motion (motdiff)" in line
        assert "left -:--:--" in line


@pytest.fixture
def told(monkeypatch):
    """Shares that commands tell, one list for each bar."""
    bars = []

    @contextmanager
    def progress(_task):
        bars.append([])
        yield lambda share, _what="", /: bars[-1].append(share)

    for name in ("calibrate", "deblur", "optimize", "demo"):
        monkeypatch.setattr(f"cep.commands.{name}.progress", progress)
    return bars


def rises(shares):
    assert shares[0] == 0
    assert shares == sorted(shares)
    assert shares[-1] == 1


@pytest.fixture
def quick_blind(monkeypatch):
    """Blind estimators whose work is a few shares."""

    def make(*, progress, **_options):
        def estimate_from(_photos):
            for share in (0.3, 0.8, 1.0):
                progress(share)
            return MotionEstimate("blind", (BENT,), (1.0,), BENT.psf(64), 0.5)

        return SimpleNamespace(estimate_from=estimate_from)

    monkeypatch.setattr("motdiff.estimators.motdiff.estimator.MotDiffEstimator", make)
    monkeypatch.setattr("motdiff.estimators.pmp.estimator.PmpEstimator", make)


GYRO = ("--gyro", "gyro.csv", "--focal", "500", "--start", "0.2", "--exposure", "0.1")


@pytest.mark.parametrize(
    ("method", "more"),
    [
        ("motdiff", ()),
        ("pmp", ()),
        ("reference", ("--sharp", "sharp.png")),
        ("point", ()),
        ("gyro", GYRO),
    ],
)
def test_the_share_of_a_calibration_rises_to_one(cep, workplace, told, quick_blind, method, more):
    light = np.zeros((120, 120))
    light[60, 60] = 60.0
    write_image("light.png", np.clip(blur_valid(light, BENT.psf(33)), 0, 1))
    lines = ["t,x,y,z", *(f"{t / 100},0.1,0.2,0" for t in range(101))]
    (workplace / "gyro.csv").write_text("\n".join(lines) + "\n")
    photo = "light.png" if method == "point" else "blurred.png"
    cep.succeeds("calibrate", photo, "--method", method, *more, "-o", "motion")
    (shares,) = told
    rises(shares)
    assert max(np.diff(shares)) < 0.6


@pytest.mark.slow  # a search
@pytest.mark.parametrize(
    "options",
    [
        ("--linear", "12", "--chips", "12", "--steps", "3000"),
        ("--linear", "12", "--chips", "12", "--method", "exact"),
        # no other code: nothing to search
        ("--linear", "12", "--chips", "3", "--open", "3", "--steps", "3000"),
    ],
)
def test_the_share_of_a_search_rises_to_one(cep, workplace, told, options):
    cep.succeeds("optimize", *options, "-o", "found.json")
    (shares,) = told
    rises(shares)


def test_the_share_of_a_folder_counts_its_photos(cep, workplace, told, quick_blind):
    (workplace / "shots").mkdir()
    for name in "abc":
        write_image(f"shots/{name}.png", np.random.default_rng(ord(name)).random((80, 80)))
    cep.succeeds("calibrate", "shots", "--workers", "1")
    (shares,) = told
    assert shares == pytest.approx([0, 1 / 3, 2 / 3, 1])


def test_the_share_of_photos_restored_together_rises_to_one(cep, workplace, told):
    code = "1101000101101111"
    path = read_motion("trajectory.json").trajectory
    for name, bits in (("a.png", code), ("b.png", code.translate(str.maketrans("01", "10")))):
        photo = capture(
            read_photo("sharp.png").pixels[:112, :112],
            path,
            ShutterCode(bits),
            rng=np.random.default_rng(ord(name[0])),
        )
        write_image(name, photo, bits=16)
    cep.succeeds(
        "deblur",
        "a.png",
        "b.png",
        "--code",
        code,
        "--code",
        f"complement:{code}",
        "--trajectory",
        "trajectory.json",
        "-o",
        "c.png",
    )
    (shares,) = told
    rises(shares)
    assert shares[1] > 0  # reading the photos is work too


class Terminal(io.StringIO):
    """A stream of a terminal that also notes what it is sent in ``log``, under its name."""

    def __init__(self, name, log):
        super().__init__()
        self.name = name
        self.log = log

    def isatty(self):
        return True

    def write(self, text):
        self.log.append((self.name, text))
        return len(text)


@pytest.mark.parametrize("options", [(), ("--linear", "7"), ("--json",)])
def test_the_answer_goes_to_stdout_after_the_bar_is_gone(
    workplace, monkeypatch, quick_blind, options
):
    """On one terminal of 80 columns, where the answer would follow the bar on its line."""
    write_image("photo.png", blur_valid(np.random.default_rng(0).random((120, 120)), BENT.psf(16)))
    log = []
    with monkeypatch.context() as patch:
        for name in ("stdout", "stderr"):
            patch.setattr(sys, name, Terminal(name, log))
        patch.setenv("COLUMNS", "80")
        patch.setenv("TERM", "xterm")
        assert main(["deblur", "photo.png", *options, "-o", "out.png"]) == 0
    before, answer, after = split_at_stdout(log)
    assert any("restoring" in text for _, text in before)
    assert "".join(text for _, text in before).endswith("\x1b[2K")  # the bar's line is empty
    assert "out.png" in "".join(text for _, text in answer)
    assert not any("restoring" in text for _, text in after)


def split_at_stdout(log):
    """Return what was written before the first and after the last text on stdout, and what is
    between."""
    places = [i for i, (name, text) in enumerate(log) if name == "stdout" and text.strip()]
    return log[: places[0]], log[places[0] : places[-1] + 1], log[places[-1] + 1 :]


def calls_in(tree):
    """Names of the functions that code calls itself: not those that it passes on."""
    return {
        node.func.id
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    }


@pytest.mark.parametrize(
    "file", sorted(Path(cep.commands.__file__).parent.glob("*.py")), ids=lambda file: file.stem
)
def test_no_command_prints_while_its_bar_is_shown(file):
    tree = ast.parse(file.read_text(encoding="utf-8"))
    functions = {
        node.name: calls_in(node) for node in tree.body if isinstance(node, ast.FunctionDef)
    }
    printing = {"finish", "announce", "warn"}
    while more := {name for name, calls in functions.items() if calls & printing} - printing:
        printing |= more
    for node in ast.walk(tree):
        if isinstance(node, ast.With) and "progress" in {
            name for item in node.items for name in calls_in(item)
        }:
            assert not set().union(*map(calls_in, node.body)) & printing, f"line {node.lineno}"
