"""The code of the next photo: the one that tells the orders apart which the photos left open."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil, log2
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cep.calibration.order_codes import (
    allowed_limits,
    longest_rest,
    neighbours,
    start_codes,
)
from cep.calibration.order_contrast import OrderContrast, SceneLight
from cep.files.code_files import StoredCode, write_code
from cep.optics.code import ShutterCode
from cep.search.limits import Limits
from cep.search.sampling import draw
from hw.device import DeviceProfile
from motdiff.crops import luminance
from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.coded.starts import orders
from motdiff.metrics import rms_distance_px
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

Code = NDArray[np.int8]

SURE = 0.95
"""Probability of an order from which no other photo is needed."""

_KNOTS = 53
_MOST_ORDERS = 40
_ALIKE_PX = 2.0  # orders nearer than this, rms, do no harm
_TOLD = 400.0  # chi-square beyond which photos taken rule an order out, errors of the model too
_DRAWN = 64  # random codes to begin with
_HARD_PAIRS = 32  # pairs of orders that the search looks at; the best codes are judged by all
_BEAMS = 2  # codes whose neighbours are tried
_MOST_ROUNDS = 10
_FINALISTS = 8

_Rating = tuple[int, float]  # chips too many at rest, negative; least chi-square


@dataclass(frozen=True)
class NextCode:
    """Code for the next photo of a motion, and why.

    Attributes
    ----------
    code : ShutterCode
    orders : int
        Orders in time that the photos so far leave open, the right one among them.
    chi_square : float
        Between the two of them that are most alike, with a photo through this code.
    before : float
        The same without it.
    device : DeviceProfile or None
        That can play it.
    """

    code: ShutterCode
    orders: int
    chi_square: float
    before: float
    device: DeviceProfile | None = None

    @property
    def reason(self) -> str:
        """Why this code, in one sentence."""
        return (
            f"the photos so far leave {self.orders} orders in time open, and this code tells the"
            f" two most alike apart (chi-square {self.chi_square:,.0f}, so far {self.before:,.0f})"
        )

    def to_dict(self) -> dict[str, Any]:
        """Fields for JSON."""
        return {
            "bits": self.code.bits,
            "orders": self.orders,
            "chi_square": self.chi_square,
            "chi_square_before": self.before,
            "reason": self.reason,
        }

    def save(self, path: Path | str) -> None:
        """Write it as a code file, the reason in its ``problem``."""
        about = {
            "next_code": self.to_dict(),
            "device": self.device.to_dict() if self.device else None,
        }
        write_code(path, StoredCode(self.code, problem=about))


def next_code(
    photos: Sequence[ArrayLike],
    codes: Sequence[ShutterCode],
    estimate: MotionEstimate,
    *,
    least_probability: float = SURE,
    chips: int = 52,
    chip_ns: int = 1_000_000,
    device: DeviceProfile | str | None = None,
    rng: np.random.Generator,
    progress: Callable[[float], None] = lambda _share: None,
) -> NextCode | None:
    """Choose the code of the next photo of a motion, after what the last ones showed.

    Parameters
    ----------
    photos : sequence of I (H, W) or (H, W, 3) array_like, linear light 0..1
        The first with the shutter open.
    codes : sequence of I ShutterCode
        Theirs; may be left empty for one open photo.
    estimate : MotionEstimate
        From these photos: of one its path, in all orders; of more its paths, each again with its
        loops reversed.
    least_probability : float
        Stated probability from which no other photo is needed.
    chips, chip_ns : int
        Of the code where the photos' codes do not say.
    device : DeviceProfile or str, optional
        That can play it.
    rng : numpy Generator
    progress : callable
        Called with the finished share 0..1.

    Returns
    -------
    NextCode, or None
        None where the order is stated as probable as asked for, or the photos show no motion.

    Raises
    ------
    ValueError
        If the device can play no such code.
    """
    if is_sure(estimate, codes, least_probability=least_probability):
        return None
    timed = [code for code in codes if code.chips > 1]  # an open shutter alone has no chips
    if timed:
        chips, chip_ns = timed[0].chips, timed[0].chip_ns
    limits, profile = allowed_limits(chips, chip_ns, device)
    scene = SceneLight.of(luminance(photos[0]), estimate.best)
    photo_codes = [code.array for code in timed] or [np.ones(chips)]
    paths = open_orders(estimate.trajectories)
    contrast = OrderContrast(paths, photo_codes, chips=chips, scene=scene)
    surviving = survivors(contrast, len(estimate.trajectories))
    if len(surviving) < len(paths):
        contrast = OrderContrast(paths[surviving], photo_codes, chips=chips, scene=scene)
    code, chi_square = search_next(contrast, limits, rng=rng, progress=progress)
    return NextCode(
        ShutterCode(code, chip_ns),
        orders=contrast.count,
        chi_square=chi_square,
        before=float(contrast.taken().min()),
        device=profile,
    )


def is_sure(
    estimate: MotionEstimate, codes: Sequence[ShutterCode], *, least_probability: float = SURE
) -> bool:
    """Whether no other photo is needed: the order is sure, or the photos show no motion.

    Parameters are those of :func:`next_code`.
    """
    if estimate.details.get("motion_blur") is False:
        return True
    probability = estimate.details.get("order_confidence", 0.0)
    return bool(codes) and isinstance(probability, float) and probability >= least_probability


def open_orders(paths: Sequence[Trajectory]) -> FloatArray:
    """Orders in time (N, K, 2) of some paths, 40 at most, none within 2 px rms of another.

    The paths themselves come first, then the orders of the first one, of the second, and so on.
    """
    listed = [orders(path, knots=_KNOTS, count=_MOST_ORDERS) for path in paths]
    distinct: list[FloatArray] = []
    for path in [order[0] for order in listed] + [o for order in listed for o in order[1:]]:
        centred = path - path.mean(axis=0)
        if all(rms_distance_px(centred, chosen_path) > _ALIKE_PX for chosen_path in distinct):
            distinct.append(centred)
        if len(distinct) == _MOST_ORDERS:
            break
    if len(distinct) == 1:  # shorter than that: its reverse is the one question left
        distinct.append(distinct[0][::-1])
    return np.stack(distinct)


def survivors(contrast: OrderContrast, count: int) -> NDArray[np.intp]:
    """Return indices of the orders not told from one of the first ``count`` by the photos taken.

    At least two: where the photos rule out all others, the most similar one stays.
    """
    between = contrast.taken()
    table = np.zeros((contrast.count, contrast.count))
    table[tuple(contrast.pairs)] = table[tuple(contrast.pairs[::-1])] = between
    nearest = table[:count].min(axis=0)
    surviving = np.flatnonzero(nearest < _TOLD)
    if len(surviving) > 1:
        return surviving
    return np.sort(np.argsort(nearest, kind="stable")[:2])


def search_next(
    contrast: OrderContrast,
    limits: Limits,
    *,
    rng: np.random.Generator,
    progress: Callable[[float], None] = lambda _share: None,
) -> tuple[Code, float]:
    """Search the code within limits whose photo tells the hardest two orders apart best.

    The best of known and random codes are changed chip by chip while that helps, judged by the
    pairs of orders that are hard; the best of these are judged by all pairs. No longer than in a
    random code, ``log2(n)`` of ``n`` chips, do all shutters rest as they are, if it can be
    avoided: in that time photos show the path, but not which way it ran, and the right path may be
    none of these orders.

    Returns
    -------
    (n,) int8 of 0 and 1, and its least chi-square
    """
    allowed = ceil(log2(limits.chips))

    def rated(codes: Sequence[Code], pairs: NDArray[np.intp] | None = None) -> list[_Rating]:
        chi_squares = contrast.of(codes, pairs).min(axis=1).tolist()
        longest = [longest_rest([*contrast.codes, code]) for code in codes]
        return [
            (-max(0, rest_chips - allowed), chi_square)
            for rest_chips, chi_square in zip(longest, chi_squares, strict=True)
        ]

    starts = [*start_codes(limits), *draw(limits, _DRAWN, rng=rng)]
    first = contrast.of(starts[: _DRAWN // 4])
    # what is hard for one of several codes: a pair easy for all of them stays easy
    hard = np.argsort(first.min(axis=0))[:_HARD_PAIRS]
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
            for neighbour in neighbours(limits, np.frombuffer(key, dtype=np.int8), single=True)
        }
        new = {key: code for key, code in new.items() if key not in ratings}
        if new:
            ratings.update(zip(new, rated(list(new.values()), hard), strict=True))
    finalists = sorted(ratings, key=ratings.__getitem__, reverse=True)[:_FINALISTS]
    codes = [np.frombuffer(key, dtype=np.int8) for key in finalists]
    final_ratings = rated(codes)
    best = max(range(len(codes)), key=final_ratings.__getitem__)
    return codes[best].copy(), final_ratings[best][1]
