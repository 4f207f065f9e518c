import heapq
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from sixthsense.navigation import frontier

Mask = NDArray[np.bool_]


def scattered(seed: int, share: float, shape: tuple[int, int] = (23, 31)) -> Mask:
    return np.random.default_rng(seed).random(shape) < share


def plain_ways(passable: Mask, blocked: Mask, row: int, col: int) -> NDArray[np.float64]:
    """Dijkstra's search, as in the textbook."""
    cost = np.full(passable.shape, np.inf)
    cost[row, col] = 0.0
    queue = [(0.0, row, col)]
    while queue:
        here, r, c = heapq.heappop(queue)
        for dr, dc in ((a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if (a, b) != (0, 0)):
            p, q = r + dr, c + dc
            if not (0 <= p < cost.shape[0] and 0 <= q < cost.shape[1] and passable[p, q]):
                continue
            if dr and dc and (blocked[r, q] or blocked[p, c]):
                continue
            there = here + math.hypot(dr, dc)
            if there < cost[p, q] - 1e-12:
                cost[p, q] = there
                heapq.heappush(queue, (there, p, q))
    return cost


@pytest.mark.parametrize("seed", range(20))
def test_ways_are_those_of_a_plain_search(seed: int) -> None:
    blocked, unseen = scattered(seed, 0.25), scattered(seed + 100, 0.1)
    blocked[5, 7] = unseen[5, 7] = False
    passable = ~blocked & ~unseen
    np.testing.assert_allclose(
        frontier.ways(passable, blocked, 5, 7), plain_ways(passable, blocked, 5, 7), atol=5e-3, rtol=1e-5
    )


@pytest.mark.parametrize("seed", range(10))
def test_a_frontier_is_a_free_cell_that_shares_an_edge_with_an_unseen_one(seed: int) -> None:
    unseen = scattered(seed, 0.2)
    free = ~unseen & scattered(seed + 50, 0.7)
    found = frontier.frontier_cells(free, unseen)
    for r, c in np.ndindex(*free.shape):
        around = [(r + 1, c), (r - 1, c), (r, c + 1), (r, c - 1)]
        inside = [unseen[p, q] for p, q in around if 0 <= p < free.shape[0] and 0 <= q < free.shape[1]]
        assert found[r, c] == (free[r, c] and any(inside))


@pytest.mark.parametrize("seed", range(10))
def test_clusters_hold_every_frontier_cell_once_and_none_is_larger_than_its_square(seed: int) -> None:
    edge = scattered(seed, 0.3)
    pieces = frontier.clusters(edge, 6)
    together = np.concatenate(pieces)
    assert len(together) == np.count_nonzero(edge)
    assert edge[together[:, 0], together[:, 1]].all() and len(np.unique(together, axis=0)) == len(together)
    assert all(len(np.unique(cells // 6, axis=0)) == 1 for cells in pieces)


def test_no_frontier_has_no_cluster() -> None:
    assert frontier.clusters(np.zeros((4, 5), dtype=np.bool_), 6) == []


@pytest.mark.parametrize("seed", range(10))
def test_what_is_in_view_is_so_from_both_ends_unless_the_line_meets_a_corner(seed: int) -> None:
    obstacles = scattered(seed, 0.1)
    rng = np.random.default_rng(seed)
    for _ in range(200):
        (r, p), (c, q) = rng.integers(23, size=2).tolist(), rng.integers(31, size=2).tolist()
        if math.gcd(abs(p - r), abs(q - c)) != 1 or (abs(p - r) % 2 and abs(q - c) % 2):
            continue
        assert frontier.in_view(obstacles, r, c, p, q) == frontier.in_view(obstacles, p, q, r, c)


def test_nothing_is_in_view_through_a_wall_of_cells_that_touch_at_their_corners() -> None:
    obstacles = np.eye(20, dtype=np.bool_)
    for r, c in np.ndindex(20, 20):
        if r < c:
            assert not frontier.in_view(obstacles, r, c, 19, 0)


@pytest.mark.parametrize("seed", range(10))
def test_a_viewpoint_is_the_nearest_reachable_cell_with_a_view(seed: int) -> None:
    obstacles = scattered(seed, 0.15)
    cost = np.where(scattered(seed + 7, 0.1), 1.0, np.inf).astype(np.float32)
    obstacles[11, 13] = False
    best = min(
        (
            math.hypot(r - 11, c - 13)
            for r, c in np.ndindex(*obstacles.shape)
            if np.isfinite(cost[r, c]) and frontier.in_view(obstacles, r, c, 11, 13)
        ),
        default=math.inf,
    )
    found = frontier.viewpoint(cost, obstacles, 11, 13, 8.0)
    if best > 8.0:
        assert found == -1
    else:
        row, col = divmod(found, obstacles.shape[1])
        assert math.hypot(row - 11, col - 13) == pytest.approx(best)


def test_the_gain_in_an_open_unseen_disc_is_its_area_and_a_wall_halves_it() -> None:
    unseen = np.ones((101, 101), dtype=np.bool_)
    obstacles = np.zeros_like(unseen)
    stamp = np.zeros(unseen.shape, dtype=np.int64)
    assert frontier.gain(obstacles, unseen, 50, 50, 720, 30.0, 100, stamp, 1) == pytest.approx(math.pi * 900, rel=0.05)
    obstacles[:, 52] = True
    assert frontier.gain(obstacles, unseen, 50, 50, 720, 30.0, 100, stamp, 2) == pytest.approx(math.pi * 450, rel=0.12)


def test_gaps_of_two_cells_in_a_wall_are_closed_and_a_door_is_not() -> None:
    wall = np.zeros((9, 30), dtype=np.bool_)
    wall[4] = True
    wall[4, 6:8] = wall[4, 15:22] = False
    closed = frontier.without_gaps(wall)
    assert closed[4, 6:8].all() and not closed[4, 16:21].any()
    assert closed[[0, 1, 2, 6, 7, 8]].sum() == 0


def test_specks_are_dropped_the_smallest_first_up_to_the_share_allowed() -> None:
    unseen = np.zeros((10, 20), dtype=np.bool_)
    unseen[2, 2] = unseen[5, 5:7] = unseen[8, 10:20] = True
    edge = frontier.frontier_cells(~unseen, unseen)
    rest, left = frontier.without_dust(unseen, edge, 2.0)
    assert not rest[2, 2] and rest[5, 5:7].all() and rest[8, 10:20].all()
    rest, left = frontier.without_dust(unseen, edge, 3.0)
    assert rest.sum() == 10 and (left == frontier.frontier_cells(edge, rest)).all()


def test_what_no_free_way_leads_to_is_not_connected() -> None:
    free = np.ones((5, 9), dtype=np.bool_)
    free[:, 4] = False
    assert frontier.connected(free, 0, 0).sum() == 20
    assert frontier.connected(free, 2, 4).sum() == 0


def test_the_cell_before_a_gap_is_the_last_that_can_be_reached_on_the_way_through_it():
    wall = np.zeros((9, 12), dtype=np.bool_)
    wall[:, 6] = True
    wall[2, 6] = False  # a door
    closed = wall.copy()
    closed[1:4, 5:8] = True  # to a robot that keeps clear of its posts
    fitting = frontier.ways(~wall, wall, 7, 1)
    cost = frontier.ways(~closed, closed, 7, 1)
    row, col = frontier.before_gap(cost, fitting, 7, 10)
    assert np.isfinite(cost[row, col]) and math.hypot(row - 2, col - 6) < 3.0
    assert frontier.before_gap(cost, fitting, 5, 2) is None  # reached by both
    assert frontier.before_gap(cost, cost, 7, 10) is None  # reached by neither
