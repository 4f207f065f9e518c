"""Exploration: see all that can be seen of a region, then drive home (report section 4.5)."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sixthsense.config import Config
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import beam_bearings
from sixthsense.navigation import frontier
from sixthsense.navigation.clearance import margin_m
from sixthsense.navigation.follow import Follower
from sixthsense.navigation.frontier import Costs
from sixthsense.navigation.navigate import Driver
from sixthsense.navigation.planners import Planner
from sixthsense.navigation.planners.shortcut import path_is_free
from sixthsense.navigation.targets import Prospect, places_left
from sixthsense.navigation.unseen import Target, Tries, View
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.mapping.freespace import TOUCH, Bools, FreeSpace
from sixthsense.slam.mapping.grid import Grid

Region = tuple[float, float, float, float]

_TILE_M = 1.0  # frontiers longer than this are several
_MOSTLY = 0.2  # a target of which no more than this is left unseen has been seen; the rest is a target of its own
_BEYOND_M = 0.5, 2.0, 5.0, math.inf  # so far outside the region counts what is unseen within leads to, in turn
_WALL_HITS, _WALL_PASSES = 3, 15  # a cell hit so often, and passed no more often per hit, is of a wall
_NO_WAY = 255  # tries of what no way led to: more than any number of looks
_HALF = 0.5  # of the sigma now: what a place must have had to be worth going back to


class Explorer(Driver):
    """Drives to where most is seen for least time until nothing is left to see, then home.

    What is wanted is every unseen cell of the region beside a free one that was seen. It is looked at from a cell that
    can be reached over cells that were seen, at first from where that is soonest, near enough for the beams to leave no
    gap; if a turn around there does not show it, from as near as possible; then it is given up, with a reason.
    """

    def __init__(
        self, start: Pose, region: Region, radius_m: float, planner: Planner, follower: Follower, config: Config,
        rng: np.random.Generator,
    ) -> None:  # fmt: skip
        """Explore `region` (x0, y0, x1, y1) from `start` with a disc of `radius_m`; `rng` is for the random method.

        A start outside the region makes the region wider, so that the way there is explored, too.
        """
        super().__init__(start.position[None], False, planner, follower, config)
        self._home = start.position
        x0, y0, x1, y1 = region
        self._region = min(x0, start.x), min(y0, start.y), max(x1, start.x), max(y1, start.y)
        self._radius_m = radius_m
        self._rng = rng
        laser = config.laser
        cell_m = config.grid.cell_m
        bearings = beam_bearings(laser)
        spacing = abs(float(bearings[1] - bearings[0]))
        self._rays = max(8, round(math.pi / spacing))  # every second beam will do
        # One that sees all around needs to turn only a little, for the gaps between its beams.
        self._turn = 2.0 * math.pi if laser.fov < 2.0 * math.pi - spacing else 3.0 * config.keyscans.turn_rad + 0.1
        self._reach = 0.95 * laser.max_range / cell_m
        self._near = max(2.0, frontier.dense_reach(spacing, laser.max_range / cell_m))
        self._view: View | None = None
        self._tries = Tries()
        self._tried = self._tries.within((0, 0), (0, 0))  # the view's part of them
        self._phase: Literal["explore", "revisit", "nearer", "home"] = "explore"
        self._approaches = 0  # how often what cuts the robot off from home was looked at from nearer
        self._taken_up = 0  # how often what no way led to was wanted again
        self._level = 0  # of _BEYOND_M: the next one when nothing is left to see at this
        self._target: Target | None = None
        self._at_viewpoint = False
        self._sigma = 0.0
        self._known: list[tuple[float, float, float]] = []  # x, y and the pose's sigma there, per key scan
        self._bearable = config.explore.revisit_sigma_m
        self._stuck_before = False
        self._retraces = False  # goes home the way it came, though it is closed by the clearance now

    def look(self, grid: Grid, estimate: Estimate) -> None:
        """Take in what was seen: choose anew when the target has been seen, replan when the path is crossed."""
        pose = estimate.pose
        self._margin_m = margin_m(estimate.pose_cov, self._config)
        self._take_in(grid, pose)
        self._sigma = math.sqrt(max(float(np.linalg.eigvalsh(estimate.pose_cov[:2, :2])[-1]), 0.0))
        self._known.append((pose.x, pose.y, self._sigma))
        self._judge_uncertainty(pose)
        if self._phase == "explore" and (self._target is None or self._is_seen(self._target)):
            self._choose(pose)
        elif not self._at_viewpoint and not (self._planned and self._path_is_free(pose)):
            self._plan(pose)
            if not self._planned and self._phase == "explore":
                self._choose(pose)  # what was seen on the way has made another viewpoint the better one

    def _free_space(self, margin_m: float, places: Array) -> FreeSpace:
        """Where the robot may drive: outside the bounds nowhere."""
        space = super()._free_space(margin_m, places)
        inside = self._inside(space)
        blocked = np.ones(space.blocked.shape, dtype=np.bool_)
        blocked[inside] = space.blocked[inside]
        if self._retraces and margin_m == 0.0:
            blocked &= ~self._own_way(space)
        return replace(space, blocked=blocked)

    def _own_way(self, space: FreeSpace) -> Bools:
        """The cells of a space that the robot has driven over and those beside, where it fits but for the clearance."""
        assert self._grid is not None
        places = np.array([place[:2] for place in self._known])
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(places, axis=0).T))])
        steps = np.arange(0.0, along[-1] + space.cell_m, 0.5 * space.cell_m)
        points = np.column_stack([np.interp(steps, along, places[:, axis]) for axis in (0, 1)])
        cols, rows = np.floor((points - space.origin) / space.cell_m).astype(np.int64).T
        height, width = space.blocked.shape
        way = np.zeros((height, width), dtype=np.bool_)
        way[np.clip(rows, 0, height - 1), np.clip(cols, 0, width - 1)] = True
        way = ndimage.binary_dilation(way, np.ones((3, 3), dtype=np.bool_))
        tight = self._grid.free_space(margin_m=-self._config.grid.clearance_m)
        down, across = (round((space.origin[k] - tight.origin[k]) / space.cell_m) for k in (1, 0))
        return np.asarray(way & ~tight.window(np.arange(height) + down, np.arange(width) + across))

    def _inside(self, space: FreeSpace) -> tuple[slice, slice]:
        """Rows and columns of a space that lie within the bounds of the drive."""
        (x0, y0, x1, y1), margin = self._region, self._config.explore.margin_m
        if self._level > 0:
            margin = max(margin, self._beyond_m())
        slices = []
        for low, high, origin, count in (
            (y0, y1, space.origin[1], space.blocked.shape[0]),
            (x0, x1, space.origin[0], space.blocked.shape[1]),
        ):
            first = math.floor((low - margin - origin) / space.cell_m + TOUCH)
            past = math.ceil((high + margin - origin) / space.cell_m - TOUCH)
            slices.append(slice(min(max(first, 0), count), min(max(past, 0), count)))
        return slices[0], slices[1]

    def _take_in(self, grid: Grid, pose: Pose) -> None:
        self._grid = grid
        space = self._free_space(0.0, np.array([pose.position, self._goal]))
        self._space = space
        cell_m = space.cell_m
        first = round(space.origin[1] / cell_m), round(space.origin[0] / cell_m)
        obstacles = np.zeros(space.blocked.shape, dtype=np.bool_)
        own = grid.obstacles
        row, col = round(grid.origin[1] / cell_m) - first[0], round(grid.origin[0] / cell_m) - first[1]
        obstacles[row : row + own.shape[0], col : col + own.shape[1]] = own
        inside = self._inside(space)
        x0, y0, x1, y1 = self._region
        corner = first[0] + inside[0].start, first[1] + inside[1].start
        y = (np.arange(inside[0].start, inside[0].stop) + first[0] + 0.5) * cell_m
        x = (np.arange(inside[1].start, inside[1].stop) + first[1] + 0.5) * cell_m
        seen, obstacles = space.seen[inside], obstacles[inside]
        unseen = ~(seen | obstacles)
        unseen[(y <= y0) | (y >= y1)] = False
        unseen[:, (x <= x0) | (x >= x1)] = False
        self._view = View(corner, cell_m, seen, obstacles, space.blocked[inside], unseen)
        self._tried = self._tries.within(corner, seen.shape)

    def _close_walls(self) -> None:
        """Take for obstacles, too, what grazing beams have erased of walls and the gaps of a cell or two in them."""
        assert self._view is not None and self._grid is not None
        view, grid = self._view, self._grid
        hits, passes = grid.hits, grid.passes
        height, width = view.seen.shape
        row, col = round(grid.origin[1] / view.cell_m), round(grid.origin[0] / view.cell_m)
        wall = np.zeros((height, width), dtype=np.bool_)
        r0, c0 = row - view.first[0], col - view.first[1]  # where the grid's corner is in the view
        rows = slice(max(r0, 0), max(min(r0 + hits.shape[0], height), 0))
        cols = slice(max(c0, 0), max(min(c0 + hits.shape[1], width), 0))
        part = slice(rows.start - r0, rows.stop - r0), slice(cols.start - c0, cols.stop - c0)
        wall[rows, cols] = (hits[part] >= _WALL_HITS) & (passes[part] <= _WALL_PASSES * hits[part])
        obstacles = frontier.without_gaps(view.obstacles | wall)
        self._view = replace(view, obstacles=obstacles, unseen=view.unseen & ~obstacles)

    def _judge_uncertainty(self, pose: Pose) -> None:
        """Drive back to where the pose was known well when it no longer is, and on when it is again."""
        explore = self._config.explore
        if self._sigma <= explore.revisit_sigma_m:
            self._bearable = explore.revisit_sigma_m
        if self._phase == "revisit" and self._sigma <= _HALF * explore.revisit_sigma_m:
            self._go_on()
        if not explore.revisit or self._phase != "explore" or self._sigma <= self._bearable:
            return
        # Wherever that leads, it is not worth trying again at once.
        self._bearable = 1.5 * self._sigma
        known = np.array([(x, y) for x, y, sigma in self._known if sigma <= _HALF * self._sigma])
        if len(known) == 0:
            return
        assert self._view is not None
        cost = self._ways(pose)
        costs = np.array([cost[self._view.cell(place)] for place in known])
        if np.isfinite(costs).any():
            self._phase, self._target, self._at_viewpoint = "revisit", None, False
            self._head_for(known[int(np.argmin(costs))], pose)

    def _go_on(self) -> None:
        """Explore again; the next look chooses where."""
        self._phase, self._target, self._at_viewpoint = "explore", None, False

    def _arrived(self, pose: Pose) -> None:
        self._stuck_before = False
        if self._phase == "home":
            self.outcome = "explored in part" if self.left else "explored"
        elif self._phase != "explore":
            self._go_on()
            self._choose(pose)
        elif self._target is not None and not self._at_viewpoint:
            # It is not seen yet, or the look that saw it would have chosen another.
            self._at_viewpoint, self._planned = True, False
            self._heading, self._turn_left = pose.theta, self._turn

    def _looked_around(self, pose: Pose) -> None:
        if self._phase == "home":
            if not self._go_nearer(pose) and not self._retrace(pose):
                self.outcome = "goal unreachable"
            return
        if self._phase != "explore":
            self._go_on()
        elif self._target is not None:
            self._note_failure(pose)
        self._choose(pose)

    def _go_nearer(self, pose: Pose) -> bool:
        """Head for what only the inflation closes on the way home, to look again; whether that is worth another try."""
        assert self._view is not None
        cost = self._ways(pose)
        before = frontier.before_gap(cost, self._ways_without_clearance(pose), *self._view.cell(self._home))
        if before is None or self._approaches == self._config.explore.tries:
            return False
        self._approaches += 1
        self._phase = "nearer"
        self._head_for(self._view.point(*before), pose)
        return True

    def _retrace(self, pose: Pose) -> bool:
        """Head home over where the robot has been, with less clearance; whether that is another try."""
        if self._retraces:
            return False
        assert self._grid is not None
        self._retraces = True
        self._take_in(self._grid, pose)
        self._head_for(self._home, pose)
        return self._planned

    def _got_stuck(self, pose: Pose) -> None:
        if self._stuck_before or self._phase == "home":
            self.outcome = "stuck"
            return
        self._stuck_before = True
        self._looked_around(pose)

    def _note_failure(self, pose: Pose) -> None:
        """Count what was not seen, though it was looked at."""
        assert self._view is not None and self._target is not None
        view = self._view
        failed = np.zeros(view.unseen.shape, dtype=np.bool_)
        cells = self._target.cells - view.first
        failed[cells[:, 0], cells[:, 1]] = True
        if self._at_viewpoint:
            failed |= frontier.cells_in_view(view.obstacles, view.dark, *view.cell(pose.position), self._near)
            self._tried[failed & view.dark] += 1
        if not self._at_viewpoint or self._target.hidden:
            # Looks from before the gap have not opened it, or no way led even there.
            looked = self._config.explore.tries if self._at_viewpoint else 0
            self._tried[failed & view.dark & (self._tried >= looked)] = _NO_WAY
        self._at_viewpoint = False

    def _is_seen(self, target: Target) -> bool:
        assert self._view is not None
        cells = target.cells - self._view.first
        left = np.count_nonzero(self._view.dark[cells[:, 0], cells[:, 1]])
        return bool(left <= _MOSTLY * len(cells))

    def _ways(self, pose: Pose) -> Costs:
        """Lengths of the ways from the robot over what was seen and is not blocked."""
        assert self._view is not None and self._space is not None
        view = self._view
        free = self._space.nearest_free(pose.position, 0.5)
        here = view.cell(pose.position if free is None else free)
        return frontier.ways(view.seen & ~view.blocked, view.blocked, *here)

    def _choose(self, pose: Pose) -> None:
        """Head for the view that is worth most, or home when none is left."""
        self._at_viewpoint, self._planned, self._heading = False, False, None
        self._target = self._next_target(pose)
        if self._target is None and self._take_up_again(pose):
            self._target = self._next_target(pose)
        if self._target is None:
            self._target = self._target_beyond(pose)
        assert self._view is not None
        view = self._view
        if self._target is not None:
            row, col = self._target.viewpoint
            self._head_for(view.point(row - view.first[0], col - view.first[1]), pose)
            return
        fitting = self._ways_without_clearance(pose)
        self.left = places_left(view, self._tried, self._ways(pose), fitting, self._reach, self._config.explore)
        if self._config.explore.return_home:
            self._phase = "home"
            self._head_for(self._home, pose)
        else:
            self.outcome = "explored in part" if self.left else "explored"

    def _next_target(self, pose: Pose) -> Target | None:
        """What is worth most of what is left to see; None if nothing is."""
        self._close_walls()
        assert self._view is not None
        view, tries = self._view, self._config.explore.tries
        # A part of the region may be in view only across its edge.
        beyond = max(1, round(self._beyond_m() / view.cell_m))
        # What was looked at and did not show is no reason to go farther.
        sought = view.unseen & ((self._tried < tries) | (self._tried == _NO_WAY)) if self._level > 0 else view.unseen
        wanted = ndimage.binary_dilation(sought, iterations=beyond, mask=view.dark) & (self._tried < tries)
        edge = frontier.frontier_cells(frontier.connected(view.free, *view.cell(pose.position)), wanted)
        wanted, edge = frontier.without_dust(wanted, edge, self._config.explore.dust * np.count_nonzero(view.seen))
        pieces = frontier.clusters(edge, max(1, round(_TILE_M / view.cell_m)))
        if not pieces:
            return None
        prospect = Prospect(view, self._ways(pose), wanted, pieces, self._reach)
        if self._config.explore.method == "random":
            target = prospect.drawn(self._rng)
        else:
            target = prospect.best(pose, self._sigma, self._rays, self._config)
        return target or prospect.nearest_hidden(self._ways_without_clearance(pose))

    def _beyond_m(self) -> float:
        """How far outside the region something unseen counts; farther than the laser reaches nothing in it shows."""
        return min(_BEYOND_M[self._level], self._config.laser.max_range)

    def _target_beyond(self, pose: Pose) -> Target | None:
        """What is left to see when the robot may go farther outside the region: there may be a way round into it."""
        assert self._grid is not None
        before = self._level
        while self._level < len(_BEYOND_M) - 1:
            self._level += 1
            self._take_in(self._grid, pose)
            target = self._next_target(pose)
            if target is not None:
                return target
        self._level = before
        self._take_in(self._grid, pose)
        self._close_walls()
        return None

    def _take_up_again(self, pose: Pose) -> bool:
        """Want what no way led to once more where it can be seen from by now: noise may have closed the way for a time.

        Whether there is any such place.
        """
        assert self._view is not None
        view, explore = self._view, self._config.explore
        if self._taken_up == explore.tries:
            return False
        self._taken_up += 1
        lost = view.unseen & (self._tried == _NO_WAY)
        labels, _ = ndimage.label(lost)
        cost = self._ways(pose)
        again: set[int] = set()
        for cells in frontier.clusters(frontier.frontier_cells(view.free, lost), max(1, round(_TILE_M / view.cell_m))):
            if frontier.viewpoint(cost, view.obstacles, *frontier.centre_cell(cells), self._reach) >= 0:
                again.update(labels[tuple(frontier.beside(lost, cells).T)].tolist())
        self._tried[np.isin(labels, list(again))] = explore.tries - 1
        return bool(again)

    def _ways_without_clearance(self, pose: Pose) -> Costs:
        """Ways of a robot that comes as near to an obstacle cell's centre as its radius."""
        assert self._view is not None
        view = self._view
        touching: NDArray[np.float64] = ndimage.distance_transform_edt(~view.obstacles)
        blocked = touching * view.cell_m < self._radius_m
        here = view.cell(pose.position)
        blocked[here] = False
        return frontier.ways(view.seen & ~blocked, blocked, *here)

    def _path_is_free(self, pose: Pose) -> bool:
        assert self._space is not None
        return path_is_free(self._space, self._follower.remaining(pose))
