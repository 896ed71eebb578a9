"""``python -m lab bench cep``: from photos to tables, going on where it stopped, and refusals."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from cep.commands.console import FAILURE, INTERRUPTED
from cep.files.code_files import StoredCode, write_code
from cep.files.images import read_image, write_image
from cep.optics.code import ShutterCode
from cep.search import code_search
from lab.bench.coded.designs import DESIGNS

TINY = """\
name = "tiny"
photos = 3
motions = 1
crop_px = 96
borders = "real"
shakes = "mixed"
chips = 16
open_range = [6, 10]
objective = "mse"
photons = [300.0, 10000.0]
quick_photons = []
calibration_photons = 10000.0
bits = 12
read_noise_e = 5.0
restoration = "wiener"
border_rounds = 10
restored_by = "psf"
steps = 1000
seed = 0
quick_photos = 1
quick_motions = 1
quick_steps = 500
"""
TABLES = [
    "Coded exposure, tiny, 300 photo-electrons",
    "Coded exposure, tiny, 300 photo-electrons: rows beyond comparison",
    "Noise gain of the codes along the true motion, 300 photo-electrons",
    "Coded exposure, tiny, 10,000 photo-electrons",
    "Coded exposure, tiny, 10,000 photo-electrons: rows beyond comparison",
    "Noise gain of the codes along the true motion, 10,000 photo-electrons",
]


@pytest.fixture
def studio(tmp_path, monkeypatch):
    """A folder with two sharp photos and a small protocol; the process works in it."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    Path("photos").mkdir()
    for name in ("a", "b"):
        write_image(
            f"photos/{name}.png", 0.1 + 0.8 * np.kron(rng.random((20, 21, 3)), np.ones((8, 8, 1)))
        )
    Path("tiny.toml").write_text(TINY)
    return tmp_path


CEP = (
    "bench",
    "cep",
    "--data",
    "photos",
    "--protocol",
    "tiny.toml",
    "--designs",
    "open,dnf,oracle",
    "--workers",
    "1",
)


def untouchable(*_arguments):
    pytest.fail("a finished cell was made again")


def test_from_photos_to_every_output_and_found_again(lab, studio, monkeypatch):
    found = lab.succeeds(*CEP, "-o", "out")
    assert list(found["tables"]) == TABLES
    assert list(found["tables"][TABLES[3]]) == [DESIGNS[name].label for name in ("open", "dnf")]
    rows = found["tables"][TABLES[4]]
    assert list(rows) == [DESIGNS["oracle"].label]
    assert rows[DESIGNS["oracle"].label]["psnr_db"]["n"] == 2
    assert (found["protocol"], found["designs"], found["failures"], found["missing"]) == (
        "tiny",
        ["open", "dnf", "oracle"],
        {},
        0,
    )
    assert found["warnings"] == ["2 photos are large enough, the protocol asks for 3"]
    names = [
        "cep-photos.csv",
        "cep.csv",
        "cep.json",
        "cep.md",
        "cep.pdf",
        "cep.png",
        "cep.svg",
        "cep.tex",
    ]
    assert [Path(file).name for file in found["files"]] == names
    with open("out/cep-photos.csv", newline="", encoding="utf-8") as stream:
        shots = list(csv.DictReader(stream))
    assert len(shots) == 3 * 2 * 2
    own = [shot for shot in shots if (shot["design"], shot["photons"]) == ("oracle", "10000")]
    mean = np.mean([float(shot["psnr_db"]) for shot in own])
    assert rows[DESIGNS["oracle"].label]["psnr_db"]["mean"] == pytest.approx(mean, rel=1e-5)
    assert all(
        6 <= ShutterCode(shot["bits"]).open_chips <= 10
        for shot in shots
        if shot["design"] != "open"
    )
    kept = json.loads(Path("out/cep.json").read_text())
    assert (
        kept["command"]
        == "python -m lab bench cep --data photos --protocol tiny.toml --designs open,dnf,oracle"
    )
    assert (kept["seed"], kept["machines"][0]["versions"]["numpy"]) == (0, np.__version__)
    text = Path("out/cep.md").read_text()
    assert "16 chips" in text
    assert str(studio) not in text + Path("out/cep.json").read_text()
    height, width = read_image("out/cep.png").shape[:2]
    assert min(height, width) > 300

    assert "exists already" in lab.refuses(*CEP, "-o", "out")
    monkeypatch.setattr("lab.jobs.engine.worked", untouchable)
    assert lab.succeeds(*CEP, "-o", "out", "--force")["tables"] == found["tables"]


def test_stopped_in_a_search_it_goes_on_later(lab, studio, monkeypatch):
    real = code_search.anneal
    calls = []

    def stopping(problem, **options):
        def stop(_fraction, _best):
            if len(calls) == 2:
                raise KeyboardInterrupt

        calls.append(problem)
        return real(problem, **options | {"progress": stop})

    monkeypatch.setattr(code_search, "anneal", stopping)
    options = ("--designs", "oracle", "--quick", "-o", "out")
    one_light = TINY.replace("quick_photons = []", "quick_photons = [300.0]")
    Path("tiny.toml").write_text(one_light.replace("quick_motions = 1", "quick_motions = 2"))
    lab(*CEP, *options, "--json")
    assert (lab.code, lab.err) == (INTERRUPTED, "lab: interrupted\n")
    assert (lab.json["missing"], lab.json["tables"]) == (1, {})
    assert any(
        "stopped early" in warning and "--force goes on" in warning
        for warning in lab.json["warnings"]
    )
    assert "stopped early" in Path("out/cep.md").read_text()
    whole = lab.succeeds(*CEP, *options, "--force")
    assert whole["missing"] == 0
    assert len(calls) == 3  # the one before Ctrl-C is kept, the one that was stopped is made whole


def test_a_search_that_fails_is_told_beside_the_others(lab, studio, monkeypatch):
    def fails(*_arguments, **_options):
        raise ValueError("problem: too hard")

    monkeypatch.setattr(code_search, "anneal", fails)
    lab(*CEP, "--designs", "open,oracle", "--quick", "-o", "out", "--json")
    assert lab.code == FAILURE
    assert set(lab.json["failures"].values()) == {"problem: too hard"}
    assert DESIGNS["open"].label in Path("out/cep.md").read_text()


def test_a_second_run_takes_no_picture_of_the_first_for_a_photo(lab, studio):
    """Its picture is large enough to be taken: --data . beside an output folder would blur a
    table's picture."""
    options = ("--designs", "open", "--quick", "-o")
    command = ["." if part == "photos" else part for part in CEP]
    first = lab.succeeds(*command, *options, "out")
    assert min(read_image("out/cep.png").shape[:2]) >= 159
    assert lab.succeeds(*command, *options, "other")["tables"] == first["tables"]
    assert Path("other/cep-photos.csv").read_text() == Path("out/cep-photos.csv").read_text()


def test_people_see_tables_and_where_the_files_are(lab, studio, monkeypatch):
    monkeypatch.setattr("lab.bench.datasets.bundled_photos", lambda: (Path("photos/a.png"),))
    lab(
        "bench",
        "cep",
        "--protocol",
        "tiny.toml",
        "--designs",
        "open",
        "--quick",
        "--workers",
        "1",
        "-o",
        "out",
    )
    assert lab.code == 0, lab.err
    assert TABLES[3] in lab.out
    assert "PSNR, dB" in lab.out
    assert "out: cep-photos.csv" in lab.out
    assert "too few and too odd for a claim" in lab.err
    assert (
        "`python -m lab bench cep --protocol tiny.toml --designs open --quick`"
        in Path("out/cep.md").read_text()
    )


def test_codes_of_ones_own_follow_the_designs(lab, studio):
    Path("folder").mkdir()
    Path("own_code.py").write_text("bits = '1011010011010011'\n")
    write_code("folder/kept.json", StoredCode(ShutterCode("1101000101101111")))
    own = (
        "--code",
        "mine=own_code:bits",
        "--code",
        "kept=folder/kept.json",
        "--designs",
        "open",
        "--quick",
    )
    found = lab.succeeds(*CEP, *own, "-o", "out")
    assert list(found["tables"][TABLES[3]]) == [DESIGNS["open"].label, "mine", "kept"]
    assert (found["designs"], found["codes"]) == (
        ["open"],
        {"mine": "1011010011010011", "kept": "1101000101101111"},
    )
    command = json.loads(Path("out/cep.json").read_text())["command"]
    assert command.endswith(
        "--designs open --code mine=own_code:bits --code kept=kept.json --quick"
    )
    with open("out/cep-photos.csv", newline="", encoding="utf-8") as stream:
        assert {line["design"]: line["bits"] for line in csv.DictReader(stream)} == {
            "open": "1" * 16,
            **found["codes"],
        }


def small():
    Path("small").mkdir()
    write_image("small/c.png", np.random.default_rng(0).random((158, 180)))


def wrong():
    Path("wrong.toml").write_text(TINY.replace("chips = 16", "chips = 9"))


def notes():
    Path("notes").write_text("no folder")


@pytest.mark.parametrize(
    ("options", "prepared", "message"),
    [
        (("--designs", "open,theirs"), None, "designs: must be among open, snapshot"),
        (("--designs", "open,open"), None, "designs: each must come once"),
        (("--designs", "open,calibrated-3"), None, "designs: must be among open, snapshot"),
        (("--set", "speed=3"), None, "--set: must be FIELD=VALUE with one of bits"),
        (("--set", "motions=0"), None, "motions: must be a whole number within 1..10000"),
        (("--code", "dnf=1011"), None, "--code: dnf is the name of a built-in design"),
        (
            ("--code", "a=1", "--code", "a=10"),
            None,
            "--code: every name must come once, a comes twice",
        ),
        (("--code", "=1011"), None, "--code: a name must be of letters"),
        (("--code", "1011"), None, "--code: must be NAME=SOURCE"),
        (("--code", "a=theirs"), None, "--code: a: 'theirs' is no code"),
        (("--code", "a="), None, "--code: a: "),
        (("--code", "a=no_such_module:code"), None, "no_such_module"),
        (("--protocol", "theirs"), None, "protocol: must be one of paper, ours or a .toml file"),
        (("--protocol", "nowhere.toml"), None, "nowhere.toml: no such file"),
        (
            ("--protocol", "wrong.toml"),
            wrong,
            "wrong.toml: open_range: must be two numbers of chips within 1..9",
        ),
        (("--data", "nowhere"), None, "nowhere: no such folder"),
        (
            ("--data", "small"),
            small,
            "c.png: 180 x 158 px is too small, the protocol needs 159 px a side",
        ),
        (("--cache", "notes"), notes, "notes: is a file"),
        (("-o", "notes"), notes, "notes: is a file"),
        (("--workers", "0"), None, "--workers"),
    ],
)
def test_refusals(lab, studio, monkeypatch, options, prepared, message):
    if prepared is not None:
        prepared()
    monkeypatch.setattr("lab.jobs.engine.worked", untouchable)
    assert message in lab.refuses(*CEP, "-o", "out", *options)
    assert not Path("out/cep.md").exists()
