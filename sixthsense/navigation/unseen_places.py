"""The places that an exploration leaves unseen, with the reasons."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from scipy import ndimage

from sixthsense.navigation.frontier import centre_cell, frontier_clusters
from sixthsense.navigation.regions import Cells, frontier_cells
from sixthsense.navigation.view_planner import ViewPlanner
from sixthsense.navigation.visibility import mark_visible, nearest_viewpoint
from sixthsense.slam.mapping.freespace import Bools

Reason = Literal["cut off by inflation only", "unreachable", "gave up"]

_SMALL_PLACES_FRACTION = 0.003  # of the area seen: small places are listed when together they exceed this


@dataclass(frozen=True, slots=True)
class UnseenPlace:
    """A place that an exploration has left unseen."""

    x: float
    """world frame, metres"""
    y: float
    """world frame, metres"""
    area_m2: float
    """area there that was not seen and would be visible from the cells that were, according to the map"""
    reason: Reason
    """cut off by inflation only: the robot would fit through without the clearance; unreachable: it would not fit;
    gave up: the robot looked at it from its viewpoints and did not see it"""


def as_reason(text: str) -> Reason:
    """The reason of that name; ValueError listing the known ones for any other."""
    reasons: tuple[Reason, ...] = get_args(Reason)
    for reason in reasons:
        if text == reason:
            return reason
    raise ValueError(f"reason: found {text!r}, allowed: {', '.join(reasons)}")


def unseen_places(planner: ViewPlanner) -> list[UnseenPlace]:
    """The connected unseen regions at a frontier that were given up, the largest first."""
    window, explore, reach = planner.window, planner.config.explore, planner.sensor.reach
    failed_views = planner.failed_views
    given_up = window.unseen & (failed_views >= explore.tries)
    edge = frontier_cells(window.free, given_up)
    if not edge.any():
        return []
    without_clearance = planner.distances_without_clearance().reachable
    labels, _ = ndimage.label(window.unseen)
    boxes = ndimage.find_objects(labels)
    reachable, obstacles = planner.distances.reachable, window.obstacles
    places = []
    for label in np.unique(labels[given_up & frontier_cells(window.unseen, edge)]).tolist():
        part = tuple(slice(max(span.start - 1, 0), span.stop + 1) for span in boxes[label - 1])
        corner = part[0].start, part[1].start
        region = labels[part] == label
        beside = np.argwhere(edge[part] & frontier_cells(edge[part], region)) + np.array(corner)
        row, col = centre_cell(beside)
        if nearest_viewpoint(reachable, obstacles, row, col, reach) >= 0:
            reason: Reason = "gave up"
            area = int(np.count_nonzero(given_up[part] & region))
        else:
            is_near = nearest_viewpoint(without_clearance, obstacles, row, col, reach) >= 0
            reason = "cut off by inflation only" if is_near else "unreachable"
            area = _visible_area(planner, beside, corner, region)
        x, y = window.point(row, col)
        places.append(UnseenPlace(float(x), float(y), float(area) * window.cell_m**2, reason))
    places.sort(key=lambda place: -place.area_m2)
    small = sum(place.area_m2 for place in places if place.area_m2 < explore.least_area_m2)
    if small > _SMALL_PLACES_FRACTION * np.count_nonzero(window.seen) * window.cell_m**2:
        return places
    return [place for place in places if place.area_m2 >= explore.least_area_m2]


def _visible_area(planner: ViewPlanner, beside: Cells, corner: tuple[int, int], unseen: Bools) -> int:
    """How many of the `unseen` cells are visible from the cells (N, 2) beside them.

    `unseen` (H, W) is the part of the window from `corner` on that holds them all. The inside of a wall is unseen, too,
    and a hole in its face connects it to all other walls' insides.
    """
    row, col = corner
    obstacles = planner.window.obstacles[row : row + unseen.shape[0], col : col + unseen.shape[1]].copy()
    visible = np.zeros_like(unseen)
    for cells in frontier_clusters(beside, planner.tile):
        at = centre_cell(cells)
        mark_visible(visible, obstacles, unseen, at[0] - row, at[1] - col, planner.sensor.reach)
    return int(np.count_nonzero(visible))
