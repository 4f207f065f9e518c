import heapq

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage
from scipy.ndimage import label
from test_planners import WORLDS

from sixthsense.navigation.gridsearch import Reached, costs_from, far_from

Mask = NDArray[np.bool_]


def scattered(seed: int, share: float, shape: tuple[int, int] = (23, 31)) -> Mask:
    return np.random.default_rng(seed).random(shape) < share


def plain_costs(passable: Mask, blocked: Mask, row: int, col: int) -> NDArray[np.float64]:
    """Dijkstra's search of the textbook; inf where no way leads."""
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
            there = here + (7 if dr and dc else 5)
            if there < cost[p, q]:
                cost[p, q] = there
                heapq.heappush(queue, (there, p, q))
    return cost


@pytest.mark.parametrize("seed", range(20))
def test_costs_of_free_cells_are_those_of_a_plain_search(seed: int) -> None:
    passable = ~scattered(seed, 0.3)
    passable[5, 7] = True
    costs = costs_from(passable.astype(np.uint8), 5, 7)
    assert np.array_equal(np.where(costs < 0, np.inf, costs), plain_costs(passable, ~passable, 5, 7))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("reach", [0, 1, 4])
def test_far_cells_are_beyond_a_square_around_every_marked_one(seed: int, reach: int) -> None:
    rng = np.random.default_rng(seed)
    marked = rng.random((int(rng.integers(1, 30)), int(rng.integers(1, 40)))) < rng.choice([0.0, 0.01, 0.2])
    near = ndimage.maximum_filter(marked, size=2 * reach + 1, mode="constant", cval=False)
    assert np.array_equal(far_from(marked, reach), ~near)


@pytest.mark.parametrize("seed", range(5))
def test_cells_reached_in_a_map_that_changes_are_those_of_a_search_from_scratch(seed: int) -> None:
    rng, reached = np.random.default_rng(seed), Reached(np.zeros((128, 192), dtype=np.bool_))
    passable = ~scattered(seed, 0.45, (128, 192))
    part = slice(0, 128), slice(0, 192)
    for _ in range(20):
        reached.redraw(passable, ~passable, *part)
        row, col = rng.permutation(np.argwhere(passable))[0].tolist()
        before, changed = reached.cells.copy(), np.zeros((16, 24), dtype=np.bool_)
        reached.search(~passable, row, col, changed)
        assert np.array_equal(reached.cells, costs_from(passable.astype(np.uint8), row, col) >= 0)
        assert np.array_equal((reached.cells != before).reshape(16, 8, 24, 8).any(axis=(1, 3)), changed)
        top, left = int(rng.integers(120)), int(rng.integers(180))
        part = slice(top, min(top + 30, 128)), slice(left, min(left + 20, 192))
        passable[part] = rng.random(passable[part].shape) < 0.6


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("world", WORLDS)
def test_reached_cells_are_the_connected_ones(world, seed: int) -> None:
    rng = np.random.default_rng(seed)
    blocked = world(rng)
    rooms, _ = label(~blocked)
    row, col = rng.permutation(np.argwhere(~blocked))[0].tolist()
    assert np.array_equal(costs_from((~blocked).astype(np.uint8), row, col) >= 0, rooms == rooms[row, col])
