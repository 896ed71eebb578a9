"""``cep studio`` without a page: what it refuses, and a saved design taken apart and reproduced by its own commands."""

import builtins
import json
import shlex

import pytest

from cep.studio.state import read_setting
from cep.studio.views import Views

SETTING = {
    "motion": {"kind": "example", "name": "shake"}, "bits": "1101000111010110", "exposure": "20ms",
    "camera": "video-8bit", "photons": 2000, "open": [6, 10],
}  # fmt: skip


@pytest.fixture
def saved(workplace):
    """A studio.json of a code that a search found."""
    made = Views().saved(read_setting(SETTING), {**SETTING, "search": {"steps": 500, "seed": 2}})
    (workplace / "studio.json").write_text(json.dumps(made))
    return workplace / "studio.json"


def test_without_its_packages_one_line_says_how_to_install_them(cep, monkeypatch):
    known = builtins.__import__

    def without(name, *args, **options):
        if name in ("starlette", "uvicorn"):
            raise ImportError(name)
        return known(name, *args, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    assert "pip install 'coded-exposure[studio]'" in cep.refuses("studio", "--no-browser")


def test_help_has_examples(cep):
    cep("studio", "--help")
    assert cep.code == 0
    assert "cep studio studio.json --extract design" in cep.out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--extract", "design"], "--extract: needs the studio.json"),
        (["missing.json", "--extract", "design"], "missing.json"),
        (["trajectory.json", "--extract", "design"], 'wanted schema "cep.studio/1"'),
        (["trajectory.json", "--no-browser"], 'wanted schema "cep.studio/1"'),
    ],
)
def test_bad_input_is_one_line(cep, workplace, arguments, words):
    assert words in cep.refuses("studio", *arguments)
    assert not (workplace / "design").exists()


def test_a_port_in_use_is_one_line(cep):
    import socket

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        assert "--port" in cep.refuses("studio", "--no-browser", "--port", taken.getsockname()[1])


@pytest.mark.slow  # a verdict over the light
def test_the_saved_commands_reproduce_what_the_page_showed(cep, saved, monkeypatch):
    document = json.loads(saved.read_text())
    found = cep.succeeds("studio", saved, "--extract", "design")
    assert len(found["files"]) == 3
    monkeypatch.chdir(saved.parent / "design")
    lines = (saved.parent / "design" / "commands.sh").read_text().splitlines()
    assert lines == document["commands"]
    results = {}
    for line in lines:
        command, *arguments = shlex.split(line)[1:]
        results[command] = cep.succeeds(command, *arguments)
    picture, verdict = Views().picture(read_setting(SETTING)), Views().verdict(read_setting(SETTING))
    assert results["audit"]["min_mtf_lower"] == pytest.approx(picture["figures"]["min_mtf_lower"], rel=1e-3)
    assert results["audit"]["noise_gain_db"] == pytest.approx(picture["figures"]["noise_gain_db"], abs=1e-3)
    (own,) = results["advise"]["codes"]
    assert own["psnr_db"] == pytest.approx(verdict["psnr_db"], abs=1e-6)
    assert own["psnr_db"] == pytest.approx(picture["figures"]["psnr_db"], abs=0.02)
    assert results["optimize"]["chips"] == 16
    assert 6 <= results["optimize"]["open"] <= 10
