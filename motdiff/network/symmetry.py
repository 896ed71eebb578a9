"""The eight symmetries of the square, on the grids of photos, PSFs and HR maps."""

from __future__ import annotations

from torch import Tensor

SYMMETRIES = 8


def mirrored(maps: Tensor, symmetry: int, *, pitch: int) -> Tensor:
    """Turn or mirror maps (B, C, H, W) about the zero displacement by a symmetry of the square.

    The zero lies at index ``H // 2`` of a PSF's grid and at ``129.5`` of the HR map, half a PSF
    pixel off the array's middle: a flipped axis must be moved by one PSF pixel.

    Parameters
    ----------
    maps : (B, C, H, W)
    symmetry : int, 0..7
        1: rows flipped; 2: columns flipped; 4: transposed; added up.
    pitch : int
        Map pixels per PSF pixel: 1 for PSFs and physics maps, 4 for HR maps; 0 for photos, which
        have no centre.
    """
    if symmetry & 1:
        maps = maps.flip(2).roll(pitch, 2)
    if symmetry & 2:
        maps = maps.flip(3).roll(pitch, 3)
    return maps.transpose(2, 3) if symmetry & 4 else maps


def inverse_symmetry(symmetry: int) -> int:
    """Symmetry that undoes ``symmetry`` of :func:`mirrored`."""
    if symmetry < 4:
        return symmetry
    return 4 + 2 * (symmetry & 1) + (symmetry >> 1 & 1)  # transposed, the two flips change places
