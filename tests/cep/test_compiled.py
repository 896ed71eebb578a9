import errno
import io
import os
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

import cep
from cep.compiled import kept_folder


@pytest.fixture
def package(tmp_path):
    folder = tmp_path / "package"
    folder.mkdir()
    (folder / "loops.py").write_text("from cep.compiled import compiled\n")
    (folder / "inner.py").write_text("from cep.compiled import inlined\nSTEP = 1\n")
    (folder / "other.py").write_text("pass\n")
    return folder


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device that is always full")
def test_on_a_full_disk_only_a_folder_that_keeps_code_is_used(package, monkeypatch):
    folder = kept_folder(package, otherwise=None)
    full = partial(open, "/dev/full", "wb")
    monkeypatch.setattr("tempfile.TemporaryFile", lambda **_: full())
    assert kept_folder(package, otherwise=None) is None
    (folder / "loops.nbi").touch()
    assert kept_folder(package, otherwise=None) == folder


def test_a_folder_with_too_little_room_for_machine_code_is_not_used(package, monkeypatch):
    class SmallDisk(io.BytesIO):
        def write(self, data):
            if self.tell() + len(data) > 500_000:
                raise OSError(errno.ENOSPC, "No space left on device")
            return super().write(data)

    monkeypatch.setattr("tempfile.TemporaryFile", lambda **_: SmallDisk())
    assert kept_folder(package, otherwise=None) is None


def test_the_folder_changes_with_any_compiled_source_and_the_old_one_goes(package, tmp_path):
    first = kept_folder(package, otherwise=tmp_path)
    (package / "other.py").write_text("something = 1\n")
    assert kept_folder(package, otherwise=tmp_path) == first
    assert first.exists()
    (package / "inner.py").write_text("from cep.compiled import inlined\nSTEP = 2\n")
    assert kept_folder(package, otherwise=tmp_path) != first
    assert not first.exists()


def test_a_package_that_cannot_be_written_keeps_its_code_elsewhere(package, tmp_path):
    (package / "__pycache__").write_text("not a folder")
    assert kept_folder(package, otherwise=tmp_path / "elsewhere").parent == tmp_path / "elsewhere"


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="Windows has no such modes")
@pytest.mark.parametrize("place", ["parent", "folder"])
def test_code_that_others_could_have_written_is_never_loaded(package, tmp_path, place):
    """Numba's files are unpickled, and run."""
    otherwise = tmp_path / "elsewhere"
    folder = kept_folder(package, otherwise=otherwise)
    shared = folder if place == "folder" else folder.parent
    for mode in (0o777, 0o775, 0o757):
        shared.chmod(mode)
        assert kept_folder(package, otherwise=otherwise).parent == otherwise
        assert kept_folder(package, otherwise=None) is None
    shared.chmod(0o755)
    assert kept_folder(package, otherwise=otherwise) == folder


def test_the_folder_is_this_users_alone(package, tmp_path):
    umask = os.umask(0)
    try:
        (package / "__pycache__").mkdir(mode=0o755)
        assert kept_folder(package, otherwise=None).stat().st_mode & 0o777 == 0o700
    finally:
        os.umask(umask)


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="Windows has no such modes")
def test_users_whose_group_may_write_what_they_make_keep_their_code(package, tmp_path):
    """The umask of Red Hat's and many other systems, where each user has a group of his own."""
    otherwise = tmp_path / "cache" / "elsewhere"
    umask = os.umask(0o002)
    try:
        (package / "__pycache__").mkdir()
        assert kept_folder(package, otherwise=otherwise).parent == otherwise
    finally:
        os.umask(umask)


LOOP = """
import sys
from cep.compiled import compiled, _cache_folder
@compiled
def double(value):
    return 2 * value
assert double(1.5) == 3.0
print(_cache_folder(), double.stats.cache_misses)
"""


@pytest.mark.parametrize(
    ("settings", "kept"),
    [
        ({"HOME": "/proc/none"}, False),
        ({"NUMBA_CACHE_DIR": "/proc/none"}, False),
        ({"XDG_CACHE_HOME": "x"}, True),
    ],
)
def test_without_a_folder_that_can_be_written(tmp_path, settings, kept):
    """A service user: a read-only installation, which a file in the folder's place stands for, and
    no home."""
    (tmp_path / "cep").mkdir()
    (tmp_path / "temporary").mkdir()
    (tmp_path / "cep" / "__init__.py").write_text("")
    (tmp_path / "cep" / "__pycache__").write_text("not a folder")
    shutil.copy(Path(cep.__file__).with_name("compiled.py"), tmp_path / "cep")
    (tmp_path / "loop.py").write_text(LOOP)
    without = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("NUMBA_", "XDG_"))
    }
    environment = without | {
        "PYTHONPATH": str(tmp_path),
        "TMPDIR": str(tmp_path / "temporary"),
        **settings,
    }
    done = subprocess.run(
        [sys.executable, "loop.py"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    folder = Path(done.stdout.split()[0])
    if kept:
        assert folder.parent == Path("x/coded-exposure")
        assert (tmp_path / folder).is_dir()
        assert done.stderr == ""
    else:
        assert folder.parent == tmp_path / "temporary"
        assert list((tmp_path / "temporary").iterdir()) == []  # it is removed
        assert done.stderr.count("NUMBA_CACHE_DIR") == 1
        assert f"{next(iter(settings.values()))}" in done.stderr


@pytest.mark.skipif("NUMBA_CACHE_DIR" in os.environ, reason="numba was told another folder")
def test_compiled_loops_are_kept_under_their_sources_name():
    from cep.search.annealing import cooling

    folder = kept_folder(
        Path(cep.__file__).parent, otherwise=Path.home() / ".cache" / "coded-exposure"
    )
    dispatchers = [value for value in vars(cooling).values() if hasattr(value, "_cache")]
    assert dispatchers
    assert all(str(folder) in dispatcher._cache.cache_path for dispatcher in dispatchers)
