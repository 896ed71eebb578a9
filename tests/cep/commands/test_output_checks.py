"""Every command refuses an output that it cannot write before it reads a photo or begins to
work."""

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

from cep.files.code_files import read_code
from cep.report.page import DEMO_FILES
from motdiff.files.trajectories import read_motion

FILES = {
    "optimize": ("optimize", "--linear", "8", "--chips", "8", "-o", "OUT.json"),
    "audit": ("audit", "1011", "-o", "OUT.json"),
    "mtf": ("mtf", "--linear", "8", "-o", "OUT.png"),
    "simulate": ("simulate", "sharp.png", "--linear", "8", "-o", "OUT.png"),
    "deblur": ("deblur", "blurred.png", "--trajectory", "trajectory.json", "-o", "OUT.png"),
    "calibrate --trajectory": (
        "calibrate",
        "blurred.png",
        "--code",
        "1101",
        "--trajectory",
        "trajectory.json",
        "-o",
        "OUT.json",
    ),
    "export": ("export", "1011", "--format", "csv", "-o", "OUT.csv"),
    "hw verify": (
        "hw",
        "verify",
        "1011",
        "--vcd",
        "played.vcd",
        "--linear",
        "8",
        "-o",
        "OUT.json",
    ),
    "hw emulate": ("hw", "emulate", "uno", "--vcd", "OUT.vcd"),
}
"""Commands that write a file, or files beside it."""
BESIDE = {"simulate": "OUT_psf.mat", "hw verify": "OUT_psf.npy"}
"""The last of those files, where the first is free."""

FOLDERS = {
    "calibrate": (("calibrate", "blurred.png", "-o", "OUT"), "psf.mat"),
    "calibrate FOLDER": (("calibrate", "shots", "--method", "pmp", "-o", "OUT"), "motions.csv"),
    "calibrate FOLDER, a photo": (
        ("calibrate", "shots", "--method", "pmp", "-o", "OUT"),
        "blurred/psf.mat",
    ),
    "demo": (("demo", "-o", "OUT"), DEMO_FILES[-1]),
}
"""Commands that write a folder, which is made when it is missing, and a file in it."""

WORK = (
    "cep.files.images.decode",
    "cep.calibration.calibrate.make_method",
    "cep.search.optimize.search_code",
    "cep.proofs.audit.certify",
    "cep.proofs.mtf_curves.mtf_curve",
    "cep.restoration.restore.restore",
    "hw.drivers.cxp.open_link",
    "cep.shutter.playback.read_recording",
    "hw.emulation.uno.EmulatedUno",
    "hw.export.export_program",
    "cep.report.chain.run_chain",
    "cep.report.scene.bundled_scene",
)


BINDING = (
    "cep.calibration.calibrate_folder.",
    "cep.calibration.folder_processes.",
    "cep.search.optimize.",
)
"""Modules that bind some of these names when they are imported, which must not be while they are
replaced."""


@pytest.fixture
def idle(workplace, monkeypatch):
    """A folder of inputs, in a process in which no photo can be read and nothing can be searched,
    drawn or played."""

    def work(*_arguments, **_options):
        raise AssertionError("the work has begun")

    for name in (*WORK, *BINDING):
        importlib.import_module(name.rpartition(".")[0])
    for name in WORK:
        monkeypatch.setattr(name, work)
    Path("shots").mkdir()
    Path("shots/blurred.png").write_bytes(Path("blurred.png").read_bytes())
    Path("motions/one").mkdir(parents=True)
    Path("motions/one/trajectory.json").write_bytes(Path("trajectory.json").read_bytes())
    Path("played.vcd").write_text("")
    assert read_motion("trajectory.json")
    assert read_code("code.json")
    return workplace


def put(arguments, place):
    return [part.replace("OUT", place) for part in arguments]


def everything(folder):
    return {
        str(item): item.read_bytes() if item.is_file() else None
        for item in sorted(Path(folder).rglob("*"))
    }


@pytest.fixture
def refused(cep, idle):
    def run(arguments, place):
        before = everything(idle)
        line = cep.refuses(*put(arguments, place))
        assert everything(idle) == before
        assert place.split("/")[0] in line
        return line

    return run


@pytest.mark.parametrize("name", FILES)
def test_a_folder_that_does_not_exist(refused, name):
    assert "there is no folder nowhere" in refused(FILES[name], "nowhere/out")


@pytest.mark.parametrize("name", [*FILES, *FOLDERS])
def test_a_file_in_place_of_a_folder(refused, name):
    Path("file").write_text("precious")
    refused(FILES[name] if name in FILES else FOLDERS[name][0], "file/out")


@pytest.mark.parametrize("name", FOLDERS)
def test_a_file_in_place_of_the_folder_to_write(refused, name):
    Path("file").write_text("precious")
    assert "is a file" in refused(FOLDERS[name][0], "file")


@pytest.mark.parametrize("name", [*FILES, *FOLDERS])
def test_an_output_that_exists(refused, name):
    if name in FILES:
        arguments = FILES[name]
        (own,) = [part for part in arguments if "OUT" in part]
        taken = Path("out" + BESIDE.get(name, own).removeprefix("OUT"))
    else:
        arguments, inside = FOLDERS[name]
        taken = Path("out", inside)
    taken.parent.mkdir(parents=True, exist_ok=True)
    taken.write_text("precious")
    assert f"{taken}: exists already, use --force to replace it" in refused(arguments, "out")


def test_a_refusal_loads_nothing_heavy(workplace):
    """At once, shown by what is imported: no test asserts a wall time."""
    Path("file").write_text("")
    code = (
        "import sys; from cep.commands.main import main; code = main(sys.argv[1:])\n"
        "heavy = {'torch', 'skimage', 'scipy.signal'} & set(sys.modules)\n"
        "assert code == 2 and not heavy, heavy"
    )
    arguments = put(FILES["deblur"], "file/out")
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], check=False, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr.count("\n")) == (0, 1), done.stderr
