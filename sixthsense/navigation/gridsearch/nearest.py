"""A shortest path to the nearest of several cells, in a small window."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sixthsense.slam.mapping.freespace import Bools


def path_to_nearest(free: Bools, wanted: Bools, cell_m: float, limit_m: float) -> NDArray[np.int64] | None:
    """The cells (N, 2) of a shortest path over `free` from the centre of a square window to a cell of `wanted`.

    Masks are (S, S), S odd. None if there is no path of at most `limit_m`.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    side = len(free)
    cells = np.arange(side * side).reshape(side, side)
    first, second, cost = [], [], []
    for down, across in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = np.s_[: side - down, max(-across, 0) : side - max(across, 0)]
        there = np.s_[down:, max(across, 0) : side + min(across, 0)]
        both = free[here] & free[there]
        if down and across:  # no corner is cut
            both &= free[here[0], there[1]] & free[there[0], here[1]]
        first.append(cells[here][both])
        second.append(cells[there][both])
        cost.append(np.full(np.count_nonzero(both), cell_m * math.hypot(down, across)))
    shape = (side * side, side * side)
    graph = coo_array((np.concatenate(cost), (np.concatenate(first), np.concatenate(second))), shape).tocsr()
    centre = int(cells[side // 2, side // 2])
    found = dijkstra(graph, False, [centre], True, limit=limit_m)
    distance, predecessor = found[0][0], found[1][0]
    distance = np.where(wanted.ravel() & free.ravel(), distance, np.inf)
    end = int(np.argmin(distance))
    if not math.isfinite(distance[end]):
        return None
    path = [end]
    while path[-1] != centre:
        path.append(int(predecessor[path[-1]]))
    return np.stack(np.divmod(np.array(path[::-1], dtype=np.int64), side), axis=1)
