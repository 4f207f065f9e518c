"""Checks of parts of your own against the contract of their seam."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sixthsense.core.landmarks import Kind, Observation
from sixthsense.navigation.explorer import Explorer
from sixthsense.navigation.planners import PlannerFactory
from sixthsense.slam.estimators import EstimatorFactory
from sixthsense.slam.features import Extractor
from sixthsense.slam.front_end import FrontEnd
from sixthsense.slam.scans.place_search import PlaceSearch
from sixthsense.testing import contract, edges, posterior, walls
from sixthsense.testing.estimation import make
from sixthsense.testing.laws import Verdicts, verdicts_of

INTERFACE = (*contract.LAWS, *edges.LAWS, *walls.LAWS, *walls.WALLS)
LAWS = (*posterior.LAWS, *INTERFACE, *edges.VALIDATION, *walls.VALIDATION)
"""of estimators"""


def check_estimator(estimator: str | EstimatorFactory, validation: bool = True) -> Verdicts:
    """Test an estimator, named or its class, against all laws of the `Estimator` contract, as the package's own.

    Statistics come first: mean and covariance beside those of batch least squares. What an estimator does with invalid
    input comes last, does not count for `kept`, and is left out without `validation`. If the estimator raises
    NotImplementedError for the first observation of a wall, the laws of walls are skipped.
    """
    return verdicts_of(LAWS, estimator, _refusal_of_walls(estimator), validation)


def check_planner(planner: str | PlannerFactory, validation: bool = True) -> Verdicts:
    """Test a planner, named or its class, against all laws of the `Planner` contract, on maps with random blocks."""
    from sixthsense.testing.navigation import PLANNER_LAWS, PLANNER_VALIDATION

    return verdicts_of((*PLANNER_LAWS, *PLANNER_VALIDATION), planner, validation=validation)


def check_explorer(explorer: str | Callable[..., Explorer]) -> Verdicts:
    """Test an explorer, named or its class, against all laws of the `Explorer` contract, in two rooms with a door."""
    from sixthsense.testing.navigation import EXPLORER_LAWS

    return verdicts_of(EXPLORER_LAWS, explorer)


def check_extractor(extractor: str | Callable[..., Extractor]) -> Verdicts:
    """Test an extractor, named or its class, against all laws of the `Extractor` contract, in a room with free ends."""
    from sixthsense.testing.perception import EXTRACTOR_LAWS, EXTRACTOR_STATISTICS

    return verdicts_of((*EXTRACTOR_STATISTICS, *EXTRACTOR_LAWS), extractor)


def check_front_end(front_end: str | Callable[..., FrontEnd]) -> Verdicts:
    """Test a front end, named or its class, against all laws of the `FrontEnd` contract, on drives with isam2."""
    from sixthsense.testing.perception import FRONT_END_LAWS, FRONT_END_STATISTICS

    return verdicts_of((*FRONT_END_STATISTICS, *FRONT_END_LAWS), front_end)


def check_place_search(place_search: str | Callable[..., PlaceSearch]) -> Verdicts:
    """Test a place search, named or its class, against all laws of the `PlaceSearch` contract, in three rooms."""
    from sixthsense.testing.places import LAWS as LAWS_OF_PLACES
    from sixthsense.testing.places import STATISTICS

    return verdicts_of((*STATISTICS, *LAWS_OF_PLACES), place_search)


def _refusal_of_walls(estimator: str | EstimatorFactory) -> str:
    """The error with which an estimator refuses the first observation of a wall; empty if it does not."""
    try:
        make(estimator).update({0: Observation(Kind.WALL, np.array([0.5, -2.0]), 0.01 * np.eye(2), (-1.0, 1.0))})
    except NotImplementedError as error:
        return f"{type(error).__name__}: {error}"
    except Exception:  # the laws find it and name it
        return ""
    return ""
