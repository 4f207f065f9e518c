"""What an exploration does next, on maps that a noiseless robot has seen."""

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from sixthsense.config import Config, merge
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.ray_casting import cast_rays
from sixthsense.navigation.exploration import Exploration, State
from sixthsense.navigation.exploration_task import TRIES, ExplorationTask
from sixthsense.navigation.path_driver import DriveEvent, Following
from sixthsense.navigation.path_planner import PathPlanner
from sixthsense.navigation.planners import make_planner
from sixthsense.navigation.unseen_places import UnseenPlace
from sixthsense.navigation.view_planner import NO_TARGET
from sixthsense.navigation.visibility import line_of_sight
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.mapping.grid import Grid

CONFIG = Config()
RADIUS = 0.2
START = Pose(1.0, 1.0, 0.0)


def rectangle(x0: float, y0: float, x1: float, y1: float) -> list[list[list[float]]]:
    return [[[x0, y0], [x1, y0]], [[x1, y0], [x1, y1]], [[x1, y1], [x0, y1]], [[x0, y1], [x0, y0]]]


ROOM = np.array(rectangle(0.0, 0.0, 3.0, 3.0))
# The second room is visible from the first only through the door.
TWO_ROOMS = np.array([*rectangle(0.0, 0.0, 8.0, 3.0), [[4.0, 0.0], [4.0, 1.8]], [[4.0, 2.8], [4.0, 3.0]]])


class Stage:
    """An exploration of a region, and the map that the robot has of it."""

    def __init__(self, walls: Array, changes: dict[str, object] | None = None) -> None:
        self.config = merge(CONFIG, changes or {})
        self.walls = walls
        self.grid = Grid(self.config.grid, RADIUS)
        self.see(START)
        task = ExplorationTask(
            home=START.position,
            region=(0.0, 0.0, float(walls[..., 0].max()), 3.0),
            radius_m=RADIUS,
            paths=PathPlanner(make_planner("astar"), self.config),
            config=self.config,
            rng=np.random.default_rng(0),
        )
        self.exploration = Exploration(task, self.grid, estimate(START))

    def see(self, pose: Pose) -> None:
        """Map the scan from a pose, together with the walls."""
        laser = self.config.laser
        ranges = cast_rays(pose, beam_bearings(laser), self.walls, laser.max_range)
        self.grid.add(pose, Scan.from_config(ranges, laser), np.zeros((0, 2, 2)))

    def look(self, pose: Pose, sigma_m: float = 0.0) -> State:
        self.exploration.look(self.grid, estimate(pose, sigma_m))
        return self.exploration.state

    def at_viewpoint(self) -> Pose:
        """Drive, without the drive, to the first viewpoint."""
        self.look(START)
        pose = Pose(*self.exploration.driver.goal, 0.0)
        self.exploration.handle("arrived", pose)
        return pose


def seen_room(changes: dict[str, object] | None = None) -> Stage:
    """A room of which all is seen."""
    stage = Stage(ROOM, changes)
    for x in (0.7, 1.5, 2.3):
        for y in (0.7, 1.5, 2.3):
            stage.see(Pose(x, y, 0.0))
    return stage


def attempts(exploration: Exploration) -> NDArray[np.uint8]:
    """(H, W) how often cells were looked at and not seen."""
    return exploration._view._attempts


def unknown_cells(exploration: Exploration) -> tuple[NDArray[np.int64], ...]:
    """Rows and columns of the unknown ones among the target's cells."""
    rows, cols = exploration._target.cells.T - np.array(exploration._view.first)[:, None]
    unknown = ~(exploration._view.seen | exploration._view.obstacles)[rows, cols]
    assert unknown.any()
    return rows[unknown], cols[unknown]


def estimate(pose: Pose, sigma_m: float = 0.0) -> Estimate:
    none = np.zeros(0, dtype=np.int64)
    cov = np.diag([sigma_m**2, sigma_m**2, 0.0])
    return Estimate(pose, cov, none, np.zeros((0, 2)), none.astype(np.bool_))


def test_the_first_map_selects_a_view_and_a_path_to_it() -> None:
    stage = Stage(TWO_ROOMS)
    assert stage.look(START) == "viewing"
    assert stage.exploration.driver.following and len(stage.exploration._target.cells) > 0


def test_when_nothing_is_left_to_see_the_robot_returns_home() -> None:
    stage = seen_room()
    assert stage.look(START) == "going home"
    assert stage.exploration.driver.goal.tolist() == START.position.tolist()
    assert stage.exploration.handle("arrived", START)
    assert stage.exploration.outcome == "explored"


def test_without_the_way_home_the_exploration_ends_when_nothing_is_left_to_see() -> None:
    stage = seen_room({"explore": {"return_home": False}})
    stage.look(START)
    assert stage.exploration.outcome == "explored"


def test_on_arrival_at_a_viewpoint_the_robot_turns_and_further_arrivals_change_nothing() -> None:
    stage = Stage(TWO_ROOMS)
    pose = stage.at_viewpoint()
    exploration = stage.exploration
    assert not exploration.driver.following
    target = exploration._target
    exploration.handle("arrived", pose)
    assert exploration._target is target
    assert exploration.driver.step(pose, 0, exploration).turn_rate > 0.0


def test_a_map_that_does_not_show_the_target_leaves_the_robot_turning() -> None:
    stage = Stage(TWO_ROOMS)
    pose = stage.at_viewpoint()
    target = stage.exploration._target
    assert stage.look(pose) == "viewing" and stage.exploration._target is target
    assert not stage.exploration.driver.following


def test_a_target_that_is_seen_is_replaced() -> None:
    stage = Stage(TWO_ROOMS)
    pose = stage.at_viewpoint()
    before = stage.exploration._target
    for _ in range(3):
        stage.see(Pose(6.0, 1.5, 0.0))
        stage.see(pose)
    stage.look(pose)
    assert stage.exploration._target is not before


@pytest.mark.parametrize("event", ["turned around", "stuck"])
def test_a_turn_at_the_viewpoint_that_does_not_show_the_target_is_counted(event: DriveEvent) -> None:
    stage = Stage(TWO_ROOMS)
    pose = stage.at_viewpoint()
    exploration = stage.exploration
    cells = unknown_cells(exploration)
    exploration.handle(event, pose)
    assert (attempts(exploration)[cells] == 1).all()
    # So is all else that is unknown and in sight from there, cell by cell.
    view, reach = exploration._view, exploration._sensor.gapless_reach
    here, is_unknown = view.cell(pose.position), ~(view.seen | view.obstacles)
    in_sight = [
        (row, col)
        for row, col in np.argwhere(is_unknown)
        if np.hypot(row - here[0], col - here[1]) <= reach and line_of_sight(view.obstacles, *here, row, col)
    ]
    counted = {tuple(cell) for cell in np.argwhere(attempts(exploration))}
    assert counted == {*in_sight, *zip(*map(np.ndarray.tolist, cells), strict=True)}
    assert len(in_sight) > len(cells[0])


@pytest.mark.parametrize("event", ["turned around", "stuck"])
def test_a_target_without_a_path_is_counted_as_not_seen(event: DriveEvent) -> None:
    stage = Stage(TWO_ROOMS)
    stage.look(START)
    exploration = stage.exploration
    cells = unknown_cells(exploration)
    exploration.handle(event, START)
    assert (attempts(exploration)[cells] == 1).all()


def test_a_robot_that_is_stuck_twice_without_an_arrival_gives_up() -> None:
    stage = Stage(TWO_ROOMS)
    stage.look(START)
    assert not stage.exploration.handle("stuck", START)
    assert stage.exploration.handle("stuck", START)
    assert stage.exploration.outcome == "stuck"


def test_an_arrival_between_two_times_stuck_lets_the_robot_go_on() -> None:
    stage = Stage(TWO_ROOMS)
    stage.look(START)
    stage.exploration.handle("stuck", START)
    stage.exploration.handle("arrived", START)
    assert not stage.exploration.handle("stuck", START)


def blocked(seen_m2: float = 0.0) -> tuple[Stage, NDArray[np.uint8]]:
    """An exploration whose target no path leads to any more, after so much was newly seen, and its attempts then."""
    stage = Stage(TWO_ROOMS)
    stage.look(START)
    exploration, cells = stage.exploration, unknown_cells(stage.exploration)
    exploration._at_choice = stage.grid.seen_area_m2 - seen_m2, exploration._history.way_m
    exploration.driver.plan = lambda pose: exploration.driver.stop()  # type: ignore[method-assign]
    exploration.driver.stop()
    exploration._replan_or_choose_view(START)
    return stage, attempts(exploration)[cells]


def test_a_view_that_no_path_leads_to_any_more_counts_as_failed_unless_more_was_seen_on_the_way() -> None:
    assert (blocked()[1] == 1).all()
    assert (blocked(0.5)[1] == 0).all()


@pytest.mark.parametrize(("seen_m2", "is_kept"), [(0.0, True), (0.5, False)])
def test_a_view_is_kept_though_its_path_becomes_longer_unless_its_way_is_repaid(seen_m2: float, is_kept: bool) -> None:
    stage = Stage(TWO_ROOMS)
    stage.look(START)
    exploration = stage.exploration
    target, there = exploration._target, exploration.driver.goal
    near = START.position + 0.1 * (there - START.position)
    exploration.driver.drive = exploration.driver.drive._replace(
        following=Following.along(np.array([START.position, near]))
    )
    exploration._at_choice = stage.grid.seen_area_m2 - seen_m2, exploration._history.way_m
    exploration._replan_or_choose_view(START)
    assert (exploration._target is target) is is_kept


def wandered() -> tuple[Stage, Pose]:
    """A robot that has driven to and fro in its room since it was certain of its pose, and where it is."""
    stage = Stage(TWO_ROOMS)
    for x, y in ((1.0, 1.0), (3.2, 1.2), (0.6, 2.2), (3.1, 2.3), (2.0, 1.5)):
        stage.look(Pose(x, y, 0.0))
    return stage, Pose(2.0, 1.5, 0.0)


def test_an_uncertain_pose_closes_a_loop_and_exploration_goes_on_when_it_is_certain() -> None:
    stage, pose = wandered()
    stage.exploration._history._rows = stage.exploration._history._rows[:1]
    assert stage.look(pose, sigma_m=0.2) == "closing a loop"
    assert stage.exploration._target is NO_TARGET
    np.testing.assert_allclose(stage.exploration.driver.goal, START.position)
    assert stage.look(pose, sigma_m=0.2) == "closing a loop"
    assert stage.look(pose, sigma_m=0.01) == "viewing"


def test_a_loop_closure_that_does_not_help_is_repeated_only_when_the_pose_is_much_less_certain() -> None:
    stage, pose = wandered()
    stage.exploration._history._rows = stage.exploration._history._rows[:1]
    stage.look(pose, sigma_m=0.2)
    stage.exploration.handle("arrived", START)
    assert stage.exploration.state == "viewing"
    assert stage.look(pose, sigma_m=0.39) == "viewing"
    assert stage.look(pose, sigma_m=0.41) == "closing a loop"


def test_a_robot_that_would_go_back_as_it_came_does_not() -> None:
    stage = Stage(TWO_ROOMS)
    stage.look(START)
    assert stage.look(Pose(2.0, 1.5, 0.0), sigma_m=0.2) == "viewing"


def test_an_uncertain_pose_without_a_certain_place_closes_no_loop() -> None:
    stage = Stage(TWO_ROOMS)
    assert stage.look(START, sigma_m=0.2) == "viewing"


@pytest.mark.parametrize("event", ["arrived", "turned around", "stuck"])
def test_a_loop_closure_ends_with_another_view(event: DriveEvent) -> None:
    stage = Stage(TWO_ROOMS)
    stage.look(START)
    stage.exploration.state, stage.exploration._target = "closing a loop", NO_TARGET
    stage.exploration.handle(event, START)
    assert stage.exploration.state == "viewing"


@pytest.mark.parametrize("state", ["closing a loop", "going home"])
def test_a_blocked_path_is_planned_again_towards_the_same_goal(state: State) -> None:
    stage = Stage(TWO_ROOMS)
    stage.look(START)
    exploration = stage.exploration
    exploration.state, exploration._target = state, NO_TARGET
    goal = exploration.driver.drive.goal
    exploration.driver.stop()
    assert stage.look(START, sigma_m=0.08) == state  # too uncertain to end a loop closure
    assert exploration.driver.following and exploration.driver.drive.goal is goal


def shut_in(walls: Array) -> Stage:
    """All that can be seen is seen, and the robot is where the walls enclose it, far from home."""
    stage = Stage(walls)
    for x, y in itertools.product((4.5, 6.0, 7.5), (0.5, 1.5, 2.5)):
        stage.see(Pose(x, y, 0.0))
    exploration = stage.exploration
    exploration.state, exploration._target = "going home", NO_TARGET
    exploration.look(stage.grid, estimate(Pose(6.0, 1.5, 0.0)))
    return stage


def test_without_a_path_home_the_exploration_ends() -> None:
    stage = shut_in(np.array([*rectangle(0.0, 0.0, 8.0, 3.0), [[4.0, 0.0], [4.0, 3.0]]]))
    assert not stage.exploration.driver.following
    assert stage.exploration.handle("turned around", Pose(6.0, 1.5, 0.0))
    assert stage.exploration.outcome == "goal unreachable"


def test_a_robot_shut_in_where_the_guard_has_stopped_it_tries_again_on_its_way_home() -> None:
    stage = shut_in(np.array([*rectangle(0.0, 0.0, 8.0, 3.0), [[4.0, 0.0], [4.0, 1.23]], [[4.0, 1.77], [4.0, 3.0]]]))
    exploration, pose = stage.exploration, Pose(6.0, 1.5, 0.0)
    assert exploration.driver.following
    for _ in range(TRIES):
        exploration._view.count_stop(np.array([[3.95, 1.2], [3.95, 1.8]]))
    exploration.driver.stop()
    stage.look(pose)
    assert not exploration.driver.following
    for _ in range(TRIES):
        assert not exploration.handle("turned around", pose) and exploration.driver.following


def test_a_robot_shut_in_where_the_guard_has_stopped_it_explores_what_is_beyond() -> None:
    door = [[[4.0, 0.0], [4.0, 1.23]], [[4.0, 1.77], [4.0, 3.0]]]
    stage = Stage(np.array([*rectangle(0.0, 0.0, 8.0, 3.0), *door, [[2.0, 3.0], [2.0, 0.9]]]))
    for x, y in ((4.8, 1.5), (6.0, 1.5)):  # but not all that is before the door
        stage.see(Pose(x, y, 0.0))
    exploration, pose = stage.exploration, Pose(6.0, 1.5, 0.0)
    exploration.look(stage.grid, estimate(pose))
    for _ in range(TRIES):
        exploration._view.count_stop(np.array([[3.95, 1.2], [3.95, 1.8]]))
    exploration.driver.stop()
    stage.look(pose)
    assert exploration.driver.goal[0] > 4.0
    while exploration.driver.goal[0] > 4.0:
        exploration._give_up_target(pose)
    assert exploration.state == "viewing" and exploration.driver.following and not exploration.left
    assert not exploration._view.given_up()[exploration._view.wanted].any()


def test_where_people_are_expected_the_robot_waits_before_it_leaves_a_place_unseen(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stage, left = seen_room({"people": True}), [UnseenPlace(2.0, 2.0, 1.0, "unreachable")]
    monkeypatch.setattr("sixthsense.navigation.exploration.unseen_places", lambda planner, candidates: left)
    states = [stage.look(START)]
    while states[-1] == "viewing":
        assert not stage.exploration.driver.following
        stage.exploration.handle("turned around", START)
        states.append(stage.exploration.state)
    assert states == ["viewing"] * 5 + ["going home"]


def test_a_robot_that_expects_nobody_leaves_a_place_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    stage, left = seen_room(), [UnseenPlace(2.0, 2.0, 1.0, "unreachable")]
    monkeypatch.setattr("sixthsense.navigation.exploration.unseen_places", lambda planner, candidates: left)
    assert stage.look(START) == "going home"
