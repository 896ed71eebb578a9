"""A camera's gain, read noise and full well, from pairs of frames, by photon transfer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cep.files.images import read_code_values
from cep.files.raw_files import RAW_SUFFIXES, read_mosaic
from cep.optics.camera import Camera
from cep.optics.frame_pairs import CodeRange, FramePair, find_code_range
from cep.optics.photon_transfer import PhotonTransfer, photon_transfer
from cep.plots.camera import photon_transfer_figure
from cep.plots.canvas import check_figure_name, save
from motdiff.files.outputs import claim
from motdiff.photo_values import to_linear

_LOSSY = (".jpg", ".jpeg", ".webp")
_FRAME_SIDE_PX = 16


@dataclass(frozen=True)
class CameraEstimate:
    """A camera measured.

    Attributes
    ----------
    camera : Camera
    transfer : PhotonTransfer
    """

    camera: Camera
    transfer: PhotonTransfer

    def save(
        self, path: Path, figure: Path | None = None, *, force: bool = False
    ) -> tuple[Path, Path]:
        """Write the camera's file and the curve's figure, ``path`` as .png when omitted."""
        figure = figure or path.with_suffix(".png")
        check_figure_name(figure)
        with claim([path, figure], force=force).written() as staged:
            self.camera.to_file(staged[path])
            save(photon_transfer_figure(self.transfer), staged[figure])
        return path, figure


@dataclass(frozen=True)
class _Frame:
    codes: NDArray[np.uint16]
    file_bits: int
    raw: tuple[float, int] | None = None  # black and white of a RAW file
    warnings: tuple[str, ...] = ()


def estimate_camera(
    flats: Sequence[Path],
    *,
    dark: Sequence[Path] = (),
    black_dn: float | None = None,
    bits: int | None = None,
    gamma: str = "linear",
    name: str = "",
    progress: Callable[[float], None] = lambda _: None,
) -> CameraEstimate:
    """Measure a camera from pairs of evenly lit frames and a pair of dark ones.

    Parameters
    ----------
    flats : sequence of Path
        Two frames of each level of light, one after the other: grey PNG or TIFF files of 8 or 16
        bits, or RAW files, of which the pixels under the first green filter are taken.
    dark : sequence of two paths, optional
        Frames without light, of the same exposure.
    black_dn : float, optional
        Code value without light, where there are no dark frames. That of RAW files is known.
    bits : int, optional
        Of the camera; found from the values when omitted.
    gamma : {"linear", "srgb"}
        Curve on which the code values are evenly spaced.
    name : str
        Of the camera.
    progress : callable, optional
        Is given the share of the work done.

    Raises
    ------
    ValueError
        If a file is not such a frame, or the frames do not show a camera's noise; the line names
        the files.
    OSError
        If a file cannot be read.
    """
    if gamma not in ("linear", "srgb"):
        raise ValueError(
            f'gamma: must be "linear" or "srgb" for frames of a camera, got {gamma!r}'
        )
    if black_dn is not None and not (np.isfinite(black_dn) and black_dn >= 0):
        raise ValueError(f"black_dn: must be a code value of 0 or more, got {black_dn:g}")
    if dark and black_dn is not None:
        raise ValueError("black_dn and dark: give one of them, dark frames show the black level")
    if len(flats) < 2 or len(flats) % 2:
        raise ValueError(
            f"flats: must be two frames of each level of light, got {len(flats)}; each in a file"
            " of its own"
        )
    if len(dark) not in (0, 2):
        raise ValueError(f"dark: must be two frames, got {len(dark)}")
    levels = len(flats) // 2
    names = [*flats, *dark]
    files = list(zip(names[::2], names[1::2], strict=True))
    response: Literal["linear", "srgb"] = "srgb" if gamma == "srgb" else "linear"
    pairs = []
    kinds = set()
    warnings = []
    for level, (first, second) in enumerate(files):
        frames = _read_frame(first), _read_frame(second)
        warnings += [line for frame in frames for line in frame.warnings]
        kinds |= {(frame.file_bits, frame.raw) for frame in frames}
        if len(kinds) > 1:  # their code values do not compare
            raise ValueError(
                f"{second}: is of another kind than the frames before it: bits, black or white"
                " differ"
            )
        pairs.append(_pair(first, second, frames, response))
        progress((level + 1) / len(files))
    file_bits, raw = kinds.pop()
    if raw is not None:
        # a RAW file states its white: there is nothing to find out, as there is of a PNG
        codes = CodeRange(bits or raw[1].bit_length(), top_dn=float(raw[1]))
        if black_dn is None:
            black_dn = raw[0]
    else:
        codes = find_code_range(pairs, file_bits=file_bits, bits=bits)
    try:
        transfer = photon_transfer(
            pairs[:levels],
            codes=codes,
            dark=next(iter(pairs[levels:]), None),
            black_dn=black_dn,
            response=response,
        )
    except ValueError as error:
        raise ValueError(_with_files(str(error), files)) from None  # the curve counts pairs
    black = "a pair of dark frames" if dark else "no dark frames"
    source = (
        f"photon-transfer curve of {levels} pair{'s' if levels > 1 else ''} of flat frames and"
        f" {black}"
    )
    camera = transfer.camera(name=name, source=source)
    return CameraEstimate(camera, replace(transfer, warnings=(*warnings, *transfer.warnings)))


def _pair(first: Path, second: Path, frames: tuple[_Frame, _Frame], response: str) -> FramePair:
    table = None
    if response == "srgb":
        full = 2 ** frames[0].file_bits - 1
        # as 16-bit numbers index it, whatever the file's depth
        table = to_linear(np.arange(65536) / full) * full
    try:
        return FramePair.of(frames[0].codes, frames[1].codes, codes=table)
    except ValueError as error:
        raise ValueError(f"{first} and {second}: {error}") from None


def _read_frame(path: Path) -> _Frame:
    """Read the code values of a frame."""
    suffix = path.suffix.lower()
    if suffix in _LOSSY:
        raise ValueError(f"{path}: its noise was compressed away; give PNG, TIFF or RAW files")
    if suffix in RAW_SUFFIXES:
        mosaic = read_mosaic(path)  # one filter, one position: no pixel is interpolated
        return _Frame(mosaic.green, 16, (mosaic.black_dn, mosaic.white_dn))
    codes, warnings = read_code_values(path, min_side_px=_FRAME_SIDE_PX)
    if codes.ndim == 3:
        if (codes != codes[:, :, :1]).any():
            raise ValueError(
                f"{path}: is a colour picture, whose pixels are interpolated; give grey or RAW"
                " files"
            )
        codes = codes[:, :, 0]  # grey that was saved with three equal channels
    return _Frame(codes.astype(np.uint16), 8 * codes.dtype.itemsize, warnings=warnings)


def _with_files(line: str, files: Sequence[tuple[Path, Path]]) -> str:
    """Put the files' names for "pair 2:" or "dark:" into an error."""
    where, colon, fault = line.partition(": ")
    if where == "dark":
        return f"{files[-1][0]} and {files[-1][1]}{colon}{fault}"
    if where.startswith("pair ") and where[5:].isdigit():
        first, second = files[int(where[5:]) - 1]
        return f"{first} and {second}{colon}{fault}"
    return line
