"""What an exploration looks at next and from where, and what it leaves unseen."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sixthsense.config import Config, ExploreConfig
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.navigation import frontier
from sixthsense.navigation.frontier import Cells, Costs
from sixthsense.navigation.navigate import Place, Reason
from sixthsense.navigation.unseen import Target, View
from sixthsense.slam.mapping.freespace import Bools

_DEEP_M = 3.0  # how far into the unknown a view is expected to reach
_VIEWS = 24  # so many views are compared, those of the nearest frontiers
_SMALL = 0.003  # of the area seen: small places that are more than that together count


@dataclass(frozen=True, slots=True, eq=False)
class Prospect:
    """What is left to see, in pieces, and the ways to look at it."""

    view: View
    """the map within bounds"""
    cost: Costs
    """(H, W) lengths of the ways from the robot, in cells"""
    wanted: Bools
    """(H, W) unseen cells to be seen"""
    pieces: list[Cells]
    """frontiers beside them, (N, 2) each, row and col in the view"""
    reach: float
    """how far away a cell is seen, in cells"""

    def best(self, pose: Pose, sigma_m: float, rays: int, config: Config) -> Target | None:
        """The target that shows most for the time it takes, of those that are in view from somewhere.

        `sigma_m` is the position's largest; `rays` are cast about a viewpoint to see what it would show.
        """
        view, explore, robot = self.view, config.explore, config.robot
        stamp = np.zeros(self.wanted.shape, dtype=np.int64)
        deep = round(_DEEP_M / view.cell_m)
        # The surer the robot is of where it is, the farther it dares.
        caution = (1.0 + sigma_m / explore.revisit_sigma_m) * view.cell_m / robot.speed
        here = view.cell(pose.position)
        best: tuple[float, Target] | None = None
        compared = 0
        away = [math.dist(here, frontier.centre_cell(cells)) for cells in self.pieces]
        for mark in np.argsort(away, kind="stable").tolist():
            if compared == _VIEWS:
                break  # what is farther is hardly worth more
            target = self.target_beside(self.pieces[mark])
            if target is None:
                continue
            compared += 1
            row, col = target.viewpoint[0] - view.first[0], target.viewpoint[1] - view.first[1]
            shown = frontier.gain(view.obstacles, self.wanted, row, col, rays, self.reach, deep, stamp, mark + 1)
            area = max(shown, len(target.cells)) * view.cell_m**2
            ahead = view.point(row, col) - pose.position
            turn = abs(wrap_angle(math.atan2(ahead[1], ahead[0]) - pose.theta)) if ahead.any() else 0.0
            seconds = caution * float(self.cost[row, col]) + turn / robot.turn_rate
            worth = area**explore.gain_exponent / (seconds + explore.overhead_s)
            if best is None or worth > best[0]:
                best = worth, target
        return best[1] if best is not None else None

    def drawn(self, rng: np.random.Generator) -> Target | None:
        """A place drawn evenly from the largest unseen area that has one in view (the report's idea)."""
        labels, _ = ndimage.label(self.wanted)
        sizes = np.bincount(labels.ravel())
        found: dict[int, list[tuple[Cells, Target]]] = {}
        for cells in self.pieces:
            target = self.target_beside(cells)
            if target is not None:
                row, col = target.cells[0] - self.view.first
                found.setdefault(int(labels[row, col]), []).append((cells, target))
        if not found:
            return None
        label = max(found, key=lambda k: int(sizes[k]))
        area = np.argwhere(labels == label)
        place = area[rng.integers(len(area))]
        return min(found[label], key=lambda pair: float(((pair[0] - place) ** 2).sum(axis=1).min()))[1]

    def target_beside(self, cells: Cells) -> Target | None:
        """The target beside a piece of frontier, with its viewpoint; None if it is in view from nowhere."""
        beside = frontier.beside(self.wanted, cells)
        index = frontier.viewpoint(self.cost, self.view.obstacles, *frontier.centre_cell(cells), self.reach)
        if index < 0:
            return None
        first = self.view.first
        row, col = divmod(index, self.wanted.shape[1])
        return Target(beside + first, (row + first[0], col + first[1]), False)

    def nearest_hidden(self, fitting: Costs) -> Target:
        """Of what is in view from nowhere the nearest, and the reachable cell to look from.

        That is the last one before the gap that only the inflation closes, a door perhaps; where there is no such gap,
        the nearest one. `fitting` (H, W) are the ways without clearance. There must be a piece.
        """
        view = self.view
        reachable = np.argwhere(np.isfinite(self.cost))
        best: tuple[float, Target] | None = None
        for cells in self.pieces:
            centre = frontier.centre_cell(cells)
            beyond = frontier.viewpoint(fitting, view.obstacles, *centre, self.reach)
            gap = divmod(beyond, self.wanted.shape[1])
            before = frontier.before_gap(self.cost, fitting, *gap) if beyond >= 0 else None
            away = ((reachable - centre) ** 2).sum(axis=1)
            at = before if before is not None else reachable[int(np.argmin(away))]
            length = float(self.cost[at[0], at[1]])
            if best is None or length < best[0]:
                viewpoint = int(at[0]) + view.first[0], int(at[1]) + view.first[1]
                best = length, Target(frontier.beside(self.wanted, cells) + view.first, viewpoint, True)
        assert best is not None
        return best[1]


def places_left(
    view: View, tried: NDArray[np.uint8], cost: Costs, fitting: Costs, reach: float, explore: ExploreConfig
) -> list[Place]:
    """What is left unseen beside what was seen, in pieces, the largest first, with the reason.

    `tried` (H, W) is how often each cell was looked for; `cost` and `fitting` (H, W) are the ways with clearance and
    without; `reach` is how far away a cell is seen, in cells.
    """
    given_up = view.unseen & (tried >= explore.tries)
    edge = frontier.frontier_cells(view.free, given_up)
    if not edge.any():
        return []
    labels, _ = ndimage.label(view.unseen)
    places = []
    for label in np.unique(labels[given_up & frontier.frontier_cells(view.unseen, edge)]):
        beside = np.argwhere(edge & frontier.frontier_cells(edge, labels == label))
        row, col = frontier.centre_cell(beside)
        reason: Reason = "unreachable"
        area = np.count_nonzero(labels == label)
        if frontier.viewpoint(cost, view.obstacles, row, col, reach) >= 0:
            reason = "gave up"
            area = np.count_nonzero(given_up & (labels == label))
        elif frontier.viewpoint(fitting, view.obstacles, row, col, reach) >= 0:
            reason = "cut off by inflation only"
        x, y = view.point(row, col)
        places.append(Place(float(x), float(y), float(area) * view.cell_m**2, reason))
    places.sort(key=lambda place: -place.area_m2)
    small = sum(place.area_m2 for place in places if place.area_m2 < explore.least_area_m2)
    if small > _SMALL * np.count_nonzero(view.seen) * view.cell_m**2:
        return places  # small each, but not together
    return [place for place in places if place.area_m2 >= explore.least_area_m2]
