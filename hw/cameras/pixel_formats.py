"""Pixel formats of GenICam: names of monochrome and Bayer ones, unpacked to whole code values."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_NAME = re.compile(r"(?:Mono|Bayer(RG|GR|GB|BG))(?:(8|10|12|14|16)|(10|12)(p|Packed))")
# colours of the second row follow from the first: greens lie on a diagonal
_SECOND_ROW = {"RG": "GB", "GR": "BG", "GB": "RG", "BG": "GR"}


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """A format of one value a pixel.

    Attributes
    ----------
    name : str
        By GenICam's convention (PFNC), as ``BayerRG12p``.
    bits : int
    packing : str
        ``p``: a stream of bits, the lowest first. ``Packed``: two pixels in three bytes, as GigE
        Vision has it. Empty: one or two bytes a pixel.
    bayer : str or None
        Colours of the first two rows, as ``RGGB``.
    """

    name: str
    bits: int
    packing: str
    bayer: str | None

    def unpack(
        self, data: bytes | memoryview, shape: tuple[int, int], *, padding: int = 0
    ) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Return the (H, W) code values of an image; ``padding`` bytes follow each of its rows.

        Raises
        ------
        ValueError
            If the data are too short for the shape.
        """
        import numpy as np  # not before a camera is opened

        height, width = shape
        octets = np.frombuffer(data, np.uint8)
        if padding:
            stride = self._bytes(width) + padding
            rows = octets[: height * stride].reshape(height, stride)[:, :-padding]
            values = np.concatenate([self._values(row, width) for row in rows])
        else:
            values = self._values(octets, height * width)
        return values.reshape(shape)

    def _bytes(self, pixels: int) -> int:
        if self.packing == "Packed":
            return (pixels * 3 + 1) // 2
        return (pixels * (self.bits if self.packing else 8 * (1 + (self.bits > 8))) + 7) // 8

    def _values(
        self, octets: NDArray[np.uint8], pixels: int
    ) -> NDArray[np.uint8] | NDArray[np.uint16]:
        import numpy as np

        if len(octets) < self._bytes(pixels):
            raise ValueError(
                f"{len(octets)} bytes for {pixels} pixels of {self.name}: {self._bytes(pixels)}"
                " are needed"
            )
        octets = octets[: self._bytes(pixels)]
        # GenICam's numbers are little-endian, the array is in the machine's order
        if not self.packing:
            return octets.copy() if self.bits == 8 else octets.view("<u2").astype(np.uint16)
        # the shortest run of whole bytes that holds whole pixels
        group, count = (5, 4) if (self.packing, self.bits) == ("p", 10) else (3, 2)
        padded = np.zeros(-(-pixels // count) * group, np.uint16)
        padded[: len(octets)] = octets
        parts = padded.reshape(-1, group)
        values = np.empty((len(parts), count), np.uint16)
        if self.packing == "p":
            for pixel in range(count):
                byte, shift = divmod(pixel * self.bits, 8)
                values[:, pixel] = parts[:, byte] >> shift | parts[:, byte + 1] << (8 - shift)
            values &= 2**self.bits - 1
        else:  # the low bits of both pixels share the byte between their high ones
            low = self.bits - 8
            mask = 2**low - 1
            values[:, 0] = parts[:, 0] << low | parts[:, 1] & mask
            values[:, 1] = parts[:, 2] << low | parts[:, 1] >> 4 & mask
        return values.reshape(-1)[:pixels]


def pixel_format(name: str) -> PixelFormat | None:
    """Return the format of a name; None if it is neither monochrome nor Bayer.

    Examples
    --------
    >>> pixel_format("BayerRG12p")
    PixelFormat(name='BayerRG12p', bits=12, packing='p', bayer='RGGB')
    >>> pixel_format("RGB8") is None
    True
    """
    if (match := _NAME.fullmatch(name)) is None:
        return None
    first, unpacked, packed, packing = match.groups()
    bayer = first and first + _SECOND_ROW[first]
    return PixelFormat(name, int(unpacked or packed), packing or "", bayer)


def deepest(names: tuple[str, ...]) -> PixelFormat | None:
    """Return the format of most bits, unpacked rather than packed; None if none fits.

    Of a camera with one Bayer pattern it is that of the sensor: its monochrome ones are computed
    from it. A camera that offers several patterns is an emulated one, and has a grey picture.

    Examples
    --------
    >>> deepest(("Mono8", "Mono12p", "Mono12", "RGB8")).name
    'Mono12'
    >>> deepest(("Mono12", "BayerRG8", "BayerRG12")).name
    'BayerRG12'
    """
    formats = [layout for name in names if (layout := pixel_format(name)) is not None]
    mosaic = len({layout.bayer for layout in formats} - {None}) == 1
    return max(
        formats,
        key=lambda layout: ((layout.bayer is not None) == mosaic, layout.bits, not layout.packing),
        default=None,
    )
