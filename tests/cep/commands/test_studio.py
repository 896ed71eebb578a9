"""``cep studio`` without a page: what it refuses, and a saved design taken apart and reproduced by
its own commands."""

import builtins
import json
import shlex
import stat
import webbrowser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

from cep.search.measured import shifts_db
from cep.studio.security import Keys
from cep.studio.state import read_setting
from cep.studio.views import Views

SETTING = {
    "motion": {"kind": "example", "name": "shake"},
    "bits": "1101000111010110",
    "exposure": "20ms",
    "camera": "video-8bit",
    "photons": 2000,
    "open": [6, 10],
}


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


FIRST_LINE = (
    "cep optimize --trajectory trajectory.json --chips 16 --exposure 20ms --open 6:10 --camera"
    " video-8bit"
)
HOSTILE = "touch ran; $(touch ran) `touch ran`\ntouch ran\n"


def extracted(cep, saved, **changes):
    """Change fields of a studio file and take it apart: the shell's lines, or the line that
    refuses it."""
    document = json.loads(saved.read_text())
    for path, value in changes.items():
        *folders, name = path.split("__")
        inside = document
        for folder in folders:
            inside = inside[folder]
        inside[name] = value
    saved.write_text(json.dumps(document))
    cep("studio", saved, "--extract", "design")
    design = saved.parent / "design"
    if cep.code == 0:
        files = [
            str(Path("design") / name) for name in ("trajectory.json", "code.json", "commands.sh")
        ]
        assert [line.strip() for line in cep.out.splitlines()][-3:] == files
        return (design / "commands.sh").read_text().splitlines()
    assert cep.code == 2
    assert cep.err.count("\n") == 1
    assert not design.exists()
    return cep.err


def test_the_commands_are_made_from_the_state_and_not_copied(cep, saved):
    lines = extracted(
        cep, saved, commands=[HOSTILE, "rm -rf ~"], state__junk=HOSTILE, extra=HOSTILE
    )
    assert lines[0].startswith(FIRST_LINE)
    assert all(shlex.split(line)[0] == "cep" for line in lines)
    assert "touch" not in "".join(lines)
    assert not any(line.startswith("rm") for line in lines)


@pytest.mark.parametrize(
    "value",
    [HOSTILE, "20\nms", "20ms\n", "20ms; touch ran", "--force", "\x1b[2J", 7, 10**400, [HOSTILE]],
)
@pytest.mark.parametrize(
    "field",
    [
        "camera",
        "device",
        "exposure",
        "bits",
        "photons",
        "read_noise",
        "path_error",
        "min_open",
        "min_closed",
        "open",
    ],
)
def test_a_state_with_a_hostile_field_is_refused_by_its_name(cep, saved, field, value):
    if field in ("photons", "read_noise") and value == 7:
        value = "7"
    if (field, value) in (("path_error", 7), ("min_open", 7), ("min_closed", 7)):
        value = [7]
    assert f"state.{field}:" in extracted(cep, saved, **{f"state__{field}": value})


@pytest.mark.parametrize(
    ("field", "value", "named"),
    [
        ("state", [HOSTILE], "state"),
        ("state__motion", HOSTILE, "state.motion"),
        ("state__motion", {"kind": "straight", "length": "20; touch ran"}, "state.length"),
        ("state__motion", {"kind": "example", "name": HOSTILE}, "state.motion"),
        ("state__search", {"steps": HOSTILE, "seed": 0}, "state.steps"),
        ("state__search", {"steps": 10**400, "seed": 0}, "state.steps"),
        ("state__search", {"steps": 5, "seed": True}, "state.seed"),
        ("state__search", [HOSTILE], "state.search"),
        ("state__pins", {HOSTILE: "101"}, "state.pins"),
        ("state__pins", [{"name": HOSTILE, "bits": "101"}], "state.pins"),
        ("state__view", HOSTILE, "state.view"),
        ("state__left", [HOSTILE], "state.left"),
        ("trajectory", HOSTILE, "trajectory"),
        ("trajectory", {}, "trajectory.t"),
        ("trajectory__x", [HOSTILE, HOSTILE], "trajectory.x"),
        ("trajectory__t", [0, 1], "trajectory.t"),
        ("trajectory__direction", HOSTILE, "trajectory.direction"),
        ("code", {}, "code.bits"),
        ("code__bits", HOSTILE, "code.bits"),
        ("code__bits", "1101000111010111", "code.bits"),
        ("code__chip_ns", 3, "code.chip_ns"),
        ("code__problem", {"device": {"name": HOSTILE}}, "code.problem.device"),
        ("commands", [{}], "commands"),
    ],
)
def test_a_part_that_is_not_what_the_state_says_is_refused(cep, saved, field, value, named):
    assert named in extracted(cep, saved, **{field: value})


def test_what_is_extracted_besides_is_made_from_the_state_too(cep, saved):
    measured = json.loads(saved.read_text())["code"]["metrics"]["min_mtf"]
    extracted(cep, saved, code__metrics={"min_mtf": 0.75}, trajectory__source={"method": HOSTILE})
    design = saved.parent / "design"
    assert (
        json.loads((design / "code.json").read_text())["metrics"]["min_mtf"]
        == pytest.approx(measured)
        != 0.75
    )
    assert "touch" not in (design / "trajectory.json").read_text()


def test_the_shutter_of_the_state_goes_with_the_code(cep, saved):
    state = {**SETTING, "device": "flc"}
    document = json.loads(json.dumps(Views().saved(read_setting(state), state)))
    saved.write_text(json.dumps(document))
    assert "--device flc" in extracted(cep, saved)[0]
    code = json.loads((saved.parent / "design" / "code.json").read_text())
    assert code["problem"]["device"] == document["code"]["problem"]["device"]


def test_a_page_is_not_begun_with_a_malformed_state(cep, saved):
    document = json.loads(saved.read_text())
    saved.write_text(json.dumps({**document, "state": {**document["state"], "photons": "many"}}))
    assert "state.photons: must be a number within 1 to" in cep.refuses(
        "studio", saved, "--no-browser"
    )


def test_the_browser_is_led_by_a_private_file_and_its_command_line_has_no_key(cep, monkeypatch):
    opened = []

    def serve_one_visit(server, sockets):
        (address,) = opened
        page = Path(unquote(urlsplit(address).path))
        opened.append(
            (
                stat.S_IMODE(page.stat().st_mode),
                stat.S_IMODE(page.parent.stat().st_mode),
                page.read_text(),
            )
        )
        (keys,) = (made.kwargs["keys"] for made in server.config.app.user_middleware)
        assert keys.spend(keys.token)
        opened.append((keys, page.exists()))
        server.config.app.state.studio.close()

    monkeypatch.setattr(webbrowser, "open", opened.append)
    monkeypatch.setattr("uvicorn.Server.run", serve_one_visit)
    cep("studio")
    assert cep.code == 0, cep.err
    address, (mode, folder_mode, text), (keys, still_there) = opened
    assert isinstance(keys, Keys)
    assert address.startswith("file:///")
    assert keys.token not in address
    assert f'content="0; url={keys.address}"' in text
    assert keys.address in cep.err  # for the user's own eyes
    assert (mode, folder_mode, still_there) == (0o600, 0o700, False)


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
    picture = Views().picture(read_setting(SETTING))
    verdict = Views().verdict(read_setting(SETTING))
    assert results["audit"]["min_mtf_lower"] == pytest.approx(
        picture["figures"]["min_mtf_lower"], rel=1e-3
    )
    assert results["audit"]["noise_gain_db"] == pytest.approx(
        picture["figures"]["noise_gain_db"], abs=1e-3
    )
    (own,) = results["advise"]["codes"]
    # the page's figures are the model's, shifted by the table: the command's here are not measured
    setting = read_setting(SETTING)
    shift_db = shifts_db(setting.trajectory, setting.sensor)["code"]
    assert own["psnr_db"] + shift_db == pytest.approx(verdict["psnr_db"], abs=1e-6)
    assert own["psnr_db"] + shift_db == pytest.approx(picture["figures"]["psnr_db"], abs=0.02)
    assert results["optimize"]["chips"] == 16
    assert 6 <= results["optimize"]["open"] <= 10
