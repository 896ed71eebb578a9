"""Cameras that read files: a path, and settings behind ``#``."""

from pathlib import Path

import pytest

from cep.shutter.cameras import path_and_settings


def test_settings_stand_behind_the_path():
    assert path_and_settings("a b/fall.mp4#t=1.5&gamma=2.2", t="0", gamma="srgb") == (
        Path("a b/fall.mp4"),
        {"t": "1.5", "gamma": "2.2"},
    )
    assert path_and_settings("photos", gamma="srgb") == (Path("photos"), {"gamma": "srgb"})
    assert path_and_settings("photos#gamma=", gamma="srgb")[1] == {"gamma": ""}


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("photos#t", "'t' is not known behind #; known are t= and gamma="),
        ("photos#gamma=2.2&frame=3", "'frame=3' is not known"),
        ("photos#=3", "'=3' is not known"),
        ("#t=1", "a path is needed"),
        ("", "a path is needed"),
    ],
)
def test_other_settings_are_refused(address, words):
    with pytest.raises(ValueError, match=f"camera: .*{words}"):
        path_and_settings(address, t="0", gamma="srgb")
