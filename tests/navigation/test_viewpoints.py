import math

import numpy as np
import pytest
from numpy.typing import NDArray

from sixthsense.navigation.viewpoints import Viewpoints
from sixthsense.navigation.visibility import line_of_sight

Mask = NDArray[np.bool_]


def scattered(seed: int, share: float, shape: tuple[int, int]) -> Mask:
    return np.random.default_rng(seed).random(shape) < share


@pytest.mark.parametrize("seed", range(10))
def test_a_viewpoint_is_the_nearest_allowed_cell_with_a_line_of_sight(seed: int) -> None:
    obstacles, allowed = scattered(seed, 0.15, (23, 31)), scattered(seed + 7, 0.1, (23, 31))
    obstacles[11, 13] = False
    best = min(
        (
            math.hypot(r - 11, c - 13)
            for r, c in np.argwhere(allowed).tolist()
            if line_of_sight(obstacles, r, c, 11, 13)
        ),
        default=math.inf,
    )
    found = Viewpoints(allowed, obstacles, 8.0).nearest((11, 13))
    if best > 8.0:
        assert found is None
    else:
        assert found is not None and math.hypot(found[0] - 11, found[1] - 13) == pytest.approx(best)


def nearest_without_shadows(
    allowed: Mask, obstacles: Mask, cell: tuple[int, int], reach: float
) -> tuple[int, int] | None:
    """The plain search: every allowed cell of the squares around the cell, outwards, row by row."""
    (row, col), best, found = cell, reach + 1e-9, None
    for ring in range(int(reach) + 1):
        for r, c in np.argwhere(allowed).tolist():
            away = math.hypot(r - row, c - col)
            is_nearer = max(abs(r - row), abs(c - col)) == ring <= best and away < best
            if is_nearer and line_of_sight(obstacles, r, c, row, col):
                best, found = away, (r, c)
    return found


@pytest.mark.parametrize("seed", range(30))
@pytest.mark.parametrize("of_allowed", [0.002, 0.02, 0.2])
def test_shadows_and_empty_tiles_change_no_viewpoint(seed: int, of_allowed: float) -> None:
    shape = (41, 37)
    obstacles, allowed = scattered(seed, 0.02 + 0.01 * seed, shape), scattered(seed + 100, of_allowed, shape)
    obstacles[:, 20:] &= seed % 2 == 0  # an empty half
    viewpoints = Viewpoints(allowed, obstacles, 30.0)
    for row, col in np.random.default_rng(seed).integers(37, size=(10, 2)).tolist():
        expected = nearest_without_shadows(allowed, obstacles, (row, col), 30.0)
        assert viewpoints.nearest((row, col)) == expected


def test_the_corners_of_a_map_are_searched_too() -> None:
    none, allowed = np.zeros((40, 50), dtype=np.bool_), np.zeros((40, 50), dtype=np.bool_)
    allowed[0, 0] = allowed[39, 49] = True
    assert Viewpoints(allowed, none, 100.0).nearest((5, 5)) == (0, 0)
    assert Viewpoints(allowed, none, 100.0).nearest((39, 40)) == (39, 49)
    assert Viewpoints(allowed, none, 100.0).nearest((0, 0)) == (0, 0)
    assert Viewpoints(allowed, none, 5.0).nearest((20, 20)) is None
