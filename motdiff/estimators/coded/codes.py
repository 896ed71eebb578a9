"""Codes that show the order in time of a motion: their check, and when they are open."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from motdiff.types import FloatArray


def check_codes(
    codes: Sequence[str], *, photos: int | None = None, tell_order: bool = True
) -> None:
    """Refuse codes from which no order in time follows.

    Parameters
    ----------
    codes : sequence of str
        Bits, one code per photo.
    photos : int, optional
        Number of photos.
    tell_order : bool
        Whether the photos are to show the order in time.

    Raises
    ------
    ValueError
        If the numbers of photos and codes differ, a code has no open chip, the codes' numbers of
        chips differ, or each of them is its own mirror image.
    """
    if photos is not None and photos != len(codes):
        raise ValueError(f"code: needs one for each photo, got {len(codes)} for {photos} photos")
    for i, code in enumerate(codes, 1):
        if not code or set(code) - set("01") or "1" not in code:
            raise ValueError(
                f"code {i}: needs bits with at least one open chip, got {code[:40]!r}"
            )
        if len(code) != len(codes[0]):
            raise ValueError(
                f"code {i}: has {len(code)} chips, the first one {len(codes[0])}; one motion is"
                " divided in one way"
            )
    if not tell_order:
        return
    if all("0" not in code for code in codes):
        raise ValueError(
            "code: order cannot be known from photos with the shutter open throughout; take one"
            " through a code"
        )
    if all(code == code[::-1] for code in codes):
        raise ValueError(
            "code: the direction cannot be known from codes that are their own mirror images; take"
            " one through another"
        )


def open_at(codes: Sequence[str], times: FloatArray) -> FloatArray:
    """Whether each code is open, 1 or 0, at times (T,) of the exposure, 0..1: (I, T)."""
    return np.stack(
        [
            np.array(list(code), dtype=np.float64)[(times * len(code)).astype(np.intp)]
            for code in codes
        ]
    )


def middles(steps: int) -> FloatArray:
    """Middle of each of so many time steps of the exposure, 0..1."""
    return np.asarray((np.arange(steps) + 0.5) / steps)
