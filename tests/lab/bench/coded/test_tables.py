"""What the coded table sums up, and its picture."""

import csv
import io
from dataclasses import replace

import numpy as np
import pytest
from coded_table import (
    MADE,
    TINY,
    shot,
    shown,
)

from lab.bench.coded.designs import DESIGNS
from lab.bench.coded.report import coded_report
from lab.bench.coded.run import CodedTable, measure_coded
from lab.bench.coded.stages import take_photo
from lab.bench.coded.tables import coded_tables, harmed, shots_csv
from lab.jobs.engine import Engine, Outcome
from motdiff.trajectory import Trajectory


def table_of(shots, **changes):
    return CodedTable(replace(TINY, **changes), tuple(shots), {}, Outcome((), 0, ()))


def test_harm_is_counted_in_the_worse_direction():
    gains = [(9.0, 9.5), (9.0, 10.5), (11.0, 3.0), (10.0, 10.0)]
    shots = [shot("both-ways", "a", i, 30.0, gain) for i, gain in enumerate(gains)]
    shots += [shot("open", "a", i, 20.0) for i in range(3)]
    assert harmed(table_of(shots), "both-ways") == (
        2,
        3,
    )  # the fourth has nothing to be compared with
    assert harmed(table_of(shots), "open") == (0, 3)
    assert harmed(table_of(shots), "one-way") == (0, 0)


def test_differences_are_ours_less_theirs_and_count_photos_and_motions():
    shots = [shot("open", photo, i, 20.0 + i) for photo in "abcdef" for i in range(8)]
    shots += [
        shot("both-ways", photo, i, 25.0 + i + ord(photo) % 2)
        for photo in "abcdef"
        for i in range(8)
    ]
    # the protocol asks for more photos than there were
    quality, less, gain = coded_tables(table_of(shots, photos=100, motions=8))
    ours = DESIGNS["both-ways"].label
    plain = DESIGNS["open"].label
    assert list(less.rows) == [plain]
    (psnr, ssim) = less.rows[plain]
    assert psnr.summary.mean == pytest.approx(5.5)
    assert ssim.summary.mean == 0
    assert quality.rows[ours][0].bold
    entries = (quality.rows[ours][0], psnr)
    assert {entry.interval.clusters for entry in entries} == {6}
    assert (
        entries[0].interval.high - entries[0].interval.low > 4
    )  # motions differ by 2.4 dB, photos by half one
    assert gain.rows[ours][1].interval is None
    few = [one for one in shots if one.motion < 2]
    assert coded_tables(table_of(few))[0].rows[ours][0].interval.clusters == 2


@pytest.mark.parametrize("photons", [(), (1e4,)])
def test_rows_that_know_the_truth_or_pay_no_light_are_no_rivals(photons):
    best = {
        "oracle": 40.0,
        "parametric-oracle": 39.0,
        "snapshot": 38.0,
        "strobe": 37.0,
        "both-ways": 30.0,
        "open": 20.0,
    }
    level = photons[0] if photons else None
    shots = [
        shot(name, p, i, psnr + i, photons=level)
        for name, psnr in best.items()
        for p in "abc"
        for i in range(3)
    ]
    rivals, apart, *_ = coded_tables(table_of(shots, photons=photons))
    limits = {"oracle", "parametric-oracle"} | (set() if photons else {"snapshot", "strobe"})
    assert set(apart.rows) == {DESIGNS[name].label for name in limits}
    assert set(rivals.rows) == {DESIGNS[name].label for name in set(best) - limits}
    assert not any(entry.bold for entries in apart.rows.values() for entry in entries)
    leader = "snapshot" if photons else "both-ways"
    assert [label for label, entries in rivals.rows.items() if entries[0].bold] == [
        DESIGNS[leader].label
    ]


def test_a_line_of_zeros_is_an_infinite_noise_gain_and_medians_bear_it():
    straight = Trajectory.straight(30.0)
    figures = take_photo(**shown(straight, bits="1" * 16))
    assert figures["noise_gain_db"] == figures["reversed_noise_gain_db"] == np.inf
    assert np.isfinite(take_photo(**shown(straight, bits="1110100110101000"))["noise_gain_db"])
    gains = [(np.inf, np.inf), (20.0, 21.0), (22.0, 22.0)]
    shots = [shot("open", p, i, 20.0, gain) for i, gain in enumerate(gains) for p in "ab"]
    gain = coded_tables(table_of(shots))[-1]
    assert gain.lines()[0][1:3] == ("22.00", "22.00")
    # and how many have a zero is told, where some have
    assert gain.lines()[0][gain.head.index("zeros, share")] == "0.33"
    sound = [one for one in shots if one.motion]
    assert "zeros, share" not in coded_tables(table_of(sound))[-1].head


def test_a_stopped_run_has_a_table_of_what_is_there(tmp_path):
    """The reference was reached at the first light level only."""
    dim = 300.0
    bright = 1e4
    shots = [
        shot("open", "a", i, 20.0, photons=level) for level in (dim, bright) for i in range(2)
    ]
    shots += [shot("both-ways", "a", i, 21.0, photons=dim) for i in range(2)]
    titles = [table.title for table in coded_tables(table_of(shots, photons=(dim, bright)))]
    assert titles == [
        "Coded exposure, tiny, 300 photo-electrons",
        f"{DESIGNS['both-ways'].label} less each other row, 300 photo-electrons",
        "Noise gain of the codes along the true motion, 300 photo-electrons",
        "Coded exposure, tiny, 10,000 photo-electrons",
        "Noise gain of the codes along the true motion, 10,000 photo-electrons",
    ]


def test_every_photo_is_in_the_csv():
    shots = [shot("open", "a", 0, 20.25, (np.inf, 10.0)), shot("dnf", "a", 1, 21.0, photons=300.0)]
    first, second = csv.DictReader(io.StringIO(shots_csv(table_of(shots))))
    assert (first["design"], first["photons"], float(first["psnr_db"])) == ("open", "", 20.25)
    assert float(first["noise_gain_db"]) == np.inf
    assert (second["motion"], second["photons"], second["bits"]) == ("1", "300", "10")


def test_the_picture_needs_no_level_that_was_not_reached(tmp_path, photos):
    dim = replace(TINY, photons=(300.0, 1e4), motions=1)
    measured = measure_coded(dim, photos, engine=Engine(tmp_path / "cells"), designs=("open",))
    reached = replace(measured, shots=tuple(one for one in measured.shots if one.photons == 300.0))
    assert len(reached.shots) == 1
    report = coded_report(reached, MADE)
    assert report.figure is not None
    assert "in neither direction" not in report.texts[".md"]
