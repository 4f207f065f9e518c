import numpy as np
from numpy.typing import NDArray

from sixthsense.navigation.visibility import line_of_sight

Mask = NDArray[np.bool_]


def test_no_line_of_sight_passes_a_wall_of_cells_that_touch_at_their_corners() -> None:
    obstacles = np.eye(20, dtype=np.bool_)
    for r, c in np.ndindex(20, 20):
        if r < c:
            assert not line_of_sight(obstacles, r, c, 19, 0)
