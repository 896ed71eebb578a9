"""Photos of one motion, taken through known codes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from skimage import data

from motdiff.path_psfs import slice_psfs
from motdiff.photo_values import to_linear
from motdiff.simulate import photograph
from motdiff.trajectory import Trajectory

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Shots:
    """Photos with the exact light-true PSFs that blurred them."""

    codes: tuple[str, ...]
    psfs: tuple[FloatArray, ...]
    photos: tuple[FloatArray, ...]


def gray_codes(chips: int, bits: int) -> tuple[str, ...]:
    """Bit planes of the Gray numbers of ``2**bits`` equal times, the largest first."""
    number = np.arange(chips) * 2**bits // chips
    number ^= number >> 1
    return tuple(
        "".join(str(bit) for bit in number >> place & 1) for place in reversed(range(bits))
    )


OPEN_AND_GRAY = ("1" * 52, *gray_codes(52, 3))


def coded_psf(
    path: Trajectory, code: str, *, shift_px: Sequence[float] = (0, 0), size: int = 65
) -> FloatArray:
    """PSF of the light that the open chips let pass, exact on the pixel grid."""
    chips = slice_psfs(
        path.t, path.xy + np.asarray(shift_px), np.linspace(0, 1, len(code) + 1), size
    )
    psf: FloatArray = chips[np.array(list(code)) == "1"].sum(axis=0)
    return psf


def shots(
    path: Trajectory,
    codes: Sequence[str] = OPEN_AND_GRAY,
    *,
    side_px: int = 216,
    read_sigma: float = 0.005,
    shifts_px: Sequence[Sequence[float]] | None = None,
    gains: Sequence[float] | None = None,
    seed: int = 0,
) -> Shots:
    """Photos of a cameraman's head and camera, whose noise is not clipped."""
    rng = np.random.default_rng(seed)
    frame = 65
    scene = to_linear(data.camera() / 255.0)[80:, 130:][
        : side_px + frame - 1, : side_px + frame - 1
    ]
    shifts = [(0, 0)] * len(codes) if shifts_px is None else shifts_px
    psfs = [
        coded_psf(path, code, shift_px=shift, size=frame)
        for code, shift in zip(codes, shifts, strict=True)
    ]
    photos = [
        gain * photograph(scene, psf, rng=rng, read_sigma=read_sigma, record=np.asarray)
        for psf, gain in zip(psfs, [1.0] * len(codes) if gains is None else gains, strict=True)
    ]
    return Shots(tuple(codes), tuple(psfs), tuple(photos))


@pytest.fixture(scope="session", name="gray_codes")
def gray_codes_fixture():
    return gray_codes


@pytest.fixture(scope="session", name="coded_psf")
def coded_psf_fixture():
    return coded_psf


@pytest.fixture(scope="session", name="shots")
def shots_fixture():
    return shots
