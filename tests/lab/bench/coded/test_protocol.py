"""Protocols of the coded table: their files, fields and motions."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from coded_table import BENT, TINY, written

from cep.restoration.registry import find_method
from lab.bench.coded import protocol
from lab.bench.coded.protocol import (
    coded_protocol,
    drawn_motions,
    paths_from,
    paths_to,
)
from lab.rivals.inverse_filter import inverse_filter
from motdiff.trajectory import Trajectory


def test_the_papers_protocol_is_the_papers():
    """arXiv 2510.26173, section IV: 10 photos x 100 motions, 256-px crops, mirrored borders,
    inverse filter."""
    paper = coded_protocol("paper")
    assert (paper.photos, paper.motions, paper.crop_px, paper.borders) == (
        10,
        100,
        256,
        "symmetric",
    )
    assert (paper.levels, paper.restored_by) == ((None,), "psf")
    assert find_method(paper.restoration)[1] is inverse_filter
    assert paper.calibration_camera == paper.camera(None)
    assert paper.camera(None).noise_variance(0.5) == pytest.approx((1 / 255) ** 2 / 12, rel=1e-3)
    assert paper.quick == replace(paper, photos=2, motions=1, steps=paper.quick_steps)
    ours = coded_protocol("ours")
    assert (ours.quick.photons, paper.quick.photons) == ((10000.0,), ())


def test_ours_has_five_light_levels_and_hides_the_motion():
    ours = coded_protocol("ours")
    assert (ours.borders, len(ours.levels), ours.restored_by) == ("real", 5, "path")
    assert ours.calibration_camera.photons_full_scale == ours.calibration_photons in ours.levels
    for level in ours.levels:
        camera = ours.camera(level)
        assert (camera.photons_full_scale, camera.read_noise_e) == (level, 5.0)
        assert camera.black_level >= 5 * camera.read_noise_e / level


def test_a_protocol_of_ones_own_is_a_file(tmp_path):
    assert coded_protocol(written(tmp_path / "mine.toml")) == TINY
    levels = coded_protocol(written(tmp_path / "mine.toml", photons=[100, 2000.0])).levels
    assert levels == (100.0, 2000.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"photos": 0}, "photos: must be a whole number within 1..10000, got 0"),
        ({"motions": True}, "motions: must be a whole number"),
        ({"crop_px": 64}, "crop_px: must be a whole number within 80.."),
        ({"bits": 17}, "bits: must be a whole number within 1..16"),
        ({"steps": 1e5}, "steps: must be a whole number"),
        ({"seed": -1}, "seed: must be a whole number"),
        ({"borders": "open"}, "borders: must be one of real, symmetric, got 'open'"),
        ({"shakes": "hard"}, "shakes: must be one of"),
        ({"objective": "psnr"}, "objective: must be one of min-mtf"),
        ({"restoration": "magic"}, "restoration: must be one of wiener"),
        ({"restoration": 3}, "restoration: must be a text"),
        ({"restoration": "math:pi"}, "restoration: math:pi is no function"),
        (
            {"restoration": "math:no_such"},
            "restoration: math:no_such: the module math has no 'no_such'",
        ),
        ({"name": ""}, "name: must be a text"),
        (
            {"restored_by": "luck"},
            "restored_by: must be one of psf, path, estimate, blind, got 'luck'",
        ),
        ({"open_range": [6]}, "open_range: must be two numbers"),
        ({"open_range": 6}, "open_range: must be two numbers"),
        ({"open_range": [10, 6]}, "open_range: must be two numbers"),
        ({"open_range": [6, 17]}, "within 1..16 in order"),
        ({"photons": [0]}, "photons: must be a list of light levels"),
        ({"photons": 300.0}, "photons: must be a list of light levels"),
        ({"photons": ["bright"]}, "photons: must be a list of light levels"),
        ({"photons": [9, 9.0]}, "photons: every level must come once"),
        ({"quick_photons": [-1.0]}, "quick_photons: must be a list of light levels"),
        ({"calibration_photons": "bright"}, "calibration_photons: must be a number"),
        ({"read_noise_e": -1}, "read_noise_e: must be a number within 0..10000"),
        ({"codes": 3}, "field 'codes' is unknown"),
        ({"chips": None}, "field 'chips' is missing"),
    ],
)
def test_a_bad_field_is_one_line_that_names_it(tmp_path, changes, message):
    path = written(tmp_path / "mine.toml", **changes)
    with pytest.raises(ValueError, match=r"mine\.toml: ") as error:
        coded_protocol(path)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("content", [b"photos = = 3", b"\xff\xfe"])
def test_a_file_that_is_no_protocol(tmp_path, content):
    (tmp_path / "mine.toml").write_bytes(content)
    with pytest.raises(ValueError, match=r"mine\.toml: not a TOML file"):
        coded_protocol(str(tmp_path / "mine.toml"))


@pytest.mark.parametrize(
    ("name", "message"), [("theirs", "must be one of paper, ours"), ("no.toml", "no such file")]
)
def test_no_such_protocol(name, message):
    with pytest.raises(ValueError, match=message):
        coded_protocol(name)


def test_the_package_carries_its_protocols():
    for name in protocol.PROTOCOLS:
        path = Path(protocol.__file__).with_name(f"{name}.toml")
        assert tomllib.loads(path.read_text())["name"] == name


def test_every_motion_fits_the_frame(monkeypatch):
    """A motion that speeds up lies off-centre: of 60 px it may leave the frame of 64, and is drawn
    again."""
    many = replace(TINY, motions=3 * 80)
    assert max(path.frame_size() for path in drawn_motions(many)) <= 64
    monkeypatch.setattr(protocol, "PSF_PX", 1000)
    assert max(path.frame_size() for path in drawn_motions(many)) > 64


def test_motions_are_the_protocols():
    first, second, third = drawn_motions(replace(TINY, motions=3))
    np.testing.assert_array_equal(
        drawn_motions(TINY)[1].xy, second.xy
    )  # a quick run's are the full one's first
    assert not np.array_equal(drawn_motions(replace(TINY, seed=1))[0].xy, first.xy)
    assert all(20 <= path.length_px <= 60 for path in (first, second, third))
    assert (len(first.t), len(third.t)) == (
        2000,
        2,
    )  # a random walk, then a bent one, then a straight one
    (shake,) = drawn_motions(replace(TINY, shakes="boracchi-foi", motions=1))
    assert shake.length_px == pytest.approx(60)


def test_paths_are_kept_to_the_last_bit():
    paths = (drawn_motions(TINY)[0], BENT, Trajectory.straight(1 / 3, direction="known"))
    weights = (0.1, 1 / 3, 0.7)
    again, kept = paths_from(paths_to(paths, weights))
    assert kept == weights
    for path, same in zip(paths, again, strict=True):
        np.testing.assert_array_equal(path.t, same.t)
        np.testing.assert_array_equal(path.xy, same.xy)
        assert path.direction == same.direction
    assert paths_to(again, kept) == paths_to(paths, weights)


def test_fields_of_a_protocol_may_be_changed():
    changed = coded_protocol(
        "ours", ["motions=20", "photons=[10000, 1e5]", "restored_by=blind", "name='dim'"]
    )
    assert (changed.motions, changed.photons, changed.restored_by) == (20, (1e4, 1e5), "blind")
    assert changed.name == "dim"
    assert replace(
        changed, motions=9, photons=coded_protocol("ours").photons, restored_by="path", name="ours"
    ) == (coded_protocol("ours"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("codes=3", "set: must be FIELD=VALUE with one of bits, .*, got 'codes=3'"),
        ("motions", "set: motions needs a number"),
        ("motions=0", "motions: must be a whole number within 1..10000, got 0"),
        ("motions=many", "motions: must be a whole number within 1..10000, got 'many'"),
        ("photons=[1", r"set: photons needs a number, a text or a list as \[1, 2\], got '\[1'"),
        ("motions=1\nphotos=2", "set: motions needs a number"),
    ],
)
def test_a_change_that_is_none_is_one_line(change, message):
    with pytest.raises(ValueError, match=message) as error:
        coded_protocol("ours", [change])
    assert "\n" not in str(error.value)
