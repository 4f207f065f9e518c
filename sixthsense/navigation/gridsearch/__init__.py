"""All searches over the cells of a grid: distances, shortest paths and connected cells.

Masks are (H, W), indexed [row = y, col = x]. Steps lead to the eight neighbours and cut no corner of a blocked cell.

There are three shortest-path searches:

- `geodesic_distances` has the lengths from one cell to all others, in float32.
- `CostTree` searches towards one cell, in float64, and reuses the result of the search before. A* plans with it.
- `costs_from` has the costs from one cell to all others where cells have prices, in whole numbers.
"""

from __future__ import annotations

from sixthsense.navigation.gridsearch.cost_tree import CostTree, shortest_path
from sixthsense.navigation.gridsearch.distances import far_from, geodesic_distances, reached_cells
from sixthsense.navigation.gridsearch.prices import Costs, Prices, cheapest_way, costs_from
from sixthsense.navigation.gridsearch.reached import Reached

__all__ = [
    "CostTree",
    "Costs",
    "Prices",
    "Reached",
    "cheapest_way",
    "costs_from",
    "far_from",
    "geodesic_distances",
    "reached_cells",
    "shortest_path",
]
