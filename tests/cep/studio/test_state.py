import json
import math
import shlex

import numpy as np
import pytest
from documented_commands import command_line

import cep
from cep.studio.fields import FieldError
from cep.studio.motions import path_fields
from cep.studio.state import read_search, read_setting, read_state
from motdiff.motions import boracchi_foi


@pytest.mark.parametrize(
    ("field", "change"),
    [
        ("bits", {"bits": "10a"}),
        ("bits", {"bits": "0000"}),
        ("bits", {"bits": ""}),
        ("bits", {"bits": "1" * 513}),
        ("bits", {"bits": 101}),
        ("length", {"motion": {"kind": "straight", "length": 0}}),
        ("length", {"motion": {"kind": "straight", "length": math.nan}}),
        ("length", {"motion": {"kind": "straight"}}),
        ("angle", {"motion": {"kind": "straight", "length": 9, "angle": "x"}}),
        ("motion", {"motion": {"kind": "loop"}}),
        ("motion", {"motion": {"kind": "example", "name": "nothing"}}),
        ("motion", {"motion": {"kind": "path", "t": [0, 1], "x": [0], "y": [0, 1]}}),
        ("motion", {"motion": {"kind": "path", "t": [0, 0], "x": [0, 1], "y": [0, 1]}}),
        ("motion", {"motion": {"kind": "path", "t": [0, 1], "x": [0, 1e9], "y": [0, 1]}}),
        ("motion", {"motion": {"kind": "path", "t": [0, 1], "x": [2, 2], "y": [1, 1]}}),
        ("motion", {"motion": {"kind": "path", "t": [0, 1], "x": [0, None], "y": [0, 1]}}),
        ("exposure", {"exposure": "soon"}),
        ("exposure", {"exposure": "-1"}),
        ("exposure", {"exposure": 3}),
        ("path_error", {"path_error": -0.1}),
        ("path_error", {"path_error": "small"}),
        ("photons", {"photons": 0}),
        ("photons", {"photons": True}),
        ("read_noise", {"read_noise": -1}),
        ("camera", {"camera": "../../etc/camera.toml"}),
        ("camera", {"camera": "mine.json"}),
        ("device", {"device": "/dev/null"}),
        ("open", {"open": [0, 4]}),
        ("open", {"open": [9, 4]}),
        ("open", {"open": [1, 99]}),
        ("open", {"open": "8"}),
        ("min_open", {"min_open": 1.5}),
        ("min_closed", {"min_closed": 0}),
    ],
)
def test_wrong_input_names_its_field(setting, field, change):
    with pytest.raises(FieldError) as caught:
        read_setting({**setting, **change})
    assert caught.value.field == field
    assert "\n" not in str(caught.value)


LARGE = [
    10**400,
    -(10**400),
    1e300,
    math.inf,
    -math.inf,
    math.nan,
    "1e400",
    "9" * 5000,
    True,
    [],
    {},
]


@pytest.mark.parametrize("value", LARGE, ids=lambda value: str(type(value).__name__))
@pytest.mark.parametrize(
    "field", ["path_error", "photons", "read_noise", "min_open", "min_closed"]
)
def test_a_number_beyond_all_measure_names_its_field(setting, field, value):
    with pytest.raises(FieldError) as caught:
        read_setting({**setting, field: value})
    assert caught.value.field == field
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize("value", LARGE, ids=lambda value: str(type(value).__name__))
@pytest.mark.parametrize("column", ["t", "x", "y"])
def test_a_number_beyond_all_measure_is_no_sample_of_a_path(setting, column, value):
    motion = {"kind": "path", "t": [0, 0.5, 1], "x": [0, 1, 2], "y": [0, 1, 0]}
    motion[column][1] = value
    with pytest.raises(FieldError) as caught:
        read_setting({**setting, "motion": motion})
    assert caught.value.field == "motion"


@pytest.mark.parametrize("field", ["steps", "seed"])
@pytest.mark.parametrize("value", [*LARGE, -1, 1.5])
def test_a_search_of_wrong_numbers_names_them(field, value):
    with pytest.raises(FieldError) as caught:
        read_search({"steps": 10, "seed": 1, field: value})
    assert caught.value.field == field


@pytest.mark.parametrize(
    "exposure", ["20\nms", "\n20ms", "20ms\x1b", "20\u00a0ms", "\u0662\u0660ms", "1e-300", "1e300"]
)
def test_an_exposure_is_one_printable_word_of_a_length_that_can_be(setting, exposure):
    with pytest.raises(FieldError) as caught:
        read_setting({**setting, "exposure": exposure})
    assert caught.value.field == "exposure"


@pytest.mark.parametrize(
    "name", ["own.JSON", "own.Toml", "--force", ".", "video-8bit\n", "\ud800", ["video-8bit"], 7]
)
@pytest.mark.parametrize("field", ["camera", "device"])
def test_a_name_is_one_of_the_list_and_no_file(setting, tmp_path, monkeypatch, field, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.JSON").write_text("{}")
    (tmp_path / "own.Toml").write_text("")
    with pytest.raises(FieldError) as caught:
        read_setting({**setting, field: name})
    assert caught.value.field == field


def test_minus_zero_is_zero_in_the_commands(setting):
    commands = read_setting({**setting, "read_noise": -0.0}).commands()
    assert "--read-noise 0 " in commands[0]


def test_a_state_is_what_it_says_field_by_field(setting):
    more = {
        "pins": [{"name": "mine", "bits": "101"}],
        "photo": "",
        "view": "restored",
        "left": "code",
        "search": None,
    }
    state = {**setting, "min_open": 2, **more}
    assert read_state({**state, "junk": "$(ls)"}) == state
    assert read_state({}) == {}  # the page begins with the rest
    assert read_state({"left": "snapshot"}) == {"left": "snapshot"}


@pytest.mark.parametrize("value", [*LARGE, "\n", -1])
@pytest.mark.parametrize(
    ("field", "fine"),
    [
        ("motion", ()),
        ("bits", ()),
        ("exposure", ()),
        ("open", ()),
        ("view", ()),
        ("left", ()),
        ("right", ()),
        ("photo", ("1e400",)),
        ("pins", ([],)),
        ("search", ()),
    ],
)
def test_a_state_of_wrong_types_is_refused(field, fine, value):
    if value in fine:
        assert read_state({field: value}) == {field: value}
        return
    with pytest.raises(FieldError) as caught:
        read_state({field: value})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("state", [None, [], "state", 7, 10**400])
def test_a_state_is_an_object(state):
    with pytest.raises(FieldError):
        read_state(state)


@pytest.mark.parametrize(
    ("field", "change"),
    [
        ("camera", {"camera": "nothing"}),
        ("device", {"device": "nothing"}),
        ("device", {"device": "mechanical"}),
        ("min_open", {"min_open": 12, "open": [1, 4]}),
        ("min_open", {"min_open": 99}),
    ],
)
def test_limits_that_no_code_keeps_name_their_field(setting, field, change):
    with pytest.raises(FieldError) as caught:
        read_setting({**setting, **change}).problem()
    assert caught.value.field == field


def test_a_setting_is_the_problem_of_the_front_door(setting):
    read = read_setting({**setting, "open": [4, 9], "min_open": 2, "device": "flc"})
    light = cep.Camera.load("video-8bit").at(2000)
    runs = cep.RunLimits(min_open=2)
    meant = cep.SearchProblem.along(
        cep.Trajectory.straight(20.0),
        chips=16,
        exposure_s=0.02,
        open_range=(4, 9),
        runs=runs,
        device="flc",
        camera=light,
        objective="mse",
    )
    made = read.problem()
    assert (made.runs, made.open_range, made.chip_ns, made.camera) == (
        meant.runs,
        meant.open_range,
        meant.chip_ns,
        light,
    )


def test_a_path_is_thinned_within_what_a_restoration_notices():
    path = boracchi_foi(np.random.default_rng(3))
    kept = path_fields(path)
    assert len(kept["t"]) <= 160 < path.t.size
    again = read_setting({"motion": kept, "bits": "10"}).trajectory
    times = np.linspace(0, 1, 400)
    assert np.abs(again.at(times) - path.at(times)).max() < 0.05


def test_commands_quote_what_a_shell_would_read(setting):
    read = read_setting({**setting, "exposure": "1/30"})
    assert read.commands()[0] == (
        "cep advise --linear 20 --code code.json --camera video-8bit --photons 2000 -o advice.png"
    )
    assert (
        "--trajectory trajectory.json"
        in read_setting({**setting, "motion": {"kind": "example", "name": "walk"}}).commands()[0]
    )
    off = read_setting(
        {**setting, "path_error": 0.3}
    )  # only the file of the trajectory can state it
    assert "--linear" not in " ".join(off.commands(steps=7))
    assert json.dumps(read.commands(steps=7, seed=3)).count("--steps 7 --seed 3") == 1


def test_commands_have_no_option_that_the_program_lacks(setting):
    limited = {"min_open": 2, "min_closed": 2, "open": [4, 9]}
    for line in read_setting({**setting, **limited}).commands(steps=7):
        words = shlex.split(line)
        offered = {
            option
            for parameter in command_line().commands[words[1]].params
            for option in parameter.opts
        }
        assert offered.issuperset(word for word in words if word.startswith("-"))


def test_times_of_a_fast_jump_stay_apart_in_the_address():
    t = np.array([0.0, 0.3, 0.3 + 1e-7, 0.3 + 2e-7, 0.8, 1 - 2e-7, 1 - 1e-7, 1.0])
    x = np.array([0.0, 1.0, 4.0, 4.5, 5.0, 6.0, 8.0, 9.0])
    kept = path_fields(cep.Trajectory.from_samples(np.column_stack([x, 0 * x]), t=t))
    steps = 65_535 * np.array(kept["t"])
    assert steps == pytest.approx(np.rint(steps))  # the page keeps 16 bits
    assert np.diff(steps).min() > 0.5
    assert kept["t"] == pytest.approx(t, abs=3 / 65_535)
    assert np.diff(kept["x"]) == pytest.approx(np.diff(x), abs=1e-4)
    assert (kept["t"][0], kept["t"][-1]) == (0.0, 1.0)
