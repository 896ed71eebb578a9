"""The built-in devices: each loads, plays what it should and names everything it cannot."""

import re
from pathlib import Path

import pytest

from hw.device import load_profile, profile_names
from hw.program import Program

RASKAR = "1010000111000001010000110011110111010111001001100111"
US = 1_000
MS = 1_000_000

ALTERNATING_5000 = "10" * 5000

CASES = {
    # name: (plays, does not play, number of limits that breaks)
    "cxp-avr": ((RASKAR, 200 * US), (RASKAR, 49_900), 2),
    "cxp-rp2040": ((RASKAR + "0" * 235, 1 * US), (RASKAR + "0" * 236, 999), 3),
    "dmd-dlpc900": ((RASKAR, 105 * US), (RASKAR, 104_500), 3),
    "flc": ((RASKAR, 200 * US), None, 0),
    "flir-mode5": (("10" * 4095, 50 * US), ("10" * 4096, 50 * US), 1),
    "generic": ((ALTERNATING_5000, 1), None, 0),
    "lc-dual-frequency": ((RASKAR, 2 * MS), None, 0),
    "led-strobe": ((RASKAR, 200 * US), ("1" * 4 + "01", 10 * MS), 1),
    "mechanical": (("1011", 200 * MS), (RASKAR, 20 * MS), 2),
    "mechanical-fast": ((RASKAR, 20 * MS), (RASKAR, 200 * US), 1),
    "pulse-pal": ((RASKAR, 150 * US), (ALTERNATING_5000, 60 * US), 3),
    "sony-pregius": ((RASKAR, 150 * US), (RASKAR, 100 * US), 1),
}


def test_every_profile_has_its_case():
    assert set(CASES) == set(profile_names())


@pytest.mark.parametrize("name", CASES)
def test_profile_plays_and_refuses(name):
    plays, refuses, count = CASES[name]
    profile = load_profile(name)
    assert profile.name == name
    assert len(profile.description) > 20
    assert profile.check(Program(*plays)) == ()
    if refuses is None:  # optics without limits of their own: only how fast they open is known
        assert profile.rise_ns or name == "generic"
    else:
        assert len(profile.check(Program(*refuses))) == count


def test_a_mechanical_shutter_names_every_limit_of_a_millisecond_code():
    slow = load_profile("mechanical")
    assert slow.check(Program(RASKAR, 200 * US)) == (
        "mechanical: shortest opening is 200 us; at least 30 ms",
        "mechanical: openings come at up to 2500 Hz; at most 5 Hz",
    )
    assert slow.check(Program(RASKAR, 20 * MS)) == (
        "mechanical: shortest opening is 20 ms; at least 30 ms",
        "mechanical: openings come at up to 25 Hz; at most 5 Hz",
    )
    assert slow.check(Program(RASKAR, 100 * MS)) == ()
    assert load_profile("mechanical-fast").check(Program(RASKAR, 200 * US)) == (
        "mechanical-fast: openings come at up to 2500 Hz; at most 100 Hz",
    )


def test_a_pregius_sensor_needs_gaps_and_not_only_exposures():
    pregius = load_profile("sony-pregius")
    assert pregius.check(Program("1110111", 50 * US)) == (
        "sony-pregius: shortest gap between openings is 50 us; the dead time is 150 us",
    )
    assert pregius.check(Program("1110001", 50 * US)) == ()


def test_the_document_names_every_profile():
    page = (Path(__file__).resolve().parents[2] / "docs" / "hardware.md").read_text(
        encoding="utf-8"
    )
    table = page.partition("## Names of devices")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| (`.*?) \|", table, re.MULTILINE)
    named = [name for row in rows for name in re.findall(r"`([\w-]+)`", row)]
    assert sorted(named) == sorted(profile_names())
