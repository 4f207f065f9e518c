import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from sixthsense.navigation import frontier
from sixthsense.navigation.regions import frontier_cells

Mask = NDArray[np.bool_]


def scattered(seed: int, share: float, shape: tuple[int, int] = (23, 31)) -> Mask:
    return np.random.default_rng(seed).random(shape) < share


@pytest.mark.parametrize("seed", range(10))
def test_a_frontier_is_a_free_cell_that_shares_an_edge_with_an_unseen_one(seed: int) -> None:
    unseen = scattered(seed, 0.2)
    free = ~unseen & scattered(seed + 50, 0.7)
    found = frontier_cells(free, unseen)
    for r, c in np.ndindex(*free.shape):
        around = [(r + 1, c), (r - 1, c), (r, c + 1), (r, c - 1)]
        inside = [unseen[p, q] for p, q in around if 0 <= p < free.shape[0] and 0 <= q < free.shape[1]]
        assert found[r, c] == (free[r, c] and any(inside))


@pytest.mark.parametrize("seed", range(10))
def test_clusters_hold_every_frontier_cell_once_and_none_is_larger_than_a_tile(seed: int) -> None:
    edge = scattered(seed, 0.3)
    pieces = frontier.frontier_clusters(np.argwhere(edge), 6, np.array([12, -6]))
    together = np.concatenate(pieces)
    assert len(together) == np.count_nonzero(edge)
    assert edge[together[:, 0], together[:, 1]].all() and len(np.unique(together, axis=0)) == len(together)
    assert all(len(np.unique(cells // 6, axis=0)) == 1 for cells in pieces)


def test_no_frontier_has_no_cluster() -> None:
    assert frontier.frontier_clusters(np.zeros((0, 2), dtype=np.int64), 6, np.zeros(2, dtype=np.int64)) == []


def test_gaps_of_two_cells_in_a_wall_are_closed_and_a_door_is_not() -> None:
    wall = np.zeros((9, 30), dtype=np.bool_)
    wall[4] = True
    wall[4, 6:8] = wall[4, 15:22] = False
    closed = frontier.close_gaps(wall)
    assert closed[4, 6:8].all() and not closed[4, 16:21].any()
    assert closed[[0, 1, 2, 6, 7, 8]].sum() == 0


def test_small_regions_are_dropped_the_smallest_first_up_to_the_area_allowed() -> None:
    unseen = np.zeros((10, 20), dtype=np.bool_)
    unseen[2, 2] = unseen[5, 5:7] = unseen[8, 10:20] = True
    edge = np.argwhere(frontier_cells(~unseen, unseen))
    assert frontier.smallest_regions(unseen, edge, 2.0).tolist() == [42]
    assert sorted(frontier.smallest_regions(unseen, edge, 3.0).tolist()) == [42, 105, 106]


def plain_smallest(unseen: Mask, edge: Mask, max_cells: float) -> Mask:
    """`smallest_regions` by labels of the whole mask."""
    labels, count = ndimage.label(unseen)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)
    beside = np.unique(labels[frontier_cells(unseen, edge)])
    order = beside[np.argsort(sizes[beside], kind="stable")]
    dropped = np.zeros(count + 1, dtype=np.bool_)
    dropped[order[np.cumsum(sizes[order]) <= max_cells]] = True
    return unseen & dropped[labels]


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("share", [0.3, 0.55])
def test_dropped_regions_are_those_that_labels_of_the_whole_map_say(seed: int, share: float) -> None:
    unseen = scattered(seed, share)
    edge = frontier_cells(~unseen & scattered(seed + 50, 0.6), unseen)
    for most in (0.0, 0.9, 3.5, 12.0, 40.0, 1000.0):
        found = frontier.smallest_regions(unseen, np.argwhere(edge), most)
        assert np.array_equal(np.sort(found), np.flatnonzero(plain_smallest(unseen, edge, most)))


@pytest.mark.parametrize("seed", range(10))
def test_clusters_come_in_the_order_of_labels_of_the_whole_map(seed: int) -> None:
    edge = scattered(seed, 0.3)
    labels, _ = ndimage.label(edge, np.ones((3, 3)))
    cells = np.argwhere(edge)
    keys = np.column_stack([labels[edge], cells // 6])
    order = np.lexsort(keys.T)
    starts = np.flatnonzero((np.diff(keys[order], axis=0) != 0).any(axis=1)) + 1
    clusters = frontier.frontier_clusters(cells, 6, np.zeros(2, dtype=np.int64))
    assert all(np.array_equal(a, b) for a, b in zip(clusters, np.split(cells[order], starts), strict=True))


def plainly_closed(obstacles: Mask, seen: Mask, most: int) -> Mask:
    """Every stretch of up to `most` unseen cells from a wall cell, or one beside it, to another."""
    closed = obstacles.copy()

    def holds(cell: tuple[int, int], mask: Mask) -> bool:
        return 0 <= cell[0] < mask.shape[0] and 0 <= cell[1] < mask.shape[1] and bool(mask[cell])

    for row, col in np.argwhere(obstacles).tolist():
        for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
            for beside in (-1, 0, 1):
                stretch: list[tuple[int, int]] = []
                for k in range(1, most + 2):
                    at = row + beside * right + k * down, col - beside * down + k * right
                    sides = (at[0] + right, at[1] - down), (at[0] - right, at[1] + down)
                    if not (0 <= at[0] < seen.shape[0] and 0 <= at[1] < seen.shape[1]):
                        break
                    if any(holds(cell, obstacles) for cell in (at, *sides)):
                        for cell in stretch:
                            closed[cell] = True
                        break
                    if seen[at]:
                        break
                    stretch.append(at)
    return closed


@pytest.mark.parametrize("seed", range(4))
def test_unseen_gaps_in_walls_up_to_a_width_are_closed_and_no_other_cells(seed: int) -> None:
    obstacles, seen = scattered(seed, 0.06, (40, 53)), scattered(seed + 10, 0.3, (40, 53))
    closed = frontier.close_unseen_gaps(obstacles, seen, 5)
    assert np.array_equal(closed, plainly_closed(obstacles, seen, 5))
    assert closed.sum() > obstacles.sum() and not (closed & seen & ~obstacles).any()


def test_a_gap_wider_than_asked_or_with_a_beam_through_it_stays_open() -> None:
    wall, seen = np.zeros((2, 9, 30), dtype=np.bool_)
    wall[4, [3, 4, 5, 14, 15, 21, 22]] = True
    seen[:4] = True
    assert np.flatnonzero(frontier.close_unseen_gaps(wall, seen, 5)[4]).tolist() == [3, 4, 5, *range(14, 23)]
    seen[4, 18] = True
    assert np.flatnonzero(frontier.close_unseen_gaps(wall, seen, 5)[4]).tolist() == [3, 4, 5, 14, 15, 21, 22]
