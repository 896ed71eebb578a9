"""Studies of many photos go on from their files, and take no rows of other options for theirs."""

import cv2
import numpy as np
import pytest

from lab.studies import drawn_path, photo_faults, photo_path
from lab.studies.goldens.inputs import recorded_shake
from lab.studies.inputs import add_row, finished_rows

FIGURES = {
    photo_path: lambda shot, _estimator: {"name": shot.name, "kind": shot.kind},
    drawn_path: lambda shot, _estimator, _denoiser, draws: {"name": shot.name, "draws": draws},
    photo_faults: lambda photo, _estimator: {
        "name": photo.name,
        "mnc": 0.5,
        "confidence": 0.5,
        "wall_s": 1.0,
    },
}


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Run a study on one photo, without its estimator; returns the number of new rows."""
    levels = np.random.default_rng(0).integers(0, 256, (420, 420), dtype=np.uint8)
    for folder in ("photos", "others"):
        (tmp_path / folder).mkdir()
        cv2.imwrite(str(tmp_path / folder / "a.png"), levels)
    (tmp_path / "gyro.csv").write_text(recorded_shake())
    file = tmp_path / "rows.jsonl"

    def run_study(study, *options, version="a", photos="photos"):
        monkeypatch.setattr(photo_faults, "_MOMENTS", 5)  # for speed
        monkeypatch.setattr(study, "MotDiffEstimator", object)
        monkeypatch.setattr(study, "study_version", lambda _study: version)
        monkeypatch.setattr(study, "figures", FIGURES[study])
        words = [] if study is photo_faults else ["rows"]
        words += [str(file), "--photos", str(tmp_path / photos), "--count", "1", *options]
        monkeypatch.setattr("sys.argv", ["study", *words, "--gyro", str(tmp_path / "gyro.csv")])
        before = len(finished_rows(file))
        study.main()
        return len(finished_rows(file)) - before

    return run_study


@pytest.mark.parametrize("study", FIGURES, ids=lambda study: study.__name__)
def test_only_rows_of_the_same_options_are_finished(run, study, capsys):
    count = run(study)
    assert count >= 1
    assert run(study) == 0
    assert run(study, "--seed", "1") == count
    assert run(study, version="b") == count
    assert run(study, photos="others") == count
    assert run(study, "--seed", "1") == 0
    if study is photo_faults:  # it prints the table of its own rows
        assert "| all | 1 |" in capsys.readouterr().out.splitlines()[-1]


def test_a_table_of_several_versions_is_refused(tmp_path, monkeypatch, capsys):
    for version in "ab":
        row = {"case": {"name": "0", "version": version}, "name": "0"}
        add_row(tmp_path / f"{version}.jsonl", row)
    files = [str(tmp_path / f"{version}.jsonl") for version in "ab"]
    for study in (photo_path, drawn_path):
        monkeypatch.setattr("sys.argv", ["study", "table", *files])
        with pytest.raises(SystemExit) as exit_status:
            study.main()
        assert exit_status.value.code == 2
        assert "2 versions" in capsys.readouterr().err


def test_a_table_of_photos_of_several_noises_is_refused(tmp_path, monkeypatch, capsys):
    for noise in (0.005, 0.01):
        row = {"case": {"name": "0", "version": "a", "noise": noise}, "name": "0"}
        add_row(tmp_path / "rows.jsonl", row)
    monkeypatch.setattr("sys.argv", ["study", "table", str(tmp_path / "rows.jsonl")])
    with pytest.raises(SystemExit) as exit_status:
        photo_path.main()
    assert exit_status.value.code == 2
    assert "table: rows of one --noise at a time, found several" in capsys.readouterr().err
