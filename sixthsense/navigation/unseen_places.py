"""The places that an exploration leaves unseen, with the reasons."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass
from typing import Literal, get_args

import numba
import numpy as np
from scipy import ndimage

from sixthsense.core.geometry import Array
from sixthsense.navigation.frontier import adjacent_cells, centre_cell, frontier_clusters
from sixthsense.navigation.gridsearch import costs_from
from sixthsense.navigation.regions import frontier_cells, in_large_regions
from sixthsense.navigation.view_planner import Candidates, ViewPlanner
from sixthsense.navigation.viewpoints import Cell, Viewpoints
from sixthsense.navigation.visibility import mark_visible
from sixthsense.slam.mapping.freespace import Bools
from sixthsense.slam.mapping.inflation import too_near

Reason = Literal["cut off by inflation only", "unreachable", "gave up"]

LEAST_AREA_M2 = 0.02
"""a place counts as left unseen if it is at least this large: eight cells, which noise at edges does not reach"""
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
    places, gaps = [], None
    for reason, mask in visible.items():
        labels, _ = ndimage.label(mask & hidden)
        hidden &= ~mask
        for k, box in enumerate(ndimage.find_objects(labels)):
            cells = np.argwhere(labels[box] == k + 1) + np.array([span.start for span in box])
            centre = centre_cell(cells)
            x, y = view.point(*centre)
            gap_m = None
            if reason != "gave up":
                gaps = gaps or _Gaps(planner)
                gap_m = gaps.width_m(min(seen_from[reason], key=lambda cell: math.dist(cell, centre)))
            places.append(UnseenPlace(float(x), float(y), len(cells) * view.cell_m**2, reason, gap_m))
    places.sort(key=lambda place: -place.area_m2)
    small = sum(place.area_m2 for place in places if place.area_m2 < LEAST_AREA_M2)
    if small > _SMALL_PLACES_FRACTION * np.count_nonzero(view.seen) * view.cell_m**2:
        return places
    return [place for place in places if place.area_m2 >= LEAST_AREA_M2]


class _Gaps:
    """How wide the narrowest gap is on the widest way from the cells in reach to each other one."""

    def __init__(self, planner: ViewPlanner) -> None:
        from scipy.spatial import cKDTree  # here, since a run that begins need not wait for it

        view = planner.view
        self._points, self._reachable = view.grid.obstacle_points(view.frame), planner.reachable
        self._cell_m, self._first = view.cell_m, view.first
        rows, cols = np.nonzero(view.free)
        centres = np.stack([(self._first[1] + cols + 0.5), (self._first[0] + rows + 0.5)], axis=1) * self._cell_m
        self._away = np.zeros(view.shape)
        self._away[rows, cols] = cKDTree(self._points).query(centres)[0] if len(self._points) else math.inf
        self._half = widest_ways(self._away, self._reachable)
        self._widths: dict[float, float] = {}

    def width_m(self, cell: Cell) -> float | None:
        """That on the way to a cell, metres; None without a way, or where one of its sides was not seen."""
        half = float(self._half[cell])
        if half == 0.0 or len(self._points) == 0:
            return None
        if half not in self._widths:
            row, col = _bottleneck(self._away, half, self._reachable)
            middle = (np.array([self._first[1] + col, self._first[0] + row]) + 0.5) * self._cell_m
            self._widths[half] = _width_m(self._points, middle)
        return None if math.isinf(self._widths[half]) else self._widths[half]


@numba.njit(cache=True, error_model="numpy")
def widest_ways(away: Array, sources: Bools) -> Array:
    """(H, W) largest of the least values of `away` (H, W), at least 0, on the ways from the `sources` to each cell.

    Ways lead from cell to cell, also across corners, over positive values. Cells are settled in the order of Dijkstra,
    the largest first.
    """
    height, width = away.shape
    found, queue = np.zeros((height, width)), [(0.0, 0)]
    for row in range(height):
        for col in range(width):
            if sources[row, col] and away[row, col] > 0.0:
                found[row, col] = away[row, col]
                heapq.heappush(queue, (-away[row, col], row * width + col))
    while queue:
        value, cell = heapq.heappop(queue)
        row, col = cell // width, cell % width
        if -value < found[row, col]:
            continue
        for r in range(max(row - 1, 0), min(row + 2, height)):
            for c in range(max(col - 1, 0), min(col + 2, width)):
                least = min(-value, away[r, c])
                if least > found[r, c]:
                    found[r, c] = least
                    heapq.heappush(queue, (-least, r * width + c))
    return found


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
