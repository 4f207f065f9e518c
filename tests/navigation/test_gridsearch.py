import heapq
import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage
from scipy.ndimage import label
from test_planners import WORLDS

from sixthsense.navigation.gridsearch import (
    Distances,
    FarCells,
    ReachableCells,
    cell_before_gap,
    far_from,
    geodesic_distances,
    path_to_nearest,
    reachable_cells,
)
from sixthsense.slam.mapping.changes import Box, Changes

Mask = NDArray[np.bool_]


def scattered(seed: int, share: float, shape: tuple[int, int] = (23, 31)) -> Mask:
    return np.random.default_rng(seed).random(shape) < share


def plain_distances(passable: Mask, blocked: Mask, row: int, col: int) -> NDArray[np.float64]:
    """Dijkstra's search of the textbook."""
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
def test_geodesic_distances_are_those_of_a_plain_search(seed: int) -> None:
    blocked, unseen = scattered(seed, 0.25), scattered(seed + 100, 0.1)
    blocked[5, 7] = unseen[5, 7] = False
    passable = ~blocked & ~unseen
    np.testing.assert_allclose(
        geodesic_distances(passable, blocked, 5, 7), plain_distances(passable, blocked, 5, 7), atol=5e-3, rtol=1e-5
    )


@pytest.mark.parametrize("seed", range(20))
def test_distances_searched_step_by_step_are_those_searched_at_once(seed: int) -> None:
    blocked, unseen = scattered(seed, 0.25), scattered(seed + 100, 0.1)
    blocked[5, 7] = False
    passable = ~blocked & ~unseen
    cost, distances = geodesic_distances(passable, blocked, 5, 7), Distances(passable, blocked, 5, 7)
    assert np.array_equal(distances.reachable, np.isfinite(cost))
    for row, col in np.random.default_rng(seed).integers((23, 31), size=(30, 2)).tolist():
        known = distances.known(row, col)
        assert known is None or known == cost[row, col]
        if known is None:
            assert distances.radius <= cost[row, col]
        distances.search(distances.radius + 1.0)
    assert all(distances.to(row, col) == cost[row, col] for row, col in np.ndindex(*cost.shape))
    assert np.array_equal(distances.to_all(), cost)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("share", [0.2, 0.38])
def test_reachable_cells_that_are_kept_are_those_of_a_flood_from_scratch(seed: int, share: float) -> None:
    rng, reachable = np.random.default_rng(seed), ReachableCells()
    blocked, unseen = scattered(seed, share, (60, 70)), scattered(seed + 100, 0.05, (60, 70))
    here = 30, 35
    for k in range(60):
        row, col = int(rng.integers(58)), int(rng.integers(66))
        mask = unseen if rng.random() < 0.2 else blocked
        mask[row : row + 7, col : col + 5] = rng.random(mask[row : row + 7, col : col + 5].shape) < rng.choice(
            [share, 0.9]
        )
        here = int(np.clip(here[0] + rng.integers(-2, 3), 0, 59)), int(np.clip(here[1] + rng.integers(-2, 3), 0, 69))
        passable = ~blocked & ~unseen
        found = reachable.of(passable, blocked.copy(), (0, k // 20), here)
        assert np.array_equal(found, Distances(passable, blocked, *here).reachable)


@pytest.mark.parametrize("seed", range(20))
def test_the_path_to_the_nearest_cell_is_as_short_as_a_plain_search_finds(seed: int) -> None:
    free, wanted = ~scattered(seed, 0.3, (21, 21)), scattered(seed + 100, 0.05, (21, 21))
    free[10, 10] = True
    cost = plain_distances(free, ~free, 10, 10)
    nearest = float(cost[wanted & free].min(initial=math.inf))
    path = path_to_nearest(free, wanted, 0.5, 4.0)
    if 0.5 * nearest > 4.0:
        assert path is None
        return
    assert path is not None
    assert path[0].tolist() == [10, 10] and wanted[tuple(path[-1])] and free[tuple(path.T)].all()
    assert np.hypot(*np.diff(path, axis=0).T).sum() == pytest.approx(nearest)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("world", WORLDS)
def test_reachable_cells_are_the_connected_ones(world, seed: int) -> None:
    rng = np.random.default_rng(seed)
    blocked = world(rng)
    rooms, _ = label(~blocked)
    row, col = rng.permutation(np.argwhere(~blocked))[0].tolist()
    cells = reachable_cells(blocked, row, col)
    assert cells[0] == row * blocked.shape[1] + col
    assert np.array_equal(np.sort(cells), np.flatnonzero(rooms == rooms[row, col]))


def test_the_cell_before_a_gap_is_the_last_reachable_one_on_the_path_through_it() -> None:
    wall = np.zeros((9, 12), dtype=np.bool_)
    wall[:, 6] = True
    wall[2, 6] = False  # a door
    closed = wall.copy()
    closed[1:4, 5:8] = True  # for a robot that keeps its clearance
    without_clearance = geodesic_distances(~wall, wall, 7, 1)
    cost = geodesic_distances(~closed, closed, 7, 1)
    cell = cell_before_gap(np.isfinite(cost), without_clearance, 7, 10)
    assert cell is not None
    row, col = cell
    assert np.isfinite(cost[row, col]) and math.hypot(row - 2, col - 6) < 3.0
    assert cell_before_gap(np.isfinite(cost), without_clearance, 5, 2) is None  # reached by both
    assert cell_before_gap(np.isfinite(cost), cost, 7, 10) is None  # reached by neither


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("reach", [0, 1, 4])
def test_far_cells_are_beyond_a_square_around_every_marked_one(seed: int, reach: int) -> None:
    rng = np.random.default_rng(seed)
    marked = rng.random((int(rng.integers(1, 30)), int(rng.integers(1, 40)))) < rng.choice([0.0, 0.01, 0.2])
    near = ndimage.maximum_filter(marked, size=2 * reach + 1, mode="constant", cval=False)
    assert np.array_equal(far_from(marked, reach), ~near)


@pytest.mark.parametrize("seed", range(5))
def test_cells_far_from_changing_marks_are_those_of_a_computation_from_scratch(seed: int) -> None:
    rng, cells, changes = np.random.default_rng(seed), FarCells(3), Changes()
    marked = {first: scattered(seed, 0.01, shape) for first, shape in (((0, 0), (40, 50)), ((-2, -2), (44, 54)))}
    for k in range(40):
        row, col = int(rng.integers(40)), int(rng.integers(50))
        value = rng.random() < 0.6
        for first, mask in marked.items():
            mask[row - first[0] : row - first[0] + 4, col - first[1] : col - first[1] + 3] = value
        changes.add(Box(row, col, row + 4, col + 3))
        if k % 17 == 16:
            marked[0, 0][:] = scattered(k, 0.01, (40, 50))
            changes.add_all()
        first = list(marked)[rng.integers(2)]
        assert np.array_equal(cells.of(marked[first], first, changes), far_from(marked[first], 3))
        assert np.array_equal(cells.of(marked[first], first, changes), far_from(marked[first], 3))
