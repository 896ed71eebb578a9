"""Choice of a camera by its address: a line for each way in which it can fail."""

import pytest

from hw.cameras.camera import ConnectedCamera, choose_camera

TWINS = [
    ConnectedCamera("Acme Fast", ("0001", "10.0.0.5", "Fast")),
    ConnectedCamera("Acme Fast", ("0001", "10.0.0.6", "Fast")),
    ConnectedCamera("Acme Slow", ("0002", "10.0.0.7", "Slow")),
]


def test_each_name_of_a_camera_chooses_it():
    assert [choose_camera("aravis", name, TWINS) for name in TWINS[2].names] == [2, 2, 2]
    assert choose_camera("aravis", "", TWINS[:1]) == 0


def test_cameras_of_one_name_are_told_apart_by_another_of_theirs():
    line = (
        r"^aravis: 2 cameras fit: Acme Fast 0001, Acme Fast 0001; name one, as aravis:10\.0\.0\.5$"
    )
    with pytest.raises(ValueError, match=line):
        choose_camera("aravis", "0001", TWINS)


def test_an_address_of_no_camera_lists_those_seen():
    with pytest.raises(
        ValueError, match=r"^aravis:9: there is no such camera; seen: Acme Fast 00"
    ):
        choose_camera("aravis", "9", TWINS)
    with pytest.raises(ValueError, match=r"^aravis: no camera is seen: check power"):
        choose_camera("aravis", "9", [])


def test_names_from_a_camera_are_printed_safely():
    with pytest.raises(ValueError, match=r"there is no such") as error:
        choose_camera("aravis", "9", [ConnectedCamera("Evil\x1b[2J\n", ("1" * 200,))])
    assert str(error.value).isprintable()
    assert len(str(error.value)) < 160
