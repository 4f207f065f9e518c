"""First level: partition a scan where neighbouring ranges jump (report eq. 4; Borges and Aldon 2004)."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.config import PartitionConfig
from sixthsense.core.geometry import Array

Indices = NDArray[np.int64]


@numba.njit(cache=True, error_model="numpy")
def _is_break(r0: float, r1: float, gap: float, spacing: float, epsilon: float, incidence: float, sigma: float) -> bool:
    """Whether two neighbouring returns, `gap` apart in bearing, with beams `spacing` apart, are in two partitions.

    `incidence` 0 selects the fixed jump `epsilon`.
    """
    if not (math.isfinite(r0) and math.isfinite(r1)):
        return True
    if incidence <= 0.0:
        return abs(r1 - r0) > epsilon  # report eq. 4
    # Borges and Aldon 2004, eq. 9: the farthest the next return can be if the wall is met no flatter than `incidence`.
    gap_sq = r0 * r0 + r1 * r1 - 2.0 * r0 * r1 * math.cos(gap)
    allowed = min(r0, r1) * math.sin(spacing) / math.sin(max(incidence - spacing, 1e-3)) + 3.0 * sigma
    return gap_sq > allowed * allowed


@numba.njit(cache=True, error_model="numpy")
def _partition(
    ranges: Array, gaps: Array, spacing: float, closed: bool, epsilon: float, incidence: float, sigma: float
) -> tuple[int, Indices, bool]:
    """First beam, (P, 2) first and past-last position from there, and whether the only piece closes on itself."""
    n = ranges.shape[0]
    offset = 0
    cyclic = False
    if closed:
        # Begin at a break, so that no piece straddles the seam; a scan without any begins at its farthest return,
        # which lies in a corner.
        offset = -1
        for i in range(n):
            if _is_break(ranges[i - 1], ranges[i], gaps[i], spacing, epsilon, incidence, sigma):
                offset = i
                break
        if offset < 0:
            offset = int(np.argmax(ranges))
            cyclic = True
    pieces = np.empty((n, 2), np.int64)
    count = 0
    for k in range(n):
        r = ranges[(offset + k) % n]
        if not math.isfinite(r):
            continue
        before, gap = ranges[(offset + k - 1) % n], gaps[(offset + k) % n]
        if k == 0 or _is_break(before, r, gap, spacing, epsilon, incidence, sigma):
            pieces[count, 0] = k
            count += 1
        pieces[count - 1, 1] = k + 1
    return offset, pieces[:count].copy(), cyclic


def partition(
    ranges: Array, spacing: float, closed: bool, sigma: float, config: PartitionConfig, gaps: Array | None = None
) -> tuple[int, Indices, bool]:
    """Split a scan into runs of returns without a jump.

    `ranges` (N,) metres, inf for no return; `spacing` radians between beams; `closed` if the first beam follows the
    last; `sigma` of a range, metres; `gaps` (N,) radians between each beam and the one before where they are not all
    `spacing`. Returns `(offset, pieces, cyclic)`: piece p covers the beams `(offset + k) % N`
    for k in `range(*pieces[p])`; `cyclic` says that the only piece closes on itself.
    """
    incidence = config.incidence_rad if config.method == "adaptive" else 0.0
    found: tuple[int, Indices, bool] = _partition(
        ranges,
        np.full(len(ranges), spacing) if gaps is None else gaps,
        spacing,
        closed,
        config.epsilon_m,
        incidence,
        sigma,
    )
    return found
