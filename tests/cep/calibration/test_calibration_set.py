"""Sets of calibration codes: playable, written whole, the same for the same seed."""

import json
import shlex

import numpy as np
import pytest

from cep.calibration.calibration_set import (
    _harmonic_mean,
    calibration_set,
    contrast_of_walks,
    ordered_walks,
    read_set,
    set_files,
)
from cep.calibration.order_codes import gray_planes
from cep.codes.sources import load_codes
from cep.files.code_files import read_code
from cep.search.limits import Limits
from hw.device import load_profile
from hw.export import EXPORTERS
from hw.program import Program
from motdiff.estimators.coded.codes import check_codes


@pytest.fixture(scope="module")
def pair():
    return calibration_set(
        2, chips=12, chip_ns=500_000, device="flc", rng=np.random.default_rng(0)
    )


def test_the_same_seed_designs_the_same_set(pair):
    again = calibration_set(
        2, chips=12, chip_ns=500_000, device="flc", rng=np.random.default_rng(0)
    )
    assert again == pair
    assert pair.sources == ("open", "code_2.json")
    assert pair.codes[1].bits != pair.codes[1].bits[::-1]
    assert {code.chip_ns for code in pair.codes} == {500_000}


def test_figures_are_of_walks_that_the_design_did_not_see(pair):
    contrast = pair.contrast
    assert 0 <= contrast.walks_told <= contrast.walks == 64
    assert 0 < contrast.worst_tenth < contrast.median
    assert pair.summary.startswith(
        "Take 2 photos of the motion, P1 with the shutter open, P2 through code_2.json."
    )


def test_another_photo_tells_more_and_the_photos_before_keep_their_codes(pair):
    shares = {}
    three = calibration_set(
        3,
        chips=12,
        chip_ns=500_000,
        device="flc",
        rng=np.random.default_rng(0),
        progress=lambda share, note: shares.setdefault(note, []).append(share),
    )
    searched = shares["searching codes"]
    assert searched == sorted(searched)
    assert 0.1 < searched[0] < 0.2
    # the search of the third code has the second half, and ends early where it has no more to try
    assert 0.55 < searched[-1] <= shares["measuring"][0] == 0.95
    assert three.codes[:2] == pair.codes
    assert three.contrast.worst_tenth > pair.contrast.worst_tenth
    assert three.contrast.walks_told >= pair.contrast.walks_told


def test_a_gray_plane_tells_no_more():
    rng = np.random.default_rng(4)
    codes = calibration_set(2, chips=16, rng=rng).codes
    walks = ordered_walks(12, rng=np.random.default_rng(5))
    contrast = contrast_of_walks(walks, np.ones(16), chips=16)
    (designed,) = _harmonic_mean(contrast.of([codes[1].array]))
    planes = [plane for count in (1, 2, 3, 4) for plane in gray_planes(count, 16)]
    assert designed > 0.8 * _harmonic_mean(contrast.of(planes)).max()  # other walks


@pytest.mark.parametrize(
    ("device", "photos", "chip_ns"),
    [("mechanical-fast", 3, 1_000_000), ("led-strobe", 2, 3_000_000)],
)
def test_the_device_can_play_every_code(device, photos, chip_ns):
    found = calibration_set(
        photos, chips=24, chip_ns=chip_ns, device=device, rng=np.random.default_rng(1)
    )
    for code in found.codes:
        assert load_profile(device).check(Program(code.bits, chip_ns=chip_ns)) == ()
    # flashes of a strobe last 33 ms at most, 24 chips of 3 ms last 72 ms: no photo can be open
    # throughout
    assert (found.sources[0] == "open") == (device != "led-strobe")


def test_a_shutter_with_one_opening_tells_the_direction():
    """An opening in the middle leaves the shortest rests, but both directions look alike."""
    calibration = calibration_set(
        2, chips=12, chip_ns=10_000_000, device="mechanical", rng=np.random.default_rng(0)
    )
    assert calibration.codes[1].bits != calibration.codes[1].bits[::-1]
    assert (
        load_profile("mechanical").check(Program(calibration.codes[1].bits, chip_ns=10_000_000))
        == ()
    )


def test_codes_that_tell_no_direction_are_refused(monkeypatch):
    limits = Limits(4, (4, 4))
    monkeypatch.setattr(
        "cep.calibration.calibration_set.allowed_limits", lambda *_arguments: (limits, None)
    )
    with pytest.raises(ValueError, match="chips: every code of 4 chips within the limits is"):
        calibration_set(2, chips=4, rng=np.random.default_rng(0))


def test_files_are_those_that_the_command_reads(pair, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    files = pair.save("a set", file_format="json")
    assert sorted(file.name for file in files) == sorted(set_files(2, "json"))
    assert sorted(item.name for item in (tmp_path / "a set").iterdir()) == sorted(
        set_files(2, "json")
    )
    stored = json.loads((tmp_path / "a set" / "set.json").read_text())
    words = shlex.split(stored["command"])
    assert words[:4] == ["cep", "calibrate", "P1", "P2"]
    sources = [words[i + 1] for i, word in enumerate(words) if word == "--code"]
    assert load_codes(sources) == pair.codes
    check_codes([code.bits for code in pair.codes])
    assert [one["bits"] for one in stored["photos"]] == [code.bits for code in pair.codes]
    assert read_set("a set") == [*pair.codes]
    assert {code.chip_ns for code in read_set("a set", chip_ns=1000)} == {1000}
    for i, code in enumerate(pair.codes, 1):
        assert read_code(f"a set/code_{i}.json").code == code
        program = EXPORTERS["json"].parse_back(
            (tmp_path / "a set" / f"code_{i}.program.json").read_text()
        )
        assert program.bits == code.bits


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"photos": 1}, "photos: must be 2 to 8, got 1"),
        ({"photos": 9}, "photos: must be 2 to 8, got 9"),
        ({"chips": 3}, "chips: must be 4 to 512, got 3"),
        ({"chips": 513}, "chips: must be 4 to 512, got 513"),
        ({"device": "mechanical"}, "chips: mechanical opens for at least 30 ms"),
        ({"device": "nothing"}, "device profile 'nothing' is unknown"),
        (
            {"device": "lc-dual-frequency", "chip_ns": 100_000},
            "lc-dual-frequency takes 500000 ns to open or close",
        ),
    ],
)
def test_what_cannot_be_designed_is_refused(options, line):
    with pytest.raises(ValueError, match=line):
        calibration_set(**{"photos": 2, "chips": 12, "rng": np.random.default_rng(0), **options})
