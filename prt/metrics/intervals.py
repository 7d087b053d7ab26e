"""Means with confidence intervals, and verdicts on claims.

Values that share a group (the lightings of one view, the views of one seed) are not independent, so a
group, not a value, is the unit that chance draws. From ``FEW`` groups on, the interval is the percentile
bootstrap over groups; below, where the bootstrap is too narrow (with five groups a nominal 95 % covers
about 83 %), Student's t with the cluster-robust variance. One group alone says nothing about spread: its
interval is NaN, and a claim resting on it undecided.
"""

from collections.abc import Hashable, Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from scipy import stats

from prt.errors import PrtError

if TYPE_CHECKING:
    from prt.metrics.registry import Direction

Verdict = Literal["holds", "fails", "undecided"]
#: differences below this are rounding
TIE = 1e-9
#: fewer groups than this use Student's t
FEW = 20
RESAMPLES = 2000


class Interval(NamedTuple):
    """The mean of ``n`` values and its confidence interval."""

    mean: float
    lo: float
    hi: float
    n: int


def mean_interval(
    values: Sequence[float],
    confidence: float = 0.95,
    seed: int = 0,
    groups: Sequence[Hashable] | None = None,
) -> Interval:
    """The mean of ``values`` with its interval; deterministic in ``seed``.

    A NaN or infinite value is not dropped: it makes the mean NaN or infinite and the interval NaN.

    Args:
        values: n numbers; none gives (NaN, NaN, NaN, 0).
        confidence: in (0, 1).
        seed: of the bootstrap.
        groups: n labels; equal labels are values that are not independent. Each its own by default.

    Raises:
        PrtError: if ``confidence`` is out of range or ``groups`` has another length.
    """
    if not 0 < confidence < 1:
        raise PrtError(f"confidence={confidence}: must lie between 0 and 1, such as 0.95")
    x, member = _grouped(values, groups)
    mean = float(x.mean()) if x.size else np.nan
    if not _spread_known(x, member):
        return Interval(mean, np.nan, np.nan, x.size)
    sizes = np.bincount(member)
    if len(sizes) < FEW:
        half = float(stats.t.ppf(0.5 + confidence / 2, len(sizes) - 1)) * _robust_error(x, member)
        return Interval(mean, mean - half, mean + half, x.size)
    lo, hi = _bootstrap(np.bincount(member, weights=x), sizes, confidence, seed)
    return Interval(mean, lo, hi, x.size)


def standard_error(values: Sequence[float], groups: Sequence[Hashable] | None = None) -> float:
    """The standard error of the mean, values that share a group counted as one draw; NaN for one group alone.

    Raises:
        PrtError: if ``groups`` has another length.
    """
    x, member = _grouped(values, groups)
    return _robust_error(x, member) if _spread_known(x, member) else np.nan


def _grouped(values: Sequence[float], groups: Sequence[Hashable] | None) -> tuple[np.ndarray, np.ndarray]:
    """The values, and the number of each one's group."""
    x = np.asarray(values, dtype=np.float64).reshape(-1)
    if groups is not None and len(groups) != x.size:
        raise PrtError(f"groups has {len(groups)} labels for {x.size} values; give one label a value")
    index: dict[Hashable, int] = {}
    labels = range(x.size) if groups is None else groups
    return x, np.array([index.setdefault(label, len(index)) for label in labels], dtype=np.int64)


def _spread_known(x: np.ndarray, member: np.ndarray) -> bool:
    return bool(np.isfinite(x).all()) and len(np.unique(member)) > 1


def _robust_error(x: np.ndarray, member: np.ndarray) -> float:
    """Root of the cluster-robust variance of the mean."""
    residuals = np.bincount(member, weights=x - x.mean())
    count = residuals.size
    return float(np.sqrt(count / (count - 1) * np.sum(residuals**2)) / x.size)


def _bootstrap(sums: np.ndarray, sizes: np.ndarray, confidence: float, seed: int) -> tuple[float, float]:
    """Percentiles of the mean over groups drawn with replacement."""
    drawn = np.random.default_rng(seed).integers(0, sums.size, (RESAMPLES, sums.size))
    means = sums[drawn].sum(axis=1) / sizes[drawn].sum(axis=1)
    tail = 50 * (1 - confidence)
    lo, hi = np.percentile(means, [tail, 100 - tail])
    return float(lo), float(hi)


def better(interval: Interval, direction: "Direction", margin: float = 0.0) -> Verdict:
    """Whether the first of two is better by more than ``margin``, from the interval of first less second.

    Undecided where the interval contains ``margin``, or where there is none (one group, NaN).
    """
    lo, hi = (interval.lo, interval.hi) if direction == "higher" else (-interval.hi, -interval.lo)
    return "holds" if lo > margin + TIE else "fails" if hi < margin - TIE else "undecided"
