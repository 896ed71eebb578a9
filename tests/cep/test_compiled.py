import os
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


def test_the_folder_changes_with_any_compiled_source_and_the_old_one_goes(package, tmp_path):
    first = kept_folder(package, otherwise=tmp_path)
    first.mkdir()
    (package / "other.py").write_text("something = 1\n")
    assert kept_folder(package, otherwise=tmp_path) == first
    assert first.exists()
    (package / "inner.py").write_text("from cep.compiled import inlined\nSTEP = 2\n")
    assert kept_folder(package, otherwise=tmp_path) != first
    assert not first.exists()


def test_a_package_that_cannot_be_written_keeps_its_code_elsewhere(package, tmp_path):
    (package / "__pycache__").write_text("not a folder")
    assert kept_folder(package, otherwise=tmp_path / "elsewhere").parent == tmp_path / "elsewhere"


@pytest.mark.skipif("NUMBA_CACHE_DIR" in os.environ, reason="numba was told another folder")
def test_compiled_loops_are_kept_under_their_sources_name():
    from cep.search.annealing import chains

    folder = kept_folder(Path(cep.__file__).parent, otherwise=Path.home() / ".cache" / "coded-exposure")
    dispatchers = [value for value in vars(chains).values() if hasattr(value, "_cache")]
    assert dispatchers
    assert all(str(folder) in dispatcher._cache.cache_path for dispatcher in dispatchers)
