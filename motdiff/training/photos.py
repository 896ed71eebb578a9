"""Sharp photos for training: from a folder or a pack of JPEGs, cropped at random."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from motdiff.files.inputs import regular_file
from motdiff.files.outputs import write_bytes

PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")


def load_photos(
    source: Path | str, *, least_px: int, most_px: int = 640, device: str = "cpu"
) -> list[Tensor]:
    """Read every photo of a folder (with its subfolders) or of a pack from :func:`pack_photos`.

    Photos with a shorter side than ``least_px`` are left out. Those with a longer short side than
    ``most_px`` are shrunk to it: the detail of a full-size photo is softer than a kernel.
    ValueError if there is no photo large enough, a file cannot be read, or photos would be shrunk
    below ``least_px``.

    They are (3, H, W) uint8, red green blue, display values.
    """
    if most_px < least_px:
        raise ValueError(f"most_px: must be at least least_px = {least_px}, got {most_px}")
    images = (image for _, image in _images(Path(source)) if min(image.shape[:2]) >= least_px)
    channels_first = (_shrunk(image, most_px).transpose(2, 0, 1) for image in images)
    photos = [torch.from_numpy(np.ascontiguousarray(a)).to(device) for a in channels_first]
    if not photos:
        raise ValueError(f"{source}: holds no photo of at least {least_px} x {least_px} px")
    return photos


def pack_photos(
    source: Path | str, target: Path | str, *, most_px: int = 512, quality: int = 92
) -> int:
    """Pack a folder's photos as JPEGs into one .zip file, to travel; returns its bytes.

    Photos with a longer short side than ``most_px`` are shrunk to it. ValueError without a photo.
    """
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as pack:
        for number, (name, image) in enumerate(_images(Path(source))):
            _, encoded = cv2.imencode(
                ".jpg", _shrunk(image, most_px)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality]
            )
            pack.writestr(f"{number:05d}_{Path(name).stem}.jpg", encoded.tobytes())
        if not pack.namelist():
            raise ValueError(f"{source}: holds no photo to pack")
    write_bytes(target, buffer.getvalue())
    return len(buffer.getvalue())


def load_scenes(
    source: str, *, held_out: int, least_px: int, device: str = "cpu"
) -> tuple[list[Tensor], list[Tensor]]:
    """Read a run's photos: those to train on, and every ``held_out``-th for validation.

    ValueError, which names the entry of the run's file, if there are none or too few.
    """
    if not Path(source).exists():
        raise ValueError(
            f"data.photos: there is no {source!r} here; name a folder, or a .zip of python -m"
            " motdiff pack, of some hundred sharp photos: your own, or a public set such as"
            " BSDS500"
        )
    try:
        photos = load_photos(source, least_px=least_px, device=device)
    except ValueError as error:
        raise ValueError(f"data.photos: {error}") from None
    if not 2 <= held_out <= len(photos):
        raise ValueError(
            f"data.held_out: must lie within 2..{len(photos)}, the number of photos; got"
            f" {held_out}"
        )
    return [photo for i, photo in enumerate(photos) if i % held_out], list(photos[::held_out])


def crops(
    photos: Sequence[Tensor], *, count: int, size: int, generator: torch.Generator
) -> Tensor:
    """Cut random square crops, turned and mirrored at random.

    The photos are (3, H, W) uint8, none smaller than the crops, which are (count, 3, size, size)
    float32, display values 0..1, on the same device. The generator is on the CPU: where the crops
    lie does not depend on the device.
    """
    # corners as shares: the draws do not depend on the photos' sizes
    indices = torch.randint(len(photos), (count,), generator=generator).tolist()
    corners = torch.rand(count, 2, generator=generator).tolist()
    symmetries = torch.randint(8, (count,), generator=generator).tolist()
    crops = []
    for index, (down, right), symmetry in zip(indices, corners, symmetries, strict=True):
        photo = photos[index]
        row = int(down * (photo.shape[1] - size + 1))
        column = int(right * (photo.shape[2] - size + 1))
        crop = photo[:, row : row + size, column : column + size]
        crop = torch.rot90(crop, symmetry % 4, (1, 2))
        if symmetry >= 4:
            crop = crop.flip(2)
        crops.append(crop)
    return torch.stack(crops).float() / 255


def _images(source: Path) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    """Yield (name, (H, W, 3) uint8 red green blue) in the order of the names."""
    if source.is_dir():
        for path in sorted(path for path in source.rglob("*") if path.suffix.lower() in PICTURES):
            yield path.name, _decoded(regular_file(path).read_bytes(), path)
    elif zipfile.is_zipfile(source):
        with zipfile.ZipFile(source) as pack:
            for name in sorted(pack.namelist()):
                try:
                    data = pack.read(name)
                except zipfile.BadZipFile as error:
                    raise ValueError(f"{source}: is damaged ({error})") from error
                yield name, _decoded(data, name)
    else:
        raise ValueError(f"{source}: must be a folder of photos or a .zip pack of them")


def _decoded(data: bytes, name: object) -> NDArray[np.uint8]:
    image = None
    if data:  # OpenCV asserts on none
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise ValueError(f"{name}: cannot be read as a photo")
    return np.asarray(image[..., ::-1], dtype=np.uint8)


def _shrunk(image: NDArray[np.uint8], most_px: int) -> NDArray[np.uint8]:
    scale = most_px / min(image.shape[:2])
    if scale >= 1:
        return image
    smaller = cv2.resize(
        np.ascontiguousarray(image), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA
    )
    return np.asarray(smaller, dtype=np.uint8)
