"""What the studies share: photos, rows that a run goes on from, and refusals."""

import cv2
import numpy as np
import pytest

from lab.studies.inputs import (
    add_row,
    case_key,
    case_rows,
    check_version,
    finished_cases,
    finished_rows,
    kept_rows,
    large_scenes,
    photos,
    refusals,
    study_parser,
    study_version,
    textured_scene,
)
from motdiff.photo_values import to_linear

CASE = {"name": "walk/000", "seed": 1, "version": "a"}

# -- photos -----------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path):
    """A folder of a colour and a grey photo, one of them in a subfolder."""
    rng = np.random.default_rng(0)
    (tmp_path / "more").mkdir()
    for name, shape in {"b.png": (40, 50, 3), "more/a.tif": (30, 20)}.items():
        cv2.imwrite(str(tmp_path / name), rng.integers(0, 256, shape, dtype=np.uint8))
    return tmp_path


def test_a_folder_s_photos_are_linear_light_red_first(folder):
    assert [name for name, _ in photos(folder)] == ["b.png", "a.tif"]
    blue_first = cv2.imread(str(folder / "b.png"))
    np.testing.assert_array_equal(photos(folder)[0][1], to_linear(blue_first[..., ::-1] / 255))


@pytest.mark.parametrize("content", [b"", b"no photo"])
def test_a_photo_that_cannot_be_read_is_refused(folder, content):
    (folder / "more" / "broken.jpg").write_bytes(content)
    with pytest.raises(ValueError, match=r"broken\.jpg: "):
        photos(folder)


@pytest.mark.parametrize("name", ["empty", "missing"])
def test_a_folder_without_photos_is_refused(tmp_path, name):
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match=f"{name}: holds no photos"):
        photos(tmp_path / name)


def test_small_scenes_are_left_out_and_none_is_refused(folder):
    assert [name for name, _ in large_scenes(photos(folder), least_px=30)] == ["b.png"]
    with pytest.raises(ValueError, match="41 px or more"):
        large_scenes(photos(folder), least_px=41)


@pytest.mark.parametrize("side_px", [16, 128])  # within the photo, and larger than it
def test_a_textured_scene_has_twice_the_side(folder, side_px):
    scene = textured_scene(str(folder), side_px=side_px, rng=np.random.default_rng(0))
    assert scene.shape == (2 * side_px, 2 * side_px)


# -- rows -------------------------------------------------------------------------------------


def test_rows_come_back(tmp_path):
    file = tmp_path / "rows.jsonl"
    assert finished_rows(file) == []
    rows = [{"mnc": 0.5}, {"mnc": None, "name": "ü"}]
    for row in rows:
        add_row(file, row)
    assert list(kept_rows(file)) == finished_rows(file) == rows


@pytest.mark.parametrize("length", range(1, 12))
def test_a_row_that_was_cut_short_is_measured_again(tmp_path, length):
    file = tmp_path / "rows.jsonl"
    add_row(file, {"mnc": 0.5})
    with file.open("a") as stream:
        stream.write('{"mnc": 0.25}'[:length])
    add_row(file, {"mnc": 0.125})
    assert list(kept_rows(file)) == [{"mnc": 0.5}, {"mnc": 0.125}]


def test_a_case_is_known_by_its_options_in_any_order():
    assert case_key(CASE) == case_key(dict(reversed(CASE.items())))


@pytest.mark.parametrize(("option", "value"), [("seed", 2), ("version", "b"), ("name", "arc/0")])
def test_a_case_of_other_options_is_not_finished(tmp_path, option, value):
    file = tmp_path / "rows.jsonl"
    add_row(file, {"case": CASE, "mnc": 0.5})
    finished = finished_cases(file)
    assert finished[case_key(CASE)] == {"mnc": 0.5}
    assert case_key(CASE | {option: value}) not in finished


def test_without_a_file_no_case_is_finished(tmp_path):
    assert finished_cases(None) == finished_cases(tmp_path / "new.jsonl") == {}


def test_rows_that_do_not_say_their_options_are_refused(tmp_path):
    file = tmp_path / "rows.jsonl"
    add_row(file, {"name": "walk/000", "mnc": 0.5})
    with pytest.raises(ValueError, match="name a new file"):
        case_rows(file)


def test_versions_are_not_pooled():
    check_version([{"case": CASE}, {"case": CASE | {"seed": 2}}])
    check_version([{"mnc": 0.5}, {"mnc": 0.25}])  # of before versions were written
    for other in ({"case": CASE | {"version": "b"}}, {"mnc": 0.5}):
        with pytest.raises(ValueError, match="2 versions"):
            check_version([{"case": CASE}, other])


# -- refusals ---------------------------------------------------------------------------------


@pytest.mark.parametrize("error", [ValueError, FileNotFoundError])
def test_a_refusal_is_one_line_and_exit_code_2(capsys, error):
    with pytest.raises(SystemExit) as exit_status, refusals(study_parser("A study.")):
        raise error("photos: there are none")
    assert exit_status.value.code == 2
    assert capsys.readouterr().err.splitlines()[-1].endswith("error: photos: there are none")


def test_other_weights_are_another_version(tmp_path, monkeypatch):
    shipped = study_version("pairs")
    assert shipped == study_version("pairs") != study_version("order")
    (tmp_path / "weights").write_bytes(b"trained anew")
    monkeypatch.setattr("motdiff.weights.CORRECTION_WEIGHTS", tmp_path / "weights")
    assert study_version("pairs") != shipped
