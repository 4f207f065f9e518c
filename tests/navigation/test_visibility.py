import math

import numpy as np
import pytest
from numpy.typing import NDArray

from sixthsense.navigation.visibility import expected_gain, line_of_sight

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


def test_the_gain_in_an_open_unseen_disc_is_its_area_and_a_wall_halves_it() -> None:
    unseen = np.ones((101, 101), dtype=np.bool_)
    obstacles = np.zeros_like(unseen)
    assert expected_gain(obstacles, unseen, 50, 50, 720, 30.0, 100) == pytest.approx(math.pi * 900, rel=0.05)
    obstacles[:, 52] = True
    assert expected_gain(obstacles, unseen, 50, 50, 720, 30.0, 100) == pytest.approx(math.pi * 450, rel=0.12)
