"""Records of photos: those of photos taken together state one motion, or none; damaged ones are
refused."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from cep.files.images import write_image
from cep.files.shot_files import ShotRecord, read_light, record_beside, stated_motion
from cep.optics.code import ShutterCode
from motdiff.trajectory import Trajectory

PHOTOS = (Path("a.tif"), Path("b.tif"))
RECORD = ShotRecord(code=ShutterCode("1101"), bits=8)
LINE = Trajectory.straight(12.0)


@pytest.mark.parametrize("second", [None, RECORD, replace(RECORD, trajectory=LINE)])
def test_one_record_with_a_motion_is_enough(second):
    assert stated_motion(PHOTOS, [replace(RECORD, trajectory=LINE), second]) is LINE


def test_without_a_motion_there_is_none():
    assert stated_motion(PHOTOS, [None, RECORD]) is None


def test_two_motions_are_refused():
    other = replace(RECORD, trajectory=LINE.scaled(1.1))
    with pytest.raises(ValueError, match=r"^b.tif: its record has another motion than .* a.tif"):
        stated_motion(PHOTOS, [replace(RECORD, trajectory=LINE), other])


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("code", {"bits": "1101"}),
        ("code", {"bits": "1101", "chip_ns": 0}),
        ("bits", 0),
        ("bits", 17),
        ("black_level", -1),
        ("black_level", 255),
        ("bayer", "xyzw"),
        ("gamma", "2.2"),
        ("problems", "blurred"),
    ],
)
def test_a_damaged_record_is_refused_by_its_name(field, value, tmp_path):
    path = tmp_path / "photo.json"
    path.write_text(json.dumps(RECORD.to_dict()))
    assert record_beside(tmp_path / "photo.tif") == RECORD
    path.write_text(json.dumps({**RECORD.to_dict(), field: value}))
    with pytest.raises(ValueError, match=r"photo\.json: .") as refused:
        record_beside(tmp_path / "photo.tif")
    assert field in str(refused.value)


@pytest.mark.parametrize("bayer", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_a_mosaic_of_one_colour_becomes_that_colour(bayer):
    colour = {"R": 40, "G": 120, "B": 200}
    cell = np.reshape([colour[letter] for letter in bayer], (2, 2)).astype(np.uint8)
    light = replace(RECORD, bayer=bayer).light(np.tile(cell, (4, 5)))
    assert light.shape == (8, 10, 3)
    np.testing.assert_allclose(light, np.broadcast_to([40, 120, 200], light.shape) / 255)


def test_a_photo_is_read_as_its_record_says_and_without_one_as_asked(tmp_path):
    photo = tmp_path / "photo.png"
    write_image(photo, np.full((40, 40), 0.5))
    values = cv2.imread(str(photo), cv2.IMREAD_GRAYSCALE)[0, 0]
    assert read_light(photo, gamma=1.0).pixels[0, 0] == pytest.approx(values / 255)
    record = replace(RECORD, black_level=15, gamma="linear")
    (tmp_path / "photo.json").write_text(json.dumps(record.to_dict()))
    assert read_light(photo, gamma=1.0).pixels[0, 0] == pytest.approx((values - 15) / (255 - 15))
