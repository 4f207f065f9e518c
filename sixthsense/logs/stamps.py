"""Stamps of records: which are the same instant, and how much time they say has passed."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sixthsense.core.geometry import Array

_EXACT_S = 1e-6
"""What a float holds of a stamp in seconds since 1970, and less than any two scans are apart."""
_SECONDS = 1e8
"""Stamps since 1970 of any log are larger: it is of 1973."""


def matched(stamps_s: ArrayLike, wanted_s: ArrayLike) -> NDArray[np.int64]:
    """Row of the stamp that is nearest to each wanted one, of equal ones the first; -1 if none is within half a period.

    `stamps_s` (N,) seconds in any order, `wanted_s` of any shape. The period is the median time between stamps.
    """
    import pandas as pd  # here, since it takes a while to load

    wanted = np.asarray(wanted_s, dtype=np.float64)
    ordered, firsts = np.unique(np.asarray(stamps_s, dtype=np.float64), return_index=True)
    half_s = 0.5 * float(np.median(np.diff(ordered))) if len(ordered) > 1 else 0.0
    rows = pd.Index(ordered).get_indexer(wanted.ravel(), method="nearest", tolerance=max(half_s, _EXACT_S))
    return np.asarray(np.append(firsts, -1)[rows].reshape(wanted.shape))


def ascending(stamps_ns: ArrayLike) -> NDArray[np.int64]:
    """Stamps (N,), ns, each at least 1 ns after the previous one, so that records keep the order of the file."""
    count = np.arange(np.size(stamps_ns))
    return np.asarray(np.maximum.accumulate(np.asarray(stamps_ns, dtype=np.int64) - count) + count)


def passed_s(stamps_ns: ArrayLike) -> Array:
    """(N - 1,) seconds from each record to the next as far as their stamps tell; infinite where no stamp tells any.

    Records that share a stamp, to a microsecond, are spread evenly up to the next one: it is rounded, or that of a
    moment when several were written.
    """
    steps_s = 1e-9 * np.diff(np.asarray(stamps_ns, dtype=np.int64)).astype(np.float64)
    ends = np.flatnonzero(steps_s > _EXACT_S)
    if not len(ends):
        return np.full(len(steps_s), np.inf)
    counts = np.diff(ends, prepend=-1)
    spread = np.repeat(steps_s[ends] / counts, counts)
    return np.concatenate([spread, np.full(len(steps_s) - len(spread), np.median(spread))])


def unit_of(stamps: Array) -> tuple[int, str]:
    """Parts of a second, and their name, that stamps since 1970 of this size are in; seconds for any others."""
    largest = float(np.abs(stamps).max(initial=0.0))
    for parts, name in ((10**9, "nanoseconds"), (10**6, "microseconds"), (10**3, "milliseconds")):
        if largest > _SECONDS * parts:
            return parts, name
    return 1, "seconds"
