"""MATLAB files, read in a separate process: a damaged one may crash SciPy or fill memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motdiff.files.inputs import one_line, regular_file

_MOST_MIB = 1024  # beyond what Python and SciPy take; a file of an image has some
_MOST_CPU_S = 15
_MOST_S = 120  # on the clock: a busy machine may need seconds to load SciPy
_SCRIPT = Path(__file__).with_name("_mat_reader.py")


def read_mat(path: Path | str, names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Read those of some variables that a .mat file of version 4, 5, 6 or 7 has, one at least.

    Raises
    ------
    ValueError
        If SciPy cannot read the file, crashes while it tries, or needs more than 1 GiB of memory
        or 15 s of computing; or if the file has none of the variables, or one is a struct, a cell
        array or sparse. The line names the file.
    OSError
        If there is no such file.
    """
    source = regular_file(path)
    with source.open("rb"):  # an unreadable file is refused here, with the system's error
        pass
    stream = BytesIO(_answer(source, names))
    try:
        answer: dict[str, Any] = json.loads(stream.readline())
        if "error" in answer:
            raise ValueError(answer["error"])
        arrays = {
            str(name): np.lib.format.read_array(stream, allow_pickle=False)
            for name in answer["sent"]
        }
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{source}: cannot be read as a .mat file ({one_line(error)})") from None
    if not arrays:
        wanted_names = " or ".join(f'"{name}"' for name in names)
        file_names = ", ".join(answer["found"]) or "nothing"
        raise ValueError(
            f"{source}: wanted a variable {wanted_names}, found {one_line(file_names)}"
        )
    return arrays


def levin_psf(kernel: NDArray[Any]) -> NDArray[Any]:
    """Turn the kernel ``f`` (S, T) of one of Levin's files into a PSF.

    In these files the blurred photo ``y`` is the sharp one, ``x``, convolved with ``f`` turned by
    180 degrees, and then shifted by up to 4 px. So the PSF, as it is convolved with here, is ``f``
    turned by 180 degrees.

    References
    ----------
    Levin, Weiss, Durand, Freeman, "Understanding and evaluating blind deconvolution algorithms",
    CVPR 2009.
    """
    return np.rot90(kernel, 2)


def _answer(source: Path, names: Sequence[str]) -> bytes:
    # -P: the script's own folder, this package, must not hide modules of the same names
    python = [sys.executable, "-P", "-W", "ignore", str(_SCRIPT)]
    try:
        run = subprocess.run(
            [*python, str(source.absolute()), str(_MOST_MIB), str(_MOST_CPU_S), *names],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=_MOST_S,
            check=False,
            # each thread of the pool takes address space
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )
    except subprocess.TimeoutExpired:
        raise ValueError(
            f"{source}: cannot be read as a .mat file (it takes longer than {_MOST_S} s)"
        ) from None
    if run.returncode != 0:
        last = run.stderr.decode(errors="replace").strip().rpartition("\n")[2]
        reason = last or f"reading it ended with status {run.returncode}"
        raise ValueError(f"{source}: cannot be read as a .mat file ({one_line(reason)})")
    return run.stdout
