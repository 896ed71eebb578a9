"""Detect output files of the project's own commands, so that they are not read as photos."""

from __future__ import annotations

import re
import struct
import sys
from pathlib import Path

from cep.calibration.calibrate import CALIBRATION_FILES
from cep.files.code_files import CODE_SCHEMA
from cep.files.images import PICTURE_SUFFIXES
from cep.files.psf_files import PSF_SUFFIXES
from cep.report.page import DEMO_SCHEMA
from lab.bench.table_io import TABLES_SCHEMA
from lab.fronts.comparison import FRONT_SCHEMA
from motdiff.files.trajectories import SCHEMA as MOTION_SCHEMA

_FIGURED = (TABLES_SCHEMA, FRONT_SCHEMA)
_HEAD = re.compile(rb'\{\s*"schema"\s*:\s*"([^"]*)"')
_HEAD_BYTES = 200  # annotations of photos may be large
_MAT_HEAD_BYTES = 176
_MAT_NAME = struct.pack(
    "=I4s", 3 << 16 | 1, b"psf"
)  # text, three bytes of it, as version 5 of the format packs it


def is_own_output(path: Path) -> bool:
    """Whether a picture or ``.mat`` file was written by a command, judged by the files beside it.

    These are figures of benchmarks and fronts, beside their JSON; PSFs, beside the same in the
    other formats; photos that ``cep simulate`` has blurred, beside their PSFs; and the pictures of
    ``cep calibrate`` and ``cep demo``, by their names in a folder with the motion, its PSF and, of
    the demo, its figures. Files of ``cep mtf`` and ``cep deblur`` have no record beside them and
    are not detected.

    Parameters
    ----------
    path : Path

    Raises
    ------
    OSError
        If a file beside it cannot be read.
    """
    return (
        _is_figure(path)
        or _is_psf(path)
        or _is_simulated(path)
        or _is_of_calibration(path)
        or _is_of_demo(path)
    )


def _is_figure(path: Path) -> bool:
    return path.suffix == ".png" and _is_ours(path.with_suffix(".json"), *_FIGURED)


def _is_psf(path: Path) -> bool:
    return path.suffix in PSF_SUFFIXES and _has_psf(path.parent, path.stem)


def _is_simulated(path: Path) -> bool:
    return (
        path.suffix.lower() in PICTURE_SUFFIXES
        and _has_psf(path.parent, f"{path.stem}_psf")
        and not _is_ours(
            path.with_suffix(".json"), CODE_SCHEMA
        )  # the PSF of a code that was played
        # which one of several was blurred is not known
        and sum(path.with_suffix(suffix).is_file() for suffix in {path.suffix, *PICTURE_SUFFIXES})
        == 1
    )


def _is_of_calibration(path: Path) -> bool:
    return path.name in CALIBRATION_FILES and _has_motion(path.parent)


def _is_of_demo(path: Path) -> bool:
    folder = path.parent
    if not _is_ours(folder / "demo.json", DEMO_SCHEMA):
        return False
    from cep.report.page import DEMO_FILES

    return path.name in DEMO_FILES and _has_motion(folder)


def _has_motion(folder: Path) -> bool:
    return _is_ours(folder / "trajectory.json", MOTION_SCHEMA) and _has_psf(folder, "psf")


def _has_psf(folder: Path, stem: str) -> bool:
    """Whether there is a PSF in the formats of :func:`cep.files.psf_files.write_psf`."""
    if not all((folder / f"{stem}{suffix}").is_file() for suffix in PSF_SUFFIXES):
        return False
    path = folder / f"{stem}.mat"
    with path.open("rb") as stream:
        head = stream.read(_MAT_HEAD_BYTES)
    # the first variable's length, to the end of the file, and its name; SciPy is not asked: a
    # damaged file may crash it
    length = int.from_bytes(head[132:136], sys.byteorder)
    return 136 + length == path.stat().st_size and head[168:] == _MAT_NAME


def _is_ours(path: Path, *schemas: str) -> bool:
    """Whether a JSON file has one of these schemas, in any version."""
    if not path.is_file():
        return False
    with path.open("rb") as stream:
        match = _HEAD.match(stream.read(_HEAD_BYTES))
    kinds = {schema.partition("/")[0].encode() for schema in schemas}
    return match is not None and match[1].partition(b"/")[0] in kinds
