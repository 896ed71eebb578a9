"""Values of photos: exact round trips to display and back, luminance, clipping, brightness."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motdiff.photo_values import clipped_mask, exposure_gain, luminance, to_display, to_linear


@given(value=st.floats(-1.5, 1.5), gamma=st.none() | st.floats(0.3, 4))
def test_gamma_round_trips_and_is_odd(value: float, gamma: float | None) -> None:
    assert to_linear(to_display(value, gamma=gamma), gamma=gamma) == pytest.approx(
        value, abs=1e-12
    )
    assert to_display(-value, gamma=gamma) == pytest.approx(-to_display(value, gamma=gamma))


def test_srgb_known_values_and_continuity() -> None:
    assert to_display([0.0, 0.18, 1.0]) == pytest.approx([0, 0.46135613, 1], abs=1e-7)
    assert to_linear(128 / 255) == pytest.approx(0.21586050, abs=1e-8)
    knee = np.array([0.0031308 - 1e-9, 0.0031308 + 1e-9])
    assert np.diff(to_display(knee)) == pytest.approx(0, abs=1e-6)
    assert (np.diff(to_display(np.linspace(0, 1, 1000))) > 0).all()
    assert to_display(0.25, gamma=2.0) == pytest.approx(0.5)
    with pytest.raises(ValueError, match="gamma"):
        to_display(0.5, gamma=0)


def test_luminance_and_clipping() -> None:
    photo = np.zeros((2, 2, 3))
    photo[0, 0] = [1.0, 0.2, 0.3]
    assert luminance(photo)[0, 0] == pytest.approx(0.5)
    np.testing.assert_array_equal(clipped_mask(photo), [[True, False], [False, False]])


def test_a_dim_photo_is_brightened_as_far_as_full_scale_allows():
    dim = np.linspace(-0.01, 0.1, 12).reshape(3, 4)  # a raw file's noise may lie below 0
    assert exposure_gain(dim) == pytest.approx(9.5)
    for level in (0.9, 0.6, 0.5, 0.1, 1e-3):
        assert 0.95 / 1.5 <= exposure_gain(level * dim / dim.max()) * level <= 0.95 + 1e-12
    assert exposure_gain(dim / 16) == pytest.approx(16 * exposure_gain(dim))
    assert exposure_gain(10 * dim) == 1
    np.testing.assert_array_equal(exposure_gain(0 * dim) * 0 * dim, 0)
