"""What is to be seen, from where it is seen, and what is left, on maps that a noiseless robot has seen."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scanned import box

from sixthsense.config import merge, preset
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.ray_casting import cast_rays
from sixthsense.navigation.clearance import Clearance
from sixthsense.navigation.exploration import TRIES, Exploration
from sixthsense.navigation.explorer import ExplorationView
from sixthsense.navigation.frontier import Known, frontier_pieces, frontier_points
from sixthsense.navigation.path_planner import DrivingMap, PathPlanner
from sixthsense.navigation.planners.astar import AStar
from sixthsense.navigation.pose_history import PoseHistory
from sixthsense.navigation.unseen_places import unseen_places
from sixthsense.navigation.view_map import ViewMap
from sixthsense.navigation.visibility import line_of_sight, nearest_view, visible_cells
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.mapping.changes import Box
from sixthsense.slam.mapping.grid import Grid

RADIUS = 0.2
CONFIG = preset()
START = Pose(1.0, 1.0, 0.0)


ROOM = box(0.0, 0.0, 3.0, 3.0)


def two_rooms(door_m):
    """The second room is visible from the first only through the door, whose middle is at (4, 2.3)."""
    half = 0.5 * door_m
    return np.array([*box(0.0, 0.0, 8.0, 3.0), [[4.0, 0.0], [4.0, 2.3 - half]], [[4.0, 2.3 + half], [4.0, 3.0]]])


class Stage:
    """An exploration of a region, and the map that the robot has of it."""

    def __init__(self, walls, poses=(START,), **changes):
        self.config, self.walls = merge(CONFIG, changes), walls
        self.grid, self.map = Grid(self.config.grid, RADIUS), DrivingMap(RADIUS, self.config, True)
        region = (0.0, 0.0, float(walls[..., 0].max()), 3.0)
        self.task = Exploration(START.position, region, RADIUS, self.config, np.random.default_rng(0))
        for pose in poses:
            self.see(pose)

    def see(self, pose):
        laser = self.config.laser
        ranges = cast_rays(pose, beam_bearings(laser), self.walls, laser.max_range)
        self.grid.add(pose, Scan.from_config(ranges, laser))

    def next(self, pose, event="looked", sigma_m=0.0):
        if event == "looked":
            cov = np.diag([sigma_m**2, sigma_m**2, 0.0])
            self.map.update(self.grid, Estimate.of_pose(pose, cov))
        return self.task.next(self.map, pose, event)


def seen_room(**changes):
    return Stage(ROOM, [Pose(x, y, 0.0) for x in (0.7, 1.5, 2.3) for y in (0.7, 1.5, 2.3)], **changes)


def at(goal):
    x, y = goal.position.tolist()
    return Pose(x, y, 0.0)


def test_the_first_goal_is_a_viewpoint_from_which_unseen_cells_are_in_sight_and_it_stays() -> None:
    stage = Stage(two_rooms(1.0))
    goal = stage.next(START)
    assert stage.task.state == "viewing" and goal.turn_rad > 0.0
    assert stage.next(START) is goal and stage.next(START, "stopped") is goal
    assert 2.0 < goal.position[0] < 4.5


@pytest.mark.parametrize(("door_m", "tried_from"), [(0.46, {1.0, 7.0}), (0.38, {7.0}), (0.34, set())])
def test_a_robot_without_a_way_home_tries_gaps_that_are_only_as_wide_as_it_is(
    door_m: float, tried_from: set[float]
) -> None:
    """It has come through one. By the returns beside it the door of 0.38 m is 0.40 m wide: 0.44 m are kept else."""
    seen_from = [Pose(x, y, 0.0) for x in (1.0, 3.2, 4.8, 7.0) for y in (0.6, 2.3)]
    for x in (1.0, 7.0):
        stage, robot = Stage(two_rooms(door_m), seen_from), Pose(x, 1.0, 0.0)
        stage.next(robot)
        path = PathPlanner(AStar(), stage.config).plan(stage.map, robot, np.array([8.0 - x, 1.0]))
        assert (path is not None) == (x in tried_from)
        assert path is None or stage.map.is_clear(path)


def test_when_nothing_is_left_to_see_the_robot_drives_home_and_has_explored() -> None:
    stage = seen_room()
    goal = stage.next(Pose(2.0, 2.0, 0.0))
    assert stage.task.state == "going home" and goal.position.tolist() == START.position.tolist()
    assert stage.next(START, "arrived") is None and stage.task.outcome == "explored"
    at_once = seen_room(explore={"return_home": False})
    assert at_once.next(START) is None and at_once.task.outcome == "explored"


def test_without_a_way_home_the_goal_is_unreachable_but_with_people_the_robot_waits() -> None:
    stage = seen_room()
    stage.next(START)
    assert stage.next(START, "no way").position.tolist() == START.position.tolist()  # by gaps of its own width
    assert stage.next(START, "no way") is None and stage.task.outcome == "goal unreachable"
    patient = seen_room(people=True)
    goals = [patient.next(START)]
    while patient.task.outcome is None:
        goals.append(patient.next(START, "no way"))
    assert len(goals) == 7 and patient.task.outcome == "goal unreachable"


def test_a_robot_whose_home_is_blocked_drives_beside_it() -> None:
    pillar = box(START.x + 0.02, START.y + 0.03, START.x + 0.08, START.y + 0.09)
    stage = Stage(np.concatenate([ROOM, pillar]), [Pose(x, y, 0.0) for x in (0.4, 2.3) for y in (0.4, 2.3)])
    far = Pose(2.3, 2.3, 0.0)
    while stage.task.state != "going home":
        goal = stage.next(far, "arrived" if stage.task._goal else "looked")
    paths = PathPlanner(AStar(), stage.config)
    assert paths.plan(stage.map, far, goal.position) is None
    beside = stage.next(far, "no way").position
    assert 0.1 < math.dist(beside, START.position) <= 2.0 * RADIUS
    assert paths.plan(stage.map, far, beside) is not None


def test_an_uncertain_robot_for_which_no_return_pays_keeps_its_view_and_asks_once(monkeypatch) -> None:
    stage, asked = Stage(two_rooms(1.0)), []
    postpone = PoseHistory.postpone_loop_closure
    monkeypatch.setattr(PoseHistory, "postpone_loop_closure", lambda self: asked.append(postpone(self)))
    goal = stage.next(START, sigma_m=0.41)
    assert stage.task.state == "viewing" and all(stage.next(START, sigma_m=sigma) is goal for sigma in (0.42, 0.43))
    assert len(asked) <= 2  # before the view was chosen, and once on the way to it


def test_a_robot_whose_own_cell_its_laser_does_not_see_looks_on() -> None:
    """The laser is ahead of its centre, and looks forward."""
    stage = Stage(two_rooms(1.0), (), laser={"fov": math.pi, "beams": 181, "mount": (0.2, 0.0, 0.0)})
    ahead = START @ Pose(0.2, 0.0, 0.0)
    ranges = cast_rays(ahead, beam_bearings(stage.config.laser), stage.walls, stage.config.laser.max_range)
    stage.grid.add(START, Scan.from_config(ranges, stage.config.laser))
    assert stage.next(START).turn_rad > 0.0 and stage.task.state == "viewing"
    assert not stage.map.clearance.seen[stage.map.clearance.cell(START.position)]


def test_a_robot_that_is_stuck_twice_without_an_arrival_is_stuck() -> None:
    stage = Stage(two_rooms(1.0))
    stage.next(START)
    assert stage.next(START, "stuck") is not None
    assert stage.next(START, "stuck") is None and stage.task.outcome == "stuck"


@pytest.mark.parametrize("event", ["arrived", "no way", "stopped"])
def test_a_target_that_fails_as_often_as_is_tried_is_given_up_and_left(event: str) -> None:
    stage = Stage(two_rooms(1.0))
    goal, tries = stage.next(START), 0
    while stage.task.state == "viewing":
        goal, tries = stage.next(at(goal) if event == "arrived" else START, event), tries + 1
    assert TRIES <= tries <= 20
    assert {place.reason for place in stage.task.left} == {"gave up"}
    assert stage.task.left[0].x > 3.5 and stage.task.left[0].area_m2 > 1.0


def test_an_uncertain_robot_drives_back_to_where_it_was_certain_and_then_explores_on() -> None:
    stage = Stage(two_rooms(1.0), [START, Pose(3.0, 2.0, 0.0)])
    stage.next(START)
    far = Pose(3.2, 2.2, 0.0)
    for _ in range(12):  # to and fro, so that the way back is worth it
        stage.next(START, sigma_m=0.05)
        stage.next(far, sigma_m=0.08)
    goal = stage.next(far, sigma_m=0.11)
    assert stage.task.state == "closing a loop" and goal.position.tolist() == START.position.tolist()
    assert stage.next(far, sigma_m=0.11) is goal
    stage.next(far, sigma_m=0.04)
    assert stage.task.state == "viewing"


@pytest.mark.parametrize(
    ("door_m", "guard", "reason"), [(0.3, True, "unreachable"), (0.45, False, "cut off by inflation only")]
)
def test_a_room_behind_a_narrow_door_is_left_with_the_width_of_the_gap(door_m: float, guard: bool, reason: str) -> None:
    views = [Pose(x, y, 0.01) for x in (1.0, 2.5, 3.5) for y in (0.6, 1.4, 2.3)]
    stage = Stage(two_rooms(door_m), views, safety={"guard": guard})  # without a guard it keeps 5 cm
    goal = stage.next(Pose(2.5, 1.4, 0.0))
    while stage.task.state == "viewing":
        pose = at(goal)
        stage.see(pose)
        if stage.next(pose) is goal:
            stage.next(pose, "arrived")
        goal = stage.next(pose)
    behind = [place for place in stage.task.left if place.reason == reason]
    assert behind and behind[0].area_m2 > 1.0
    assert behind[0].gap_m == pytest.approx(door_m, abs=0.06)  # a jamb ends beyond its last return


@pytest.mark.parametrize(("opening", "is_view"), [(1, False), (2, False), (5, False), (10, True)])
def test_openings_that_are_narrower_than_the_robot_are_no_frontier(opening: int, is_view: bool) -> None:
    seen = np.zeros((60, 90), dtype=bool)
    seen[3:57, 3:61] = True
    obstacles = np.zeros_like(seen)
    obstacles[[2, 57], 2:61] = obstacles[2:58, [2, 60]] = True
    obstacles[30 : 30 + opening, 60] = False
    known = Known.of(seen | obstacles, obstacles, (7, -9), 0.05, (-0.4, 0.4, 3.9, 3.2), 0.5)
    assert known.free[30, 60] and not (known.free & known.unseen).any()
    pieces = frontier_pieces(known.free, known.unseen, (7, -9), 0.05, ((20, 20), RADIUS))
    assert bool(pieces) == is_view
    for piece in pieces:
        assert known.free[tuple(piece.cells.T)].all() and known.unseen[tuple(piece.unseen.T)].all()
        assert (np.abs(piece.cells - (35, 60)).max(axis=0) <= (6, 1)).all()


@pytest.mark.parametrize(
    ("side", "deep", "is_shown"), [(160, 3, False), (160, 4, True), (420, 9, False), (420, 11, True)]
)
def test_a_look_at_less_than_half_a_square_metre_or_two_thousandths_of_the_map_is_not_worth_it(
    side: int, deep: int, is_shown: bool
) -> None:
    """A niche of a metre in a wall is unseen; so is a place behind it that the wall hides."""
    seen, obstacles = np.ones((2, side, side + 70), dtype=bool)
    obstacles[:] = False
    obstacles[30:70, side : side + 40] = True
    seen[40:60, side : side + deep] = obstacles[40:60, side : side + deep] = False
    seen[40:60, side + 15 : side + 19] = obstacles[40:60, side + 15 : side + 19] = False
    view, _ = drawn(obstacles, seen, Pose(1.0, 2.25, 0.0))
    (piece,) = [found for found in view.pieces(view.wanted) if found.centre[1] < side + 15]
    viewpoint = 49, side - 15
    assert view.shows_enough(viewpoint, piece, view.wanted) == is_shown
    assert not view.shows_enough(viewpoint, piece, np.zeros_like(view.wanted))
    shown = ExplorationView(view, Pose(1.0, 2.25, 0.0), START.position, 100.0)
    assert any(np.array_equal(target.cells, piece.unseen) for target in shown.targets()) == is_shown


def test_a_niche_that_shows_little_nearby_is_not_left_unseen_though_it_is_deep() -> None:
    seen, obstacles = np.ones((2, 420, 560), dtype=bool)
    obstacles[:] = False
    obstacles[30:70, 420:] = True
    seen[43:52, 420:510] = obstacles[43:52, 420:510] = False
    view, _ = drawn(obstacles, seen, Pose(20.0, 2.35, 0.0))
    assert view.known.unseen[43:52, 420:510].all() and len(view.pieces(view.wanted)) == 1
    assert unseen_places(view, Grid(CONFIG.grid, RADIUS), RADIUS, 100.0) == []
    view.least_m2 = 0.4  # the nine by twenty cells are more
    (place,) = unseen_places(view, Grid(CONFIG.grid, RADIUS), RADIUS, 100.0)
    assert place.reason == "gave up" and place.area_m2 == pytest.approx(9 * 90 * 0.05**2) and place.x > 21.0


@pytest.mark.parametrize(("off_m", "is_clear"), [(-0.04, False), (-0.015, True), (0.01, True), (0.04, False)])
def test_a_path_leads_through_a_narrow_gap_within_half_a_cell_of_its_middle(off_m: float, is_clear: bool) -> None:
    stage = Stage(two_rooms(0.46), [START, Pose(3.0, 2.3, 0.0), Pose(3.4, 2.25, 0.0)])
    stage.next(START)
    assert stage.map.is_clear(np.array([[3.6, 2.3 + off_m], [4.4, 2.3 + off_m]])) == is_clear


def test_targets_are_in_the_order_of_their_ways_and_the_nearest_are_the_same_of_all() -> None:
    stage = Stage(two_rooms(1.0), [START, Pose(3.4, 2.2, 0.4)])
    stage.next(START)
    region, nothing = (0.0, 0.0, 8.0, 3.0), np.zeros_like(stage.map.clearance.seen)
    view = ExplorationView(ViewMap(stage.map, START, region, 1.0, RADIUS, nothing), START, START.position, 100.0)
    targets = view.targets()
    ways_m = view.ways_m([view.position(target) for target in targets])
    assert len(targets) > 3 and (np.diff(ways_m) >= 0.0).all() and ways_m[0] < ways_m[-1]
    assert [target.viewpoint for target in view.targets(3)] == [target.viewpoint for target in targets[:3]]


def test_figures_draw_the_frontier_that_is_explored_by() -> None:
    stage = Stage(two_rooms(1.0))
    region = (0.0, 0.0, 8.0, 3.0)
    points = frontier_points(stage.grid, 0.05, region, 1.0, START.position, RADIUS)
    goal = stage.next(START)
    assert np.hypot(*(points - goal.position).T).min() < 0.5 and points[:, 0].max() < 8.1
    assert frontier_points(Grid(CONFIG.grid, RADIUS), 0.05, region, 1.0, START.position, RADIUS).shape == (0, 2)
    # Less has been seen than counts anywhere but around the robot.
    here, narrow = Pose(3.3, 0.7, 0.3), {"max_range": 0.4}
    points = frontier_points(Stage(two_rooms(1.0), [here], laser=narrow).grid, 0.05, region, 1.0, here.position, RADIUS)
    assert len(points) > 20 and np.hypot(*(points - here.position).T) == pytest.approx(0.4, abs=0.1)


def drawn(obstacles, seen, pose):
    """The map of views of a robot at a pose, and where it may drive."""
    clearance = Clearance(0.05, 0.22, 0.5)
    clearance.box, clearance.seen, clearance.obstacles = Box(0, 0, *seen.shape), seen, obstacles
    clearance.metres = np.where(obstacles, np.float32(0.0), np.float32(0.3))
    space = clearance.free_space(0.22, 0.5)
    map_ = SimpleNamespace(clearance=clearance, free_space=lambda pose: space)
    region = 0.0, 0.0, 0.05 * seen.shape[1], 0.05 * seen.shape[0]
    return ViewMap(map_, pose, region, 0.5, RADIUS, np.zeros_like(seen)), space


def wall_of_a_cell(door):
    """Two rooms whose cells meet in tiles alone, or at a door as well."""
    blocked = np.zeros((60, 68), dtype=bool)
    blocked[:, 30] = True
    blocked[door, 30] = False
    return blocked


@pytest.mark.parametrize(
    "blocked",
    [wall_of_a_cell([]), wall_of_a_cell([1, 2]), np.random.default_rng(4).random((60, 68)) < 0.4],
    ids=["two rooms", "with a door", "general"],
)
def test_a_place_is_reachable_where_the_planner_finds_a_way(blocked) -> None:
    blocked[50:53, 5:8] = False
    start = Pose(0.33, 2.57, 0.0)
    view, space = drawn(blocked, ~blocked, start)
    for row, col in np.argwhere(~blocked)[::23].tolist():
        plan = AStar().plan(space, start.position, space.centre(row, col))
        assert view.reachable[row, col] == plan.found
        assert np.isfinite(view.lengths_m([(row, col)])[0]) or not plan.found
    assert not view.reachable[blocked].any()
    assert view.reachable.ravel()[view.places[view.places >= 0]].all()


@pytest.mark.parametrize("seed", range(4))
def test_the_nearest_view_is_the_nearest_place_in_sight(seed: int) -> None:
    rng = np.random.default_rng(seed)
    obstacles, side = rng.random((40, 52)) < 0.08, 4
    places = np.full((10, 13), -1)
    for r, c in np.argwhere(rng.random(places.shape) < 0.15):
        places[r, c] = (r * side + rng.integers(side)) * 52 + c * side + rng.integers(side)
    for row, col in rng.integers(0, (40, 52), (30, 2)).tolist():
        near = [
            (math.hypot(p // 52 - row, p % 52 - col), int(p))
            for p in places[places >= 0]
            if line_of_sight(obstacles, p // 52, p % 52, row, col)
        ]
        found = int(nearest_view(obstacles, places, side, row, col, 20.0))
        away = min(near)[0] if near else math.inf
        assert (found == -1) == (away >= 20.0)
        if found >= 0:
            assert math.hypot(found // 52 - row, found % 52 - col) == pytest.approx(away)


def test_lines_of_sight_are_the_same_both_ways_and_end_at_obstacles() -> None:
    rng = np.random.default_rng(5)
    obstacles = rng.random((23, 31)) < 0.1
    visible = np.zeros_like(obstacles)
    visible[tuple(visible_cells(obstacles, np.ones_like(obstacles), 8, 11, 9.5).T)] = True
    for r, c in np.ndindex(*obstacles.shape):
        assert line_of_sight(obstacles, 8, 11, r, c) == line_of_sight(obstacles, r, c, 8, 11)
        samples = np.linspace(0.0, 1.0, 400)
        cells = np.floor(np.array([8.5, 11.5]) + samples[:, None] * (r - 8, c - 11)).astype(int)
        between = [cell for cell in map(tuple, cells) if cell not in ((8, 11), (r, c))]
        if any(obstacles[cell] for cell in between):
            assert not line_of_sight(obstacles, 8, 11, r, c)
        assert visible[r, c] == (math.hypot(r - 8, c - 11) <= 9.5 and line_of_sight(obstacles, 8, 11, r, c))
