"""``cep calibration-set``: its files, its JSON, its refusals."""

import json
from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def workplace(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_it_writes_the_codes_and_how_to_use_them(cep):
    found = cep.succeeds(
        "calibration-set", "--photos", 2, "--chips", 8, "--device", "flc", "-o", "set"
    )
    assert sorted(found["files"]) == sorted(f"set/{item.name}" for item in Path("set").iterdir())
    stored = json.loads(Path("set/set.json").read_text())
    assert stored["schema"] == "cep.calibration-set/2"
    assert stored["command"] == "cep calibrate P1 P2 --code open --code set/code_2.json -o motion"
    assert {name: found[name] for name in stored if name != "schema"} == {
        name: value for name, value in stored.items() if name != "schema"
    }
    assert cep.succeeds("export", "set/code_2.json", "--format", "csv", "-o", "again.csv")
    assert Path("again.csv").read_text() == Path("set/code_2.csv").read_text()


def test_people_read_first_what_to_do(cep):
    cep("calibration-set", "--photos", 2, "--chips", 8, "--format", "rp2", "-o", "set")
    assert cep.code == 0
    assert cep.out.startswith("Take 2 photos of the motion, P1 with the shutter open, P2 through ")
    assert "then: cep calibrate P1 P2 --code open --code set/code_2.json -o motion" in cep.out
    assert Path("set/code_1_rp2.py").is_file()


def test_existing_files_are_kept(cep):
    Path("set").mkdir()
    Path("set/set.json").write_text("precious")
    assert "set/set.json: exists already" in cep.refuses(
        "calibration-set", "--chips", 8, "-o", "set"
    )
    assert Path("set/set.json").read_text() == "precious"


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--photos", "0"], "--photos"),
        (["--chips", "3"], "--chips"),
        (["--chips", "600"], "--chips: must be 4 to 512, got 600"),
        (
            ["--chips", "12", "--device", "mechanical"],
            "--chips: mechanical opens for at least 30 ms",
        ),
        (
            ["--chips", "12", "--device", "flc", "--chip-ns", "1000"],
            "--chip-ns: flc takes 50000 ns",
        ),
        (["--format", "morse"], "--format"),
    ],
)
def test_what_cannot_be_designed_is_refused(cep, options, named):
    assert named in cep.refuses("calibration-set", *options, "-o", "set")
    assert not Path("set").exists()
