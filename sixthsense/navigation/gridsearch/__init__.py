"""All searches over the cells of a grid: distances, shortest paths and connected cells.

Masks are (H, W), indexed [row = y, col = x]. Steps lead to the eight neighbours and cut no corner of a blocked cell.

There are three shortest-path searches. Each breaks ties between paths of equal length in its own way, and a run's path
depends on it, so they are not merged:

- `Distances` searches from one cell to others, in float32, as far as it is asked. Exploration compares the distances.
- `CostTree` searches towards one cell, in float64, and reuses the result of the search before. A* plans with it.
- `path_to_nearest` searches a small window for the nearest of several cells, by scipy's Dijkstra.
"""

from __future__ import annotations

from sixthsense.navigation.gridsearch.connected import reachable_cells
from sixthsense.navigation.gridsearch.cost_tree import CostTree, shortest_path
from sixthsense.navigation.gridsearch.distances import Costs, Distances, cell_before_gap, geodesic_distances
from sixthsense.navigation.gridsearch.far import FarCells, far_from
from sixthsense.navigation.gridsearch.nearest import path_to_nearest
from sixthsense.navigation.gridsearch.reachable import ReachableCells

__all__ = [
    "CostTree",
    "Costs",
    "Distances",
    "FarCells",
    "ReachableCells",
    "cell_before_gap",
    "far_from",
    "geodesic_distances",
    "path_to_nearest",
    "reachable_cells",
    "shortest_path",
]
