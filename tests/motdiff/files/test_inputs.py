"""Input files: what is no regular file is refused at once, and what is wrong with one takes one
short line."""

import json
import os
import socket
from pathlib import Path

import pytest

from motdiff.files.inputs import (
    JSON_BYTES,
    TEXT_BYTES,
    TOML_BYTES,
    one_line,
    read_json,
    read_text,
    read_toml,
    regular_file,
)


def test_regular_files_and_links_to_them_are_taken(tmp_path):
    file = tmp_path / "a.json"
    link = tmp_path / "link.json"
    file.write_text("{}")
    link.symlink_to(file)
    assert regular_file(str(file)) == file
    assert read_json(link) == {}
    with pytest.raises(FileNotFoundError, match="none"):
        regular_file(tmp_path / "none.json")


def test_what_is_no_regular_file_is_refused_without_being_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "socket"))
        cases = {
            tmp_path: "folder",
            tmp_path / "pipe": "pipe",
            tmp_path / "socket": "socket",
            "/dev/zero": "device",
        }
        for path, kind in cases.items():
            for read in (regular_file, read_text, read_json, read_toml):
                with pytest.raises(
                    ValueError, match=f"is a {kind}, a regular file is needed"
                ) as caught:
                    read(path)
                assert str(path) in str(caught.value)


def test_standard_input_and_process_substitution_are_pipes():
    reading, writing = os.pipe()
    try:
        with pytest.raises(ValueError, match="is a pipe"):
            regular_file(f"/dev/fd/{reading}")
    finally:
        os.close(reading)
        os.close(writing)


def test_the_mark_of_windows_editors_is_no_harm(tmp_path):
    for name, text in (("a.json", '{"a": 1}'), ("a.toml", "a = 1")):
        (tmp_path / name).write_text(text, encoding="utf-8-sig")
    assert read_json(tmp_path / "a.json") == read_toml(tmp_path / "a.toml") == {"a": 1}
    assert read_text(tmp_path / "a.toml") == "a = 1"


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\xff\xfe\x00",
        b"[" * 100_000,
        b"9" * 5000,
        b'{"a": ' * 100_000,
        b"\x00" * 9,
        b'"\x1b[2J',
        b"{xxxxxxxxxxx",
    ],
    ids=lambda content: repr(content[:6]),
)
@pytest.mark.parametrize("read", [read_json, read_toml])
def test_damage_takes_one_short_printable_line(tmp_path, read, content):
    if read is read_toml:
        content = b"a = " + content
    path = tmp_path / "file"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"not a (JSON|TOML) file \(") as caught:
        read(path)
    line = str(caught.value)
    assert line.startswith(str(path))
    assert line.isprintable()
    assert len(line) < 600


def test_a_binary_file_is_no_text(tmp_path):
    (tmp_path / "a").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match="a: not a text file"):
        read_text(tmp_path / "a")


def test_messages_are_cut_and_cannot_command_a_terminal():
    assert one_line(ValueError("short")) == "short"
    assert one_line(json.dumps("é")) == '"\\u00e9"'
    for hostile in ("x" * 10**6, "\x1b" * 10**6, "a\nb" * 10**5, "\udcff\x07", Path("\x9b31m")):
        assert one_line(hostile).isprintable()
        assert len(one_line(hostile)) <= 300


@pytest.mark.parametrize(
    ("read", "text"),
    [
        (read_json, '{"a": ' + "9" * 5000 + "}"),
        (read_json, "[" * 100_000),
        (read_toml, f"a = {'9' * 5000}"),
        (read_toml, f"a = {'[' * 5000}"),
    ],
)
def test_why_a_parser_gives_up_is_said_in_plain_words(tmp_path, read, text):
    path = tmp_path / "a.txt"
    path.write_text(text)
    with pytest.raises(
        ValueError, match=r"a\.txt: not a (JSON|TOML) file \((it is nested|a number in it)"
    ):
        read(path)


@pytest.mark.parametrize(
    ("read", "limit", "text"),
    [
        (read_json, JSON_BYTES, "[]"),
        (read_toml, TOML_BYTES, "a = 1"),
        (read_text, TEXT_BYTES, "0 0 0 0"),
    ],
)
def test_a_file_too_large_for_its_kind_is_refused_before_it_is_parsed(tmp_path, read, limit, text):
    path = tmp_path / "a.txt"
    path.write_text(text.ljust(limit))
    assert read(path) is not None
    with path.open("r+b") as stream:
        stream.truncate(2**40)  # sparse: only a reader that takes it all would notice
    with pytest.raises(
        ValueError,
        match=rf"a\.txt: is too large, a file of this kind has at most {limit >> 20} MiB",
    ):
        read(path)


@pytest.mark.parametrize(
    ("read", "nested"),
    [
        (read_json, lambda depth: "[" * depth + "]" * depth),
        (read_json, lambda depth: '{"a":' * depth + "1" + "}" * depth),
        (read_toml, lambda depth: ".".join("a" * depth) + " = 1"),
        (read_toml, lambda depth: "[" + ".".join("a" * (depth - 1)) + "]"),
    ],
    ids=["lists", "objects", "dotted keys", "tables"],
)
def test_what_is_nested_too_deeply_for_later_work_is_refused(tmp_path, read, nested):
    path = tmp_path / "a.txt"
    path.write_text(nested(64))
    assert json.dumps(read(path), indent=1)
    for depth in (65, 900, 50_000 if read is read_json else 2000):
        path.write_text(nested(depth))
        with pytest.raises(
            ValueError, match=r"a\.txt: not a (JSON|TOML) file \(it is nested too deeply\)"
        ):
            read(path)


def test_text_has_line_feeds_whatever_its_lines_end_with(tmp_path):
    (tmp_path / "a").write_bytes(b"a\r\nb\rc\nd")
    assert read_text(tmp_path / "a") == "a\nb\nc\nd"
