"""A command line that tests call in their own process, and small inputs for it."""

import json

import numpy as np
import pytest

from cep.cli.main import main
from cep.code import ShutterCode
from cep.files import StoredCode, write_code
from cep.images import write_image
from motdiff.files import StoredMotion, write_motion
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory


class Cep:
    """Runs ``cep`` in the current process; what it printed and its exit code are kept."""

    def __init__(self, capfd):
        self._capfd = capfd
        self.code, self.out, self.err = 0, "", ""

    def __call__(self, *arguments):
        self._capfd.readouterr()
        self.code = main([str(argument) for argument in arguments])
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
        assert self.err.startswith("cep: ")
        assert self.err.count("\n") == 1
        assert "Traceback" not in self.err
        return self.err

    def fails(self, *arguments):
        """Run, expect exit code 1 and one line on stderr, and return the line."""
        self(*arguments)
        assert self.code == 1, (self.code, self.out, self.err)
        assert self.out == ""
        assert self.err.startswith("cep: ")
        assert self.err.count("\n") == 1
        assert "Traceback" not in self.err
        return self.err


@pytest.fixture
def cep(capfd):
    return Cep(capfd)


@pytest.fixture
def workplace(tmp_path, monkeypatch):
    """A folder with a sharp and a blurred photo, a bent trajectory, and a code; the process works in it."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    blocks = np.kron(rng.random((24, 28)), np.ones((8, 8)))
    sharp = 0.1 + 0.8 * blocks
    motion = Trajectory.from_samples([[0, 0], [6, 1], [9, 5], [10, 11]])
    write_image("sharp.png", sharp, bits=16)
    write_image("blurred.png", blur_valid(sharp, motion.psf(motion.frame_size() | 1)), bits=16)
    write_motion("trajectory.json", StoredMotion(motion, source={"method": "test"}))
    write_code("code.json", StoredCode(ShutterCode("1101000101101111", 250_000)))
    return tmp_path
