"""MATLAB files: what they hold is read, and whatever SciPy does with a damaged one, this process
goes on."""

import subprocess
import sys
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

import motdiff.files._mat_reader as script
from motdiff.files import mat_files
from motdiff.files.mat_files import read_mat

HDF5 = (
    b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116)
    + bytes(8)
    + b"\x00\x02IM"
    + b"\x89HDF\r\n\x1a\n"
)


def stored(variables, **options):
    stream = BytesIO()
    savemat(stream, variables, **options)
    return stream.getvalue()


@pytest.mark.parametrize("options", [{}, {"do_compression": True}, {"format": "4"}], ids=str)
def test_variables_come_back_as_they_are(tmp_path, options):
    path = tmp_path / "a.mat"
    table = np.random.default_rng(0).random((7, 5))
    savemat(path, {"psf": table, "y": table.T, "z": np.ones(3)}, **options)
    found = read_mat(path, ["psf", "y", "none"])
    assert list(found) == ["psf", "y"]
    np.testing.assert_array_equal(found["psf"], table)
    np.testing.assert_array_equal(found["y"], table.T)


def test_other_kinds_of_numbers_and_shapes(tmp_path):
    photo = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    savemat(
        tmp_path / "a.mat",
        {"y": photo, "f": np.array([[1 + 2j]]), "text": "hello", "part": {"a": 1}},
    )
    found = read_mat(tmp_path / "a.mat", ["y", "f"])
    np.testing.assert_array_equal(found["y"], photo)
    assert found["y"].dtype == np.uint8
    assert found["f"].dtype == np.complex128


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (stored({"a": 1.0, "b": 2.0}), r'wanted a variable "psf" or "f", found a, b$'),
        (stored({}), "found nothing"),
        (stored({"psf": {"part": 1.0}}), "variable psf is a struct"),
        (stored({"psf": np.array([1, "x"], object)}), "variable psf is a struct, a cell array"),
        (b"", "cannot be read as a .mat file"),
        (b"hello", "cannot be read as a .mat file"),
        (stored({"psf": np.eye(9)})[:-100], "cannot be read as a .mat file"),
        (HDF5, "option -v7"),
    ],
)
def test_what_is_not_there_or_damaged_takes_one_line(tmp_path, content, message):
    path = tmp_path / "a.mat"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=message) as caught:
        read_mat(path, ["psf", "f"])
    assert str(caught.value).startswith(f"{path}: ")
    assert str(caught.value).isprintable()


def test_files_that_are_not_there(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_mat(tmp_path / "none.mat", ["psf"])
    savemat(tmp_path / "none.mat.mat", {"psf": 1.0})  # SciPy would try this name
    with pytest.raises(FileNotFoundError):
        read_mat(tmp_path / "none.mat", ["psf"])
    with pytest.raises(ValueError, match="folder"):
        read_mat(tmp_path, ["psf"])


@pytest.mark.parametrize(
    ("at", "word"), [(176, 0), (176, 15), (144, 0), (144, 255), (168, 0), (180, 2**31 - 1)]
)
def test_words_that_kill_scipys_loader_or_confuse_it(tmp_path, at, word):
    """Version 1.17 is ended by a segmentation fault on the first two: the type of the numbers."""
    data = bytearray(stored({"psf": np.eye(4)}))
    data[at : at + 4] = word.to_bytes(4, "little")
    (tmp_path / "a.mat").write_bytes(data)
    with pytest.raises(
        ValueError, match=r"a\.mat: (cannot be read as a \.mat file|wanted a variable)"
    ) as caught:
        read_mat(tmp_path / "a.mat", ["psf"])
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    ("program", "message"),
    [
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "status -11"),
        ("import time; time.sleep(60)", "longer than 1 s"),
        ("print('no answer')", "cannot be read"),
        ('print(\'{"sent": ["psf"]}\')', "cannot be read"),
        ("raise RuntimeError('broken')", "RuntimeError: broken"),
    ],
)
def test_whatever_happens_to_the_other_process(tmp_path, monkeypatch, program, message):
    (tmp_path / "script.py").write_text(program)
    savemat(tmp_path / "a.mat", {"psf": np.eye(3)})
    monkeypatch.setattr(mat_files, "_SCRIPT", tmp_path / "script.py")
    monkeypatch.setattr(mat_files, "_MOST_S", 1 if "sleep" in program else 60)
    with pytest.raises(ValueError, match=message):
        read_mat(tmp_path / "a.mat", ["psf"])


@pytest.mark.skipif(
    sys.platform != "linux", reason="needs the limit on memory that other systems do not enforce"
)
def test_a_small_file_that_unpacks_to_a_large_table(tmp_path, monkeypatch):
    monkeypatch.setattr(mat_files, "_MOST_MIB", 50)
    savemat(tmp_path / "a.mat", {"psf": np.zeros((3000, 3000))}, do_compression=True)
    assert (tmp_path / "a.mat").stat().st_size < 200_000
    with pytest.raises(ValueError, match="more than 50 MiB"):
        read_mat(tmp_path / "a.mat", ["psf"])


def test_the_other_process_loads_numpy_and_scipy_only_and_needs_no_path(tmp_path):
    savemat(tmp_path / "a.mat", {"psf": np.eye(3)})
    program = (
        f"import runpy, sys\nsys.argv = ['', {str(tmp_path / 'a.mat')!r}, '1000', '60', 'psf']\n"
        f"runpy.run_path({script.__file__!r}, run_name='__main__')\n"
        "print(sorted({name.partition('.')[0] for name in sys.modules}), file=sys.stderr)"
    )
    run = subprocess.run(
        [sys.executable, "-P", "-c", program], cwd=tmp_path, capture_output=True, check=True
    )
    loaded = run.stderr.decode()
    assert "'scipy'" in loaded
    assert not any(
        f"'{name}'" in loaded
        for name in ("torch", "cep", "motdiff", "hw", "cv2", "matplotlib", "typer")
    )


def test_no_other_module_reads_mat_files():
    root = Path(mat_files.__file__).resolve().parents[2]
    files = [
        path
        for folder in ("cep", "motdiff", "hw", "benchmarks")
        for path in (root / folder).rglob("*.py")
    ]
    assert [path.name for path in files if "loadmat" in path.read_text(encoding="utf-8")] == [
        "_mat_reader.py"
    ]
