"""Shards: numbered files of samples in a folder."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from motdiff.files.inputs import one_line, regular_file
from motdiff.files.outputs import new_file

_Loaded = TypeVar("_Loaded")


def shard_range(text: str) -> range:
    """Numbers of ``--shards``, ``FIRST:LAST`` or ``FIRST:LAST:STEP``; ValueError for others."""
    try:
        first, last, *step = (int(number) for number in text.split(":"))
        shards = range(first, last, *step)
    except (TypeError, ValueError):
        raise ValueError(
            f"--shards: must be FIRST:LAST or FIRST:LAST:STEP, got {text!r}"
        ) from None
    if not shards or min(shards) < 0:
        raise ValueError(
            f"--shards: must hold numbers from 0 upwards, FIRST below LAST, got {text!r}"
        )
    return shards


def write_shards(
    folder: Path | str,
    shards: range,
    *,
    name: str,
    make: Callable[[int], Mapping[str, NDArray[np.generic]]],
    on_shard: Callable[[int], None],
) -> None:
    """Write the missing ones of the shards.

    Parameters
    ----------
    folder : path, made when missing
    shards : range
        Numbers of the files; several processes can share the work by strides.
    name : str
        First part of the files' names.
    make : callable
        From a number to the arrays of its file.
    on_shard : callable
        Called with the number of every shard that is there.
    """
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    for shard in shards:
        file = target / f"{name}_{shard:05d}.npz"
        if not file.exists():
            arrays = make(shard)
            with new_file(file) as temporary:
                np.savez(temporary, **arrays)  # type: ignore[arg-type]  # an array may be named as an option of savez
        on_shard(shard)


def load_shards(
    folder: Path | str,
    *,
    name: str,
    load: Callable[[Mapping[str, NDArray[np.generic]]], _Loaded],
    missing: str,
) -> list[_Loaded]:
    """Load every shard of a folder, in the order of the numbers.

    Parameters
    ----------
    name : str
        First part of the files' names.
    load : callable
        From the arrays of a file to the samples.
    missing : str
        Kind of the files and the command that writes them: the end of the error without any.

    Raises
    ------
    ValueError
        If there are none, or one is damaged.
    """
    # partial ones are of earlier versions
    files = sorted(
        file for file in Path(folder).glob(f"{name}_*.npz") if ".partial" not in file.suffixes
    )
    if not files:
        raise ValueError(f"{folder}: holds no {missing}")
    return [_loaded(file, load) for file in files]


def _loaded(file: Path, load: Callable[[Mapping[str, NDArray[np.generic]]], _Loaded]) -> _Loaded:
    regular_file(file)
    try:
        with file.open("rb") as stream, np.load(stream) as stored:
            return load(stored)
    except (zipfile.BadZipFile, EOFError, KeyError, ValueError) as error:
        # numpy takes a file that is no archive for a pickle, and says how to load it unsafely
        reason = "no archive of arrays" if "pickle" in str(error) else one_line(error)
        raise ValueError(
            f"{file}: is damaged ({reason}); delete it and prepare it again"
        ) from error
