"""The searches against Dijkstra's of another library, on cells of general costs."""

import math

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from sixthsense.navigation.gridsearch import Links, cheapest_path, ways_from

NONE = np.zeros((0, 2), dtype=np.int64)


def reference(cost, right, up, source):
    """(H, W) costs over links, of steps to eight neighbours; diagonal ones need all four links around."""
    height, width = cost.shape
    index = np.arange(height * width).reshape(height, width)
    tails, heads, costs = [], [], []
    for (dr, dc), linked in {
        (0, 1): right[:, :-1], (1, 0): up[:-1],
        (1, 1): right[:-1, :-1] & right[1:, :-1] & up[:-1, :-1] & up[:-1, 1:],
    }.items():  # fmt: skip
        a, b = np.s_[: height - dr, : width - dc], np.s_[dr:, dc:]
        pairs = [(a, b)] if not (dr and dc) else [(a, b), (np.s_[: height - 1, 1:], np.s_[1:, : width - 1])]
        for a, b in pairs:
            tails.append(index[a][linked])
            heads.append(index[b][linked])
            costs.append(0.5 * math.hypot(dr, dc) * (cost[a] + cost[b])[linked])
    ends = np.concatenate(tails).astype(np.int32), np.concatenate(heads).astype(np.int32)
    graph = coo_array((np.concatenate(costs), ends), shape=(height * width,) * 2).tocsr()
    return dijkstra(graph, directed=False, indices=index[source]).reshape(height, width)


def world(seed):
    rng = np.random.default_rng(seed)
    cost = rng.choice(np.array([1.0, 1.0, 1.5, 6.0], np.float32), (23, 31))
    cost[rng.random(cost.shape) < 0.3] = np.inf
    return rng, cost


@pytest.mark.parametrize("seed", range(12))
def test_a_path_is_the_cheapest_and_cuts_no_corner(seed):
    rng, cost = world(seed)
    free = np.isfinite(cost)
    start, goal = (tuple(cell) for cell in rng.permutation(np.argwhere(free))[:2].tolist())
    costs = reference(np.where(free, cost, 1.0), *Links.of(free, 1), start)
    cells, found, expanded = cheapest_path(cost, start, goal)
    assert found == pytest.approx(costs[goal]) or (found == costs[goal] == np.inf and len(cells) == 0)
    assert 0 < expanded <= np.isfinite(costs).sum()
    if len(cells):
        assert tuple(cells[0]) == start and tuple(cells[-1]) == goal
        steps, total = np.diff(cells, axis=0), 0.0
        assert (np.abs(steps).max(axis=1) == 1).all()
        for (row, col), (down, across) in zip(cells[:-1], steps, strict=True):
            assert free[row + down, col] and free[row, col + across]
            total += 0.5 * math.hypot(down, across) * (cost[row, col] + cost[row + down, col + across])
        assert total == pytest.approx(found)


@pytest.mark.parametrize("seed", range(8))
def test_ways_over_tiles_are_the_cheapest_over_their_links(seed):
    rng, cost = world(seed)
    cost = np.where(np.isfinite(cost), cost, 1.0).astype(np.float32)
    right, up = rng.random((2, *cost.shape)) < 0.75
    right[:, -1] = up[-1] = False
    costs, before = ways_from(Links(right, up), cost, (7, 11), NONE)
    np.testing.assert_allclose(costs, reference(cost, right, up, (7, 11)), rtol=1e-5)
    reached = np.argwhere(np.isfinite(costs) & (costs > 0.0))
    for row, col in reached[::9]:
        r, c = divmod(int(before[row * cost.shape[1] + col]), cost.shape[1])
        step = 0.5 * math.hypot(row - r, col - c) * (cost[row, col] + cost[r, c])
        assert costs[row, col] == pytest.approx(costs[r, c] + step, rel=1e-5)
    wanted = reached[[3, 40]]
    early, _ = ways_from(Links(right, up), cost, (7, 11), wanted)
    assert (
        np.array_equal(early[tuple(wanted.T)], costs[tuple(wanted.T)]) and np.isinf(early).sum() > np.isinf(costs).sum()
    )


@pytest.mark.parametrize("side", [1, 3, 4])
def test_tiles_lead_to_each_other_where_passable_cells_meet_across_their_edge(side):
    passable = np.random.default_rng(side).random((24, 36)) < 0.3
    links = Links.of(passable, side)
    for row, col in np.ndindex(*links.right.shape):
        for found, (down, across) in ((links.right, (0, 1)), (links.up, (1, 0))):
            a = [(r, c) for r in range(row * side, (row + 1) * side) for c in range(col * side, (col + 1) * side)]
            meets = [
                passable[r, c] and passable[r + down, c + across]
                for r, c in a
                if r + down < 24 and c + across < 36 and ((r + down) // side, (c + across) // side) != (row, col)
            ]
            assert found[row, col] == any(meets)
