"""One exploration: where the robot drives next, and when it ends (report section 4.5).

- Viewing: an explorer chooses a target, unseen cells beside free ones, and the viewpoint to see it from. The default
  takes the first stop of a short tour through the viewpoints of the nearest pieces of the frontier and home. The robot
  drives to the viewpoint and turns there. It chooses anew when most of the target is seen, or the viewpoint is blocked.
- A target that was not reached, or not seen after a look, counts a try at its cells; a look counts one at all unseen
  cells in view, too. Cells with `TRIES` tries are given up.
- Closing a loop: where the position is uncertain, and a way back pays, it drives to a place where it was certain.
- Waiting: where something was given up and people are expected, it looks again after a turn, for a while.
- Going home: when no target is left. The exploration ends there. It also ends if the robot is stuck twice without an
  arrival between, or once on its way home. A robot without a known way home tries gaps of its own width.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import Literal, NamedTuple

import numpy as np

from sixthsense.config import Config
from sixthsense.config.parts import EXPLORERS
from sixthsense.config.sections import GOAL_SLACK_M
from sixthsense.config.tree import check_returned, part_of
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import beam_bearings
from sixthsense.navigation.clearance import Clearance
from sixthsense.navigation.driver import PATIENT_TURNS
from sixthsense.navigation.explorer import ExplorationView, Explorer, Target
from sixthsense.navigation.frontier import Region
from sixthsense.navigation.gridsearch import Cell
from sixthsense.navigation.navigator import Event, Goal, Outcome
from sixthsense.navigation.path_planner import DrivingMap
from sixthsense.navigation.pose_history import LOST_M, PoseHistory
from sixthsense.navigation.unseen_places import UnseenPlace, unseen_places
from sixthsense.navigation.view_map import LEAST_AREA_M2, ViewMap
from sixthsense.navigation.visibility import visible_cells
from sixthsense.slam.mapping.freespace import Bools

State = Literal["viewing", "closing a loop", "waiting", "going home"]

TRIES = 2
"""a target that was not seen at so many tries, with a turn at each viewpoint, is given up: a single one may mislead"""
_MOST_UNKNOWN = 0.2  # a target is seen when at most this share of it is unknown


class SensorModel(NamedTuple):
    """What the choice of a view assumes about the laser."""

    reach: float
    """range within which a cell is seen, in cells"""
    gapless_reach: float
    """range within which no cell falls between two beams, in cells"""
    turn_rad: float
    """turn at a viewpoint that covers all directions, and the gaps between beams"""

    @classmethod
    def of(cls, config: Config) -> SensorModel:
        """The model of the configured laser."""
        bearings, laser = beam_bearings(config.laser), config.laser
        # From the whole range away a border would be seen, and next to nothing beyond it.
        spacing, reach = abs(float(bearings[1] - bearings[0])), 0.95 * laser.max_range / config.grid.cell_m
        # A laser all around turns by four keyframes: the gaps between the beams of one are crossed by other ones.
        turn_rad = math.tau if laser.fov < math.tau - spacing else 4.0 * config.keyframes.turn_rad
        return cls(reach, max(2.0, min(1.0 / spacing, reach)), turn_rad)


class Exploration:
    """A task that sees all of a region, and comes home."""

    def __init__(self, home: Array, region: Region, radius_m: float, config: Config, rng: np.random.Generator) -> None:
        """See a region with a disc of `radius_m`, and come back to `home` (2,); the explorer draws from `rng`."""
        self.outcome: Outcome | None = None
        self.left: list[UnseenPlace] = []
        self.tours: list[Array] = []
        self.state: State = "viewing"
        self._home, self._region, self._radius_m, self._config = home, region, radius_m, config
        self._sensor, self._history = SensorModel.of(config), PoseHistory(config.explore)
        self._part = part_of(config, EXPLORERS)
        self.explorer: Explorer = self._part.make(rng)
        """chooses the views"""
        self._goal: Goal | None = None
        self._target: Target | None = None
        self._failures: Counter[Cell] = Counter()  # tries to see each cell; cells are counted from the world's origin
        self._is_stuck = False  # since a goal was reached last
        self._has_left_view = True  # since a return was last considered: else one could follow another for ever
        self._waits, self._seen_m2 = 0, 0.0  # waits since the robot saw anything new; the area seen by then

    def next(self, map_: DrivingMap, pose: Pose, event: Event) -> Goal | None:
        """The goal after an event: the same one until it is reached, seen or given up; None at the end."""
        if event == "stuck" and self._is_stuck:
            self.outcome = "stuck"
        self._is_stuck = event == "stuck" or (self._is_stuck and event != "arrived")
        if event == "looked":
            self._history.add(pose, map_.estimate.pose_cov, self._sees_walls(map_.clearance, pose))
        if self.outcome is None:
            react = {"viewing": self._view, "closing a loop": self._close_loop, "waiting": self._wait}
            react.get(self.state, self._go_home)(map_, pose, event)
        return self._goal if self.outcome is None else None

    def _view(self, map_: DrivingMap, pose: Pose, event: Event) -> None:
        """Go on until the target is seen, has failed, or the pose becomes uncertain."""
        if event != "looked" and self._target is not None:
            self._count_failure(map_.clearance, pose, has_looked=event == "arrived")
            # A robot that the guard has stopped goes on: more scans may show another way.
            if event == "stopped" and not self._is_given_up(self._target):
                return
            self._has_left_view = True
        elif self._begins_loop_closure(map_, pose) or self._is_worth_going_on(map_):
            return
        self._choose_view(map_, pose)

    def _choose_view(self, map_: DrivingMap, pose: Pose) -> None:
        """Head for the explorer's choice; when there is none wait, for people to go, or drive home."""
        self.state, reach_m = "viewing", self._sensor.reach * map_.clearance.cell_m
        self._has_left_view |= self._target is not None
        for outside_m in (self._config.explore.margin_m, reach_m):
            view = self._map_of_views(map_, pose, outside_m)
            self._target = self._chosen(view, pose)
            if self._target is not None:
                break
        if self._target is not None:
            if len(self._target.tour):
                self.tours.append(self._target.tour)
            viewpoint = view.points(np.subtract(self._target.viewpoint, view.first)[None])[0]
            self._goal = Goal(viewpoint, self._sensor.turn_rad)
            return
        self.left = unseen_places(view, map_.grid, self._radius_m, self._sensor.reach)
        if self.left and self._may_wait(map_):
            self.state, self._goal = "waiting", Goal(pose.position, math.tau)
        elif self._config.explore.return_home:
            self.state, self._goal = "going home", Goal(self._home, 0.0)
        else:
            self._finish()

    def _chosen(self, view: ViewMap, pose: Pose) -> Target | None:
        """The explorer's choice. Raises PartError for one that is none."""
        shown = ExplorationView(view, pose, self._home, self._sensor.reach)
        target = self.explorer.next_target(shown) if shown.pieces else None
        if self._part.members and target is not None:
            check_returned(self._part.name, "next_target", target, Target, cells=(None, 2), viewpoint=(2,))
        return target

    def _close_loop(self, map_: DrivingMap, pose: Pose, event: Event) -> None:
        """Go on until the pose is certain, or the place is reached."""
        if event not in ("looked", "stopped"):
            self._history.came_back()
            self._choose_view(map_, pose)
        elif self._history.is_certain:
            self._choose_view(map_, pose)

    def _begins_loop_closure(self, map_: DrivingMap, pose: Pose) -> bool:
        """Head for the nearest place to which a return is worth its way; whether one is due, and there is one."""
        is_wanted = self._has_left_view or self._history.is_much_less_certain
        if not (self._history.needs_loop_closure and is_wanted):
            return False
        self._history.postpone_loop_closure()
        self._has_left_view = False
        places = self._history.well_known_places()
        view = self._map_of_views(map_, pose, self._config.explore.margin_m)
        cells = np.array([view.cell(place[:2]) for place in places], dtype=np.int64).reshape(-1, 2)
        lengths_m = view.lengths_m(cells)
        lengths_m[~self._history.are_worth_it(places, lengths_m)] = np.inf
        if not np.isfinite(lengths_m).any():
            return False
        place = places[int(np.argmin(lengths_m))]
        self._history.go_back(place)
        self.state, self._target = "closing a loop", None
        self._goal = Goal(place[:2], 0.0)
        return True

    def _wait(self, map_: DrivingMap, pose: Pose, event: Event) -> None:
        """Look again, after a turn, as if nothing had been given up: who was in the way may have gone."""
        if event == "arrived":
            self._failures.clear()
            self._choose_view(map_, pose)

    def _may_wait(self, map_: DrivingMap) -> bool:
        """Count a wait for people to go, anew if more has been seen; whether any are expected and patience is left."""
        seen_m2 = map_.grid.seen_area_m2
        has_seen_more = seen_m2 > self._seen_m2 + LEAST_AREA_M2  # beside noise at obstacles' edges
        self._waits = 1 if has_seen_more else self._waits + 1
        self._seen_m2 = max(seen_m2, self._seen_m2)
        return bool(self._config.people) and self._waits <= PATIENT_TURNS

    def _go_home(self, map_: DrivingMap, pose: Pose, event: Event) -> None:
        """End at home; without a way there wait for people to go."""
        if event == "arrived":
            self._finish()
        elif event in ("no way", "stuck"):
            if self._may_wait(map_) or (event == "no way" and map_.least_m > map_.shut_in_m):
                map_.least_m = map_.shut_in_m
                near = map_.free_space(pose).nearest_free(self._home, 2.0 * self._radius_m)  # beside a stray return
                self._goal = Goal(self._home if near is None else near, 0.0)
            else:
                self.outcome = "goal unreachable" if event == "no way" else "stuck"

    def _finish(self) -> None:
        explored: Outcome = "explored in part" if self.left else "explored"
        self.outcome = "lost" if self._history.sigma_m > LOST_M else explored

    def _map_of_views(self, map_: DrivingMap, pose: Pose, outside_m: float) -> ViewMap:
        """The map as views are chosen from it, of unseen cells as far as `outside_m` from the region.

        The robot has come from home: where no way leads there, it is shut in by errors of the map.
        """
        clearance = map_.clearance
        given_up: Bools = np.zeros_like(clearance.seen)
        cells = np.array([cell for cell, count in self._failures.items() if count >= TRIES], dtype=np.int64)
        given_up[tuple((cells.reshape(-1, 2) - clearance.first).T)] = True
        for least_m in sorted({map_.usual_m, map_.shut_in_m}, reverse=True):
            map_.least_m = least_m
            view = ViewMap(map_, pose, self._region, outside_m, self._radius_m, given_up)
            home = map_.free_space(pose).nearest_free(self._home, GOAL_SLACK_M)
            if home is None or view.reachable[view.cell(home)]:
                break
        return view

    def _count_failure(self, clearance: Clearance, pose: Pose, has_looked: bool) -> None:
        """Count a try at all cells of the target, and after a look at all unseen cells that are in view from here."""
        assert self._target is not None
        cells = [self._target.cells]
        if has_looked:
            (row, col), reach = clearance.cell(pose.position), self._sensor.gapless_reach
            unseen = ~(clearance.seen | clearance.obstacles)
            cells.append(visible_cells(clearance.obstacles, unseen, row, col, reach) + clearance.first)
        self._failures.update(map(tuple, np.unique(np.concatenate(cells), axis=0).tolist()))

    def _is_given_up(self, target: Target) -> bool:
        return all(self._failures[cell] >= TRIES for cell in map(tuple, target.cells.tolist()))

    def _is_worth_going_on(self, map_: DrivingMap) -> bool:
        """Whether much of the target is still unknown, and the viewpoint is not blocked by what was seen since."""
        clearance, target, goal = map_.clearance, self._target, self._goal
        if target is None or goal is None or clearance.metres[clearance.cell(goal.position)] < map_.least_m:
            return False
        rows, cols = (target.cells - clearance.first).T
        unknown = ~(clearance.seen[rows, cols] | clearance.obstacles[rows, cols])
        return float(unknown.mean()) > _MOST_UNKNOWN

    def _sees_walls(self, clearance: Clearance, pose: Pose) -> bool:
        """Whether an obstacle lies within the laser's reach."""
        (row, col), reach = clearance.cell(pose.position), math.ceil(self._sensor.reach)
        return bool(
            clearance.obstacles[max(row - reach, 0) : row + reach + 1, max(col - reach, 0) : col + reach + 1].any()
        )
