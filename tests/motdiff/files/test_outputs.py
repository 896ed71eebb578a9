"""Output paths: nothing is replaced unasked, nothing is half-written."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from cep.commands.console import BAD_INPUT, FAILURE
from cep.commands.errors import explain
from motdiff.files.outputs import claim, new_file, new_folder, write_text


def test_existing_files_are_refused_unless_forced(tmp_path):
    taken = tmp_path / "a.png"
    taken.write_text("precious")
    with pytest.raises(ValueError, match=r"a\.png: exists already, use --force"):
        claim([tmp_path / "free.png", taken])
    claim([taken], force=True)
    assert taken.read_text() == "precious"


def test_what_is_read_is_never_replaced(tmp_path):
    source = tmp_path / "code.json"
    link = tmp_path / "link.json"
    source.write_text("{}")
    link.symlink_to(source)
    for target in (source, link, tmp_path / "." / "code.json"):
        with pytest.raises(ValueError, match="is what is read, the output needs another name"):
            claim([target], force=True, inputs=[source])
    # a published code's name or bits are no file
    claim([source], force=True, inputs=["raskar-52", "1011", tmp_path / "other.json"])


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
    with (
        pytest.raises(ValueError, match="cannot be written to"),
        new_folder(tmp_path / "out", ["a"]),
    ):
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
        write_text(tmp_path / "a", "")
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


def test_a_full_disk_names_the_output(tmp_path, monkeypatch, capsys):
    def full(*_arguments, **_options):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(OSError, match="No space left") as caught:
        write_text(tmp_path / "a.txt", "text")
    assert caught.value.filename == str(tmp_path / "a.txt")
    assert explain(caught.value) == FAILURE
    assert capsys.readouterr().err == f"cep: {tmp_path / 'a.txt'}: No space left on device\n"
    with (
        pytest.raises(OSError, match="No space left") as caught,
        new_folder(tmp_path / "out", ["a"]) as made,
    ):
        write_text(made / "a", "text")
    assert caught.value.filename == str(tmp_path / "out" / "a")
    with (
        pytest.raises(OSError, match="No space left") as caught,
        new_folder(tmp_path / "out", ["a"]),
    ):
        full()
    assert caught.value.filename == str(tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_errors_of_other_files_keep_their_names(tmp_path):
    """A missing input is bad input; so is a missing folder of the output, under the name that was
    given."""
    elsewhere = tmp_path / "elsewhere" / "missing"
    with pytest.raises(FileNotFoundError) as caught, new_folder(tmp_path / "out", ["a"]):
        elsewhere.read_bytes()
    assert caught.value.filename == elsewhere or caught.value.filename == str(elsewhere)
    assert explain(caught.value) == BAD_INPUT
    with pytest.raises(FileNotFoundError) as caught, new_file(tmp_path / "no" / "a.txt"):
        pass
    assert caught.value.filename == str(tmp_path / "no" / "a.txt")


def test_what_is_no_regular_file_is_never_replaced(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path in (pipe, Path(os.devnull)):
        for force in (False, True):
            with pytest.raises(ValueError, match="is not a regular file"):
                claim([path], force=force)


def test_links_stay_and_what_they_lead_to_is_replaced(tmp_path):
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "real").write_text("old")
    link = tmp_path / "link.txt"
    link.symlink_to(Path("there") / "real")
    with new_file(link) as temporary:
        assert temporary.suffix == ".txt"
        temporary.write_text("new")
    assert link.is_symlink()
    assert (tmp_path / "there" / "real").read_text() == "new"
    with new_folder(tmp_path, ["link.txt"], force=True) as made:
        (made / "link.txt").write_text("newer")
    assert link.is_symlink()
    assert (tmp_path / "there" / "real").read_text() == "newer"
    link.unlink()
    link.symlink_to(Path("nowhere") / "real")
    with pytest.raises(ValueError, match="there is no folder"):
        claim([link])


def test_an_error_without_a_name_gets_the_one_that_was_given_not_what_its_link_leads_to(tmp_path):
    target = tmp_path / "target.txt"
    link = tmp_path / "link.txt"
    target.write_text("old")
    link.symlink_to(target)
    with pytest.raises(OSError, match="No space left") as caught, new_file(link):
        raise OSError(errno.ENOSPC, "No space left on device")  # as a library's, of no file
    assert caught.value.filename == str(link)
    assert target.read_text() == "old"


def test_a_folder_keeps_nothing_of_an_earlier_run(tmp_path):
    for name in ("a", "b", "mine"):
        (tmp_path / name).write_text("old")
    with new_folder(tmp_path, ["a", "b"], force=True) as made:
        (made / "a").write_text("new")
    assert {item.name: item.read_text() for item in tmp_path.iterdir()} == {
        "a": "new",
        "mine": "old",
    }


@pytest.mark.parametrize("name", ["mtf.pdf", "mtf.png", "mtf.svg"])
def test_a_figure_on_a_full_disk(tmp_path, name):
    """A real limit on file sizes, in a process of its own."""
    code = (
        "import resource, signal, sys; from cep.commands.main import main;"
        " signal.signal(signal.SIGXFSZ, signal.SIG_IGN); resource.setrlimit(resource.RLIMIT_FSIZE,"
        " (4096, 4096)); sys.exit(main(sys.argv[1:]))"
    )
    command = [sys.executable, "-c", code, "mtf", "--linear", "10", "-o", str(tmp_path / name)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == FAILURE
    # matplotlib may complain before that it cannot keep its list of fonts
    assert done.stderr.splitlines()[-1] == f"cep: {tmp_path / name}: File too large"
    assert list(tmp_path.iterdir()) == []
