"""Search for codes of several photos of one motion that tell its order in time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import compress
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cep.calibration.order_separation import BLIND_ERROR, OrderSeparation
from cep.codes.published import published
from cep.optics.code import ShutterCode
from cep.search.limits import Limits, RunLimits, check_feasible, feasible, nearest
from cep.search.playable import within_device
from cep.search.sampling import draw
from hw.device import DeviceProfile, load_profile
from motdiff.types import FloatArray

Code = NDArray[np.int8]

_DRAWN = 16  # codes drawn for each limit on the openings, and the largest of these limits
_MOST_PULSES = 8
_SWEEPS = 6  # at most; it ends when a sweep gains nothing
_UNSEEN_PARTS = 8  # the motion may be unseen for one of so many parts of the exposure
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


def search_order_codes(
    limits: Limits,
    photos: int,
    *,
    measure: OrderSeparation,
    rng: np.random.Generator,
    progress: Callable[[float], None] = lambda _share: None,
) -> tuple[Code, ...]:
    """Search codes whose photos confuse orders of the fewest motions.

    The best of many codes are taken, and then changed edge by edge. Two photos or more begin with
    the open shutter where the limits allow it: it fixes the path, of which only the order is left
    to tell. At no time are all shutters closed for more than an eighth of the exposure, if it can
    be avoided.

    Parameters
    ----------
    limits : Limits
        That every code keeps.
    photos : int
    measure : OrderSeparation
        Of as many chips.
    rng : numpy Generator
    progress : callable
        Called with the finished share 0..1.

    Returns
    -------
    tuple of (n,) int8 of 0 and 1, one per photo

    Raises
    ------
    ValueError
        If every code within the limits is its own mirror image.
    """
    open_shutter = np.ones(limits.chips, dtype=np.int8)
    open_codes: list[Code] = []
    if photos > 1 and limits.satisfied(open_shutter[None])[0]:
        open_codes = [open_shutter]
    search = _Search(limits, measure)
    candidates = start_codes(limits)
    # one code beside the open shutter, if searched, fits the few walks of the design
    searched = not open_codes or photos > 2
    if searched or all(map(_is_own_mirror, candidates)):
        candidates += _random_codes(limits, rng)
    for i, code in enumerate(candidates):
        search.separation(code)
        progress(0.6 * i / len(candidates))
    chosen: list[Code] = []
    while len(open_codes) + len(chosen) < photos:
        # greedy at first; the sweeps below revise each choice
        companions = [*open_codes, *chosen]
        chosen.append(search.best(candidates, companions))
    for sweep in range(searched * _SWEEPS):
        before = search.score([*open_codes, *chosen])
        for i in range(len(chosen)):
            # one code at a time: sets of several are too many to be tried
            companions = [*open_codes, *chosen[:i], *chosen[i + 1 :]]
            chosen[i] = search.best([chosen[i], *candidates], companions)
            chosen[i] = search.best([chosen[i], *neighbours(limits, chosen[i])], companions)
        progress(0.6 + 0.4 * (sweep + 1) / _SWEEPS)
        if search.score([*open_codes, *chosen]) <= before:
            break
    if all(map(_is_own_mirror, chosen)):
        raise ValueError(
            f"chips: every code of {limits.chips} chips within the limits is its own mirror image,"
            " which tells no direction; more or shorter chips would do"
        )
    return (*open_codes, *chosen)


class _Search:
    """Scores of sets of codes within limits; what each code separates is computed once."""

    def __init__(self, limits: Limits, measure: OrderSeparation) -> None:
        self._limits = limits
        self._measure = measure
        self._separations: dict[bytes, FloatArray] = {}

    def separation(self, code: Code) -> FloatArray:
        key = code.tobytes()
        if key not in self._separations:
            self._separations[key] = self._measure.of(code)
        return self._separations[key]

    def score(self, codes: Sequence[Code]) -> tuple[int, float]:
        """Score of a set, higher is better: first what it loses for all walks, then for some."""
        chips = self._limits.chips
        excess = max(0, longest_unseen(np.stack(codes)) - max(1, chips // _UNSEEN_PARTS))
        if all(map(_is_own_mirror, codes)):
            # codes that are their own mirror image cannot tell a path from its reverse
            excess += chips
        # the worst order of each walk, but the mean over walks: a worst tenth fits the few walks
        # of the design
        separations = self._measure.of_each_motion(
            np.sum([self.separation(code) for code in codes], axis=0)
        )
        confused = np.exp(-separations / BLIND_ERROR)
        return -excess, -float(confused.mean())

    def best(self, codes: Sequence[Code], companions: Sequence[Code]) -> Code:
        """Return the code, the first of several, that makes the best set with the rest."""
        return max(codes, key=lambda code: self.score([*companions, code]))


def neighbours(limits: Limits, code: Code, *, single: bool = False) -> list[Code]:
    """Codes within the limits with one edge moved by up to 2 chips, or all by up to 3.

    With ``single``, those with one chip changed too.
    """
    moved_codes = [np.roll(code, by) for by in (-3, -1, 1, 3)]
    for edge in np.flatnonzero(np.diff(code)) + 1:
        for by in (-2, -1, 1, 2):
            first, end = sorted((edge, min(max(edge + by, 0), len(code))))
            neighbour = code.copy()
            # the run after the edge grows where it moves back, else the one before it
            neighbour[first:end] = code[edge - (by > 0)]
            moved_codes.append(neighbour)
    if single:
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


def longest_unseen(codes: ArrayLike) -> int:
    """Most chips in a row that are closed in every one of codes (I, n).

    Examples
    --------
    >>> longest_unseen([[1, 0, 0, 0], [0, 0, 0, 1]])
    2
    """
    union = ShutterCode(np.any(np.asarray(codes), axis=0))
    return max((length for is_open, length in union.runs if not is_open), default=0)


def longest_rest(codes: ArrayLike) -> int:
    """Most chips in a row over which no one of codes (I, n) switches.

    Examples
    --------
    >>> longest_rest([[1, 1, 1, 0, 0], [1, 1, 1, 1, 0]])
    3
    """
    switches = np.flatnonzero(np.diff(codes, axis=1).any(axis=0)) + 1
    return int(np.diff([0, *switches, np.shape(codes)[1]]).max())


def start_codes(limits: Limits) -> list[Code]:
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


def _random_codes(limits: Limits, rng: np.random.Generator) -> list[Code]:
    """Random codes of few openings."""
    codes: list[Code] = []
    for pulses in range(1, _MOST_PULSES + 1):
        few = replace(limits, runs=limits.runs.tightened(RunLimits(max_pulses=pulses)))
        if feasible(few):
            codes += list(draw(few, _DRAWN, rng=rng))
    return _without_repeats(codes)


def _without_repeats(codes: Sequence[Code]) -> list[Code]:
    return list({code.tobytes(): code for code in codes}.values())  # arrays have no hash


def _is_own_mirror(code: Code) -> bool:
    return bool((code == code[::-1]).all())


def _stretched(values: NDArray[Any], chips: int) -> NDArray[Any]:
    """Repeat values so that they last for so many chips, each as long as the others."""
    return values[np.arange(chips) * len(values) // chips]
