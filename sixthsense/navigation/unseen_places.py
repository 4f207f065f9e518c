"""The places that an exploration leaves unseen, with the reasons."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from scipy import ndimage

from sixthsense.navigation.frontier import Cells, centre_cell, frontier_cells, frontier_clusters
from sixthsense.navigation.view_planner import ViewPlanner
from sixthsense.navigation.visibility import nearest_viewpoint, visible_cells
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
    without_clearance = planner.cost_without_clearance()
    labels, _ = ndimage.label(window.unseen)
    places = []
    for label in np.unique(labels[given_up & frontier_cells(window.unseen, edge)]):
        beside = np.argwhere(edge & frontier_cells(edge, labels == label))
        row, col = centre_cell(beside)
        reason: Reason = "unreachable"
        area = _visible_area(planner, beside, labels == label)
        if nearest_viewpoint(planner.cost, window.obstacles, row, col, reach) >= 0:
            reason = "gave up"
            area = int(np.count_nonzero(given_up & (labels == label)))
        elif nearest_viewpoint(without_clearance, window.obstacles, row, col, reach) >= 0:
            reason = "cut off by inflation only"
        x, y = window.point(row, col)
        places.append(UnseenPlace(float(x), float(y), float(area) * window.cell_m**2, reason))
    places.sort(key=lambda place: -place.area_m2)
    small = sum(place.area_m2 for place in places if place.area_m2 < explore.least_area_m2)
    if small > _SMALL_PLACES_FRACTION * np.count_nonzero(window.seen) * window.cell_m**2:
        return places
    return [place for place in places if place.area_m2 >= explore.least_area_m2]


def _visible_area(planner: ViewPlanner, beside: Cells, unseen: Bools) -> int:
    """How many of the `unseen` cells (H, W) are visible from the cells (N, 2) beside them.

    The inside of a wall is unseen, too, and a hole in its face connects it to all other walls' insides.
    """
    window, visible = planner.window, np.zeros_like(unseen)
    edge = np.zeros_like(unseen)
    edge[tuple(beside.T)] = True
    for cells in frontier_clusters(edge, planner.tile):
        visible |= visible_cells(window.obstacles, unseen, *centre_cell(cells), planner.sensor.reach)
    return int(np.count_nonzero(visible))
