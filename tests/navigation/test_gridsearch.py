import heapq
import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage
from scipy.ndimage import label
from test_planners import WORLDS

from sixthsense.navigation.gridsearch import (
    FarCells,
    far_from,
    geodesic_distances,
    reached_cells,
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


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("world", WORLDS)
def test_reached_cells_are_the_connected_ones(world, seed: int) -> None:
    rng = np.random.default_rng(seed)
    blocked = world(rng)
    rooms, _ = label(~blocked)
    row, col = rng.permutation(np.argwhere(~blocked))[0].tolist()
    assert np.array_equal(reached_cells(~blocked, blocked, row, col), rooms == rooms[row, col])
