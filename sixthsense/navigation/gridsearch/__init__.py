"""All searches over the cells of a grid: distances, shortest paths and connected cells.

Masks are (H, W), indexed [row = y, col = x]. Steps lead to the eight neighbours and cut no corner of a blocked cell.

There are two shortest-path searches:

- `CostTree` searches towards one cell, in float64, and reuses the result of the search before. A* plans with it.
- `costs_from` has the costs from one cell to all others where cells have prices, in whole numbers.
"""

from __future__ import annotations

from sixthsense.navigation.gridsearch.cost_tree import CostTree, shortest_path
from sixthsense.navigation.gridsearch.prices import Costs, Prices, cheapest_way, costs_from
from sixthsense.navigation.gridsearch.reached import Reached, far_from

__all__ = [
    "CostTree",
    "Costs",
    "Prices",
    "Reached",
    "cheapest_way",
    "costs_from",
    "far_from",
    "shortest_path",
]
