"""PSF files: ``.npy``, ``.mat`` and pictures, in and out, and doubts about what they hold."""

from __future__ import annotations

import warnings
from io import BytesIO
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cep.files.images import read_photo
from motdiff.files.inputs import one_line, regular_file
from motdiff.files.mat_files import levin_psf, read_mat
from motdiff.files.outputs import new_files, write_bytes
from motdiff.photo_values import luminance

PSF_SUFFIXES = (".npy", ".mat", ".png")
# how far a centre of mass may be off the middle without a doubt
_OFF_MIDDLE_PX = 1.0  # of an open shutter's PSF
_CODED_OFF = 0.25  # of a coded one's, share of its extent
_OPEN_LIGHT = 0.999  # sum of a PSF, light-true: less was taken through a code
# a rim of one level is the background of a photo of a light, unless it is as bright as a box
_VEIL = 0.05  # share of the light in it
_VEIL_LEVEL = 0.5  # share of the peak
_MAT_TEXT = b"MATLAB 5.0 MAT-file, written by coded-exposure"  # "MAT-File Format", MathWorks
_MAT_TEXT_BYTES = 116


def write_psf(folder: Path | str, psf: ArrayLike, *, stem: str = "psf") -> tuple[Path, Path, Path]:
    """Write a PSF (S, S) as ``.npy``, ``.mat`` and, for people, ``.png``, all three or none.

    They are float32, the variable ``psf``, and 8 bits, and are returned in that order. In the
    ``.png`` the largest value is white. The folder exists; the stem is a name without suffix.
    """
    import cv2
    from scipy.io import savemat

    kernel = np.asarray(psf, dtype=np.float32)
    paths = tuple(Path(folder) / f"{stem}{suffix}" for suffix in PSF_SUFFIXES)
    peak = max(float(kernel.max()), float(np.finfo(np.float32).tiny))  # an all-black one too
    grey = np.rint(255 * kernel / peak).astype(np.uint8)
    stored = BytesIO()
    np.save(stored, kernel)  # written to a file, SciPy hides the error of a full disk
    matlab = BytesIO()
    savemat(matlab, {"psf": kernel.astype(np.float64)})  # MATLAB computes in double
    # SciPy puts the date there, and the same PSF must give the same file
    undated = _MAT_TEXT.ljust(_MAT_TEXT_BYTES) + matlab.getvalue()[_MAT_TEXT_BYTES:]
    contents = (stored.getvalue(), undated, cv2.imencode(".png", grey)[1].tobytes())
    with new_files(paths) as temporary:
        for path, content in zip(paths, contents, strict=True):
            write_bytes(temporary[path], content)
    return paths[0], paths[1], paths[2]


def load_psf(path: Path | str) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Read a PSF from ``.npy``, ``.mat`` or an image (whose samples are taken as linear).

    Of a ``.mat`` file the variable ``psf`` is read as it is; where there is none, ``f``, the
    kernel in Levin's files, which is turned by 180 degrees: see
    :func:`motdiff.files.mat_files.levin_psf`.

    Returns
    -------
    kernel : (S, S') float
        Non-negative, as stored; an image is scaled to sum 1.
    warnings : tuple of str
        Of its file; and where its light is off its middle, or does not end at its rim.

    Raises
    ------
    ValueError
        If there is no usable PSF in the file.
    OSError
        If the file cannot be read.
    """
    source = Path(path)
    suffix = source.suffix.lower()
    psf: NDArray[Any]
    warnings: tuple[str, ...] = ()
    if suffix == ".npy":
        psf = _psf_from_npy(source)
    elif suffix == ".mat":
        variables = read_mat(source, ["psf", "f"])
        psf = variables["psf"] if "psf" in variables else levin_psf(variables["f"])
    else:
        photo = read_photo(source, gamma="linear", min_side_px=1)
        warnings = photo.warnings
        grey = luminance(photo.pixels)
        psf = grey / (grey.sum() or 1.0)  # a black one is refused below
    if psf.ndim != 2 or min(psf.shape) < 1 or psf.dtype.kind not in "fiu":
        kind = one_line(repr(psf.dtype.name))
        raise ValueError(
            f"{source}: a PSF is one table of real numbers, found shape {psf.shape} of {kind}"
        )
    kernel = psf.astype(np.float64)
    if not np.isfinite(kernel).all() or kernel.min() < 0 or kernel.sum() <= 0:
        raise ValueError(f"{source}: a PSF must be finite, not negative and not all zero")
    return kernel, (*warnings, *(f"{source}: {doubt}" for doubt in _psf_doubts(kernel)))


def _psf_doubts(kernel: NDArray[np.float64]) -> list[str]:
    """List what in a PSF is against its conventions, and may still be meant."""
    light = float(kernel.sum())
    rows, columns = np.nonzero(kernel)
    extent = max(np.ptp(rows), np.ptp(columns)) + 1
    y, x = (
        float(kernel.sum(axis=1 - axis) @ np.arange(kernel.shape[axis])) / light
        - kernel.shape[axis] // 2
        for axis in (0, 1)
    )
    doubts = []
    most_off_px = _OFF_MIDDLE_PX
    if light <= _OPEN_LIGHT:  # the open chips of a code lie off the middle of the path's time
        most_off_px = max(_OFF_MIDDLE_PX, extent * _CODED_OFF)
    if max(abs(x), abs(y)) > most_off_px:
        doubts.append(
            f"its centre of mass is ({x:+.1f}, {y:+.1f}) px (x, y) off its middle, which stands"
            f" for no displacement: the restored photo moves by ({-x:+.1f}, {-y:+.1f}) px; centre"
            " it if that is not meant"
        )
    rim = np.concatenate([kernel[0], kernel[-1], kernel[1:-1, 0], kernel[1:-1, -1]])
    level = float(np.median(rim))  # a PSF that is cut off crosses its rim in a few pixels
    veil = level * kernel.size / light
    if veil > _VEIL and level < _VEIL_LEVEL * kernel.max():
        doubts.append(
            f"its rim is not 0 but {level:.2g}: such a veil over all of it is {veil:.0%} of its"
            " light; subtract the background, or give the whole PSF if it is cut off"
        )
    return doubts


def _psf_from_npy(source: Path) -> NDArray[Any]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # headers of old versions of NumPy
            # memory-mapped: a header with too large a shape allocates nothing
            return np.lib.format.open_memmap(regular_file(source), mode="r")
    except (
        ValueError,
        TypeError,
        OverflowError,
        EOFError,
        SyntaxError,
        TokenError,
        RecursionError,
    ) as error:
        raise ValueError(f"{source}: not a NumPy array file ({one_line(error)})") from None
