"""The places that an exploration leaves unseen, with the reasons."""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from scipy import ndimage

from sixthsense.core.geometry import Array
from sixthsense.navigation.frontier import adjacent_cells, centre_cell, frontier_clusters
from sixthsense.navigation.gridsearch import costs_from
from sixthsense.navigation.regions import frontier_cells, in_large_regions
from sixthsense.navigation.view_planner import LEAST_AREA_M2, Candidates, ViewPlanner
from sixthsense.navigation.viewpoints import Cell, Viewpoints
from sixthsense.navigation.visibility import mark_visible
from sixthsense.slam.mapping.freespace import Bools
from sixthsense.slam.mapping.inflation import too_near

Reason = Literal["cut off by inflation only", "unreachable", "gave up"]

_OPPOSITE = -0.8  # cosine: the two sides of a gap are at an angle larger than this, those of a corner are not
_SMALL_PLACES_FRACTION = 0.003  # of the area seen: small places are listed when together they exceed this


@dataclass(frozen=True, slots=True)
class UnseenPlace:
    """A place that an exploration has left unseen."""

    x: float
    """world frame, metres"""
    y: float
    """world frame, metres"""
    area_m2: float
    """unseen area there that would be visible, according to the map, from the viewpoint that the reason tells"""
    reason: Reason
    """gave up: visible from where the robot can drive; it looked and did not see it; cut off by inflation only: visible
    from where it could drive if it might touch obstacle cells; unreachable: visible from where it would fit but cannot
    get to"""
    gap_m: float | None = None
    """how wide the narrowest gap on the widest way there is, metres; None where it can be reached, or where none was
    seen"""


def as_reason(text: str) -> Reason:
    """The reason of that name; ValueError listing the known ones for any other."""
    reasons: tuple[Reason, ...] = get_args(Reason)
    for reason in reasons:
        if text == reason:
            return reason
    raise ValueError(f"reason: found {text!r}, allowed: {', '.join(reasons)}")


def unseen_places(planner: ViewPlanner, candidates: Candidates) -> list[UnseenPlace]:
    """The connected unseen areas that would be visible from where the robot fits, the largest first.

    They were given up, or are of the `candidates` and in view of no cell in reach.

    A line of sight counts if it passes no opaque cell.
    """
    view = planner.view
    unseen = view.unseen
    given_up = unseen & view.given_up()
    for cells in candidates.clusters:
        if planner.viewpoints.nearest(centre_cell(cells)) is None:  # there was nowhere to look from
            given_up[tuple(adjacent_cells(candidates.wanted, cells).T)] = True
    edge = np.argwhere(frontier_cells(view.free, given_up))
    edge = edge[in_large_regions(view.free, edge, planner.glimpsed_cells(), view.cell(planner.pose.position))]
    clusters = frontier_clusters(edge, planner.tile, np.array(view.first))
    if not clusters:
        return []
    reach = planner.gain.sensor.reach
    viewpoints = {
        reason: Viewpoints(allowed, view.obstacles, reach) for reason, allowed in _viewpoints(planner).items()
    }
    hidden = unseen.copy()
    visible = {reason: np.zeros_like(hidden) for reason in viewpoints}
    seen_from: dict[Reason, list[Cell]] = {reason: [] for reason in viewpoints}
    for centre in map(centre_cell, clusters):
        for reason, allowed in viewpoints.items():
            cell = allowed.nearest(centre)
            if cell is not None and planner.gain.shown(hidden, cell, centre, 0) > 0:
                mark_visible(visible[reason], view.opaque, hidden, *cell, reach)
                seen_from[reason].append(cell)
                break
    places = []
    for reason, mask in visible.items():
        labels, _ = ndimage.label(mask & hidden)
        hidden &= ~mask
        for k, box in enumerate(ndimage.find_objects(labels)):
            cells = np.argwhere(labels[box] == k + 1) + np.array([span.start for span in box])
            centre = centre_cell(cells)
            x, y = view.point(*centre)
            gap_m = None
            if reason != "gave up":
                nearest = min(seen_from[reason], key=lambda cell: math.dist(cell, centre))
                gap_m = _gap_m(planner, nearest)
            places.append(UnseenPlace(float(x), float(y), len(cells) * view.cell_m**2, reason, gap_m))
    places.sort(key=lambda place: -place.area_m2)
    small = sum(place.area_m2 for place in places if place.area_m2 < LEAST_AREA_M2)
    if small > _SMALL_PLACES_FRACTION * np.count_nonzero(view.seen) * view.cell_m**2:
        return places
    return [place for place in places if place.area_m2 >= LEAST_AREA_M2]


def _gap_m(planner: ViewPlanner, cell: Cell) -> float | None:
    """How wide the narrowest gap is on the widest way from the cells in reach to another one, m; None without a way."""
    from scipy.spatial import cKDTree  # here, since a run that begins need not wait for it

    view = planner.view
    points = view.grid.obstacle_points(view.frame)
    if len(points) == 0:
        return None
    obstacles = cKDTree(points)
    rows, cols = np.nonzero(view.free)
    centres = np.stack([(view.frame.left + cols + 0.5), (view.frame.top + rows + 0.5)], axis=1) * view.cell_m
    away = np.zeros(view.shape)
    away[rows, cols] = obstacles.query(centres)[0]

    def is_way(half: float) -> bool:
        parts, _ = ndimage.label(away >= half, np.ones((3, 3)))
        return bool((parts[planner.reachable & (parts > 0)] == parts[cell]).any())

    halves = np.unique(away[(away > 0.0) & (away <= away[cell])])[::-1]
    k = bisect.bisect_left(halves, True, key=is_way)
    if k == len(halves):
        return None
    row, col = _bottleneck(away, halves[k], planner.reachable)
    width_m = _width_m(points, (np.array([view.frame.left + col, view.frame.top + row]) + 0.5) * view.cell_m)
    return None if math.isinf(width_m) else width_m


def _bottleneck(away: Array, half: float, reachable: Bools) -> Cell:
    """The cell at this distance from obstacles beside two parts that only such cells connect; best one of the robot's.

    `away` (H, W) are the distances of free cells to the nearest obstacle, 0 elsewhere.
    """
    around = np.ones((3, 3), dtype=np.bool_)
    wide, count = ndimage.label(away > half, around)
    own = np.zeros(count + 1, dtype=np.bool_)
    own[np.unique(wide[reachable])] = True
    narrow, _ = ndimage.label(away == half, around)
    found: list[tuple[bool, bool, Cell]] = []
    for j, part in enumerate(ndimage.find_objects(narrow), 1):
        rows, cols = (slice(max(one.start - 1, 0), one.stop + 1) for one in part)
        beside = np.unique(wide[rows, cols][ndimage.binary_dilation(narrow[rows, cols] == j, around)])
        beside = beside[beside > 0]
        first = np.argwhere(narrow[part] == j)[0] + (part[0].start, part[1].start)
        found.append((len(beside) < 2, not own[beside].any(), (int(first[0]), int(first[1]))))
    return min(found)[2]


def _width_m(points: Array, middle: Array) -> float:
    """The distance, m, between the nearest of points (N, 2) to a (2,) place and the nearest opposite; inf if none."""
    near = points - middle
    away = np.linalg.norm(near, axis=1)
    first = int(np.argmin(away))
    opposite = near @ near[first] < _OPPOSITE * away * away[first]
    return float(np.linalg.norm(near[opposite] - near[first], axis=1).min(initial=math.inf))


def _viewpoints(planner: ViewPlanner) -> dict[Reason, Bools]:
    """(H, W) the cells from which something may be seen, by the reason why it has not been, the best first."""
    view, here = planner.view, planner.view.cell(planner.pose.position)
    fitting = view.seen & ~too_near(view.obstacles, view.radius)
    without_clearance = costs_from(fitting.astype(np.uint8), *here) >= 0
    labels, _ = ndimage.label(fitting)
    large = np.bincount(labels.ravel()) >= planner.glimpsed_cells()
    elsewhere = fitting & large[labels] & ~without_clearance & ~planner.reachable
    return {"gave up": planner.reachable, "cut off by inflation only": without_clearance, "unreachable": elsewhere}
