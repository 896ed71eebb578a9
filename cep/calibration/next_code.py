"""The code of the next photo: the one that tells the orders apart which the photos left open."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cep.calibration.order_codes import allowed_limits, search_next
from cep.calibration.order_contrast import ALIKE_PX, ORDER_KNOTS, TOLD, OrderContrast, SceneLight
from cep.files.code_files import StoredCode, write_code
from cep.optics.code import ShutterCode
from cep.search.limits import Limits
from hw.device import DeviceProfile
from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.coded.estimator import LARGEST_PROBABILITY
from motdiff.estimators.coded.starts import orders
from motdiff.metrics import rms_distance_px
from motdiff.photo_values import luminance
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

SURE = 0.95
"""Probability of an order from which no other photo is needed."""

_MOST_ORDERS = 40


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
        Stated probability from which no other photo is needed, at most 0.97.
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
        If the device can play no such code, or ``least_probability`` is out of range.
    """
    limits, profile = next_limits(
        codes, least_probability=least_probability, chips=chips, chip_ns=chip_ns, device=device
    )
    if is_sure(estimate, codes, least_probability=least_probability):
        return None
    timed = timed_codes(codes)
    chips = limits.chips
    chip_ns = timed[0].chip_ns if timed else chip_ns
    scene = SceneLight.of(luminance(photos[0]), estimate.best)
    photo_codes = [code.array for code in timed] or [np.ones(chips)]
    # one open photo's alternatives are orders of its path as well, which are all listed anyway
    open_paths = estimate.trajectories if len(photos) > 1 else (estimate.best,)
    paths, explaining = open_orders(open_paths)
    contrast = OrderContrast(paths, photo_codes, chips=chips, scene=scene)
    surviving = survivors(contrast, explaining)
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


def next_limits(
    codes: Sequence[ShutterCode],
    *,
    least_probability: float = SURE,
    chips: int = 52,
    chip_ns: int = 1_000_000,
    device: DeviceProfile | str | None = None,
) -> tuple[Limits, DeviceProfile | None]:
    """Return the limits of the next code, and the device's profile.

    Called before the motion is estimated, it refuses what :func:`next_code` would refuse after it.
    """
    if not 0 <= least_probability <= LARGEST_PROBABILITY:
        raise ValueError(
            f"least_probability: must be within 0..{LARGEST_PROBABILITY}, the largest that is"
            f" stated, got {least_probability:g}"
        )
    timed = timed_codes(codes)
    if timed:
        chips, chip_ns = timed[0].chips, timed[0].chip_ns
    return allowed_limits(chips, chip_ns, device)


def timed_codes(codes: Sequence[ShutterCode]) -> list[ShutterCode]:
    """Codes with chips, which an open shutter alone has not."""
    return [code for code in codes if code.chips > 1]


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


def open_orders(paths: Sequence[Trajectory]) -> tuple[FloatArray, int]:
    """List the orders in time of some paths, 40 at most, none within 2 px rms of another.

    Returns
    -------
    orders : (N, K, 2) float, px
        The paths themselves, then the other orders of the first one, of the second, and so on.
    count : int
        How many of them are paths themselves.
    """
    listed = [orders(path, knots=ORDER_KNOTS, count=_MOST_ORDERS) for path in paths]
    themselves = _distinct([order[0] for order in listed])
    distinct = _distinct([*themselves, *(path for order in listed for path in order[1:])])
    if len(distinct) == 1:  # shorter than that: its reverse is the one question left
        distinct.append(distinct[0][::-1])
    return np.stack(distinct), len(themselves)


def _distinct(paths: Sequence[FloatArray]) -> list[FloatArray]:
    """First paths (K, 2), centred, that are not within 2 px rms of one before; 40 at most."""
    distinct: list[FloatArray] = []
    for path in paths:
        centred = path - path.mean(axis=0)
        if all(rms_distance_px(centred, chosen_path) > ALIKE_PX for chosen_path in distinct):
            distinct.append(centred)
        if len(distinct) == _MOST_ORDERS:
            break
    return distinct


def survivors(contrast: OrderContrast, count: int) -> NDArray[np.intp]:
    """Return indices of the orders not told from one of the first ``count`` by the photos taken.

    At least two: where the photos rule out all others, the most similar one stays.
    """
    between = contrast.taken()
    table = np.zeros((contrast.count, contrast.count))
    table[tuple(contrast.pairs)] = table[tuple(contrast.pairs[::-1])] = between
    nearest = table[:count].min(axis=0)
    surviving = np.flatnonzero(nearest < TOLD)
    if len(surviving) > 1:
        return surviving
    return np.sort(np.argsort(nearest, kind="stable")[:2])
