"""The command lines, which tests call in their own process, and small inputs for them."""

import functools
import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import typer
from emulators.tools import give_up

from cep.commands.main import main
from cep.files.code_files import StoredCode, write_code
from cep.files.images import write_image
from cep.optics.code import ShutterCode
from lab.commands.main import main as lab_main
from motdiff.files.trajectories import StoredMotion, write_motion
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory


class Program:
    """Runs a program in the current process; what it printed and its exit code are kept."""

    def __init__(self, capfd, main, *, name):
        self._capfd = capfd
        self._main = main
        self._name = name
        self.code = 0
        self.out = ""
        self.err = ""

    def __call__(self, *arguments):
        self._capfd.readouterr()
        self.code = self._main([str(argument) for argument in arguments])
        self.out, self.err = self._capfd.readouterr()
        return self

    @property
    def json(self):
        """The one object on stdout; anything else there makes this fail."""
        return json.loads(self.out, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))

    def succeeds(self, *arguments):
        """Run with --json and return the object."""
        self(*arguments, "--json")
        assert self.code == 0, self.err
        return self.json

    def refuses(self, *arguments):
        """Run, expect exit code 2 and one line on stderr, and return the line."""
        self(*arguments)
        assert self.code == 2, (self.code, self.out, self.err)
        assert self.out == ""
        assert self.err.startswith(f"{self._name}: ")
        assert self.err.count("\n") == 1
        assert "Traceback" not in self.err
        return self.err

    def fails(self, *arguments):
        """Run, expect exit code 1 and one line on stderr, and return the line."""
        self(*arguments)
        assert self.code == 1, (self.code, self.out, self.err)
        assert self.out == ""
        assert self.err.startswith(f"{self._name}: ")
        assert self.err.count("\n") == 1
        assert "Traceback" not in self.err
        return self.err


@pytest.fixture(scope="session", autouse=True)
def gains_of_the_model():
    """Gains are those of the model, in a second: photographs take six.

    Tests that measure them name their photographs; what runs in a process of its own measures too.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cep.photographs.scenes.photographs", tuple)
        yield


@pytest.fixture(scope="session")
def commands_built_once():
    """Typer builds the parsers of all commands anew at every call, which takes longer than most
    commands that fail."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(typer.main, "get_command", functools.cache(typer.main.get_command))
        yield


@pytest.fixture
def short_search(monkeypatch):
    """Search photos and trails through codes once, from fewer starts, instead of up to five times.

    For tests that need a motion and not the surest one: tests/motdiff/estimators/coded and
    notebooks/order_in_time.py have whole searches.
    """
    from motdiff.estimators.coded import estimator, exposures, trail_estimator  # import torch

    monkeypatch.setattr(exposures, "STARTS", exposures.STARTS[:2])
    once = {"_SEARCHES_AT_ONCE": 1, "_MOST_SEARCHES": 1}
    starts = {"_DRAWS": 32, "_LONE_WALKS": 16, "_LONE_SWEEPS": 32}
    for name, value in {**once, **starts}.items():
        monkeypatch.setattr(estimator, name, value)
    for name, value in {"_SEARCHES": 1, "_STARTS": 80}.items():
        monkeypatch.setattr(trail_estimator, name, value)
    for module in (estimator, trail_estimator):
        evolution = replace(module._EVOLUTION, rounds=6, patience=2)
        monkeypatch.setattr(module, "_EVOLUTION", evolution)


@pytest.fixture
def cep(capfd, commands_built_once):
    return Program(capfd, main, name="cep")


@pytest.fixture
def lab(capfd, commands_built_once):
    return Program(capfd, lab_main, name="lab")


@pytest.fixture(scope="session")
def small_inputs(tmp_path_factory):
    """A folder with a sharp and a blurred photo, a bent trajectory, and a code, to be copied
    from."""
    folder = tmp_path_factory.mktemp("inputs")
    rng = np.random.default_rng(0)
    blocks = np.kron(rng.random((24, 28)), np.ones((8, 8)))
    sharp = 0.1 + 0.8 * blocks
    motion = Trajectory.from_samples([[0, 0], [6, 1], [9, 5], [10, 11]])
    write_image(folder / "sharp.png", sharp, bits=16)
    write_image(
        folder / "blurred.png", blur_valid(sharp, motion.psf(motion.frame_size() | 1)), bits=16
    )
    write_motion(folder / "trajectory.json", StoredMotion(motion, source={"method": "test"}))
    write_code(folder / "code.json", StoredCode(ShutterCode("1101000101101111", 250_000)))
    return folder


@pytest.fixture
def workplace(small_inputs, tmp_path, monkeypatch):
    """A folder of the test's own with copies of the small inputs; the process works in it."""
    shutil.copytree(small_inputs, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def browser():
    """A headless Chromium; without one the test is skipped, or fails where all tools were
    promised.

    Not of the whole session: Playwright keeps an event loop running, in which other tests fail.
    """
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        give_up("playwright is not installed: see .ci/tools")
    chromium = next(
        filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
    )
    if chromium is None:
        give_up("no Chromium is installed: see .ci/tools")
    with sync_playwright() as play:
        started = play.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        yield started
        started.close()
