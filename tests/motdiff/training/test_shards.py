"""Shards: each written once and whole, read back in order, and refused by name where it cannot be
read."""

import re

import numpy as np
import pytest

from motdiff.training.prepared import load_shards, shard_range, write_shards

MISSING = "numbers; write some"


def write(folder, shards, made):
    def make(shard):
        made.append(shard)
        return {"number": np.array([shard])}

    told = []
    write_shards(folder, shards, name="part", make=make, on_shard=told.append)
    return told


def load(folder):
    return load_shards(
        folder, name="part", load=lambda stored: int(stored["number"][0]), missing=MISSING
    )


def test_only_missing_shards_are_made_and_all_are_read_in_the_order_of_their_numbers(tmp_path):
    made = []
    assert write(tmp_path / "new" / "folder", range(4, 8, 2), made) == [4, 6]
    assert write(tmp_path / "new" / "folder", range(3, 7), made) == [3, 4, 5, 6]
    assert made == [4, 6, 3, 5]
    (tmp_path / "new" / "folder" / "other_00001.npz").write_bytes(b"of another name")
    assert load(tmp_path / "new" / "folder") == [3, 4, 5, 6]


def test_a_folder_without_shards_says_what_is_missing(tmp_path):
    with pytest.raises(ValueError, match=f"^{re.escape(str(tmp_path))}: holds no {MISSING}$"):
        load(tmp_path)


@pytest.mark.parametrize("data", [b"", b"neither an archive nor an array", b"PK\x03\x04 torn"])
def test_a_file_that_is_no_shard_is_named_in_one_line(tmp_path, data):
    write(tmp_path, range(1), [])
    (tmp_path / "part_00001.npz").write_bytes(data)
    with pytest.raises(
        ValueError, match=r"part_00001\.npz: is damaged \(.*\); delete it and prepare it again$"
    ) as caught:
        load(tmp_path)
    assert "\n" not in str(caught.value)
    assert "pickle" not in str(caught.value)


def test_a_shard_of_other_arrays_is_damaged(tmp_path):
    np.savez(tmp_path / "part_00000.npz", other=np.zeros(1))
    with pytest.raises(ValueError, match=r"part_00000\.npz: is damaged"):
        load(tmp_path)


def test_ranges_are_read_as_they_are_written():
    assert shard_range("2:9:3") == range(2, 9, 3)
    for text in ("5", "3:3", "4:2", "-1:2", "a:b", "1:2:0"):
        with pytest.raises(ValueError, match=f"--shards: .*'{text}'"):
            shard_range(text)
