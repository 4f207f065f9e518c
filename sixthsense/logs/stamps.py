"""Stamps of records: which are the same instant, how much time they say has passed, and what they do not say."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sixthsense.core.geometry import Array
from sixthsense.core.source import seconds

_EXACT_S = 1e-6
"""What a float holds of a stamp in seconds since 1970, and less than any two scans are apart."""
_SECONDS = 1e8
"""Stamps since 1970 of any log are larger: it is of 1973."""
_MOSTLY = 0.5
"""Stamps of which a larger share repeats the one before are rounded, or not set: they tell no speed."""


def matched(stamps_s: ArrayLike, wanted_s: ArrayLike) -> NDArray[np.int64]:
    """Row of the stamp that is nearest to each wanted one, of equal ones the first; -1 if none is within half a period.

    `stamps_s` (N,) seconds in any order, `wanted_s` of any shape. The period is the median time between stamps.
    """
    stamps, wanted = np.asarray(stamps_s, dtype=np.float64), np.asarray(wanted_s, dtype=np.float64)
    if not len(stamps):
        return np.full(wanted.shape, -1)
    order = np.argsort(stamps, kind="stable")
    ordered, firsts = np.unique(stamps[order], return_index=True)
    period_s = float(np.median(np.diff(ordered))) if len(ordered) > 1 else 0.0
    after = np.clip(np.searchsorted(ordered, wanted), 1, max(len(ordered) - 1, 1))
    before, after = after - 1, np.minimum(after, len(ordered) - 1)
    nearest = np.where(wanted - ordered[before] <= ordered[after] - wanted, before, after)
    is_near = np.abs(ordered[nearest] - wanted) <= max(0.5 * period_s, _EXACT_S)
    return np.where(is_near, order[firsts][nearest], -1)


def passed_s(stamps_ns: ArrayLike) -> Array:
    """(N - 1,) seconds from each record to the next as far as their stamps tell; infinite where no stamp tells any.

    Records that share a stamp are spread evenly up to the next one: it is rounded, or that of a moment when several
    were written. Over a step back, and after the last stamp that differs, the usual time passes.
    """
    steps_s = 1e-9 * np.diff(np.asarray(stamps_ns, dtype=np.int64)).astype(np.float64)
    tells = np.flatnonzero(steps_s > 0.0)
    if not len(tells):
        return np.full(len(steps_s), np.inf)
    spread = np.full(len(steps_s), np.nan)
    begin = 0
    for end, step_s in enumerate(steps_s.tolist()):
        if step_s > 0.0:
            spread[begin : end + 1] = step_s / (end + 1 - begin)
        if step_s != 0.0:
            begin = end + 1
    return np.where(np.isnan(spread), np.nanmedian(spread), spread)


def tell_time(stamps_ns: ArrayLike) -> bool:
    """Whether most stamps (N,) differ from the one before, so that they put records in order."""
    stamps = np.asarray(stamps_ns, dtype=np.int64)
    return len(stamps) < 2 or bool(np.mean(np.diff(stamps) == 0) <= _MOSTLY)


def stamp_remarks(stamps_s: ArrayLike) -> list[str]:
    """A line on each thing that the stamps (N,), seconds, of scans in the order of the file do not tell."""
    stamps = np.asarray(stamps_s, dtype=np.float64)
    if len(stamps) < 2:
        return []
    steps, lines = np.diff(stamps), []
    if backward := int(np.count_nonzero(steps < 0.0)):
        lines.append(f"stamps decrease at {backward} scans; replayed in the order of the file")
    if stamps.min() == stamps.max():
        lines.append(
            f"all {len(stamps)} scans have the stamp {stamps[0]:.6f}; replayed in the order of the file, "
            "and no motion is judged by its speed"
        )
    elif not tell_time(np.round(stamps * 1e9)):
        repeated = int(np.count_nonzero(steps == 0.0))
        lines.append(
            f"{repeated} of {len(stamps)} scans have the stamp of the one before, as where stamps are rounded; "
            "replayed in the order of the file"
        )
    return lines


def from_zero_on(stamps_ns: NDArray[np.int64], remarks: list[str]) -> NDArray[np.int64]:
    """Stamps (N,), ns, moved so that none is below 0; a line on that is added to the remarks."""
    least = int(stamps_ns.min(initial=0))
    if least >= 0:
        return stamps_ns
    least_s = seconds(least)
    remarks.append(f"stamps begin at {least_s:.3f} s: those of the run are {-least_s:.3f} s later, from 0 on")
    return stamps_ns - least


def shown_span(stamps_ns: ArrayLike) -> str:
    """From the first to the last stamp, seconds, for a message."""
    stamps = np.asarray(stamps_ns, dtype=np.int64)
    return f"{1e-9 * stamps.min():.3f} to {1e-9 * stamps.max():.3f} s"


def unit_of(stamps: Array) -> tuple[int, str]:
    """Parts of a second, and their name, that stamps since 1970 of this size are in; seconds for any others."""
    largest = float(np.abs(stamps).max(initial=0.0))
    for parts, name in ((10**9, "nanoseconds"), (10**6, "microseconds"), (10**3, "milliseconds")):
        if largest > _SECONDS * parts:
            return parts, name
    return 1, "seconds"
