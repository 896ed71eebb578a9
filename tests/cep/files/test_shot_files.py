"""Records of photos: those of photos taken together state one motion, or none."""

from dataclasses import replace
from pathlib import Path

import pytest

from cep.files.shot_files import ShotRecord, stated_motion
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
