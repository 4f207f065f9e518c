"""Scans of two lasers that take turns on one topic under one frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sixthsense.config.section import shown_name
from sixthsense.core.geometry import Array
from sixthsense.core.laser import Scan

_FEWEST, _MOST_TRIPLES = 6, 100  # scans, and triples of successive ones that are compared
_BINS = 36  # of bearings, around a full turn
_LEAST_M = 0.1  # difference of two views, below which noise and the robot's own motion may make it
_RATIO = 0.25
"""Of a scan's difference from the second next one, to that from the next: a laser that moves has at least about 1."""
_SHARE = 0.8  # of the triples


def found_turns(scans: Sequence[Scan], frame: str) -> str | None:
    """What is wrong with scans of one topic and `frame` if they are those of two lasers in turn; None if they are not.

    Robots that stand, too: the next scan would else resemble the first as the second next one does.
    """
    if not _take_turns(scans):
        return None
    return f"found scans of two lasers in turn, all of frame {shown_name(frame)}, allowed: a frame for each laser"


def _take_turns(scans: Sequence[Scan]) -> bool:
    """Whether scans resemble the second next one and not the next one, along the whole log."""
    if len(scans) < _FEWEST:
        return False
    first = np.unique(np.linspace(0, len(scans) - 3, _MOST_TRIPLES).astype(int))
    found = [_resembles_the_second_next(*(_view(scan) for scan in scans[k : k + 3])) for k in first]
    return float(np.mean(found)) >= _SHARE


def _view(scan: Scan) -> Array:
    """(36,) median range in each sector of bearings, m; NaN where no beam has returned."""
    ranges = np.asarray(scan.ranges, dtype=np.float64)
    sector = np.floor(scan.bearings * (_BINS / (2.0 * np.pi))).astype(int) % _BINS
    returned = np.isfinite(ranges) & (ranges > 0.0) & (ranges <= scan.max_range)
    own = [ranges[returned & (sector == k)] for k in range(_BINS)]
    return np.array([np.median(values) if len(values) else np.nan for values in own])


def _resembles_the_second_next(first: Array, next_one: Array, second_next: Array) -> bool:
    to_next, to_second = _difference(first, next_one), _difference(first, second_next)
    return to_next > _LEAST_M and to_second < _RATIO * to_next


def _difference(one: Array, other: Array) -> float:
    """Median difference of two views, m; that of views which share no sector is infinite."""
    off = np.abs(one - other)
    return float(np.nanmedian(off)) if np.isfinite(off).any() else float("inf")
