"""RAW files of cameras, read by LibRaw: as linear light, or the sensor's own code values."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motdiff.files.decoding import decoder_output
from motdiff.files.inputs import one_line, regular_file
from motdiff.files.photo_files import check_px

# read with the package rawpy
RAW_SUFFIXES = (
    ".3fr",
    ".arw",
    ".cr2",
    ".cr3",
    ".dng",
    ".nef",
    ".nrw",
    ".orf",
    ".pef",
    ".raf",
    ".raw",
    ".rw2",
    ".srw",
)
_RAW_OPTIONS: dict[str, Any] = {
    "gamma": (1, 1),  # linear light
    "output_bps": 16,  # 8 are too coarse for linear light in the shadows
    "use_camera_wb": True,
    "no_auto_bright": True,  # which would stretch each photo differently
    "adjust_maximum_thr": 0.0,  # full scale is the sensor's, not the brightest pixel of this photo
}


@dataclass(frozen=True)
class Mosaic:
    """The sensor's own code values of a RAW file.

    Attributes
    ----------
    green : (N,) uint16
        Code values of the pixels under the first green filter; where the sensor has none, of all
        pixels like the first.
    black_dn : float
        Code value without light, as the file states it.
    white_dn : int
        Largest code value.
    """

    green: NDArray[np.uint16]
    black_dn: float
    white_dn: int


def read_mosaic(path: Path | str) -> Mosaic:
    """Read a RAW file's code values as the sensor gave them, neither balanced nor interpolated.

    Raises
    ------
    ValueError
        If it is not a RAW file that LibRaw can read, or ``rawpy`` is missing; the line names it.
    OSError
        If the file cannot be read.
    """
    with _opened_raw(Path(path)) as raw:
        if raw.raw_image_visible.ndim != 2:
            raise ValueError(
                f"{path}: holds colours that were interpolated, and not the sensor's own values"
            )
        colours = raw.raw_colors_visible
        # LibRaw's 1 is a green filter; without filters there is one colour
        colour = 1 if (colours == 1).any() else int(colours.flat[0])
        blacks = raw.black_level_per_channel
        return Mosaic(
            green=np.asarray(raw.raw_image_visible[colours == colour], dtype=np.uint16),
            # LibRaw's colour of no filters is 6
            black_dn=float(blacks[colour if colour < len(blacks) else 0]),
            white_dn=int(raw.white_level),
        )


def read_raw(source: Path) -> NDArray[np.uint16]:
    """Read a RAW file as linear light, (H, W, 3) in 16 bits."""
    with _opened_raw(source) as raw:
        return np.asarray(raw.postprocess(**_RAW_OPTIONS), dtype=np.uint16)


@contextmanager
def _opened_raw(source: Path) -> Iterator[Any]:
    """Open a RAW file with LibRaw, whose complaints become one line."""
    regular_file(source)  # a missing file is reported before a missing package
    try:
        import rawpy
    except ImportError:
        raise ValueError(
            f"{source}: RAW files need a package besides: pip install rawpy"
        ) from None
    try:
        with decoder_output(), rawpy.imread(str(source)) as raw:
            check_px(raw.sizes.raw_width, raw.sizes.raw_height, source)
            yield raw
    except rawpy.LibRawError as error:
        reason = b"".join(text for text in error.args if isinstance(text, bytes)).decode(
            errors="replace"
        )
        raise ValueError(
            f"{source}: not a RAW file that LibRaw can read ({one_line(reason or error)})"
        ) from None
