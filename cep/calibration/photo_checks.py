"""Checks of photos before a search: their size, their texture, their number, their codes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from cep.optics.code import ShutterCode
from motdiff.estimators.coded.codes import check_codes
from motdiff.estimators.method import Method
from motdiff.estimators.registry import METHODS, blind_methods
from motdiff.photo_values import check_size, numbered_photo

_LEAST_CONTRAST = 2 / 255  # two steps of 8 bit: rounding alone makes one


def check_method_photos(photos: Sequence[ArrayLike], method: Method) -> None:
    """Refuse photos that the method cannot search, before anything slow is loaded.

    Raises
    ------
    ValueError
        If there are more than the method takes, or not as many as its codes, or as of
        :func:`check_photos`.
    """
    codes: tuple[str, ...] | None = getattr(method, "codes", None)
    if codes is not None:
        # a stack of three photos would pass for one in colour
        if len(photos) == 1 < len(codes) and np.ndim(photos[0]) >= 3:
            raise ValueError(
                "photo: give the photos of several codes as a list or tuple, not as one array"
            )
        check_codes(codes, photos=len(photos))
    elif len(photos) > 1 and not method.is_blind:
        raise ValueError(
            f"method: {method.name} takes one photo; several of one motion go with"
            f" {' or '.join(blind_methods())}"
        )
    check_photos(photos, method.name)


def check_apart(photos: Sequence[ArrayLike]) -> None:
    """Refuse a photo given twice: its noise would count as agreement.

    Raises
    ------
    ValueError
        If two photos are equal.
    """
    for (i, first), (j, second) in combinations(enumerate(photos, 1), 2):
        if np.array_equal(first, second):
            raise ValueError(f"photo {j}: is the same as photo {i}; give each photo once")


def check_times(codes: Sequence[ShutterCode]) -> None:
    """Refuse codes that were played at different speeds: they divide one motion in different ways.

    Raises
    ------
    ValueError
        If the codes' chips last differently.
    """
    for i, code in enumerate(codes, 1):
        if code.chip_ns != codes[0].chip_ns:
            raise ValueError(
                f"code {i}: its chips last {code.chip_ns} ns, those of the first one"
                f" {codes[0].chip_ns} ns; photos of one motion need codes of one duration"
            )


def check_photos(photos: Sequence[ArrayLike], method: str) -> None:
    """Refuse a photo that is too small for a method, without texture, or given twice.

    Parameters
    ----------
    photos : sequence of (H, W) or (H, W, 3) array_like, linear light 0..1
    method : str
        Name of a registered method.

    Raises
    ------
    ValueError
        Beginning with ``photo:``, where there are several with ``photo 2:``, what is wrong with
        it.
    """
    for number, photo in enumerate(photos, 1):
        with numbered_photo(number, count=len(photos)):
            check_size(photo, least_px=METHODS[method].smallest_px)
            check_texture(photo)
    check_apart(photos)


def check_texture(photo: ArrayLike) -> None:
    """Refuse a photo that is constant, black or white.

    Raises
    ------
    ValueError
        If the photo's values span less than two steps of 8 bit.
    """
    pixels = np.asarray(photo)
    darkest = float(pixels.min())  # not the mean: a lone light on a dark ground has texture
    brightest = float(pixels.max())
    if brightest - darkest >= _LEAST_CONTRAST:
        return
    shade = "the same"
    if brightest < _LEAST_CONTRAST:
        shade = "black"
    elif darkest > 1 - _LEAST_CONTRAST:
        shade = "white"
    raise ValueError(f"photo: is {shade} all over; motion shows only where the scene has texture")
