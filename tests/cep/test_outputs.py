"""Output paths: nothing is replaced unasked, nothing is half-written."""

import os

import pytest

from cep.outputs import claim, new_file, new_folder


def test_existing_files_are_refused_unless_forced(tmp_path):
    taken = tmp_path / "a.png"
    taken.write_text("precious")
    with pytest.raises(ValueError, match=r"a\.png: exists already, use --force"):
        claim([tmp_path / "free.png", taken])
    claim([taken], force=True)
    assert taken.read_text() == "precious"


def test_impossible_places_are_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="cannot be written to"):
        claim([tmp_path / "file" / "a.png"])
    with pytest.raises(ValueError, match="no folder"):
        claim([tmp_path / "nowhere" / "a.png"])
    with pytest.raises(ValueError, match="is a folder"):
        claim([tmp_path], force=True)


def test_a_folder_without_write_permission(tmp_path, monkeypatch):
    # root may write everywhere, so the answer of the operating system is what is replaced here
    monkeypatch.setattr(os, "access", lambda _path, mode: not mode & os.W_OK)
    with pytest.raises(ValueError, match="cannot be written to"):
        claim([tmp_path / "a.png"])
    with pytest.raises(ValueError, match="cannot be written to"), new_folder(tmp_path / "out", ["a"]):
        pass


def test_a_file_appears_whole_or_not_at_all(tmp_path):
    target = tmp_path / "a.txt"
    with new_file(target) as temporary:
        assert temporary.suffix == ".txt"
        temporary.write_text("new")
        assert not target.exists()
    assert target.read_text() == "new"

    def interrupted(file):
        file.write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), new_file(target) as temporary:
        interrupted(temporary)
    assert [item.name for item in tmp_path.iterdir()] == ["a.txt"]
    assert target.read_text() == "new"


def test_permissions_follow_the_umask(tmp_path):
    umask = os.umask(0o027)
    try:
        with new_file(tmp_path / "a"):
            pass
    finally:
        os.umask(umask)
    assert (tmp_path / "a").stat().st_mode & 0o777 == 0o640


def test_a_folder_appears_whole_or_not_at_all(tmp_path):
    target = tmp_path / "deep" / "out"

    def interrupted(folder):
        (folder / "a").write_text("1")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), new_folder(target, ["a", "b"]) as temporary:
        interrupted(temporary)
    assert list(tmp_path.iterdir()) == []
    with new_folder(target, ["a", "b"]) as temporary:
        (temporary / "a").write_text("1")
        (temporary / "b").write_text("2")
        assert not target.exists()
    assert sorted(item.name for item in target.iterdir()) == ["a", "b"]
    assert list(tmp_path.iterdir()) == [tmp_path / "deep"]


def test_a_folder_in_use_keeps_its_other_files(tmp_path):
    (tmp_path / "mine").write_text("keep")
    with new_folder(tmp_path, ["a"]) as temporary:
        (temporary / "a").write_text("1")
    assert sorted(item.name for item in tmp_path.iterdir()) == ["a", "mine"]
    with pytest.raises(ValueError, match="exists already"), new_folder(tmp_path, ["a"]):
        pass
    with new_folder(tmp_path, ["a"], force=True) as temporary:
        (temporary / "a").write_text("2")
    assert (tmp_path / "a").read_text() == "2"
    with pytest.raises(ValueError, match="is a file"), new_folder(tmp_path / "a", ["b"]):
        pass
