"""Errors of commands: one line that names options as typed, and the exit code."""

import errno
from pathlib import Path
from types import SimpleNamespace

import pytest

from cep.commands.errors import explain, in_options, with_photo_file


def test_failures_are_one_line_and_exit_1(monkeypatch, capsys):
    assert explain(RuntimeError("device is gone")) == 1
    assert explain(ZeroDivisionError("two\nlines")) == 1
    noted = RuntimeError("device is gone")
    noted.add_note("look at the shutter")
    assert explain(noted) == 1
    assert explain(MemoryError()) == 1
    lines = capsys.readouterr().err.splitlines()
    assert lines[:3] == [
        "cep: device is gone",
        "cep: ZeroDivisionError: two lines",
        "cep: device is gone; look at the shutter",
    ]
    assert "Traceback" not in "".join(lines)
    monkeypatch.setenv("CEP_DEBUG", "1")
    explain(ValueError("why"))
    assert "cep: why" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("number", "code"),
    [
        (errno.ENOENT, 2),
        (errno.EACCES, 2),
        (errno.EISDIR, 2),
        (errno.ENOSPC, 1),
        (errno.EDQUOT, 1),
        (errno.EFBIG, 1),
        (errno.EIO, 1),
    ],
)
def test_a_full_disk_is_no_fault_of_the_command_line(capsys, number, code):
    assert explain(OSError(number, "why", "photo.tif")) == code
    assert capsys.readouterr().err == "cep: photo.tif: why\n"


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (ValueError("chips: must be 4"), "chips: must be 4"),
        (ValueError(), "wrong input"),
        (FileNotFoundError(errno.ENOENT, "No such file"), "No such file"),
        (IsADirectoryError(), "IsADirectoryError"),
    ],
)
def test_wrong_input_exits_2(capsys, error, line):
    assert explain(error) == 2
    assert capsys.readouterr().err == f"cep: {line}\n"


def test_an_error_of_a_photo_names_its_file():
    images = [Path("a.png"), Path("b.png")]
    for error, named in (
        ("photo 2: is black", "b.png: is black"),
        ("photo: is black", "a.png: is black"),
        ("photos: are black", "photos: are black"),
        ("the photo 2: is black", "the photo 2: is black"),
    ):
        assert with_photo_file(error, images) == named


def param(name, *opts, kind="option", metavar=None):
    return SimpleNamespace(name=name, opts=list(opts), param_type_name=kind, metavar=metavar)


@pytest.mark.parametrize(
    ("message", "given", "translated"),
    [
        ("exposure_s: must be above 0, got -1", (), "--exposure: must be above 0, got -1"),
        (
            "start_s and exposure_s: need a recording",
            (),
            "--start and --exposure: need a recording",
        ),
        ("open_range: fewest 9 is above most 3", (), "--open: fewest 9 is above most 3"),
        ("duty: must be LOW:HIGH", (), "--open: must be LOW:HIGH"),
        ("min_open: conflicts with 3 (open_range)", (), "--min-open: conflicts with 3 (--open)"),
        ("sharp: not valid with method='pmp'", (), "--sharp: not valid with --method pmp"),
        (
            "method: must be one of min_open, got 'min_open'",
            (),
            "--method: must be one of --min-open, got 'min_open'",
        ),
        ("bits: only 0 and 1", (), "CODE: only 0 and 1"),
        ("fixed (1 open): no code", (), "fixed (1 open): no code"),
        ("method (1 open): no code", (), "--method (1 open): no code"),
        (
            "open_range 9..12, min_open 4 and method 3 conflict: no",
            (),
            "--open 9..12, --min-open 4 and --method 3 conflict: no",
        ),
        ("method and sharp.png: no photo", (), "method and sharp.png: no photo"),
        ("shots/method: no photo", (), "shots/method: no photo"),
        ("scene: is empty", (), "scene: is empty"),
        ("scene: needs size=3", (), "scene: needs size=3"),
        (
            "method: known are sharp=, code=, method=",
            (),
            "--method: known are sharp=, code=, method=",
        ),
        ("my_photo.png: is empty", (), "my_photo.png: is empty"),
        (
            "camera.json: exposure_s: must be a number",
            (),
            "camera.json: exposure_s: must be a number",
        ),
        ("--open: must lie within 1..9 (min_open)", (), "--open: must lie within 1..9 (min_open)"),
        ("the photo is black", (), "the photo is black"),
    ],
)
def test_parameters_are_translated_into_options(message, given, translated):
    params = [
        param("code", "code", kind="argument", metavar="CODE"),
        param("exposure", "--exposure"),
        param("start_s", "--start"),
        param("open_chips", "--open", "-k"),
        param("min_open", "--min-open"),
        param("method", "--method"),
        param("sharp", "--sharp"),
    ]
    source = {name: SimpleNamespace(name="COMMANDLINE") for name in given}
    context = SimpleNamespace(
        command=SimpleNamespace(params=params), get_parameter_source=source.get
    )
    assert in_options(message, context) == translated
