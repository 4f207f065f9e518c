"""How uncertain keyframes are relative to one of them, along the graph of links (Dijkstra)."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array

_CHAIN = -2  # the group of arcs between consecutive keyframes


class UncertaintyGraph:
    """Arcs between keyframes with the variances of their relative poses."""

    def __init__(self) -> None:
        self._ends = np.zeros((128, 2), dtype=np.int64)
        self._variances = np.zeros((128, 3))
        self._group = np.zeros(128, dtype=np.int64)
        self._count = 0
        self._stand_ins: dict[int, int] = {}
        """of a keyframe that was taken out: the one before it"""

    def add(
        self, before: int, after: int, position_m2: float, heading_rad2: float, group: int = _CHAIN, bias_m: float = 0.0
    ) -> None:
        """Add an arc with the variances of position and heading; arcs of a `group` can be removed together.

        Without a group it belongs to the chain from each keyframe to the next.

        `bias_m` is a sigma of position that all arcs have in common: on a path these add up, not their squares.
        """
        if self._count == len(self._ends):
            self._ends = np.concatenate([self._ends, np.zeros_like(self._ends)])
            self._variances = np.concatenate([self._variances, np.zeros_like(self._variances)])
            self._group = np.concatenate([self._group, np.zeros_like(self._group)])
        self._ends[self._count] = before, after
        self._variances[self._count] = position_m2, heading_rad2, bias_m
        self._group[self._count] = group
        self._count += 1

    def remove(self, groups: Collection[int]) -> None:
        """Remove the arcs of these groups."""
        self._keep(np.flatnonzero(~np.isin(self._group[: self._count], list(groups))))

    def _keep(self, kept: NDArray[np.int64]) -> None:
        for rows in (self._ends, self._variances, self._group):
            rows[: len(kept)] = rows[kept]
        self._count = len(kept)

    def take_out(self, keys: Sequence[int]) -> None:
        """Take keyframes out, ascending: their arcs of the chain are joined, and others lost.

        What was known of one is from then on what is known of the one before it.
        """
        ends, variances = self._ends[: self._count], self._variances[: self._count]
        is_chain = self._group[: self._count] == _CHAIN
        is_lost = ~is_chain & np.isin(ends, keys).any(axis=1)
        for key in keys:
            (to,), (on,) = (np.flatnonzero(is_chain & ~is_lost & (ends[:, k] == key)) for k in (1, 0))
            self._stand_ins[key] = int(ends[to, 0])
            ends[on, 0] = ends[to, 0]
            variances[on] += variances[to]
            is_lost[to] = True
        self._keep(np.flatnonzero(~is_lost))

    def sigmas(self, source: int, poses: Array) -> tuple[Array, Array]:
        """(K,) sigmas of position, m, and of heading, rad, relative to keyframe `source`; infinite where unconnected.

        `poses` (K, 3). An arc's variance of heading counts with a third of the squared distance from the source, as
        that of a random walk of the heading over that distance does.
        """
        count = self._count
        tails = np.concatenate([self._ends[:count, 0], self._ends[:count, 1]])
        heads = np.concatenate([self._ends[:count, 1], self._ends[:count, 0]])
        variances = np.concatenate([self._variances[:count], self._variances[:count]])
        order = np.argsort(tails, kind="stable")
        first = np.searchsorted(tails[order], np.arange(len(poses) + 1))
        found = _spread(source, first, heads[order], variances[order], poses)
        found[list(self._stand_ins)] = found[list(self._stand_ins.values())]
        return np.sqrt(found[:, 0]), np.sqrt(found[:, 1])


@numba.njit(cache=True, error_model="numpy")
def _spread(source: int, first: NDArray[np.int64], heads: NDArray[np.int64], variances: Array, poses: Array) -> Array:
    """(K, 2) variances of position and heading on the path of least variance of position; Dijkstra with a heap.

    `first` (K + 1,) are the rows in `heads` and `variances` (m, 3) of each keyframe's arcs.
    """
    n, m = len(poses), len(heads)
    # Variance of position, of heading, the position's own part, the largest distance on the path, and the bias.
    found = np.empty((n, 5))
    found[:, 0], found[:, 1], found[:, 2], found[:, 3], found[:, 4] = np.inf, np.inf, 0.0, 0.0, 0.0
    found[source, 0] = found[source, 1] = 0.0
    costs, nodes, size = np.empty(m + 1), np.empty(m + 1, np.int64), 1
    costs[0], nodes[0] = 0.0, source
    is_done = np.zeros(n, np.bool_)
    while size > 0:
        node = nodes[0]
        size -= 1
        _sift_down(costs, nodes, size)
        if is_done[node]:
            continue
        is_done[node] = True
        for arc in range(first[node], first[node + 1]):
            other = heads[arc]
            if is_done[other]:
                continue
            dx, dy = poses[other, 0] - poses[source, 0], poses[other, 1] - poses[source, 1]
            farthest = max(found[node, 3], np.sqrt(dx * dx + dy * dy))
            own, heading = found[node, 2] + variances[arc, 0], found[node, 1] + variances[arc, 1]
            bias = found[node, 4] + variances[arc, 2]
            cost = own + bias * bias + heading * farthest * farthest / 3.0
            if cost < found[other, 0]:
                found[other, 0], found[other, 1], found[other, 2], found[other, 3] = cost, heading, own, farthest
                found[other, 4] = bias
                _push(costs, nodes, size, cost, other)
                size += 1
    return found[:, :2].copy()


@numba.njit(cache=True, error_model="numpy")
def _push(costs: Array, nodes: NDArray[np.int64], size: int, cost: float, node: int) -> None:
    """Add to a heap of `size` entries."""
    i = size
    while i > 0 and costs[(i - 1) // 2] > cost:
        costs[i], nodes[i] = costs[(i - 1) // 2], nodes[(i - 1) // 2]
        i = (i - 1) // 2
    costs[i], nodes[i] = cost, node


@numba.njit(cache=True, error_model="numpy")
def _sift_down(costs: Array, nodes: NDArray[np.int64], size: int) -> None:
    """Move the last entry of a heap, at `size`, into the place of the first."""
    cost, node, i = costs[size], nodes[size], 0
    while 2 * i + 1 < size:
        child = 2 * i + 1
        if child + 1 < size and costs[child + 1] < costs[child]:
            child += 1
        if costs[child] >= cost:
            break
        costs[i], nodes[i] = costs[child], nodes[child]
        i = child
    costs[i], nodes[i] = cost, node
