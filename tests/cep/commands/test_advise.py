"""``cep advise`` and the verdict of ``cep optimize``: sentence, table, figure, JSON."""

import json
from pathlib import Path

import numpy as np
import pytest

from cep.commands.code_options import exposure_seconds
from cep.files.code_files import StoredCode, write_code
from cep.files.images import read_image, write_image
from cep.optics.code import ShutterCode
from cep.optics.scene import SCENES
from cep.photographs.scenes import photographs

ALONG = ("--linear", "12", "--chips", "12")
FIELDS = {
    "verdict",
    "choice",
    "gains_db",
    "equal_light_gains_db",
    "crossover",
    "levels",
    "chips",
    "exposure_s",
    "plot",
}


def test_the_answer_comes_first(cep, workplace):
    assert (
        cep("advise", *ALONG, "--photons", "3000", "--read-noise", "2", "-o", "quiet.png").code
        == 0
    )
    assert cep.out.startswith("Coding does not pay here: expose 1/")
    assert cep("advise", *ALONG, "--read-noise", "50", "-o", "noisy.png").code == 0
    assert cep.out.startswith("Code this exposure: ")
    assert read_image("noisy.png").ndim == 3


def test_what_to_expect_is_said_before_it_is_measured(cep, workplace, monkeypatch):
    scenes = photographs()[:1]
    monkeypatch.setattr("cep.photographs.scenes.photographs", lambda: scenes)
    cep("advise", *ALONG, "--photons", "3000", "--read-noise", "2")
    (expected,) = [line for line in cep.err.splitlines() if "expected" in line]
    assert expected.startswith("cep: expected, before it is measured: coding does not pay here")
    assert "about" in expected
    assert "expected" not in cep.out
    cep("advise", "--linear", "200", "--chips", "12", "--photons", "3000")  # not measured
    assert "expected" not in cep.err


def test_a_figure_is_drawn_where_it_is_asked_for_alone(cep, workplace):
    """The answer is on the page: asking twice must not fail over a file of the first time."""
    given = ("--chips", "4", "--linear", "12", "--read-noise", "50")
    before = sorted(Path().iterdir())
    first, second = (cep.succeeds("advise", *given) for _ in range(2))
    assert sorted(Path().iterdir()) == before
    assert first == second
    assert first["plot"] is None
    assert cep.succeeds("advise", *given, "-o", "told.png")["plot"] == "told.png"
    assert "told.png: exists already" in cep.refuses("advise", *given, "-o", "told.png")


def test_json_holds_what_is_said(cep, workplace):
    found = cep.succeeds(
        "advise", *ALONG, "--read-noise", "50", "--exposure", "1/50", "-o", "advice.png"
    )
    assert set(found) >= FIELDS
    assert found["choice"] == "code"
    assert {one["photons"]: one["choice"] for one in found["levels"]}[10_000] == "code"
    assert found["exposure_s"] == pytest.approx(0.02, rel=1e-6)
    assert found["gains_db"]["open"] == 0
    assert found["gains_db"]["code"] > found["gains_db"]["snapshot"]
    assert found["verdict"].startswith("Code this exposure")


def test_the_gain_is_measured_on_photographs(cep, workplace, monkeypatch):
    scenes = photographs()[:1]
    monkeypatch.setattr("cep.photographs.scenes.photographs", lambda: scenes)
    document = cep.succeeds("advise", "--linear", "6", "--chips", "4", "--read-noise", "50")
    assert document["photographs"] == 1
    assert " dB over the best single exposure (" in document["verdict"]
    assert " on 1 photograph)" in document["verdict"]
    assert document["gains_db"]["code"] == pytest.approx(
        document["ways"]["code"]["photo_psnr_db"][0] - document["ways"]["open"]["photo_psnr_db"][0]
    )


@pytest.mark.slow(reason="advice three times")
def test_a_stated_error_of_the_path_counts(cep, workplace):
    path = json.loads(Path("trajectory.json").read_text())
    path["source"] = {"path_uncertainty_px": 0.7}
    Path("vague.json").write_text(json.dumps(path))
    given = ("--chips", "8", "--read-noise", "50", "--force", "-o", "advice.png")
    exact, vague, told = (
        cep.succeeds("advise", "--trajectory", name, *given, *more)
        for name, more in (
            ("trajectory.json", ()),
            ("vague.json", ()),
            ("trajectory.json", ("--path-error", "0.7")),
        )
    )
    assert (exact["path_error_px"], vague["path_error_px"]) == (0.0, 0.7)
    assert vague["gains_db"] == told["gains_db"] != exact["gains_db"]


def test_codes_of_ones_own_are_judged(cep, workplace):
    bits = "110100101011"
    found = cep.succeeds("advise", *ALONG, "--code", bits, "-o", "advice.png")
    assert found["chips"] == len(bits)
    line = cep.refuses("advise", *ALONG, "--code", "1011", "-o", "other.png")
    assert "--code" in line
    assert not Path("other.png").exists()


def test_the_chip_time_of_a_code_file_counts(cep, workplace):
    """1 e-/ms of dark current: the longer the file's chips, the worse its code; another exposure
    contradicts it."""
    Path("warm.toml").write_text("read_noise_e = 2.0\ndark_current_e_s = 100000.0\n")
    given = (*ALONG, "--camera", "warm.toml", "--force", "-o", "advice.png")
    found = {}
    for chip_ns in (100_000, 4_000_000):
        write_code("own.json", StoredCode(ShutterCode("110100101011", chip_ns)))
        one = cep.succeeds("advise", *given, "--code", "own.json")
        assert (one["chip_ns"], one["exposure_s"]) == (chip_ns, pytest.approx(12 * chip_ns * 1e-9))
        assert one["warnings"] == []
        found[chip_ns] = one["codes"][0]["psnr_db"]
    assert found[100_000] > found[4_000_000] + 1
    assert cep("advise", *given, "--code", "own.json", "--exposure", "48ms").code == 0
    line = cep.refuses("advise", *given, "--code", "own.json", "--exposure", "20ms")
    assert line.startswith(
        "cep: --exposure: 20 ms contradicts the file of --code, whose 12 chips of 4 ms take 48 ms"
    )
    write_code("other.json", StoredCode(ShutterCode("110100101011", 100_000)))
    line = cep.refuses("advise", *given, "--code", "own.json", "--code", "other.json")
    assert line.startswith("cep: --code: the files state chips of")


def test_search_and_advice_take_as_many_chips_as_the_motion_allows(cep, workplace):
    found = cep.succeeds("advise", "--linear", "12", "--read-noise", "50", "-o", "advice.png")
    searched = cep.succeeds(
        "optimize", "--linear", "12", "--read-noise", "50", "--steps", "2000", "-o", "new.json"
    )
    assert searched["chips"] == found["chips"] == 32
    assert searched["exposure_s"] == pytest.approx(0.052)


def test_an_exposure_sets_the_chip_time_of_a_code(cep, workplace):
    given = (*ALONG, "--steps", "2000", "--device", "cxp-avr", "--exposure", "6.01ms")
    found = cep.succeeds("optimize", *given, "-o", "new.json")
    assert found["chip_ns"] == 501_000  # the nearest tick of 0.5 us
    assert found["exposure_s"] == pytest.approx(12 * 501e-6)


@pytest.mark.parametrize("text", ["0", "-1", "1/0", "x", "", "inf", "nan", "1/x", "10 m"])
def test_a_wrong_exposure_is_refused(cep, workplace, text):
    assert cep.refuses("advise", *ALONG, "--exposure", text).startswith(
        "cep: --exposure: must be a time above 0"
    )


@pytest.mark.parametrize(
    ("text", "seconds"), [("1/30", 1 / 30), ("20ms", 0.02), ("500us", 5e-4), ("2 s", 2), ("3", 3)]
)
def test_exposures_are_read(text, seconds):
    assert exposure_seconds(text) == pytest.approx(seconds)


@pytest.mark.slow(reason="a search that is judged on parts of a photo")
def test_a_photo_of_the_scene_is_what_gains_are_measured_on(cep, workplace):
    write_image("belt.png", photographs()[3])
    noisy = (*ALONG, "--read-noise", "50")
    advice = cep.succeeds("advise", *noisy, "--scene", "belt.png")
    assert advice["scene"] == "belt.png"
    assert advice["photographs"] == 4
    assert "on 4 parts of belt.png" in advice["verdict"]
    best = cep.succeeds(
        "optimize", *noisy, "--steps", "2000", "--scene", "belt.png", "-o", "belt.json"
    )
    assert "4 parts of belt.png" in best["verdict"]
    audited = cep.succeeds("audit", "belt.json", *ALONG[:2])
    assert audited["mse_db"] == pytest.approx(best["mse_db"], abs=1e-6)
    assert "a model of belt.png" in audited["verdict"]


def test_where_one_speed_is_too_fast_to_be_measured_no_photo_is_too_small(cep, workplace):
    """Gains are then those of the photo's model, for which any of its parts will do."""
    write_image("belt.png", photographs()[3])
    fast = ("--linear", "120", "--speed", "0.9:1.1", "--chips", "8", "--read-noise", "50")
    best = cep.succeeds("optimize", *fast, "--steps", "500", "--scene", "belt.png", "-o", "a.json")
    assert "a model of belt.png" in best["verdict"]
    slow = ("--linear", "100", *fast[2:])
    assert "too small" in cep.refuses("optimize", *slow, "--scene", "belt.png")


def test_named_scenes_are_those_of_the_help_page_and_a_models(cep, workplace):
    assert cep("advise", "--help").code == 0
    page = " ".join(cep.out.split())
    for name, scene in SCENES.items():
        assert name in page
        advice = cep.succeeds("advise", *ALONG, "--scene", name)
        assert f"a model of {scene.name}" in advice["verdict"]


@pytest.mark.parametrize("command", ["advise", "optimize"])
def test_what_is_no_scene_is_refused(cep, workplace, command):
    scene = photographs()[3]
    write_image("small.png", scene[:100, :100])
    write_image("flat.png", np.full((200, 200), 0.3))
    write_image("white.png", np.where(scene > np.quantile(scene, 0.7), 1.0, scene))
    Path("text.png").write_text("no photo")
    for name, fault in (
        ("small.png", "too small for this motion"),
        ("flat.png", "flat"),
        ("white.png", "at white"),
        ("text.png", "text.png"),
        ("tekst", "photo, text, texture, flat-part"),
    ):
        line = cep.refuses(command, *ALONG, "--scene", name)
        assert "--scene: " in line
        assert fault in line


def test_the_photo_of_the_scene_is_not_replaced(cep, workplace):
    write_image("belt.png", photographs()[3])
    before = Path("belt.png").read_bytes()
    for command in ("advise", "optimize"):
        line = cep.refuses(command, *ALONG, "--scene", "belt.png", "-o", "belt.png", "--force")
        assert "belt.png" in line
    assert Path("belt.png").read_bytes() == before
