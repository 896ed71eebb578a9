"""Input files that a user names: regular, and not larger than their kind."""

import os

import pytest

from hw.files import content


def test_a_file_may_have_its_most_bytes_and_not_one_more(tmp_path):
    path = tmp_path / "recording.vcd"
    path.write_bytes(bytes(2**20))
    assert len(content(path, most_bytes=2**20)) == 2**20
    path.write_bytes(bytes(2**20 + 1))
    with pytest.raises(ValueError, match="too large, a file of this kind has at most 1 MiB"):
        content(path, most_bytes=2**20)
    assert len(content(path)) == 2**20 + 1


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes on this system")
def test_a_pipe_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "pipe"
    os.mkfifo(path)
    with pytest.raises(ValueError, match="a pipe, a socket or a device"):
        content(path)


def test_a_folder_is_the_systems_own_error(tmp_path):
    with pytest.raises(OSError, match=tmp_path.name):
        content(tmp_path)
