"""One exploration that has a map: what each action of its states does (report section 4.5).

`exploration_states.py` has the states and transitions, `view_planner.py` chooses views, `path_driver.py` drives.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from sixthsense.core.geometry import Pose
from sixthsense.navigation.closed_walls import ClosedWalls
from sixthsense.navigation.exploration_states import TRANSITIONS, Action, Event, State
from sixthsense.navigation.exploration_task import ExplorationTask
from sixthsense.navigation.gridsearch import Distances, ReachableCells
from sixthsense.navigation.known_views import KnownViews
from sixthsense.navigation.limited_map import LimitedMap
from sixthsense.navigation.map_window import NO_TARGET, FailedViewCounts, MapWindow, Target
from sixthsense.navigation.navigator import Outcome
from sixthsense.navigation.path_driver import DriveEvent, PathDriver
from sixthsense.navigation.pose_history import PoseHistory
from sixthsense.navigation.stagnation import Stagnation
from sixthsense.navigation.unseen_places import UnseenPlace, unseen_places
from sixthsense.navigation.view_gain import ViewGain
from sixthsense.navigation.view_planner import ViewPlanner
from sixthsense.navigation.views_elsewhere import cells_approached_at, nearest_shown_elsewhere
from sixthsense.navigation.visibility import visible_cells
from sixthsense.navigation.without_clearance import GapsOnTheWay
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.mapping.grid import Grid

_LOST_M = 0.5  # a robot whose position is less certain cannot say what it has explored
_LONGER = 1.5  # a path to a viewpoint may become this much longer before another view is chosen
_SIGHT_MARGIN = 0.5  # robot radii that a line of sight keeps off obstacles


class Exploration:
    """Drives to the view with the largest gain per time until nothing is left to see, then home.

    It looks at unseen cells of the region beside seen free ones from the nearest cell with a line of sight and, if a
    turn around there does not show them, from as near as possible. Then it gives them up, with a reason.
    """

    def __init__(self, task: ExplorationTask, grid: Grid, estimate: Estimate) -> None:
        """Begin with the first map."""
        self.outcome: Outcome | None = None
        self.left: list[UnseenPlace] = []
        self.state: State = "selecting"
        self._task, self._limited = task, LimitedMap(task)
        self._widening, self._passages = self._limited.widening, self._limited.passages
        self._target, self._failed_views = NO_TARGET, FailedViewCounts()
        self._known_views, self._reachable_cells = KnownViews(), ReachableCells()
        self._closed_walls = ClosedWalls(round(_SIGHT_MARGIN * task.radius_m / task.config.grid.cell_m))
        self._history = PoseHistory(task.config.explore)
        self._gaps_home = GapsOnTheWay(task.home, task.radius_m, task.config.explore.tries)
        self._retries, self._retracing = 0, False  # of unreachable cells; home as the robot came
        self._stagnation = Stagnation(task.config.people)
        self._has_seen_more = True  # since the last loop closure: else one loop closure could follow another for ever
        self._map = self._limited.driving_map(grid, estimate)
        self.driver = PathDriver(self._map, estimate.pose, task.home, task.paths, task.follower, task.config)
        self._drawn_window: MapWindow | None = None

    def look(self, grid: Grid, estimate: Estimate) -> None:
        """Take in a map that has changed: choose another view if the target is seen, replan if the path is blocked."""
        pose = estimate.pose
        self._map = self._limited.driving_map(grid, estimate)
        self._update_window(pose)
        self._history.add(pose, estimate.pose_cov)
        if self._passages.moved(pose.position):
            self._retries = 0  # what was unreachable may no longer be
        if self._history.is_certain:
            self._react("pose certain", pose)
        elif self._history.needs_loop_closure and (self._has_seen_more or self._history.is_much_less_certain):
            self._react("pose uncertain", pose)
        if self._target.is_seen(grid):
            self._has_seen_more |= self._target is not NO_TARGET
            if self._react("target seen", pose):
                return
        if not self.driver.path_is_free(pose):
            self._react("path blocked", pose)

    def handle(self, event: DriveEvent, pose: Pose) -> bool:
        """React to an event of the drive; whether the exploration is over."""
        self._react(event, pose)
        return self.outcome is not None

    def _react(self, event: Event, pose: Pose) -> bool:
        """Carry out the transition of the present state; whether there is one."""
        transition = TRANSITIONS[self.state].get(self._stagnation.event(event))
        if transition is None:
            return False
        self.state = _ACTIONS[transition.action](self, pose)
        return True

    def _choose_view(self, pose: Pose) -> State:
        """Head for the view with the largest utility, or home when none is left."""
        self.driver.stop()
        target = self._next_target(pose) or self._unreachable_target(pose) or self._target_outside(pose)
        target = target or self._target_through_passage(pose)
        self._target = NO_TARGET if target is None else target
        if target is not None:
            self.driver.head_for(self._window.point(*target.viewpoint_in(self._window)), pose)
            return "to viewpoint"
        self.left = unseen_places(self._make_view_planner(pose))
        if self.left and self._stagnation.may_wait(self._map.grid.seen_area_m2):
            self.driver.wait(pose)
            return "waiting"
        if self._task.config.explore.return_home:
            self.driver.head_for(self._task.home, pose)
        else:
            self._finish(pose)
        return "returning"

    def _replan(self, pose: Pose) -> State:
        self.driver.plan(pose)
        return self.state

    def _replan_or_choose_view(self, pose: Pose) -> State:
        """Without a path, or with a much longer one, choose anew: what was seen on the way may favour another view.

        A target whose path is blocked again and again, while nothing new is seen, is given up.
        """
        promised_m = self.driver.remaining_m(pose)
        self.driver.plan(pose)
        if self.driver.remaining_m(pose) <= _LONGER * promised_m < math.inf:
            return self.state
        seen_m2 = np.count_nonzero(self._window.seen) * self._window.cell_m**2
        return self._mark_unreachable(pose) if self._stagnation.blocks_for_good(seen_m2) else self._choose_view(pose)

    def _turn_around(self, pose: Pose) -> State:
        self.driver.turn_around(pose, self._task.sensor.turn_rad)
        return "at viewpoint"

    def _count_failed_view(self, pose: Pose) -> State:
        """Count a failed view of the target and of all else visible from here, then choose another view."""
        window, self._has_seen_more = self._window, True
        cell = window.cell(pose.position)
        visible = visible_cells(window.obstacles, window.unknown, *cell, self._task.sensor.gapless_reach)
        failed = (self._target.mask(window) | visible) & window.unknown
        self._failed_views.count_failure(window, failed)
        often = failed & (self._failed_views.within(window) >= self._task.config.explore.tries)
        if self._target.occluded and often.any():
            # The views from before the gap have not opened it.
            planner = self._make_view_planner(pose)
            approached = cells_approached_at(planner, planner.candidates(self._widening), cell)
            self._failed_views.mark_unreachable(window, often | approached)
        return self._choose_view(pose)

    def _look_again(self, pose: Pose) -> State:
        """Choose a view as if nothing had been given up: who was in the way may have gone."""
        self._failed_views, self._retries = FailedViewCounts(), 0
        return self._choose_view(pose)

    def _mark_unreachable(self, pose: Pose) -> State:
        """Give the target up until a path leads to it, then choose another view."""
        self._passages.close_untried()
        self._failed_views.mark_unreachable(self._window, self._target.mask(self._window) & self._window.unknown)
        return self._choose_view(pose)

    def _close_loop(self, pose: Pose) -> State:
        """Head for the nearest place where the pose was certain, if one can be reached."""
        self._history.postpone_loop_closure()
        places = self._history.well_known_places()
        distances = self._distances(pose)
        costs = np.array([distances.to(*self._window.cell(place)) for place in places])
        if not np.isfinite(costs).any():
            return self.state
        self._target, self._has_seen_more = NO_TARGET, False
        self.driver.head_for(places[int(np.argmin(costs))], pose)
        return "closing a loop"

    def _drop_target(self, pose: Pose) -> State:
        self._target = NO_TARGET
        return "selecting"

    def _approach_gap_or_retrace(self, pose: Pose) -> State:
        """Without a path home: look at the gap that closes it, else drive back as the robot came."""
        been, reachable = self._history.positions, self._distances(pose).reachable
        gap = self._gaps_home.next(self._window, pose, reachable, been)
        if gap is not None:
            self.driver.head_for(gap, pose)
            return "approaching gap"
        if not self._retracing:
            self._retracing = True
            self._passages.open_back(been)
            self._update_window(pose)
            self.driver.head_for(self._task.home, pose)
            if self.driver.following:
                return "returning"
        if self._stagnation.may_wait(self._map.grid.seen_area_m2):
            self.driver.plan(pose)
        else:
            self.outcome = "goal unreachable"
        return "returning"

    def _finish(self, pose: Pose) -> State:
        explored: Outcome = "explored in part" if self.left else "explored"
        self.outcome = "lost" if self._history.sigma_m > _LOST_M else explored
        return self.state

    def _give_up(self, pose: Pose) -> State:
        self.outcome = "stuck"
        return self.state

    def _next_target(self, pose: Pose) -> Target | None:
        """The best view, else the nearest one of what only cells out of reach show; None if nothing is left to see."""
        planner = self._make_view_planner(pose)
        candidates = planner.candidates(self._widening)
        return planner.next_target(candidates, self._task.rng) or nearest_shown_elsewhere(planner, candidates)

    def _unreachable_target(self, pose: Pose) -> Target | None:
        """A target among cells that were unreachable and have become visible."""
        if self._retries == self._task.config.explore.tries:
            return None
        self._retries += 1
        visible = self._make_view_planner(pose).visible_again()
        self._failed_views.reset(self._window, visible, self._task.config.explore.tries - 1)
        return self._next_target(pose) if visible.any() else None

    def _target_outside(self, pose: Pose) -> Target | None:
        """A target for a robot that may drive farther outside the region, from where it may see more of it."""
        before = self._widening.step
        while not self._widening.is_last:
            self._widening.step += 1
            self._update_window(pose)
            target = self._next_target(pose)
            if target is not None:
                return target
        self._widening.step = before
        self._update_window(pose)
        return None

    def _target_through_passage(self, pose: Pose) -> Target | None:
        """A target behind a gap that only the clearance closes, which the robot may now pass without it."""
        planner = self._make_view_planner(pose)
        for place in unseen_places(planner):
            shown = self._passages.open_to(planner, place, self._map.grid)
            if shown is not None:
                self._failed_views.reset(planner.window, shown, 0)
                self._update_window(pose)
                target = self._next_target(pose) or self._unreachable_target(pose)
                if target is not None:
                    return target
                self._passages.close_untried()
        self._update_window(pose)
        return None

    def _make_view_planner(self, pose: Pose) -> ViewPlanner:
        """Close the walls of the map window, and make the view planner for it."""
        closed = self._closed_walls.close(self._window, self._map.grid)
        window = self._drawn_window = closed.window
        task, failed_views = self._task, self._failed_views.within(window)
        distances, gain = self._distances(pose), ViewGain(closed, task.sensor, task.radius_m)
        viewpoints = gain.viewpoints(distances.reachable)
        return ViewPlanner(gain, failed_views, pose, distances, viewpoints, task.config, task.home, self._known_views)

    def _distances(self, pose: Pose) -> Distances:
        """Distances from the robot over cells that were seen and are not blocked."""
        window = self._window
        free = self.driver.space.nearest_free(pose.position, 0.5)
        here = window.cell(pose.position if free is None else free)
        passable, blocked = window.seen & ~window.blocked, np.array(window.blocked)
        return Distances(passable, blocked, *here, self._reachable_cells.of(passable, blocked, window.first, here))

    def _update_window(self, pose: Pose) -> None:
        self.driver.update_map(self._map, pose)
        self._drawn_window = None

    @property
    def _window(self) -> MapWindow:
        """The map window, drawn when somebody looks at it."""
        if self._drawn_window is None:
            self._drawn_window = self._limited.window(self._map.grid, self.driver.space)
        return self._drawn_window


_ACTIONS: dict[Action, Callable[[Exploration, Pose], State]] = {
    "choose view": Exploration._choose_view,
    "replan": Exploration._replan,
    "replan or choose view": Exploration._replan_or_choose_view,
    "turn around": Exploration._turn_around,
    "count failed view": Exploration._count_failed_view,
    "look again": Exploration._look_again,
    "mark unreachable": Exploration._mark_unreachable,
    "close loop": Exploration._close_loop,
    "drop target": Exploration._drop_target,
    "approach gap or retrace": Exploration._approach_gap_or_retrace,
    "finish": Exploration._finish,
    "give up": Exploration._give_up,
}
