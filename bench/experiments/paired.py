"""Statistics of paired differences: the sign test, and intervals for mean and median."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Paired:
    """Differences a - b of pairs. Intervals are NaN where too few pairs give none of that confidence."""

    pairs: int
    smaller: int  # a < b
    larger: int
    sign_test_p: float  # two-sided
    mean: float
    mean_interval: tuple[float, float]  # Student's t
    median: float
    median_interval: tuple[float, float]  # of order statistics: no assumption on the distribution


def sign_test(smaller: int, larger: int) -> float:
    """Two-sided p of the exact sign test; ties are left out (Dixon and Mood 1946)."""
    if smaller + larger == 0:
        return 1.0
    return float(stats.binomtest(smaller, smaller + larger, 0.5).pvalue)


def mean_interval(differences: Array, confidence: float) -> tuple[float, float]:
    count = len(differences)
    if count < 2:
        return math.nan, math.nan
    half = stats.t.ppf(0.5 + confidence / 2, count - 1) * differences.std(ddof=1) / math.sqrt(count)
    return float(differences.mean() - half), float(differences.mean() + half)


def median_interval(differences: Array, confidence: float) -> tuple[float, float]:
    """The narrowest symmetric pair of order statistics that covers the median so often (Conover 1999, section 3.2)."""
    ordered, count = np.sort(differences), len(differences)
    rank = int(stats.binom.ppf((1 - confidence) / 2, count, 0.5))  # of the first that may be cut off
    while rank > 0 and 2 * stats.binom.cdf(rank - 1, count, 0.5) > 1 - confidence:
        rank -= 1
    if rank == 0:
        return math.nan, math.nan
    return float(ordered[rank - 1]), float(ordered[count - rank])


def paired(a: list[float], b: list[float], confidence: float = 0.95) -> Paired:
    """Compares a with b pair by pair; pairs with a NaN are left out."""
    if len(a) != len(b):
        raise ValueError(f"{len(a)} values are not paired with {len(b)}")
    differences = np.asarray(a, float) - np.asarray(b, float)
    differences = differences[~np.isnan(differences)]
    smaller, larger = int((differences < 0).sum()), int((differences > 0).sum())
    none = len(differences) == 0
    return Paired(
        len(differences),
        smaller,
        larger,
        sign_test(smaller, larger),
        math.nan if none else float(differences.mean()),
        mean_interval(differences, confidence),
        math.nan if none else float(np.median(differences)),
        median_interval(differences, confidence),
    )
