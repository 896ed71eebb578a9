"""MTFs of codes from Python: what is measured, what is checked before any work."""

import numpy as np
import pytest

from cep.optics.code import ShutterCode
from cep.optics.exposure import mtf
from cep.proofs.measure import measure_worst
from cep.proofs.mtf_curves import OPEN, compare_mtfs, main_axis, mtf_curve
from motdiff.trajectory import Trajectory

PATH = Trajectory.straight(8.0)
CODES = {"ours": ShutterCode("11010011"), "theirs": ShutterCode("1011")}


def test_the_open_shutter_comes_first_and_every_row_has_its_curve_and_figures():
    found = compare_mtfs(PATH, CODES, figures={"light": lambda _path, code: code.duty})
    assert list(found) == [OPEN, "ours", "theirs"]
    for row in found.values():
        assert row.mtf == pytest.approx(
            mtf(PATH, row.code, row.freq_cy_px, np.zeros_like(row.freq_cy_px))
        )
        assert row.metrics == measure_worst(PATH, row.code or ShutterCode("1"))
        light = (row.code or ShutterCode("1")).duty
        assert row.figures == {"light": (light, light)}  # the direction is unknown
    assert found["ours"].to_dict()["bits"] == "11010011"


def test_codes_are_checked_before_outputs_and_outputs_before_the_work(monkeypatch):
    def claimed():
        raise RuntimeError("outputs")

    monkeypatch.setattr("cep.proofs.mtf_curves.own_figures", None)  # not called
    with pytest.raises(ValueError, match="at most 4 can be resolved"):
        compare_mtfs(Trajectory.straight(1.0), CODES, on_checked=claimed)
    with pytest.raises(RuntimeError, match="outputs"):
        compare_mtfs(PATH, CODES, on_checked=claimed)


def test_the_mtf_of_a_box_is_a_sinc():
    freq_cy_px, mtf = mtf_curve(Trajectory.straight(12.0, angle_rad=0.3), None)
    np.testing.assert_allclose(mtf, np.abs(np.sinc(12 * freq_cy_px)), atol=1e-12)
    coded = mtf_curve(Trajectory.straight(12.0), ShutterCode("1010"))[1]
    assert coded[0] == pytest.approx(0.5)


def test_the_main_axis_points_along_the_motion():
    for angle in (0.0, 0.4, 2.0):
        axis = main_axis(Trajectory.straight(10.0, angle_rad=angle))
        assert abs(axis @ [np.cos(angle), np.sin(angle)]) == pytest.approx(1)
