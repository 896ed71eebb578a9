"""Shots of the studio: a photo is shown before it is restored, and the progress only grows."""

from types import SimpleNamespace

import numpy as np
import pytest

from cep.files.shot_files import ShotRecord
from cep.optics.code import ShutterCode
from cep.shutter import shot_folder
from cep.studio import shots
from hw.cameras.camera import Frame


@pytest.fixture
def shoot(setting, tmp_path, monkeypatch):
    """Take a photo that counts or not, without a camera; what the page is told of it."""
    values = np.random.default_rng(0).integers(0, 256, (30, 40), dtype=np.uint8)

    def shoot(*, counts):
        shot = SimpleNamespace(
            frame=Frame(values=values, bits=8, frame_id=0, camera="any"),
            light=values / 255,
            counts=counts,
            verdict="played once",
            warnings=("The light is low.",),
            record=ShotRecord(code=ShutterCode(setting["bits"]), bits=8),
        )
        monkeypatch.setattr(shots, "_taken", lambda *_: (shot, ("Chips were rounded.",)))
        told = []
        order = {"setting": setting, "path": tmp_path / "key.tif", "photo": "key"}
        about = shots.shoot(order, lambda share, note, best=None: told.append((share, note, best)))
        return about, told

    def restored(shot, progress):
        assert (tmp_path / "key_preview.jpg").exists()
        for share in (0.0, 0.5, 1.0):
            progress(share, f"restored {share:.0%}")
        return SimpleNamespace(
            image=shot.light,
            warnings=("Borders are unreliable.",),
            save=lambda path, *, bits: path.write_text(f"{bits} bits"),
        )

    monkeypatch.setattr(shot_folder, "restored_shot", restored)
    return shoot


def test_a_photo_is_shown_and_then_restored(shoot, tmp_path):
    about, told = shoot(counts=True)
    assert about["restored"]
    assert about["warnings"] == [
        "Chips were rounded.",
        "The light is low.",
        "Borders are unreliable.",
    ]
    assert (about["width"], about["height"]) == (40, 30)
    assert told[0][2]["photo"] == "key"
    assert "restored" not in told[0][2]
    assert [share for share, *_ in told] == pytest.approx([0.5, 0.5, 0.725, 0.95])
    assert (tmp_path / "key_sharp.png").read_text() == "8 bits"


def test_a_photo_that_does_not_count_is_kept_and_not_restored(shoot, tmp_path):
    about, told = shoot(counts=False)
    assert not about["counts"]
    assert "restored" not in about
    assert told == []
    assert (tmp_path / "key.tif").exists()
    assert not (tmp_path / "key_sharp.png").exists()
