"""Unseen places that only cells out of reach show: the view to try for one, and all that it tries."""

from __future__ import annotations

import numpy as np

from sixthsense.navigation.frontier import adjacent_cells, centre_cell
from sixthsense.navigation.gridsearch import Distances, cell_before_gap
from sixthsense.navigation.known_views import View
from sixthsense.navigation.map_window import Target
from sixthsense.navigation.regions import Cells
from sixthsense.navigation.view_planner import Candidates, ViewPlanner
from sixthsense.navigation.viewpoints import Cell
from sixthsense.navigation.visibility import visible_cells
from sixthsense.slam.mapping.freespace import Bools

_MAX_VIEWS = 24  # so many views are compared, those of the nearest frontiers


def nearest_shown_elsewhere(planner: ViewPlanner, candidates: Candidates) -> Target | None:
    """The nearest target of the clusters that only cells out of reach show, though the robot would fit there.

    If a reachable cell has the cluster in view, past the edge of an obstacle perhaps, it is looked at from there, else
    from the last reachable cell before a gap that only the clearance closes, or from as near as possible. None if there
    is no such cluster.
    """
    if not candidates.clusters:
        return None
    gain, reachable = planner.gain, planner.distances.reachable
    without_clearance = planner.distances_without_clearance()
    elsewhere = (planner.fitting_cells() | without_clearance.reachable) & ~reachable
    views_elsewhere, beyond_gaps = gain.viewpoints(elsewhere), gain.viewpoints(without_clearance.reachable)
    places = np.argwhere(reachable)
    targets: list[Target] = []
    for k in planner.by_distance(candidates.clusters):
        cells, centre = candidates.clusters[k], centre_cell(candidates.clusters[k])
        if len(targets) == _MAX_VIEWS:
            break
        if planner.view_beside(candidates.wanted, cells) is not None or _is_hidden(planner, centre):
            continue  # nothing to see, or dust
        there = views_elsewhere.nearest(centre)
        if there is None or gain.shown(candidates.wanted, there, centre) == 0:
            planner.known.add(centre, View(None, 0, int(gain.sensor.reach), nowhere=True))
            continue
        view = planner.viewpoints.nearest(centre)
        at = view or _gap_to(planner, beyond_gaps.nearest(centre), without_clearance) or _nearest(places, centre)
        targets.append(planner.target_of(candidates.wanted, cells, at, occluded=view is None))
    away = [planner.distances.to(*target.viewpoint_in(planner.window)) for target in targets]
    return targets[int(np.argmin(away))] if targets else None


def cells_approached_at(planner: ViewPlanner, candidates: Candidates, here: tuple[int, int]) -> Bools:
    """(H, W) the wanted cells beside clusters in no reachable cell's view that would be approached where a view looks.

    A view from the cell `here` has looked, without a gap between two beams, at the gaps that it has in sight, and at
    all that leads through them.
    """
    window, reachable = planner.window, planner.distances.reachable
    without_clearance, places = planner.distances_without_clearance(), np.argwhere(reachable)
    beyond_gaps = planner.gain.viewpoints(without_clearance.reachable)
    looked_at = visible_cells(window.obstacles, reachable, *here, planner.gain.sensor.gapless_reach)
    looked_at[here] = True
    approached = np.zeros_like(candidates.wanted)
    for cells in candidates.clusters:
        centre = centre_cell(cells)
        if _is_hidden(planner, centre) or planner.viewpoints.nearest(centre) is not None:
            continue
        gap = _gap_to(planner, beyond_gaps.nearest(centre), without_clearance)
        if looked_at[gap or _nearest(places, centre)]:
            approached[tuple(adjacent_cells(candidates.wanted, cells).T)] = True
    return approached


def _is_hidden(planner: ViewPlanner, cell: Cell) -> bool:
    """Whether it is remembered that a cell is seen from nowhere."""
    known = planner.known.get(cell)
    return known is not None and known.nowhere


def _gap_to(planner: ViewPlanner, view: tuple[int, int] | None, without_clearance: Distances) -> tuple[int, int] | None:
    """The reachable cell before the gap on the way to a view; None if there is no such way."""
    if view is None:
        return None
    return cell_before_gap(planner.distances.reachable, without_clearance.to_all(), *view)


def _nearest(places: Cells, cell: tuple[int, int]) -> tuple[int, int]:
    """The nearest of `places` (N, 2) to a cell."""
    row, col = places[int(np.argmin(((places - cell) ** 2).sum(axis=1)))].tolist()
    return row, col
