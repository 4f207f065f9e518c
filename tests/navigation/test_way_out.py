import math

import numpy as np
from test_path_margin import grid_of

from sixthsense.navigation.planners.shortcut import path_is_free
from sixthsense.navigation.ways import way_out


def test_a_robot_enclosed_by_the_clearance_alone_leaves_where_it_fits() -> None:
    # A dead end 0.55 m wide, closed towards the nearest free place, which lies behind its wall.
    grid = grid_of((-1.0, 0.275, 0.6, 0.275), (-1.0, -0.275, 0.6, -0.275), (-1.0, -0.275, -1.0, 0.275), clearance=0.15)
    space = grid.free_space()
    start = np.array([0.0, 0.0])
    assert space.is_blocked(start)
    path = way_out(grid, space, start, 0.15)
    assert path is not None
    assert np.array_equal(path[0], start) and not space.is_blocked(path[-1])
    assert path[-1][0] > 0.6 and np.abs(path[:, 1]).max() < 0.1
    assert path_is_free(grid.free_space(margin_m=-0.15), path)


def test_an_escape_path_never_leads_through_a_wall() -> None:
    # The nearest free place is behind the thin wall at 0.1 m; the robot's own side is open in the other direction.
    grid = grid_of((-2.0, 0.1, 2.0, 0.1), (-2.0, -0.45, 2.0, -0.45), (2.0, 0.1, 2.0, -0.45), (-2.0, 0.1, -2.0, -0.45))
    space = grid.free_space()
    path = way_out(grid, space, np.array([0.0, 0.0]), 0.05)
    assert path is None or path_is_free(grid.free_space(margin_m=-math.inf), path)


def test_a_robot_that_noise_has_put_inside_an_obstacles_disc_gets_away_from_it() -> None:
    grid = grid_of((-1.0, 0.1, 1.0, 0.1))
    path = way_out(grid, grid.free_space(), np.array([0.0, 0.0]), 0.05)
    assert path is not None
    assert path[-1][1] < -0.1 and not grid.free_space().is_blocked(path[-1])


def test_a_robot_walled_in_all_round_has_no_way_out() -> None:
    box = (-0.3, -0.3, 0.3, -0.3), (0.3, -0.3, 0.3, 0.3), (0.3, 0.3, -0.3, 0.3), (-0.3, 0.3, -0.3, -0.3)
    grid = grid_of(*box, clearance=0.2)
    assert way_out(grid, grid.free_space(), np.array([0.0, 0.0]), 0.2) is None
