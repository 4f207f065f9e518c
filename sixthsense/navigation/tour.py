"""The order in which views are visited: a short tour from the robot through all of them and home."""

from __future__ import annotations

import numba
import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.navigation.gridsearch import Cells

_LESS = 1e-6  # a tour that is not shorter by so much is as long


def stop_order(lengths: Array) -> Cells:
    """(n - 2,) the stops 1 to n - 2 in the order of a short tour from 0 through all to n - 1.

    `lengths` are (n, n), inf where no way is known. Nearest insertion, made shorter by 2-opt.
    """
    is_way = np.isfinite(lengths)
    no_way = lengths.sum(where=is_way) + 1.0  # more than any tour, and a number that can be added
    return np.asarray(_inserted(np.where(is_way, lengths, no_way))[1:-1])


@numba.njit(cache=True, error_model="numpy")
def _inserted(lengths: Array) -> Cells:
    """(n,) a tour from 0 to n - 1: the stop nearest to the tour is inserted where it costs least; then 2-opt."""
    last = len(lengths) - 1
    tour = np.array([0, last])
    away = np.minimum(lengths[0], lengths[last])
    away[0] = away[last] = np.inf
    for _ in range(last - 1):
        stop = np.argmin(away)
        best, at = np.inf, 1
        for k in range(len(tour) - 1):
            more = lengths[tour[k], stop] + lengths[stop, tour[k + 1]] - lengths[tour[k], tour[k + 1]]
            if more < best:
                best, at = more, k + 1
        tour = np.concatenate((tour[:at], np.array([stop]), tour[at:]))
        away = np.minimum(away, lengths[stop])
        away[tour] = np.inf
    better = True
    while better:
        better = False
        for i in range(1, last):
            for j in range(i + 1, last):
                before, first, end, after = tour[i - 1], tour[i], tour[j], tour[j + 1]
                kept = lengths[before, first] + lengths[end, after]
                if lengths[before, end] + lengths[first, after] < kept - _LESS:
                    for k in range((j + 1 - i) // 2):  # turned round
                        tour[i + k], tour[j - k] = tour[j - k], tour[i + k]
                    better = True
    return tour
