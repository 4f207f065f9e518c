import itertools
import math

import numpy as np
import pytest
from numpy.typing import ArrayLike

from sixthsense.config import Config, GridConfig, RobotConfig, merge
from sixthsense.config.sections import GOAL_SLACK_M
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.core.motion import rk4
from sixthsense.core.source import Command
from sixthsense.navigation import make_navigator
from sixthsense.navigation.goals import Goals
from sixthsense.navigation.navigator import Navigator
from sixthsense.navigation.path_planner import DrivingMap, PathPlanner
from sixthsense.navigation.planners import Plan
from sixthsense.navigation.planners.astar import AStar
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.mapping.freespace import FreeSpace
from sixthsense.slam.mapping.grid import Grid, Walls

CONFIG = Config(task="goal")
NOWHERE = Scan.from_config(np.full(CONFIG.laser.beams, np.inf), CONFIG.laser)
BOX = [[[1.0, -1.0], [3.0, -1.0]], [[3.0, -1.0], [3.0, 1.0]], [[3.0, 1.0], [1.0, 1.0]], [[1.0, 1.0], [1.0, -1.0]]]


def navigator_to(*goals: tuple[float, float], config: Config = CONFIG) -> Navigator:
    rng = np.random.default_rng(0)
    return make_navigator(config, Pose(), np.array(goals), (0.0, 0.0, 1.0, 1.0), 0.2, rng, rng)


def empty_grid() -> Grid:
    grid = Grid(GridConfig(), 0.2)
    grid.add(Pose(), NOWHERE)
    return grid


def add_walls(grid: Grid, walls: object, times: int = 3) -> None:
    """Put walls (W, 2, 2), world frame, into the grid, often enough to outweigh the beams that went through."""
    for _ in range(times):
        grid.add(Pose(), NOWHERE, Walls(np.array(walls, dtype=np.float64), np.zeros((0, 2, 2))))


def steer(navigator: Navigator, grid: Grid, pose: Pose, seconds: float, look_every: int = 10) -> list[Pose]:
    """Drive without noise, looking at the same grid again and again, until it is over."""
    poses, period_ns = [pose], 20_000_000
    for tick in range(round(seconds / 0.02)):
        if tick % look_every == 0:
            navigator.look(grid, believed(pose))
        command = navigator.step(pose, tick * period_ns)
        if navigator.outcome is not None:
            break
        pose = rk4(pose, command.speed, command.turn_rate, 0.02)
        poses.append(pose)
    return poses


def believed(pose: Pose, sigma: float = 0.0) -> Estimate:
    """An estimate with a pose of that sigma, m and rad, and without landmarks."""
    none = np.zeros(0, dtype=np.int64)
    return Estimate(pose, sigma**2 * np.eye(3), none, np.zeros((0, 2)), none.astype(np.bool_))


def xy(poses: list[Pose]) -> Array:
    return np.array([pose.position for pose in poses])


def test_a_replay_navigator_commands_nothing_and_is_never_done() -> None:
    navigator = Navigator()
    navigator.look(empty_grid(), believed(Pose()))
    assert navigator.step(Pose(3.0, 4.0, 5.0), 10**18) == Command()
    assert navigator.outcome is None
    assert navigator.plans == []


def test_goals_are_visited_in_turn() -> None:
    goals = (1.0, 0.0), (1.0, 1.0), (0.0, 0.5)
    navigator = navigator_to(*goals)
    assert navigator.step(Pose(), 0) == Command()  # before the first map
    positions = xy(steer(navigator, empty_grid(), Pose(), 60.0))
    assert navigator.outcome == "goal reached" and len(navigator.plans) == len(goals)
    at = 0
    for goal in goals:
        near = np.flatnonzero(np.linalg.norm(positions[at:] - goal, axis=1) <= GOAL_SLACK_M + 1e-9)
        assert len(near)
        at += int(near[0])
    assert navigator.step(Pose(), 0) == Command()


def test_a_tour_starts_over_and_never_ends() -> None:
    navigator = navigator_to((0.5, 0.0), (0.0, 0.0), config=merge(CONFIG, {"task": "tour", "max_time": 60.0}))
    positions = xy(steer(navigator, empty_grid(), Pose(0.2, 0.0, 0.0), 40.0))
    assert navigator.outcome is None
    at_first = np.linalg.norm(positions - (0.5, 0.0), axis=1) <= GOAL_SLACK_M
    assert np.count_nonzero(np.diff(at_first.astype(int)) == 1) >= 3


def test_an_obstacle_across_the_path_causes_a_replan_and_one_beside_it_does_not() -> None:
    navigator, grid = navigator_to((4.0, 0.0)), empty_grid()
    navigator.look(grid, believed(Pose()))
    add_walls(grid, [[[0.0, 2.0], [4.0, 2.0]]])
    navigator.look(grid, believed(Pose()))
    assert len(navigator.plans) == 1
    add_walls(grid, [[[2.0, -1.0], [2.0, 1.0]]])
    navigator.look(grid, believed(Pose()))
    assert len(navigator.plans) == 2
    assert np.abs(navigator.plans[0][:, 1]).max() < 0.3
    assert np.abs(navigator.plans[1][:, 1]).max() > 1.2


def test_the_robot_drives_around_an_obstacle_that_appears_on_its_path() -> None:
    navigator, grid = navigator_to((4.0, 0.0)), empty_grid()
    steer(navigator, grid, Pose(), 1.0)
    add_walls(grid, [[[2.0, -1.0], [2.0, 1.0]]])
    poses = steer(navigator, grid, Pose(), 60.0)
    assert navigator.outcome == "goal reached"
    beside = xy(poses)
    near_wall = np.abs(beside[:, 0] - 2.0) < 0.02
    assert np.all(np.abs(beside[near_wall, 1]) > 1.2)  # the wall's end and the robot's radius


def test_an_enclosed_goal_is_unreachable_after_one_turn_on_the_spot() -> None:
    navigator, grid = navigator_to((2.0, 0.0)), empty_grid()
    add_walls(grid, BOX)
    poses = steer(navigator, grid, Pose(), 30.0)
    assert navigator.outcome == "goal unreachable"
    assert navigator.plans == []
    assert np.abs(xy(poses)).max() == 0.0
    turned = sum(abs((a.inverse() @ b).theta) for a, b in itertools.pairwise(poses))
    assert turned == pytest.approx(2.0 * math.pi, abs=0.05)


def test_a_path_that_opens_during_the_turn_is_taken() -> None:
    navigator, grid = navigator_to((2.0, 0.0)), empty_grid()
    add_walls(grid, BOX)
    steer(navigator, grid, Pose(), 3.0)
    assert navigator.outcome is None
    grid.clear()
    grid.add(Pose(), NOWHERE)
    steer(navigator, grid, Pose(), 30.0)
    assert navigator.outcome == "goal reached"


def test_a_robot_inside_the_inflation_leaves_it_and_arrives() -> None:
    navigator, grid = navigator_to((3.0, 0.0)), empty_grid()
    add_walls(grid, [[[-1.0, 0.21], [1.0, 0.21]]])
    assert grid.free_space().is_blocked((0.0, 0.0))
    poses = steer(navigator, grid, Pose(), 60.0)
    assert navigator.outcome == "goal reached"
    assert xy(poses)[:, 1].max() <= 0.01


def test_a_robot_that_gets_nowhere_is_stuck_after_a_minute() -> None:
    navigator, grid = navigator_to((3.0, 0.0)), empty_grid()
    navigator.look(grid, believed(Pose()))
    outcomes = [(s, navigator.step(Pose(), s * 10**9) and navigator.outcome) for s in range(0, 80)]
    first = next(s for s, outcome in outcomes if outcome == "stuck")
    assert first == 64


def test_a_slow_robot_has_the_time_it_needs() -> None:
    config = Config(task="goal", robot=RobotConfig(speed=0.001, turn_rate=0.02))
    navigator, grid = navigator_to((-0.2, 0.0), config=config), empty_grid()
    pose = Pose()
    navigator.look(grid, believed(pose))
    for second in range(1000):
        command = navigator.step(pose, second * 10**9)
        pose = rk4(pose, command.speed, command.turn_rate, 1.0)
        if navigator.outcome is not None:
            break
    assert navigator.outcome == "goal reached"


def test_astar_plans_where_the_configured_planner_gives_up() -> None:
    class Straight:
        def plan(self, space: FreeSpace, start: ArrayLike, goal: ArrayLike) -> Plan:
            if not space.line_is_free(start, goal):
                return Plan.without_path("gave up", 1, 0.0)
            return Plan.along(space, [start, goal], 1, 0.0)

    grid, paths = empty_grid(), PathPlanner(Straight(), CONFIG)
    navigator = Navigator(Goals(np.array([[4.0, 0.0]]), CONFIG), paths, DrivingMap(0.2, CONFIG, False), CONFIG)
    navigator.look(grid, believed(Pose()))
    assert len(navigator.plans[0]) == 2 and navigator.plans_by_astar == 0
    add_walls(grid, [[[2.0, -0.5], [2.0, 0.5]]])
    navigator.look(grid, believed(Pose()))
    assert len(navigator.plans[1]) > 2 and navigator.plans_by_astar == 1
    assert navigator_to((3.0, 0.0)).plans_by_astar is None


def test_a_robot_that_the_guard_has_stopped_turns_on_the_spot_until_it_has_another_plan() -> None:
    navigator, grid = navigator_to((3.0, 0.0)), empty_grid()
    navigator.look(grid, believed(Pose()))
    assert navigator.step(Pose(), 0).speed > 0.0
    navigator.guard_stopped(Pose())
    command = navigator.step(Pose(), 20_000_000)
    assert command.speed == 0.0 and command.turn_rate != 0.0
    add_walls(grid, [[[0.5, -0.5], [0.5, 0.5]]])
    navigator.look(grid, believed(Pose(0.0, 0.0, 0.2)))
    assert len(navigator.plans) == 2 and np.abs(navigator.plans[1][:, 1]).max() > 0.7


def test_plans_that_keep_less_than_the_margin_are_counted() -> None:
    roomy, tight, grid = navigator_to((3.0, 0.0)), navigator_to((3.0, 0.0)), empty_grid()
    roomy.look(grid, believed(Pose()))
    add_walls(grid, [[[1.0, -4.0], [1.0, -0.35]], [[1.0, 0.35], [1.0, 4.0]]])
    tight.look(grid, believed(Pose()))
    assert (roomy.plans_below_margin, tight.plans_below_margin) == (0, 1)


@pytest.mark.parametrize("radius_m", [0.12, 0.2, 0.23, 0.28])
def test_a_way_keeps_the_wish_in_the_open_and_not_through_a_door_between_its_points(radius_m) -> None:
    grid, way = empty_grid(), np.array([[0.0, 0.0], [3.0, 0.0]])
    map_ = DrivingMap(radius_m, CONFIG, stays_near_seen=False)
    map_.update(grid, believed(Pose(), 0.3))
    assert map_.keeps_wish(way)
    add_walls(grid, [[[1.5, -4.0], [1.5, -0.35]], [[1.5, 0.35], [1.5, 4.0]]])
    map_.update(grid, believed(Pose(), 0.3))
    assert not map_.keeps_wish(way) and map_.keeps_wish(way[:1])


def test_no_path_is_searched_for_again_until_cells_join_robot_and_goal() -> None:
    class Counting(AStar):
        count = 0

        def plan(self, space, start, goal):
            self.count += 1
            return super().plan(space, start, goal)

    planner, goal, closed = Counting(), np.array([2.0, 0.1]), empty_grid()
    paths = PathPlanner(planner, CONFIG)
    add_walls(closed, BOX)
    for grid, is_path, count in (
        (empty_grid(), True, 1),
        (closed, False, 2),
        (closed, False, 2),
        (empty_grid(), True, 3),
    ):
        map_ = DrivingMap(0.2, CONFIG, stays_near_seen=False)
        map_.update(grid, believed(Pose()))
        assert ((paths.plan(map_, Pose(), goal) is not None), planner.count) == (is_path, count)
