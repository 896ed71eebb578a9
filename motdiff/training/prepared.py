"""Prepared training samples: simulated and searched once, stored in small files."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from motdiff.io.inputs import regular_file
from motdiff.io.outputs import new_file
from motdiff.network.condition import PHOTO_PX
from motdiff.psf_frame import MAP_PX
from motdiff.training.motion_bank import MotionMix, build_bank
from motdiff.training.samples import Samples, simulate
from motdiff.training.simulation import Photography

__all__ = ["SHARD_SAMPLES", "prepare", "read_shards", "shard_range"]

SHARD_SAMPLES = 64


def prepare(
    folder: Path | str,
    *,
    scenes: Sequence[Tensor],
    mix: MotionMix,
    photography: Photography,
    shards: range,
    seed: int,
    on_shard: Callable[[int], None] = lambda _shard: None,
) -> None:
    """Write the missing ones of the ``shards`` (64 samples each); each depends on its number and the seed only.

    Parameters
    ----------
    folder : path, made when missing
    scenes, mix, photography
        As for :func:`motdiff.training.samples.simulate`.
    shards : range
        Numbers of the files; several processes can share the work by strides.
    seed : int
    on_shard : callable, optional
        Called with the number of every finished shard.
    """
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    for shard in shards:
        file = target / f"shard_{shard:05d}.npz"
        if not file.exists():
            bank = build_bank(mix, count=SHARD_SAMPLES, seed=seed, first=shard * SHARD_SAMPLES)
            index = torch.arange(SHARD_SAMPLES)
            with torch.no_grad():
                samples = simulate(
                    bank, scenes, index, photography=photography, physics=True, seed=seed * 1_000_003 + shard
                )
            _write(file, samples)
        on_shard(shard)


def shard_range(text: str) -> range:
    """Read the numbers of shards, ``FIRST:LAST`` or ``FIRST:LAST:STEP``, as the option ``--shards`` has them.

    Raises
    ------
    ValueError
        If they are others, or none.
    """
    try:
        first, last, *step = (int(number) for number in text.split(":"))
        shards = range(first, last, *step)
    except (TypeError, ValueError):
        raise ValueError(f"--shards: must be FIRST:LAST or FIRST:LAST:STEP, got {text!r}") from None
    if not shards or min(shards) < 0:
        raise ValueError(f"--shards: must hold numbers from 0 upwards, FIRST below LAST, got {text!r}")
    return shards


def read_shards(folder: Path | str) -> Samples:
    """Read every shard of a folder into memory (photos as luminance; about 110 KB a sample).

    Returns
    -------
    Samples with uint8 photos (B, 1, 256, 256) holding ``255 sqrt(light)``, float16 kernels and dwell, uint8 x0

    Raises
    ------
    ValueError
        If there are none.
    """
    files = sorted(file for file in Path(folder).glob("shard_*.npz") if ".partial" not in file.suffixes)
    if not files:
        raise ValueError(
            f"{folder}: holds no prepared samples (shard_*.npz); write them with: python -m motdiff prepare"
        )
    read = [_read(file) for file in files]
    return Samples(
        *(torch.cat([getattr(part, name) for part in read]) for name in ("photos", "kernels", "x0", "dwell"))
    )


def _write(file: Path, samples: Samples) -> None:
    grey = samples.photos.mean(dim=1, keepdim=True).clamp(0, 1).sqrt()
    path = samples.x0 > 0
    with new_file(file) as temporary:
        np.savez(
            temporary,
            photos=(255 * grey).round().to(torch.uint8).numpy(),
            kernels=samples.kernels.half().numpy(),
            x0=np.packbits(path.numpy().reshape(len(samples), -1), axis=1),
            dwell=samples.dwell[path].half().numpy(),
        )


def _read(file: Path) -> Samples:
    try:
        return _loaded(file)
    except (zipfile.BadZipFile, EOFError, KeyError) as error:
        raise ValueError(f"{file}: is damaged ({error}); delete it and prepare it again") from error


def _loaded(file: Path) -> Samples:
    with np.load(regular_file(file)) as stored:
        count = len(stored["photos"])
        path = np.unpackbits(stored["x0"], axis=1).reshape(count, 1, MAP_PX, MAP_PX)
        dwell = np.zeros(path.shape, np.float16)
        dwell[path > 0] = stored["dwell"]
        photos = stored["photos"].reshape(count, 1, PHOTO_PX, PHOTO_PX)
        return Samples(*(torch.from_numpy(array) for array in (photos, stored["kernels"], path, dwell)))
