"""The order in which views are visited: a short tour from the robot through all of them and home.

Lengths are in cells. They are measured over tiles, squares of a few cells: a tile is entered from the next one where
two passable cells meet across the edge between them. So no length leads through a wall that is thicker than a tile.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.core.ordering import ascending
from sixthsense.navigation.gridsearch.cost_tree import MOVES
from sixthsense.navigation.gridsearch.prices import DIAGONAL, STRAIGHT
from sixthsense.navigation.gridsearch.reached import TILE
from sixthsense.navigation.regions import Cells
from sixthsense.slam.mapping.freespace import Bools

_STOPS = 30  # so many views are visited by a tour, those with the shortest ways
_LEG = 0.15  # the way to the first stop counts so much more: what is seen early may shorten the rest
_OPTIONS = 6  # nearest views that may be the first stop instead of the tour's
_SEGMENT = 3  # most stops that are moved at once
_LESS = 1e-6  # a tour that is not shorter by so much is as long
_RING = DIAGONAL + 1  # more than the longest step

Links = NDArray[np.uint8]
"""(H, W) of each tile: a bit for each neighbour, set if it leads there; across a corner, by a third tile."""
Steps = NDArray[np.int32]
Cell = tuple[int, int]


class TileWays:
    """Lengths of ways over the passable cells of one map, kept up to date."""

    def __init__(self, tile: int) -> None:
        """Begin without a map."""
        self.tile = tile
        """cells a side of a tile"""
        self._shape: tuple[int, ...] = 0, 0
        self._make(self._shape)

    def update(self, passable: Bools, changed: Bools | None = None) -> None:
        """Take in another map (H, W), `changed` (R, C) where it may differ, or everywhere: tiles of `TILE` cells."""
        rows = cols = slice(0, max(passable.shape))
        if passable.shape != self._shape:
            self._make(passable.shape)
        elif changed is not None:
            r, c = np.nonzero(changed)
            if len(r) == 0:
                return
            rows, cols = (slice(int(k.min()) * TILE, (int(k.max()) + 1) * TILE) for k in (r, c))
        # A tile's links hang on its own cells and on those of its neighbours.
        bounds = [
            (max(span.start // self.tile - 2, 0), min(span.stop // self.tile + 3, count))
            for span, count in zip((rows, cols), self._links.shape, strict=True)
        ]
        _link(passable, self.tile, (self._across, self._up), self._links, *bounds)

    def _make(self, shape: tuple[int, ...]) -> None:
        self._shape, tiles = shape, (shape[0] // self.tile + 1, shape[1] // self.tile + 1)
        self._links: Links = np.zeros(tiles, dtype=np.uint8)
        # Whether each tile leads to the next one of its row, and to that in the next row; the rim leads nowhere.
        self._across, self._up = np.zeros((2, tiles[0] + 2, tiles[1] + 2), dtype=np.bool_)

    def lengths(self, cell: Cell, cells: Cells) -> Array:
        """(N,) lengths from a cell to `cells` (N, 2); inf without a way."""
        both = np.vstack([np.array([cell], dtype=np.int64), cells])
        return np.asarray(self._between(both, 1)[0, 1:])

    def matrix(self, cells: Cells) -> Array:
        """(N, N) lengths between cells (N, 2); inf without a way."""
        lengths = self._between(cells, len(cells))
        return lengths + lengths.T

    def _between(self, cells: Cells, sources: int) -> Array:
        """(M, N) lengths from the first M of cells (N, 2) to those after each; 0 for the others."""
        lengths = _lengths(self._links, cells // self.tile, sources) * (self.tile / STRAIGHT)
        straight = np.hypot(*(cells[:sources, None] - cells).transpose(2, 0, 1))
        return np.asarray(np.triu(np.maximum(lengths, straight), 1))


def view_order(ways: TileWays, here: Cell, views: Cells, home: Cell) -> Cells:
    """(K,) the indices of those of `views` (N, 2) that a short tour from `here` to home stops at, in its order.

    One view in a tile is a stop, of the nearest ones.
    """
    away = ways.lengths(here, views)
    nearest = np.argsort(away, kind="stable")
    if np.isfinite(away).any():
        nearest = nearest[np.isfinite(away[nearest])]  # a view that only beams lead to has no way over the tiles yet
    _, one_each = np.unique(views[nearest] // ways.tile, axis=0, return_index=True)
    stops = nearest[np.sort(one_each)][:_STOPS]
    lengths = np.zeros((len(stops) + 2, len(stops) + 2))
    lengths[1:-1, 1:-1] = ways.matrix(views[stops])
    lengths[0, 1:-1] = lengths[1:-1, 0] = away[stops]
    homewards = ways.lengths(home, views[stops])
    if np.isfinite(homewards).all():  # else the tour is open
        lengths[-1, 1:-1] = lengths[1:-1, -1] = homewards
    return np.asarray(stops[stop_order(lengths) - 1])


def stop_order(lengths: Array) -> Cells:
    """(n - 2,) the stops 1 to n - 2 in the order of a tour from 0 through all to n - 1.

    `lengths` are (n, n), inf where no way is known. Of the first stop of a short tour and the nearest ones, that is
    first with the least way to it, which counts a little more, plus the best tour found from there; the lowest of
    equals.
    """
    is_way = np.isfinite(lengths)
    no_way = lengths.sum(where=is_way) + 1.0  # more than any tour, and a number that can be added
    return np.asarray(_stop_order(np.where(is_way, lengths, no_way)))


@numba.njit(cache=True, error_model="numpy")
def _link(
    passable: Bools,
    tile: int,
    leads: tuple[Bools, Bools],
    links: Links,
    rows: tuple[int, int],
    cols: tuple[int, int],
) -> None:
    """Write the `links` of the tiles in some rows and columns, and whether they lead to the next ones, `leads`."""
    height, width = passable.shape
    across, up = leads
    for r in range(rows[0], rows[1]):
        for c in range(cols[0], cols[1]):
            leads_across = leads_up = False
            past_r, past_c = (r + 1) * tile, (c + 1) * tile
            if past_c < width:
                for row in range(r * tile, min(past_r, height)):
                    leads_across |= passable[row, past_c - 1] and passable[row, past_c]
            if past_r < height:
                for col in range(c * tile, min(past_c, width)):
                    leads_up |= passable[past_r - 1, col] and passable[past_r, col]
            across[r + 1, c + 1], up[r + 1, c + 1] = leads_across, leads_up
    for r in range(rows[0] + 1, rows[1] + 1):
        for c in range(cols[0] + 1, cols[1] + 1):
            link = 0
            for k in range(8):
                dr, dc = MOVES[k]
                below, left = r + min(dr, 0), c + min(dc, 0)
                if dr == 0:
                    is_link = across[r, left]
                elif dc == 0:
                    is_link = up[below, c]
                else:
                    is_link = (across[r, left] and up[below, c + dc]) or (up[below, c] and across[r + dr, left])
                link |= is_link << k
            links[r - 1, c - 1] = link


@numba.njit(cache=True, error_model="numpy")
def _lengths(links: Links, tiles: Cells, sources: int) -> Array:
    """(M, N) lengths, in steps, of ways from the first M of tiles (N, 2) to those after each; inf without one."""
    width = links.shape[1]
    lengths = np.full((sources, len(tiles)), np.inf)
    at = tiles[:, 0] * width + tiles[:, 1]
    steps: Steps = np.empty(links.size, dtype=np.int32)
    stacks = np.empty((_RING, links.size), dtype=np.int32)
    moves = np.empty(8, dtype=np.int64)
    for k in range(8):
        moves[k] = MOVES[k][0] * width + MOVES[k][1]
    wanted = np.zeros(links.size, dtype=np.bool_)
    wanted[at] = True
    missing = wanted.sum()
    for i in range(sources):
        _search(links.ravel(), moves, at[i], (wanted, missing), stacks, steps)
        for j in range(i + 1, len(tiles)):
            if steps[at[j]] >= 0:
                lengths[i, j] = steps[at[j]]
        if wanted[at[i]] and not (at[i + 1 :] == at[i]).any():
            wanted[at[i]] = False
            missing -= 1
    return lengths


@numba.njit(cache=True, error_model="numpy")
def _search(
    links: NDArray[np.uint8],
    moves: NDArray[np.int64],
    start: int,
    wanted: tuple[Bools, int],
    stacks: NDArray[np.int32],
    steps: Steps,
) -> None:
    """Write the lengths of ways from a tile to `steps`, -1 for none, until so many of the `wanted` tiles are met.

    Tiles are flat indices, `moves` what is added to one for each neighbour. Dijkstra's search with a ring of buckets: a
    tile is in a bucket once at most.
    """
    is_wanted, missing = wanted
    steps[:] = -1
    steps[start] = 0
    sizes = np.zeros(_RING, dtype=np.int64)
    stacks[0, 0], sizes[0] = start, 1
    at, queued = 0, 1
    while queued > 0 and missing > 0:
        while sizes[at % _RING] == 0:
            at += 1
        slot = at % _RING
        sizes[slot] -= 1
        queued -= 1
        tile = stacks[slot, sizes[slot]]
        if steps[tile] != at:
            continue  # a shorter way to it has been found since
        missing -= is_wanted[tile]
        for k in range(8):
            if links[tile] >> k & 1:
                to, there = tile + moves[k], at + (STRAIGHT if k < 4 else DIAGONAL)
                if 0 <= steps[to] <= there:
                    continue
                steps[to] = there
                slot = there % _RING
                stacks[slot, sizes[slot]] = to
                sizes[slot] += 1
                queued += 1


@numba.njit(cache=True, error_model="numpy")
def _stop_order(lengths: Array) -> Cells:
    tour = short_tour(lengths)
    best, least = tour[1:-1].copy(), np.inf
    is_option = np.zeros(len(lengths), np.bool_)
    is_option[tour[1]] = True
    is_option[ascending(lengths[0, 1:-1])[:_OPTIONS] + 1] = True
    for stop in range(len(lengths)):
        if not is_option[stop]:
            continue
        rest = np.append(stop, tour[1:][tour[1:] != stop])
        shorten(lengths, rest)
        cost = (1.0 + _LEG) * lengths[0, stop] + tour_length(lengths, rest)
        if cost < least - _LESS:
            best, least = rest[:-1].copy(), cost
    return best


@numba.njit(cache=True, error_model="numpy")
def tour_length(lengths: Array, tour: Cells) -> float:
    """Length of the way from stop to stop of `tour` (K,)."""
    total = 0.0
    for k in range(len(tour) - 1):
        total += lengths[tour[k], tour[k + 1]]
    return total


@numba.njit(cache=True, error_model="numpy")
def short_tour(lengths: Array) -> Cells:
    """(n,) a short tour from 0 through all to n - 1: farthest insertion, then made shorter."""
    n = len(lengths)
    tour = np.array([0, n - 1])
    away = np.minimum(lengths[0], lengths[n - 1])
    away[0] = away[n - 1] = -1.0
    for _ in range(n - 2):
        stop = np.argmax(away)
        cost = np.empty(len(tour) - 1)
        for k in range(len(cost)):
            a, b = tour[k], tour[k + 1]
            cost[k] = lengths[a, stop] + lengths[stop, b] - lengths[a, b]
        at = np.argmin(cost) + 1
        tour = np.concatenate((tour[:at], np.array([stop]), tour[at:]))
        away = np.minimum(away, lengths[stop])
        away[tour] = -1.0
    shorten(lengths, tour)
    return tour


@numba.njit(cache=True, error_model="numpy")
def shorten(lengths: Array, tour: Cells) -> None:
    """Reverse (2-opt) and move (or-opt) parts of `tour` (K,) until nothing makes it shorter; its ends stay."""
    last = len(tour) - 1
    better = True
    while better:
        better = False
        for i in range(1, last):
            for j in range(i, last):
                # The part from i to j: reversed where it is, or moved between two other stops.
                a, first, end, b = tour[i - 1], tour[i], tour[j], tour[j + 1]
                kept = lengths[a, first] + lengths[end, b]
                gain, to, turned = kept - lengths[a, end] - lengths[first, b], -1, True
                for k in range(last if j - i < _SEGMENT else 0):
                    if i - 1 <= k <= j:
                        continue
                    x, y = tour[k], tour[k + 1]
                    saved = kept - lengths[a, b] + lengths[x, y]
                    for turn in (False, True):
                        head, tail = (end, first) if turn else (first, end)
                        by = saved - lengths[x, head] - lengths[tail, y]
                        if by > gain:
                            gain, to, turned = by, k, turn
                if gain <= _LESS:
                    continue
                better = True
                part = tour[i : j + 1].copy()
                if turned:
                    part = part[::-1].copy()
                begin = i
                if to >= i:
                    part = np.concatenate((tour[j + 1 : to + 1], part))
                elif to >= 0:
                    begin, part = to + 1, np.concatenate((part, tour[to + 1 : i]))
                for k in range(len(part)):
                    tour[begin + k] = part[k]
