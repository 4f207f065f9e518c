import math

import numpy as np
import pytest
from scipy.stats import norm

from sixthsense.config import Config, GridConfig, merge
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.navigation.guard import latency_s, stopping_distance
from sixthsense.navigation.path_planner import margin_m, plan_with_margin
from sixthsense.navigation.planners.astar import AStar
from sixthsense.navigation.planners.shortcut import path_is_free
from sixthsense.slam.mapping.freespace import Ellipse, FreeSpace
from sixthsense.slam.mapping.grid import Grid

CONFIG = Config()
NOWHERE = Scan.from_config(np.full(CONFIG.laser.beams, np.inf), CONFIG.laser.replaced(max_range=6.0))
RADIUS = 0.2


def grid_of(*walls: tuple[float, float, float, float], radius: float = RADIUS, clearance: float = 0.05) -> Grid:
    grid = Grid(GridConfig(clearance_m=clearance), radius)
    for _ in range(3):
        grid.add(Pose(), NOWHERE, np.array(walls, dtype=np.float64).reshape(-1, 2, 2))
    return grid


def gap_m(grid: Grid, path: Array) -> float:
    """Least distance of a path's points from the centres of obstacle cells."""
    rows, cols = np.nonzero(grid.obstacles)
    centres = np.column_stack([cols + 0.5, rows + 0.5]) * 0.05 + grid.origin
    return float(np.linalg.norm(path[:, None] - centres[None], axis=2).min())


def planned(grid: Grid, start: Array, goal: Array, wanted: float = 0.3, detour: float = 1.2):
    def free_space(margin: float, places: Array, within: Ellipse | None) -> FreeSpace:
        return grid.free_space(margin_m=margin, within=within).covering(*places)

    plan, space, kept = plan_with_margin((AStar(), AStar()), free_space, start, goal, wanted, detour)
    assert not plan.found or path_is_free(space, plan.path_world)
    return plan, kept


def test_a_margin_leaves_a_free_rim_around_what_it_blocks() -> None:
    space = grid_of((5.9, -1.0, 5.9, 1.0)).free_space(margin_m=2.0)
    for edge in (space.blocked[0], space.blocked[-1], space.blocked[:, 0], space.blocked[:, -1]):
        assert not edge.any()


@pytest.mark.parametrize("margin", [math.nan, math.inf])
def test_an_infinite_margin_or_nan_is_rejected(margin: float) -> None:
    with pytest.raises(ValueError, match="margin_m: found"):
        grid_of().free_space(margin_m=margin)
    with pytest.raises(InputError, match="inflation"):
        grid_of().free_space(margin_m=100.0)


def test_the_margin_is_the_quantile_in_the_worst_direction_plus_the_stopping_distance() -> None:
    braking = stopping_distance(0.5, latency_s(CONFIG), 1.0)
    assert margin_m(np.zeros((3, 3)), CONFIG) == pytest.approx(braking)
    turn = np.array([[math.cos(0.7), -math.sin(0.7)], [math.sin(0.7), math.cos(0.7)]])
    cov = np.zeros((3, 3))
    cov[:2, :2] = turn @ np.diag([0.01**2, 0.02**2]) @ turn.T
    assert margin_m(cov, CONFIG) == pytest.approx(braking + norm.ppf(0.999) * 0.02)


def test_the_margin_is_capped_however_uncertain_the_pose_is() -> None:
    assert margin_m(100.0 * np.eye(3), CONFIG) == CONFIG.safety.max_margin_m
    assert margin_m(np.eye(3), merge(CONFIG, {"safety": {"max_margin_m": 0.0}})) == 0.0


def test_a_path_keeps_the_margin_where_there_is_room() -> None:
    grid = grid_of((0.0, -2.0, 0.0, 0.0))
    start, goal = np.array([-1.0, -1.0]), np.array([1.0, -1.0])
    for wanted in (0.0, 0.1, 0.3):
        plan, kept = planned(grid, start, goal, wanted, 1.5)
        assert plan.found and kept == wanted
        assert gap_m(grid, plan.path_world) >= RADIUS + 0.05 + wanted


@pytest.mark.parametrize(("width", "kept"), [(0.65, 0.0), (0.95, 0.15), (1.4, 0.3)])
def test_a_path_through_a_door_keeps_as_much_of_the_margin_as_fits(width: float, kept: float) -> None:
    half = 0.5 * width
    grid = grid_of((0.0, -3.0, 0.0, -half), (0.0, half, 0.0, 3.0))
    plan, margin = planned(grid, np.array([-1.0, 0.3]), np.array([1.0, 0.3]))
    assert plan.found and margin == pytest.approx(kept)
    assert np.abs(plan.path_world[np.abs(plan.path_world[:, 0]) < 0.1, 1]).max() < half


def test_the_margin_is_kept_before_and_after_a_door_too_narrow_for_it() -> None:
    # A door 0.65 m wide, and a corner 2 m before it on the shortest path.
    door = (0.0, -3.0, 0.0, -0.325), (0.0, 0.325, 0.0, 3.0)
    grid = grid_of(*door, (-3.0, -2.0, -2.0, -0.2), (-2.0, -0.2, -2.0, -2.0))
    plan, kept = planned(grid, np.array([-3.5, -1.5]), np.array([2.0, 0.0]))
    assert plan.found and kept == 0.0
    path = plan.path_world
    through = np.hypot(path[:, 0], path[:, 1]) < 1.0
    assert gap_m(grid, path[~through]) >= RADIUS + 0.05 + 0.3
    assert gap_m(grid, path[through]) < RADIUS + 0.05 + 0.1


def test_an_enclosed_goal_is_unreachable_with_any_margin() -> None:
    grid = grid_of((1, -1, 3, -1), (3, -1, 3, 1), (3, 1, 1, 1), (1, 1, 1, -1))
    plan, kept = planned(grid, np.array([-1.0, 0.0]), np.array([2.0, 0.0]))
    assert plan.status == "no path" and kept == 0.0
