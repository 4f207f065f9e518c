"""One exploration that has a map: where it drives next, and when it ends (report section 4.5).

It is viewing, closing a loop because its pose is uncertain, or going home. `view_planner.py` chooses views, `ways.py`
has the costs of going, `path_driver.py` drives.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from sixthsense.config.parts import EXPLORERS
from sixthsense.config.tree import check_returned, part_of
from sixthsense.core.geometry import Pose
from sixthsense.navigation.exploration_task import TRIES, ExplorationTask
from sixthsense.navigation.explorer import ExplorationView, Explorer
from sixthsense.navigation.map_view import MapView
from sixthsense.navigation.navigator import Outcome
from sixthsense.navigation.path_driver import PATIENT_TURNS, DriveEvent, PathDriver
from sixthsense.navigation.path_planner import DETOUR, DrivingMap, margin_m
from sixthsense.navigation.pose_history import LOST_M, PoseHistory
from sixthsense.navigation.unseen_places import LEAST_AREA_M2, UnseenPlace, unseen_places
from sixthsense.navigation.view_planner import NO_TARGET, Candidates, Target, ViewPlanner
from sixthsense.navigation.viewpoints import Viewpoints
from sixthsense.navigation.views import KnownViews, SensorModel, ViewGain
from sixthsense.navigation.visibility import visible_cells
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.mapping.grid import Grid

State = Literal["viewing", "closing a loop", "going home"]


class Exploration:
    """Drives from view to view until nothing is left to see, then home.

    It looks at unseen cells of the region beside seen free ones from the nearest cell with a line of sight. Where a
    turn around does not show them, it gives them up after a few tries, with a reason.
    """

    def __init__(self, task: ExplorationTask, grid: Grid, estimate: Estimate) -> None:
        """Begin with the first map."""
        self.outcome: Outcome | None = None
        self.left: list[UnseenPlace] = []
        self.state: State = "viewing"
        self._task, self._view = task, MapView(task.region, task.radius_m, task.config)
        self._target, self._turning = NO_TARGET, False  # whether it turns around, at a viewpoint or while it waits
        config = task.config
        self._sensor = SensorModel.of(config.laser, config.grid.cell_m, config.keyframes.turn_rad)
        self._gain, self._known_views = ViewGain(self._view, self._sensor), KnownViews()
        self._history = PoseHistory(task.config.explore)
        self._part = part_of(task.config, EXPLORERS)
        self.explorer: Explorer = self._part.make(task.rng)
        """chooses the views"""
        self._times_opened = 0  # that what the guard's stops have closed was opened
        self._stuck = False  # since the last arrival
        self._at_choice = 0.0, 0.0  # area seen and way driven, when the view was chosen
        self._waits, self._seen_m2 = 0, 0.0  # since the robot has seen anything new, and how much that was
        self._has_seen_more = True  # since the last loop closure: else one loop closure could follow another for ever
        self._map = self._driving_map(grid, estimate)
        self.driver = PathDriver(self._map, estimate.pose, task.home, task.paths, task.config)

    def look(self, grid: Grid, estimate: Estimate) -> None:
        """Take in a map that has changed: choose another view if the target is seen, replan if the path is blocked."""
        pose = estimate.pose
        self._map = self._driving_map(grid, estimate)
        self._view.moved(pose.position)
        self.driver.update_map(self._map, pose)
        self._history.add(pose, estimate.pose_cov, self._view.sees_walls(pose.position, self._sensor.reach))
        if self.state == "viewing":
            self._go_on(pose)
        elif self.state == "closing a loop" and self._history.is_certain:
            self._choose_view(pose)
        elif not self.driver.path_is_free(pose):
            self.driver.plan(pose)

    def _go_on(self, pose: Pose) -> None:
        """Go on with a view: until its cells are seen, its path is blocked, or the pose becomes uncertain."""
        waits = self._turning and self._target is NO_TARGET
        seen_more = self._has_seen_more or self._history.is_much_less_certain
        if self._history.needs_loop_closure and seen_more and not waits and self._close_loop(pose):
            return
        if self._target.is_seen(self._view) and not waits:
            self._has_seen_more |= self._target is not NO_TARGET
            self._choose_view(pose)
        elif not self._turning and not self.driver.path_is_free(pose):
            self._replan_or_choose_view(pose)

    def guard_stopped(self, pose: Pose) -> None:
        """Take in that the guard has stopped the robot: it turns, and another path avoids what it did not fit through.

        What stops it has come into the map by then, or the robot does not fit though the map says so.
        """
        self._view.count_stop(self.driver.ahead(pose, self._task.radius_m))
        self.driver.update_map(self._map, pose)
        self.driver.guard_stopped(pose)

    def handle(self, event: DriveEvent, pose: Pose) -> bool:
        """React to an event of the drive; whether the exploration is over."""
        if event == "stuck" and self._stuck:
            self.outcome = "stuck"
        elif self.state == "closing a loop":
            self._history.came_back()
            self._choose_view(pose)
        elif self.state == "going home":
            self._finish() if event == "arrived" else self._look_for_a_way_home(pose)
        elif event == "arrived":
            if not self._turning:
                self._turning = True
                self.driver.turn_around(pose, self._sensor.turn_rad)
        elif not self._turning:
            self._give_up_target(pose)
        elif self._target is NO_TARGET:
            self._look_again(pose)
        else:
            self._count_failed_view(pose)
        self._stuck = event == "stuck" or (self._stuck and event != "arrived")
        return self.outcome is not None

    def _choose_view(self, pose: Pose) -> None:
        """Head for the first view of a tour, or home when none is left."""
        self.driver.stop()
        self.state, self._turning = "viewing", False
        self._at_choice = self._map.grid.seen_area_m2, self._history.way_m
        self._target = self._next_target(pose) or self._target_outside(pose) or NO_TARGET
        if self._target is not NO_TARGET:
            if len(self._target.tour):
                stops = (self._target.tour[:, ::-1] + 0.5) * self._view.cell_m
                self._task.paths.tours.append(np.vstack([pose.position, stops, self._task.home]))
            row, col = self._target.viewpoint
            self.driver.head_for(self._view.point(row - self._view.frame.top, col - self._view.frame.left), pose)
            return
        if self._is_shut_in and self._forgets_stops(pose):
            self._choose_view(pose)
            return
        planner = self._make_view_planner(pose)
        self.left = unseen_places(planner, planner.candidates(self._view.filled))
        if self.left and self._may_wait():
            self._turning = True
            self.driver.wait(pose)
            return
        self.state = "going home"
        if self._task.config.explore.return_home:
            self.driver.head_for(self._task.home, pose)
        else:
            self._finish()

    def _replan_or_choose_view(self, pose: Pose) -> None:
        """Go on by another path; only what was newly seen on the way is a reason to choose another view.

        A longer path to the same view is taken, unless the way driven for it is repaid: then another view may be better
        now. A view that no path leads to any more counts as failed, if it is not. So to and fro cost unseen area or one
        of a few tries, which both come to an end.
        """
        promised_m = self.driver.remaining_m(pose)
        self.driver.plan(pose)
        is_longer = self.driver.remaining_m(pose) > DETOUR * promised_m
        if self.driver.following and not (is_longer and self._is_repaid):
            return
        if not self._is_repaid:
            self._view.count_attempt(self._target.cells)
        self._choose_view(pose)

    @property
    def _is_repaid(self) -> bool:
        """Whether the robot has newly seen as much, since it chose the view, as its body has swept on its way there."""
        seen_m2, way_m = self._at_choice
        swept_m2 = 2.0 * self._task.radius_m * (self._history.way_m - way_m)
        return self._map.grid.seen_area_m2 - seen_m2 > swept_m2

    def _count_failed_view(self, pose: Pose) -> None:
        """Count a failed view of the target and of all else visible from here, then choose another view."""
        view, self._has_seen_more = self._view, True
        row, col = view.cell(pose.position)
        span = int(self._sensor.gapless_reach)
        top, left = max(row - span, 0), max(col - span, 0)
        part = slice(top, row + span + 1), slice(left, col + span + 1)
        obstacles, unknown = view.obstacles[part].copy(), ~(view.seen[part] | view.obstacles[part])
        visible = visible_cells(obstacles, unknown, row - top, col - left, self._sensor.gapless_reach)
        cells = np.argwhere(visible) + np.add(view.first, (top, left))
        view.count_attempt(np.concatenate([self._target.cells, cells]))
        self._choose_view(pose)

    def _give_up_target(self, pose: Pose) -> None:
        """Count a target that the robot has not come to as not seen, then choose another view."""
        self._view.count_attempt(self._target.cells)
        self._choose_view(pose)

    def _look_again(self, pose: Pose) -> None:
        """Choose a view as if nothing had been given up: who was in the way may have gone."""
        self._view.forget_attempts()
        self._choose_view(pose)

    def _close_loop(self, pose: Pose) -> bool:
        """Head for the nearest place to which a return is worth its way; whether there is one."""
        self._history.postpone_loop_closure()
        places, view = self._history.well_known_places(), self._view
        view.draw_views(self._here(pose))
        cells = np.array([view.cell(place[:2]) for place in places], dtype=np.int64).reshape(-1, 2)
        lengths = view.tile_ways.lengths(self._here(pose), cells)
        lengths[~self._history.are_worth_it(places, view.cell_m * lengths)] = np.inf
        if not np.isfinite(lengths).any():
            return False
        self.state, self._target, self._turning, self._has_seen_more = "closing a loop", NO_TARGET, False, False
        place = places[int(np.argmin(lengths))]
        self._history.go_back(place)
        self.driver.head_for(place[:2], pose)
        return True

    def _look_for_a_way_home(self, pose: Pose) -> None:
        """Without a path home, explore on where the guard has stopped the robot, or wait."""
        if self._forgets_stops(pose):
            self._choose_view(pose)
            if self.driver.following or self._turning:
                return
        if self._may_wait():
            self.driver.plan(pose)
        else:
            self.outcome = "goal unreachable"

    @property
    def _is_shut_in(self) -> bool:
        """Whether no cell near home is in reach."""
        (row, col), span = self._view.cell(self._task.home), math.ceil(self._view.radius)
        return not self._view.reached[max(row - span, 0) : row + span + 1, max(col - span, 0) : col + span + 1].any()

    def _forgets_stops(self, pose: Pose) -> bool:
        """Open what is closed because the guard has stopped the robot there, a few times; whether it is opened.

        It has come through somewhere, so one of these places can be passed, or the robot has closed them about itself.
        """
        if self._times_opened == TRIES:
            return False
        self._times_opened += 1
        self._view.forget_stops()
        self.driver.update_map(self._map, pose)
        return True

    def _finish(self) -> None:
        explored: Outcome = "explored in part" if self.left else "explored"
        self.outcome = "lost" if self._history.sigma_m > LOST_M else explored

    def _next_target(self, pose: Pose) -> Target | None:
        """The best view from a cell in reach; None if nothing is left to see from there.

        The far end of what a laser reaches is seen in single beams. What is beside these is looked at last: most of it
        is seen on the way to what is nearer.
        """
        planner = self._make_view_planner(pose)
        found = self._chosen(planner, planner.candidates())
        return found or self._chosen(planner, planner.candidates(self._view.filled))

    def _chosen(self, planner: ViewPlanner, candidates: Candidates) -> Target | None:
        """The explorer's choice among candidates; None if there are none. Raises PartError for one that is none."""
        if not candidates.clusters:
            return None
        view = ExplorationView(planner, candidates)
        target = self.explorer.next_target(view)
        if not self._part.is_shipped and target is not None:
            check_returned(self._part.name, "next_target", target, Target, cells=(None, 2), viewpoint=(2,))
        return target

    def _target_outside(self, pose: Pose) -> Target | None:
        """A target for a robot that may drive far outside the region, from where it may see more of it."""
        if self._view.is_wide or not self._view.reaches_limits:
            return None
        self._view.widen(True)
        target = self._next_target(pose)
        if target is None:
            self._view.widen(False)
        self.driver.update_map(self._map, pose)
        return target

    def _make_view_planner(self, pose: Pose) -> ViewPlanner:
        """The view planner for views from the cells that a path leads to."""
        view, task = self._view, self._task
        view.draw_views(self._here(pose))
        roomy = view.reached & ~view.tight
        viewpoints = Viewpoints(view.reached, view.obstacles, self._sensor.reach, view.occupied, roomy)
        return ViewPlanner(
            self._gain, pose, view.reached, viewpoints, view.tile_ways, task.config, task.home, self._known_views
        )

    def _here(self, pose: Pose) -> tuple[int, int]:
        """The cell that paths from the robot begin at."""
        free = self.driver.space.nearest_free(pose.position, 0.5)
        return self._view.cell(pose.position if free is None else free)

    def _may_wait(self) -> bool:
        """Count a wait for people to go, anew if more has been seen; whether any are expected and patience is left."""
        seen_m2 = self._map.grid.seen_area_m2
        if seen_m2 > self._seen_m2 + LEAST_AREA_M2:  # beside noise at obstacles' edges
            self._waits = 0
        self._seen_m2 = max(seen_m2, self._seen_m2)
        self._waits += 1
        return bool(self._task.config.people) and self._waits <= PATIENT_TURNS

    def _driving_map(self, grid: Grid, estimate: Estimate) -> DrivingMap:
        """The map as a path planner sees it."""
        self._view.update(grid)
        margin = self._view.spare_m + margin_m(estimate.pose_cov, self._task.config)
        return DrivingMap(grid, self._view.free_space, margin)
