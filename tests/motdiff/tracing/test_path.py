"""Whether a path's order can be believed: crossings counted, plain curves not taken for
tangles."""

import numpy as np
import pytest

from motdiff.tracing.path import crossings, is_tangled
from motdiff.trajectory import Trajectory

T = np.linspace(0, 1, 400)


def lissajous(across, down, phase=0.2, size=12.0):
    """``2 a d - a - d`` crossings for coprime frequencies and a phase in general position."""
    t = 2 * np.pi * T
    return Trajectory.from_samples(size * np.c_[np.sin(across * t + phase), np.sin(down * t)])


def circle(turns, growth=0.0):
    radius = 9 * (1 + growth * T)
    angle = 2 * np.pi * turns * T
    return Trajectory.from_samples(np.c_[radius * np.cos(angle), radius * np.sin(angle)])


@pytest.mark.parametrize(("across", "down"), [(1, 2), (2, 3), (3, 4), (3, 5)])
def test_crossings_of_lissajous_figures(across, down):
    assert crossings(lissajous(across, down)) == 2 * across * down - across - down


def test_plain_curves_do_not_cross_themselves():
    plain = [circle(0.95), circle(1.3, growth=0.5), Trajectory.straight(20.0, angle_rad=0.4)]
    plain += [Trajectory.from_samples(np.c_[20 * T, 6 * np.sin(6 * T)])]
    assert [crossings(path) for path in plain] == [0] * 4
    assert [
        crossings(Trajectory.from_samples(np.c_[x, y]))
        for x, y in [([0, 5, 0], [0, 0, 0]), ([0, 0.01], [0, 0])]
    ] == [0, 0]


@pytest.mark.parametrize("turn", [0.0, 0.7, 2.2])
@pytest.mark.parametrize("radius", [3.0, 9.0, np.inf])
def test_a_retraced_strand_does_not_cross_itself(radius, turn):
    angle = 20 * T / radius if np.isfinite(radius) else 0 * T
    arc = radius * (np.exp(1j * angle) - 1) if np.isfinite(radius) else 20 * T
    way = np.r_[arc, arc[-2::-1]] * np.exp(1j * turn)
    assert crossings(Trajectory.from_samples(np.c_[way.real, way.imag])) == 0


def test_a_strand_that_wobbles_along_another_does_not_cross_it_though_their_pieces_do():
    """Run three times, 0.1 px to one side and the other every 1.5 px: as steep as 0.4, over a
    pixel hardly so."""
    along = 20 * (1 - np.abs(1 - (3 * np.linspace(0, 1, 2001)) % 2))
    aside = 0.1 * np.sin(2 * np.pi * along / 3) * np.where(np.arange(2001) // 667 == 1, -1, 1)
    assert crossings(Trajectory.from_samples(np.c_[along, aside])) == 0


def test_the_smallest_loops_count():
    assert crossings(lissajous(1, 2, size=1.0)) == 1


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_crossings_stay_under_turns_and_reversal(turn):
    path = lissajous(2, 3)
    way = np.exp(1j * turn) * (path.xy @ np.array([1, 1j]))
    turned = Trajectory.from_samples(np.c_[way.real, way.imag][::-1])
    assert crossings(turned) == crossings(path) == 7


def test_tangled_is_long_and_crossing_and_nothing_less():
    assert is_tangled(lissajous(2, 3))
    once = lissajous(1, 2)
    assert once.length_px > 2.5 * once.extent_px
    assert not is_tangled(once)
    assert not is_tangled(
        circle(1.3, growth=0.5)
    )  # 3.4 times its extent, but no strand meets another
    assert circle(1.3, growth=0.5).length_px > 3 * circle(1.3, growth=0.5).extent_px
    zigzag = np.c_[
        np.r_[0, 30, 25, 25, 20, 20, 15, 15, 10, 10], np.r_[0, 0, 1, -1, -1, 1, 1, -1, -1, 1]
    ].astype(float)
    crossing = Trajectory.from_samples(zigzag)
    assert crossings(crossing) >= 4
    assert not is_tangled(crossing)  # crossed often, but short
