import math

import numpy as np
import pytest
from numpy.typing import NDArray

from sixthsense.navigation.visibility import expected_gain, line_of_sight, nearest_viewpoint

Mask = NDArray[np.bool_]


def scattered(seed: int, share: float, shape: tuple[int, int] = (23, 31)) -> Mask:
    return np.random.default_rng(seed).random(shape) < share


@pytest.mark.parametrize("seed", range(10))
def test_a_line_of_sight_is_free_in_both_directions_unless_it_meets_a_corner(seed: int) -> None:
    obstacles = scattered(seed, 0.1)
    rng = np.random.default_rng(seed)
    for _ in range(200):
        (r, p), (c, q) = rng.integers(23, size=2).tolist(), rng.integers(31, size=2).tolist()
        if math.gcd(abs(p - r), abs(q - c)) != 1 or (abs(p - r) % 2 and abs(q - c) % 2):
            continue
        assert line_of_sight(obstacles, r, c, p, q) == line_of_sight(obstacles, p, q, r, c)


def test_no_line_of_sight_passes_a_wall_of_cells_that_touch_at_their_corners() -> None:
    obstacles = np.eye(20, dtype=np.bool_)
    for r, c in np.ndindex(20, 20):
        if r < c:
            assert not line_of_sight(obstacles, r, c, 19, 0)


@pytest.mark.parametrize("seed", range(10))
def test_a_viewpoint_is_the_nearest_reachable_cell_with_a_line_of_sight(seed: int) -> None:
    obstacles = scattered(seed, 0.15)
    cost = np.where(scattered(seed + 7, 0.1), 1.0, np.inf).astype(np.float32)
    obstacles[11, 13] = False
    best = min(
        (
            math.hypot(r - 11, c - 13)
            for r, c in np.ndindex(*obstacles.shape)
            if np.isfinite(cost[r, c]) and line_of_sight(obstacles, r, c, 11, 13)
        ),
        default=math.inf,
    )
    found = nearest_viewpoint(np.isfinite(cost), obstacles, 11, 13, 8.0)
    if best > 8.0:
        assert found == -1
    else:
        row, col = divmod(found, obstacles.shape[1])
        assert math.hypot(row - 11, col - 13) == pytest.approx(best)


def viewpoint_without_shadows(cost: NDArray[np.float32], obstacles: Mask, row: int, col: int, reach: float) -> int:
    """The plain search of `nearest_viewpoint`: every reachable cell of the squares around the cell, outwards."""
    best, found = reach + 1e-9, -1
    for ring in range(int(reach) + 1):
        for r, c in np.ndindex(*cost.shape):
            if max(abs(r - row), abs(c - col)) == ring <= best and np.isfinite(cost[r, c]):
                away = math.hypot(r - row, c - col)
                if away < best and line_of_sight(obstacles, r, c, row, col):
                    best, found = away, r * cost.shape[1] + c
    return found


@pytest.mark.parametrize("seed", range(30))
def test_shadows_change_no_viewpoint(seed: int) -> None:
    obstacles = scattered(seed, 0.02 + 0.01 * seed, (41, 37))
    cost = np.where(scattered(seed + 100, 0.02, (41, 37)), 1.0, np.inf).astype(np.float32)
    for row, col in np.random.default_rng(seed).integers(37, size=(10, 2)).tolist():
        found = nearest_viewpoint(np.isfinite(cost), obstacles, row, col, 30.0)
        assert found == viewpoint_without_shadows(cost, obstacles, row, col, 30.0)


def test_the_gain_in_an_open_unseen_disc_is_its_area_and_a_wall_halves_it() -> None:
    unseen = np.ones((101, 101), dtype=np.bool_)
    obstacles = np.zeros_like(unseen)
    assert expected_gain(obstacles, unseen, 50, 50, 720, 30.0, 100) == pytest.approx(math.pi * 900, rel=0.05)
    obstacles[:, 52] = True
    assert expected_gain(obstacles, unseen, 50, 50, 720, 30.0, 100) == pytest.approx(math.pi * 450, rel=0.12)
