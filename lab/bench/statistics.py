"""Summary statistics of benchmarks: mean, spread, and clustered confidence intervals."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from motdiff.types import FloatArray

# two show their spread by one difference: Student's t then reaches 13 standard errors
_FEWEST_CLUSTERS = 3
_RESAMPLES = 10_000
_AT_ONCE = 2_000_000  # numbers drawn at a time: 16 MB


@dataclass(frozen=True)
class Summary:
    """A figure over many cells; NaN where there are too few.

    Attributes
    ----------
    n : int
    mean, median : float
    sd : float
        Of the population they are drawn from (n - 1).
    q05, q95 : float
        Quantiles, interpolated.
    """

    n: int
    mean: float
    median: float
    sd: float
    q05: float
    q95: float


@dataclass(frozen=True)
class Interval:
    """Confidence interval of a mean.

    Attributes
    ----------
    mean, low, high : float
        Infinite ends where there are one or two clusters, which say next to nothing of the spread
        between clusters.
    level : float
        Probability that such an interval holds the true mean.
    n, clusters : int
        Values, and clusters: of the scarcer kind where two kinds cross.
    """

    mean: float
    low: float
    high: float
    level: float
    n: int
    clusters: int

    @property
    def excludes_zero(self) -> bool:
        """Whether the interval excludes zero."""
        return self.low > 0 or self.high < 0


def summarized(values: Iterable[float]) -> Summary:
    """Sum up values that are not NaN; an infinite one makes the mean infinite and the spread
    NaN.
    """
    numbers = np.array(list(values), dtype=float)
    if numbers.size == 0:
        return Summary(0, *(float("nan"),) * 5)
    with np.errstate(invalid="ignore"):  # infinite less infinite
        sd = float(numbers.std(ddof=1)) if numbers.size > 1 else float("nan")
    q05, median, q95 = (_quantile(np.sort(numbers), share) for share in (0.05, 0.5, 0.95))
    return Summary(numbers.size, float(numbers.mean()), median, sd, q05, q95)


def mean_interval(
    values: ArrayLike,
    *,
    rng: np.random.Generator,
    clusters: Sequence[Hashable] | None = None,
    level: float = 0.95,
    resamples: int = _RESAMPLES,
) -> Interval:
    """Bootstrap the mean, studentised: whole clusters are drawn again, and each draw is scaled by
    its own error.

    With ten clusters intervals of 95 % hold the true mean in 95 % of trials; percentile and BCa
    intervals in 89-91 %.

    Parameters
    ----------
    values : (n,) array_like, finite
    rng : numpy.random.Generator
    clusters : n labels, optional
        Values that share a photo, say, are no independent evidence: they are drawn together. Each
        its own when omitted.
    level : float, 0..1
    resamples : int

    Returns
    -------
    Interval

    Raises
    ------
    ValueError
        If there are no values, one is not finite, or the labels do not fit.
    """
    x = _checked(values, () if clusters is None else (clusters,), level)
    if resamples < 1000:
        raise ValueError(f"resamples: must be at least 1000, got {resamples}")
    numbers: dict[Hashable, int] = {}
    members = [
        numbers.setdefault(label, len(numbers))
        for label in (range(x.size) if clusters is None else clusters)
    ]
    sizes = np.bincount(members).astype(float)
    # relative to the first value: equal values then have no spread from rounding
    sums: FloatArray = np.bincount(members, weights=x - x[0]).astype(float)
    count = len(numbers)
    offset = float(sums.sum() / sizes.sum())
    mean = float(x[0]) + offset
    if count < _FEWEST_CLUSTERS:
        return Interval(mean, -np.inf, np.inf, level, x.size, count)
    error = float(_errors(np.ones((1, count)), sums, sizes)[0])
    if error == 0:  # clusters that differ by rounding only have no spread
        return Interval(mean, mean, mean, level, x.size, count)
    pivots = np.concatenate(
        [
            _pivots(_draws(count, size, rng), sums, sizes, offset)
            for size in _portions(resamples, count)
        ]
    )
    # whole draws, no interpolation: a draw without spread is infinite
    low = np.quantile(pivots, (1 - level) / 2, method="lower")
    high = np.quantile(pivots, (1 + level) / 2, method="higher")
    return Interval(
        mean, float(mean - high * error), float(mean - low * error), level, x.size, count
    )


def crossed_interval(
    values: ArrayLike,
    clusters: Sequence[Hashable],
    others: Sequence[Hashable],
    *,
    level: float = 0.95,
) -> Interval:
    """Interval of the mean where values share two things at once: every photo is taken with the
    same motions.

    The variances by either clustering are added and that of single values is taken away; Student's
    t with the scarcer clusters' degrees of freedom.

    Parameters
    ----------
    values : (n,) array_like, finite
    clusters, others : n labels each
    level : float, 0..1

    Raises
    ------
    ValueError
        As :func:`mean_interval`.

    References
    ----------
    Cameron, Gelbach and Miller, "Robust inference with multiway clustering", J. Business &
    Economic Statistics 2011.
    """
    x = _checked(values, (clusters, others), level)
    mean = float(x.mean())
    counts, variances = zip(
        *(_clustered(x - mean, labels) for labels in (clusters, others)), strict=True
    )
    scarcest = min(counts)
    if scarcest < _FEWEST_CLUSTERS:
        return Interval(mean, -np.inf, np.inf, level, x.size, scarcest)
    joint = _clustered(x - mean, list(zip(clusters, others, strict=True)))[1]
    error = float(np.sqrt(max(sum(variances) - joint, *variances)))
    reach = float(stats.t.ppf((1 + level) / 2, scarcest - 1)) * error
    return Interval(mean, mean - reach, mean + reach, level, x.size, scarcest)


def _quantile(ordered: FloatArray, share: float) -> float:
    """Interpolate linearly; at a value itself it is that value, though the next one is infinite
    (NaN with numpy).
    """
    place = share * (ordered.size - 1)
    below = int(place)
    first = ordered[below]
    second = ordered[min(below + 1, ordered.size - 1)]
    return float(
        first if place == below or first == second else first + (place - below) * (second - first)
    )


def _checked(values: ArrayLike, labels: Sequence[Sequence[Hashable]], level: float) -> FloatArray:
    x = np.asarray(values, dtype=float)
    if x.ndim != 1 or x.size == 0 or not np.isfinite(x).all():
        raise ValueError(f"values: must be finite numbers in one row, got shape {x.shape}")
    for clusters in labels:
        if len(clusters) != x.size:
            raise ValueError(
                f"clusters: must be one label per value, got {len(clusters)} for {x.size}"
            )
    if not 0 < level < 1:
        raise ValueError(f"level: must be between 0 and 1, got {level:g}")
    return x


def _clustered(away: FloatArray, labels: Sequence[Hashable]) -> tuple[int, float]:
    """Count clusters, and estimate the variance of the mean from them; ``away`` are distances from
    the mean.
    """
    numbers: dict[Hashable, int] = {}
    sums = np.bincount([numbers.setdefault(label, len(numbers)) for label in labels], weights=away)
    count = len(numbers)
    return count, float((sums**2).sum()) / away.size**2 * count / max(1, count - 1)


def _draws(count: int, size: int, rng: np.random.Generator) -> FloatArray:
    """Return how often each of ``count`` clusters is in each of ``size`` draws of as many:
    ``(size, count)``.
    """
    indices = rng.integers(0, count, (size, count)) + count * np.arange(size)[:, None]
    return np.bincount(indices.ravel(), minlength=size * count).reshape(size, count).astype(float)


def _pivots(draws: FloatArray, sums: FloatArray, sizes: FloatArray, offset: float) -> FloatArray:
    """Return each draw's distance from the mean in units of the draw's own error."""
    away = (draws @ sums) / (draws @ sizes) - offset
    errors = _errors(draws, sums, sizes)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(
            errors > 0, away / errors, np.where(away == 0, 0.0, np.copysign(np.inf, away))
        )


def _errors(draws: FloatArray, sums: FloatArray, sizes: FloatArray) -> FloatArray:
    """Return the standard error of the mean of each draw: that of a ratio of sums over clusters,
    to first order.
    """
    count = len(sums)
    totals = draws @ sizes
    means = (draws @ sums) / totals
    squares = (
        draws @ sums**2 - 2 * means * (draws @ (sums * sizes)) + means**2 * (draws @ sizes**2)
    )
    # what is left of equal clusters is rounding
    rounding = 1e-12 * (draws @ sums**2)
    return np.asarray(
        np.sqrt(np.where(squares > rounding, squares, 0) * count / (count - 1)) / totals
    )


def _portions(resamples: int, count: int) -> list[int]:
    size = max(1, _AT_ONCE // count)
    return [min(size, resamples - start) for start in range(0, resamples, size)]
