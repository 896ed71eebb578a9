"""Sums and layout on rows written by hand."""

import csv
import io
import math

import cv2
import numpy as np
import pytest

from motdiff.evaluation.floors import delta, gaussian
from motdiff.evaluation.measure import FIGURES, Row
from motdiff.evaluation.pictures import contact_sheet, reliability_plot
from motdiff.evaluation.sets import Case
from motdiff.evaluation.tables import (
    Bin,
    Spread,
    calibration,
    calibration_text,
    csv_line,
    summaries_csv,
    summary_text,
    summed_up,
)

ROWS = [
    Row("a", "0", "delta", mnc=0.4, mnc_subpixel=0.5),
    Row("a", "0", "pmp", mnc=0.6, mnc_subpixel=0.7, psnr_db=20.0, confidence=0.9, cpu_s=4.0),
    Row("a", "1", "delta", mnc=0.2, mnc_subpixel=0.3),
    Row("a", "1", "pmp", mnc=0.8, mnc_subpixel=0.9, psnr_db=24.0, confidence=0.7, cpu_s=6.0),
    Row("b", "0", "pmp", cpu_s=100.0, failure="photo: is constant"),
    Row("a", "2", "pmp", cpu_s=100.0, failure="photo: is constant"),
]


def test_means_spreads_and_worst_cases():
    assert Spread.of([1.0, 3.0, math.nan, 8.0]) == Spread(4.0, pytest.approx(math.sqrt(26 / 3)), 1.0)
    assert all(math.isnan(value) for value in (Spread.of([math.nan]).mean, Spread.of([]).min))


def test_rows_are_summed_by_set_and_method_in_order():
    summaries = summed_up(ROWS)
    assert [(s.set, s.method, s.n, s.failed) for s in summaries] == [
        ("a", "delta", 2, 0),
        ("a", "pmp", 3, 1),
        ("b", "pmp", 1, 1),
    ]
    pmp = summaries[1].figures
    assert tuple(pmp) == FIGURES
    assert (pmp["mnc"].mean, pmp["mnc"].sd, pmp["mnc"].min) == pytest.approx((0.7, 0.1, 0.6))
    assert (pmp["psnr_db"].mean, pmp["psnr_db"].sd, pmp["psnr_db"].min) == pytest.approx((22, 2, 20))
    assert pmp["cpu_s"].mean == pytest.approx(5)  # a failure's seconds say nothing of an estimate's
    assert math.isnan(summaries[2].figures["mnc"].mean)


def test_sets_that_come_in_turns_stay_together():
    mixed = [Row("a", "0", "x"), Row("b", "0", "x"), Row("a", "0", "y")]
    assert [(s.set, s.method) for s in summed_up(mixed)] == [("a", "x"), ("a", "y"), ("b", "x")]


def test_text_is_aligned_and_shows_what_was_not_measured():
    first, second = summary_text(summed_up(ROWS)).split("\n\n")
    lines = first.splitlines()
    assert len({len(line) for line in lines}) == 1
    cells = [line.split() for line in lines]
    assert cells[0][0] == "a"
    assert cells[1][:7] == ["delta", "2", "0", "0.300", "0.400", "0.100", "0.300"]
    assert cells[2] == (
        ["pmp", "3", "1", "0.700", "0.800", "0.100", "0.700", "-", "-", "22.00", "2.00", "20.00", "-", "0.80", "5.0"]
    )
    assert second.splitlines()[1].split() == ["pmp", "1", "1", *"-" * 12]


def test_csv_has_every_figure_and_no_nan():
    rows = list(csv.DictReader(io.StringIO(summaries_csv(summed_up(ROWS)))))
    assert len(rows[0]) == 4 + 3 * len(FIGURES)
    assert rows[1]["mnc_subpixel_mean"] == "0.8"
    assert rows[1]["failed"] == "1"
    assert rows[0]["cpu_s_min"] == ""
    assert csv_line(["a,b", 1, math.nan, 0.123456789]) == '"a,b",1,,0.123457\n'


def said(confidence, mnc, method="pmp"):
    return Row("a", "0", method, mnc_subpixel=mnc, confidence=confidence)


def test_calibration_counts_in_bins():
    rows = [said(0.1, 0.8), said(0.3, 0.2), said(0.5, 0.69), said(0.6, 0.7), said(1.0, 0.9), said(0.96, 0.1)]
    found = calibration([*rows, ROWS[0], ROWS[4], said(0.9, 0.9, "other")], edges=(0, 0.5, 0.95, 1))
    assert found == [
        Bin("pmp", 0, 0.5, 2, pytest.approx(0.2), 0.5),
        Bin("pmp", 0.5, 0.95, 2, pytest.approx(0.55), 0.5),
        Bin("pmp", 0.95, 1, 2, pytest.approx(0.98), 0.5),
        Bin("other", 0.5, 0.95, 1, pytest.approx(0.9), 1.0),
    ]
    assert sum(b.n for b in calibration(rows)) == len(rows)
    assert calibration([ROWS[0]]) == []
    lines = calibration_text(found).splitlines()
    assert lines[1].split() == ["pmp", "0.00", "0.50", "2", "0.20", "0.50"]
    assert len({len(line) for line in lines}) == 1


@pytest.mark.parametrize("edges", [(0.5,), (0, 0.5, 0.5)])
def test_bins_must_increase(edges):
    with pytest.raises(ValueError, match="edges"):
        calibration([], edges=edges)


def opened(png):
    return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)


def test_pictures_are_drawn():
    bins = [Bin("pmp", 0, 0.5, 3, 0.3, 0.0), Bin("pmp", 0.5, 1, 4, 0.8, 1.0)]
    assert np.ptp(opened(reliability_plot(bins))) > 0
    cases = [Case("grey", np.full((20, 30), 0.5), gaussian()), Case("colour", np.zeros((20, 30, 3)), delta())]
    kernels = {"pmp": {"grey": gaussian(2.0, 90), "colour": delta(15)}, "lost": {"grey": delta()}}
    small, large = opened(contact_sheet(cases[:1], kernels)), opened(contact_sheet(cases, kernels))
    assert large.shape[0] > small.shape[0]
    assert large.shape[1] == small.shape[1]
