"""Bank of random motions as training tensors: PSFs, HR maps and dwell."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from motdiff.files.gyro_tables import read_gyro
from motdiff.gyro import GyroTrace
from motdiff.motions import boracchi_foi, quadratic, random_gyro_motion, random_straight
from motdiff.processes import end_with_parent
from motdiff.psf_frame import MAP_CENTRE, MAP_PITCH, MAP_PX, PSF_PX
from motdiff.trajectory import Trajectory

# in the order of the shares: another one would change which motions a seed draws
_KINDS = ("boracchi_foi", "boracchi_foi_short", "gyro", "straight", "quadratic")
_TRIES = 100
_CHUNK = 200
_TIMES = 6000  # some 20 for each map pixel of a long path

_Row = tuple[NDArray[np.float16], NDArray[np.int32], NDArray[np.float16]]
"""PSF, path pixels and dwell of a motion."""


@dataclass(frozen=True)
class MotionMix:
    """Distribution of random motions.

    Attributes
    ----------
    boracchi_foi : float
        Share of Boracchi-Foi paths of full length ``max_length_px``, as the paper's.
    boracchi_foi_short : float
        Share of those with a length uniform over the range.
    gyro : float
        Share of real hand shake; needs ``gyro_trace``.
    straight, quadratic : float
        Shares of uniform straight motions, and of motions of constant acceleration.
    min_length_px, max_length_px : float, px
    min_extent_px, max_extent_px : float, px
        Range of the larger side of a gyro-driven path.
    exposure_s : (float, float), seconds
        Range of exposures of gyro-driven motion.
    gyro_trace : str
        Gyroscope recording, see :func:`motdiff.files.gyro_tables.read_gyro`; "" for none.
    """

    boracchi_foi: float = 1.0
    boracchi_foi_short: float = 0.0
    gyro: float = 0.0
    straight: float = 0.0
    quadratic: float = 0.0
    min_length_px: float = 4.0
    max_length_px: float = 60.0
    min_extent_px: float = 8.0
    max_extent_px: float = 40.0
    exposure_s: tuple[float, float] = (0.05, 0.5)
    gyro_trace: str = ""

    def __post_init__(self) -> None:
        shares = self.shares
        if min(shares) < 0 or sum(shares) <= 0:
            raise ValueError(
                f"motions: the shares must be non-negative and not all zero, got {shares}"
            )
        if self.gyro > 0 and not self.gyro_trace:
            raise ValueError("gyro_trace: motions.gyro > 0 needs a gyroscope recording")
        if not 0 < self.min_length_px <= self.max_length_px:
            raise ValueError(
                "min_length_px: must be positive and at most max_length_px, got"
                f" {self.min_length_px} and {self.max_length_px}"
            )

    @property
    def shares(self) -> tuple[float, ...]:
        """Weights of the five kinds."""
        return tuple(getattr(self, kind) for kind in _KINDS)


@dataclass(frozen=True)
class MotionBank:
    """Motions as tensors, on any device.

    Attributes
    ----------
    psfs : (N, 64, 64) float16
        Each sums to 1 (in float64, before rounding), zero displacement at index 32.
    pixels : (P,) int32
        Flat indices of the path pixels of the HR maps (256 x 256), one motion after another.
    dwell : (P,) float16
        Time spent at each path pixel, relative to the motion's mean.
    starts : (N + 1,) int64
        Where each motion begins within ``pixels``.
    """

    psfs: Tensor
    pixels: Tensor
    dwell: Tensor
    starts: Tensor

    def __len__(self) -> int:
        return len(self.psfs)

    def to(self, device: str | torch.device) -> MotionBank:
        """Copy to a device."""
        return MotionBank(
            *(tensor.to(device) for tensor in (self.psfs, self.pixels, self.dwell, self.starts))
        )

    def targets(self, index: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """PSFs (B, 64, 64), x0 of 0 and 1, and dwell, both (B, 1, 256, 256), of motions (B,)."""
        start = self.starts[index]
        count = self.starts[index + 1] - start
        sample = torch.repeat_interleave(torch.arange(len(index), device=index.device), count)
        offset = torch.repeat_interleave(count.cumsum(0) - count, count)
        within = torch.arange(int(count.sum()), device=index.device) - offset
        source = start[sample] + within
        pixel = sample * MAP_PX**2 + self.pixels[source].long()
        x0 = torch.zeros(len(index) * MAP_PX**2, device=index.device)
        dwell = torch.zeros_like(x0)
        x0[pixel] = 1.0
        dwell[pixel] = self.dwell[source].float()
        shape = (len(index), 1, MAP_PX, MAP_PX)
        return self.psfs[index].float(), x0.view(shape), dwell.view(shape)


def draw_motion(
    mix: MotionMix, rng: np.random.Generator, trace: GyroTrace | None = None
) -> Trajectory:
    """Draw one motion of the mix that fits the 64-px frame.

    ValueError if no drawn motion fits, or the mix has gyro-driven motion and there is no trace.
    """
    return _draw(mix, rng, trace)[1]


def drawn_motions(mix: MotionMix, *, seed: int, indices: range) -> list[Trajectory]:
    """Draw motions as :func:`draw_motion`; motion i depends on (seed, i) only."""
    trace = mix_trace(mix)
    return [draw_motion(mix, np.random.default_rng([seed, i]), trace) for i in indices]


def drawn_kinds(mix: MotionMix, *, count: int, seed: int) -> list[str]:
    """Kinds, as the mix names their shares, of the motions that :func:`build_bank` draws."""
    trace = mix_trace(mix)
    return [_draw(mix, np.random.default_rng([seed, i]), trace)[0] for i in range(count)]


def _draw(
    mix: MotionMix, rng: np.random.Generator, trace: GyroTrace | None
) -> tuple[str, Trajectory]:
    if mix.gyro > 0 and trace is None:
        raise ValueError("trace: motions.gyro > 0 needs a gyroscope recording, got none")
    shares = np.array(mix.shares) / sum(mix.shares)
    low_px = mix.min_length_px
    high_px = mix.max_length_px
    # a motion that does not fit is drawn anew, its kind as well
    for _ in range(_TRIES):
        kind = _KINDS[int(rng.choice(len(shares), p=shares))]
        if kind == "boracchi_foi":
            motion = boracchi_foi(rng, max_length_px=high_px)
        elif kind == "boracchi_foi_short":
            motion = boracchi_foi(rng, max_length_px=rng.uniform(low_px, high_px))
        elif kind == "gyro" and trace is not None:
            extent_px = rng.uniform(mix.min_extent_px, mix.max_extent_px)
            motion = random_gyro_motion(
                trace, rng, exposure_s=rng.uniform(*mix.exposure_s), extent_px=extent_px
            )
        elif kind == "straight":
            motion = random_straight(rng, min_length_px=low_px, max_length_px=high_px)
        else:
            motion = quadratic(rng, min_length_px=low_px, max_length_px=high_px)
        if motion.frame_size() <= PSF_PX:
            return kind, motion
    raise ValueError(
        f"max_length_px: {_TRIES} drawn motions did not fit {PSF_PX} px, got {mix.max_length_px}"
    )


def dwell_on_map(motion: Trajectory, hr_map: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Time (P,) spent at each path pixel of the motion's HR map, mean 1, in row-major order."""
    from scipy.spatial import KDTree

    rows, columns = np.nonzero(hr_map)
    points = np.column_stack([columns, rows])
    times = (np.arange(_TIMES) + 0.5) / _TIMES
    _, nearest = KDTree(points).query(MAP_CENTRE + MAP_PITCH * motion.at(times))
    dwell = np.bincount(nearest, minlength=len(points)) * (len(points) / _TIMES)
    return np.asarray(dwell, dtype=np.float64)


def build_bank(mix: MotionMix, *, count: int, seed: int, workers: int = 1) -> MotionBank:
    """Draw ``count`` motions, see :func:`drawn_motions`, in about 6 ms of one core each."""
    if count < 1:
        raise ValueError(f"count: must be at least 1, got {count}")
    if workers == 1:
        return bank_of(drawn_motions(mix, seed=seed, indices=range(count)))
    chunks = [range(start, min(start + _CHUNK, count)) for start in range(0, count, _CHUNK)]
    with ProcessPoolExecutor(
        workers, initializer=end_with_parent, initargs=(os.getpid(),)
    ) as pool:
        banked = pool.map(partial(_drawn_rows, mix, seed), chunks)
        return _joined([row for rows in banked for row in rows])


def bank_of(motions: Sequence[Trajectory]) -> MotionBank:
    """Make the tensors of motions that fit the 64-px frame, at least one."""
    return _joined([_row(motion) for motion in motions])


def _drawn_rows(mix: MotionMix, seed: int, indices: range) -> list[_Row]:
    return [_row(motion) for motion in drawn_motions(mix, seed=seed, indices=indices)]


def _row(motion: Trajectory) -> _Row:
    hr_map = motion.hr_map()
    psf = motion.psf(PSF_PX).astype(np.float16)
    pixels = np.flatnonzero(hr_map).astype(np.int32)
    return psf, pixels, dwell_on_map(motion, hr_map).astype(np.float16)


def _joined(rows: Sequence[_Row]) -> MotionBank:
    psfs, pixels, dwell = zip(*rows, strict=True)
    starts = np.concatenate([[0], np.cumsum([len(flat) for flat in pixels])])
    return MotionBank(
        psfs=torch.from_numpy(np.stack(psfs)),
        pixels=torch.from_numpy(np.concatenate(pixels)),
        dwell=torch.from_numpy(np.concatenate(dwell)),
        starts=torch.from_numpy(starts.astype(np.int64)),
    )


def mix_trace(mix: MotionMix) -> GyroTrace | None:
    """Read the recording of a mix that has gyro-driven motion."""
    if mix.gyro == 0:
        return None
    if not Path(mix.gyro_trace).exists():
        raise ValueError(
            f"motions.gyro_trace: there is no {mix.gyro_trace!r} here; name a gyroscope recording"
            " of your own, or set motions.gyro = 0"
        )
    try:
        return read_gyro(mix.gyro_trace)
    except ValueError as error:
        raise ValueError(f"motions.gyro_trace: {error}") from None
