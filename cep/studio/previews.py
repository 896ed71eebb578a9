"""Small copies of photos, as the page shows them, beside the photos themselves."""

from __future__ import annotations

from pathlib import Path

from motdiff.types import FloatArray

PREVIEW_PX = 1600
"""Longest side of what the page shows of a photo."""


def write_preview(file: Path, name: str, image: FloatArray) -> None:
    """Write every n-th pixel of an image as ``STEM_NAME.jpg`` beside a photo's file.

    Parameters
    ----------
    file : Path
        Of the photo.
    name : str
    image : (H, W) or (H, W, 3) float, linear light
        Values outside 0..1 are clipped.
    """
    from cep.files.images import encode_image
    from motdiff.files.outputs import write_bytes

    step = max(1, -(-max(image.shape[:2]) // PREVIEW_PX))
    write_bytes(
        file.with_name(f"{file.stem}_{name}.jpg"), encode_image(image[::step, ::step], ".jpg")
    )
