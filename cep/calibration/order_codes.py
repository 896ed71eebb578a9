"""Search for the code of one more photo of a motion, which tells its orders in time apart."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import compress
from math import ceil, log2
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cep.calibration.order_contrast import OrderContrast
from cep.codes.published import published
from cep.search.limits import Limits, RunLimits, check_feasible, nearest
from cep.search.playable import within_device
from cep.search.sampling import draw
from hw.device import DeviceProfile, load_profile
from motdiff.types import FloatArray

Code = NDArray[np.int8]

_Rating = tuple[int, float]  # chips too many at rest, negative; what a score says

_DRAWN = 64  # random codes to begin with
_HARD_PAIRS = 32  # pairs of orders that the search looks at; the best codes are judged by all
_BEAMS = 2  # codes whose neighbours are tried
_MOST_ROUNDS = 10
_FINALISTS = 8
_GRAY_PLANES = (1, 2, 3, 4)  # 2 to 16 bins of time
# de Bruijn sequences of order 3, 4 and 5: each window of so many chips occurs once, so a piece of
# the code shows when it was played
_DE_BRUIJN = ("00010111", "0000100110101111", "00000100011001010011101011011111")


def allowed_limits(
    chips: int, chip_ns: int, device: DeviceProfile | str | None
) -> tuple[Limits, DeviceProfile | None]:
    """Return the limits of a calibration code, open throughout too, and the device's profile.

    Raises
    ------
    ValueError
        If the device is not known or can play no such code.
    """
    if isinstance(device, str):
        device = load_profile(device)
    limits = Limits(chips, (1, chips))
    if device is not None:
        playable = within_device(
            device, chips=chips, chip_ns=chip_ns, open_range=(1, chips), runs=RunLimits()
        )
        limits = Limits(chips, playable.open_range, playable.runs)
    check_feasible(limits)
    return limits, device


def least_chi_square(chi_squares: FloatArray) -> FloatArray:
    """Chi-square (C,) of the two orders most alike, of chi-squares (C, P)."""
    return np.asarray(chi_squares.min(axis=1))


def search_next(
    contrast: OrderContrast,
    limits: Limits,
    *,
    score: Callable[[FloatArray], FloatArray] = least_chi_square,
    rng: np.random.Generator,
    progress: Callable[[float], None] = lambda _share: None,
) -> tuple[Code, float]:
    """Search the code within limits whose photo tells orders apart best.

    The best of known and random codes are changed chip by chip while that helps, judged by the
    pairs of orders that are hard; the best of these are judged by all pairs. No longer than in a
    random code, ``log2(n)`` of ``n`` chips, do all shutters rest as they are, if it can be
    avoided: in that time photos show the path, but not which way it ran, and the right path may be
    none of these orders.

    Parameters
    ----------
    contrast : OrderContrast
        Of the orders, after the photos that are taken already.
    limits : Limits
    score : callable
        Of each code, higher is better, from chi-squares (C, P) of codes and pairs of orders; that
        of the two orders most alike when omitted.
    rng : numpy Generator
    progress : callable
        Called with the finished share 0..1.

    Returns
    -------
    (n,) int8 of 0 and 1, and its score
    """
    allowed = ceil(log2(limits.chips))

    def rated(codes: Sequence[Code], contrast: OrderContrast) -> list[_Rating]:
        scores = score(contrast.of(codes)).tolist()
        return [
            (-_lost_chips([*contrast.codes, code], allowed), value)
            for code, value in zip(codes, scores, strict=True)
        ]

    starts = [*_start_codes(limits), *draw(limits, _DRAWN, rng=rng)]
    first = contrast.of(starts[: _DRAWN // 4])
    # what is hard for one of several codes: a pair easy for all of them stays easy
    hard = contrast.among(np.argsort(first.min(axis=0))[:_HARD_PAIRS])
    keys = [code.tobytes() for code in starts]
    ratings = dict(zip(keys, rated(starts, hard), strict=True))
    expanded: set[bytes] = set()
    for turn in range(_MOST_ROUNDS):
        progress((turn + 1) / (_MOST_ROUNDS + 1))
        beams = sorted(ratings, key=ratings.__getitem__, reverse=True)[:_BEAMS]
        fresh = [key for key in beams if key not in expanded]
        if not fresh:
            break
        expanded.update(fresh)
        new = {
            neighbour.tobytes(): neighbour
            for key in fresh
            for neighbour in _neighbours(limits, np.frombuffer(key, dtype=np.int8))
        }
        new = {key: code for key, code in new.items() if key not in ratings}
        if new:
            ratings.update(zip(new, rated(list(new.values()), hard), strict=True))
    finalists = sorted(ratings, key=ratings.__getitem__, reverse=True)[:_FINALISTS]
    codes = [np.frombuffer(key, dtype=np.int8) for key in finalists]
    final_ratings = rated(codes, contrast)
    best = max(range(len(codes)), key=final_ratings.__getitem__)
    return codes[best].copy(), final_ratings[best][1]


def _neighbours(limits: Limits, code: Code) -> list[Code]:
    """Codes within the limits with one edge moved by up to 2 chips, all by up to 3, or a chip."""
    moved_codes = [np.roll(code, by) for by in (-3, -1, 1, 3)]
    for edge in np.flatnonzero(np.diff(code)) + 1:
        for by in (-2, -1, 1, 2):
            first, end = sorted((edge, min(max(edge + by, 0), len(code))))
            neighbour = code.copy()
            # the run after the edge grows where it moves back, else the one before it
            neighbour[first:end] = code[edge - (by > 0)]
            moved_codes.append(neighbour)
    moved_codes += list(code ^ np.eye(len(code), dtype=np.int8))
    return list(compress(moved_codes, limits.satisfied(np.stack(moved_codes))))


def gray_planes(planes: int, chips: int) -> Code:
    """Bit planes (planes, chips) of a Gray code of 2^planes bins, the slowest first.

    Examples
    --------
    >>> gray_planes(3, 8)[2].tolist()
    [0, 1, 1, 0, 0, 1, 1, 0]
    """
    number = _stretched(np.arange(2**planes), chips)
    # n XOR n / 2 (Gray 1953): neighbouring bins differ in one plane alone
    return np.asarray((number ^ (number >> 1)) >> np.arange(planes)[::-1, None] & 1, dtype=np.int8)


def _lost_chips(codes: Sequence[NDArray[Any]], allowed: int) -> int:
    """Chips at rest beyond those allowed; all more where codes tell no direction."""
    lost = max(0, longest_rest(np.stack(codes)) - allowed)
    return lost + tells_no_direction(codes) * len(codes[0])


def tells_no_direction(codes: Sequence[NDArray[Any]]) -> bool:
    """Whether each code is its own mirror image: a path and its reverse then look alike."""
    return all(np.array_equal(code, code[::-1]) for code in codes)


def longest_rest(codes: ArrayLike) -> int:
    """Most chips in a row over which no one of codes (I, n) switches.

    Examples
    --------
    >>> longest_rest([[1, 1, 1, 0, 0], [1, 1, 1, 1, 0]])
    3
    """
    switches = np.flatnonzero(np.diff(codes, axis=1).any(axis=0)) + 1
    return int(np.diff([0, *switches, np.shape(codes)[1]]).max())


def _start_codes(limits: Limits) -> list[Code]:
    """Known codes and their complements, brought within the limits."""
    chips = limits.chips
    texts = (*_DE_BRUIJN, published("raskar-52").code.bits)
    codes = [plane for planes in _GRAY_PLANES for plane in gray_planes(planes, chips)]
    codes += [_stretched(np.array(list(text), dtype=np.int8), chips) for text in texts]
    # open ever more often
    ramp = np.diff(np.floor(0.5 * chips * np.linspace(0, 1, chips + 1) ** 2 + 0.5)) > 0
    codes.append(ramp.astype(np.int8))
    allowed = (nearest(limits, code) for plain in codes for code in (plain, 1 - plain))
    return _without_repeats([code for code in allowed if code is not None])


def _without_repeats(codes: Sequence[Code]) -> list[Code]:
    return list({code.tobytes(): code for code in codes}.values())  # arrays have no hash


def _stretched(values: NDArray[Any], chips: int) -> NDArray[Any]:
    """Repeat values so that they last for so many chips, each as long as the others."""
    return values[np.arange(chips) * len(values) // chips]
